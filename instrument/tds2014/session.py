"""One open scope: what opening, closing, identity, events and plain text mean for every instrument here."""

from __future__ import annotations

from types import TracebackType
from typing import Self

import pyvisa

from instrument.dialogue.acquisition_time import AcquisitionTime
from instrument.dialogue.dialogue import Dialogue
from instrument.dialogue.identity import Identity
from instrument.dialogue.link import Link
from instrument.errors import InstrumentError, LinkError, ScopeEvent, SettingError
from instrument.facts import POINTS
from instrument.tds2014.front_panel import FrontPanel


class Session:
    """An open oscilloscope of the TDS1000/TDS2000 family; the base of `TDS2014`, which tells the parameters."""

    def __init__(
        self,
        resource_name: str,
        *,
        resource_manager: pyvisa.ResourceManager | None = None,
        baud_rate: int | None = None,
    ) -> None:
        link = Link(resource_name, resource_manager, baud_rate)
        try:
            self._dialogue = Dialogue(link)
        except BaseException:
            link.close()
            raise
        self._panel = FrontPanel(self._dialogue)
        self._timing: AcquisitionTime | None = None
        self._lock: str | None = None
        """What LOCk says outside our own exchanges, None if not known."""
        self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except InstrumentError as restoring:
            # What went wrong inside the block matters more than what it left behind.
            if error is None:
                raise
            error.add_note(f"besides, the scope's settings could not be put back: {restoring}")

    def close(self) -> None:
        """Put the front panel back as found and close the link; closing twice does nothing."""
        if self._closed:
            return
        self._closed = True
        try:
            self.restore()
        except LinkError:
            self._dialogue.link.close()  # asking a lost scope for more would only cost time
            raise
        finally:
            self._dialogue.close()

    @property
    def identity(self) -> Identity:
        """Manufacturer, model, serial number and firmware, as asked for on opening."""
        return self._dialogue.identity

    @property
    def resource_name(self) -> str:
        """The VISA resource name that was opened."""
        return self._dialogue.link.name

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels of this model, ``("CH1", "CH2", ...)``."""
        return tuple(f"CH{number}" for number in range(1, self.identity.channel_count + 1))

    def restore(self) -> None:
        """Put back every group of settings that was changed, as it was found."""
        self._forget()
        self._panel.restore()

    # ------------------------------------------------------------------ events and plain text

    def events(self) -> list[ScopeEvent]:
        """Read and empty the scope's event queue."""
        return self._dialogue.events()

    def query(self, text: str) -> str:
        """Send a query of your own and return its answer as text.

        Events that it causes without staying unanswered (a measurement that cannot be made, for example) are
        there for `events` until the next record is read.
        """
        self._dialogue.unread_events = True
        return ";".join(self._dialogue.ask(text, parts=None))

    def write(self, text: str) -> None:
        """Send commands of your own; raises `ScopeEvent` if the scope refuses them.

        What they change is not put back on closing.
        """
        self._forget()
        self._dialogue.command(text)

    # ------------------------------------------------------------------ inside

    def _channel(self, channel: str | int) -> str:
        name = f"CH{channel}" if isinstance(channel, int) else channel.strip().upper()
        if name not in self.channels:
            raise SettingError(
                f"{self.identity.model} has no channel {name}; choose one of {', '.join(self.channels)}"
            )
        return name

    def _forget(self) -> None:
        """Settings may have changed: what was derived from them must be read again."""
        self._timing = None
        self._lock = None
        self._dialogue.source = None

    def __repr__(self) -> str:
        return f"<{self.identity.model} at {self.resource_name}, {POINTS} points>"
