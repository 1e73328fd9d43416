"""One open scope: opening, closing, names, plain text, and what must be known again after settings changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import pyvisa

from instrument import scpi
from instrument.dialogue.dialogue import Dialogue
from instrument.dialogue.link import Link
from instrument.dialogue.persistence import Persistence, Tally
from instrument.errors import LinkError, NoTrigger, ScopeEvent, SettingError, TransferError
from instrument.facts import POINTS_PER_DIVISION
from instrument.tds2014.acquisition_time import AcquisitionTime
from instrument.tds2014.front_panel import FoundPanel, FrontPanel
from instrument.waveform import Waveform

T = TypeVar("T")

_TIMING_COMMANDS = (
    ":HORIZONTAL:MAIN:SCALE",
    ":ACQUIRE:MODE",
    ":ACQUIRE:NUMAVG",
    ":TRIGGER:MAIN:MODE",
    ":TRIGGER:MAIN:HOLDOFF:VALUE",
    ":TRIGGER:MAIN:TYPE",
    ":TRIGGER:MAIN:EDGE:SOURCE",
)


_HURRIED = 5.0  # s for which a lost link is tried again when somebody wants the program to end


class Session:
    """What the parts of `TDS2014` share: the dialogue with the scope and its front panel."""

    def __init__(
        self,
        resource_name: str,
        resource_manager: pyvisa.ResourceManager | None,
        baud_rate: int | None,
        persistence: Persistence | None = None,
    ) -> None:
        wanted = persistence or Persistence()
        link = Link(resource_name, resource_manager, baud_rate, wanted.clock)
        try:
            self.dialogue = Dialogue(link, wanted)
            self.panel = FrontPanel(self.dialogue)
            self.found: FoundPanel | None = self.panel.found() if wanted.careful else None
        except BaseException:
            link.close()
            raise
        self._timing: AcquisitionTime | None = None
        self.panel_is_back = False
        """Whether the front panel was put back on closing."""
        self._closed = False
        self._stepping = False

    def close(self) -> None:
        """Put the front panel back as found and close the link; closing twice does nothing."""
        if self._closed:
            return
        self._closed = True
        try:
            self.dialogue.let_late_messages_pass()
            self.restore()
            self.panel_is_back = True
        except LinkError:
            self.dialogue.link.close()  # asking a lost scope for more would only cost time
            raise
        finally:
            self.dialogue.close()

    def restore(self) -> None:
        """Put back every group of settings that was changed, as it was found."""
        self.forget()
        self.panel.restore()

    # ------------------------------------------------------------------ a link with faults

    @property
    def link_faults(self) -> Tally:
        """What it took so far to keep the link: exchanges repeated, connections, settings made again."""
        return self.dialogue.tally

    @property
    def front_panel_found(self) -> FoundPanel | None:
        """The front panel as it will be put back; None without persistence: groups are then read as needed."""
        return self.found

    def put_back_in_the_end(self, found: FoundPanel) -> None:
        """Put this front panel back on closing, not the one that was found: an earlier session could not do it."""
        self.found = found
        self.panel.put_back_in_the_end(found)

    def abandon(self) -> None:
        """Close the link and put nothing back, as when the program is killed."""
        self._closed = True
        self.dialogue.link.close()

    def hurry(self) -> None:
        """Somebody wants the program to end: a lost link is not waited for any longer."""
        patience = min(_HURRIED, self.dialogue.persistence.reconnect_for)
        self.dialogue.persistence = replace(self.dialogue.persistence, reconnect_for=patience)

    def step(self, work: Callable[[], T]) -> T:
        """Do something that can be done again as a whole, until it succeeds, as often as the persistence allows.

        After a fault the settings that records depend on are verified first, and made again where the scope has
        lost them. A step inside a step is part of it. Errors are those of `work`.
        """
        if self._stepping or not self.dialogue.persistence.careful:
            return work()
        self._stepping = True
        try:
            return self.dialogue.repeated(lambda: self._with_settings_held(work))
        finally:
            self._stepping = False

    def _with_settings_held(self, work: Callable[[], T]) -> T:
        while self.dialogue.settings_in_doubt():
            self.dialogue.in_doubt = False
            self.panel.hold()
            self.forget()
        before = self.dialogue.tally.repeated
        try:
            return work()
        except NoTrigger as missing:
            if self.dialogue.tally.repeated == before and not self.dialogue.in_doubt:
                raise
            # Perhaps it was the trigger's setting that was spoiled on its way.
            raise TransferError(f"{missing}; but there were faults on the link, so ask again") from missing

    # ------------------------------------------------------------------ events and plain text

    def events(self) -> list[ScopeEvent]:
        """Read and empty the scope's event queue."""
        return self.dialogue.events()

    def query(self, text: str) -> str:
        """Send a query of your own and return its answer as text.

        Events that it causes without staying unanswered (a measurement that cannot be made, for example) are
        there for `events` until the next record is read.
        """
        self.dialogue.unread_events = True
        return ";".join(self.dialogue.ask(text, parts=None))

    def write(self, text: str) -> None:
        """Send commands of your own; raises `ScopeEvent` if the scope refuses them.

        What they change is not put back on closing.
        """
        self.forget()
        self.dialogue.command(text)

    # ------------------------------------------------------------------ names

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels of this model, ``("CH1", "CH2", ...)``."""
        return tuple(f"CH{number}" for number in range(1, self.dialogue.identity.channel_count + 1))

    def channel(self, channel: str | int) -> str:
        """Name of a channel of this model; SettingError if it has none like that."""
        name = f"CH{channel}" if isinstance(channel, int) else channel.strip().upper()
        if name not in self.channels:
            raise SettingError(
                f"{self.dialogue.identity.model} has no channel {name}; choose one of {', '.join(self.channels)}"
            )
        return name

    def source(self, name: str | int) -> str:
        """A channel, MATH, or one of the references (as many as channels)."""
        word = str(name).strip().upper()
        references = [f"REF{letter}" for letter in "ABCD"[: len(self.channels)]]
        return word if word in ("MATH", *references) else self.channel(name)

    # ------------------------------------------------------------------ settings that change

    def before_changing(self, *groups: str) -> None:
        """Remember these groups of settings as they are, to be put back on closing."""
        self.panel.remember(*groups)
        self.forget()

    def before_changing_all(self) -> None:
        """Remember the whole setup, to be put back on closing."""
        self.panel.remember_all()
        self.forget()

    def forget(self) -> None:
        """Settings may have changed: what was derived from them must be read again."""
        self._timing = None
        self.panel.lock = None
        self.dialogue.source = None

    def acquisition_time(self) -> AcquisitionTime:
        """How long an acquisition takes with the settings of now."""
        if self._timing is None:
            scale, mode, averages, trigger_mode, holdoff, kind, source = self.panel.read(_TIMING_COMMANDS)
            self._timing = AcquisitionTime(
                seconds_per_division=scpi.number(scale),
                acquisitions=scpi.integer(averages) if mode.startswith("AVE") else 1,
                automatic=trigger_mode.startswith("AUTO"),
                holdoff=scpi.number(holdoff),
                mains=kind == "EDGE" and source.endswith("LINE"),
            )
        return self._timing

    def check_time_base(self, waveform: Waveform) -> None:
        """Somebody may have turned the knob: the record tells the time base it was taken with."""
        taken_with = waveform.sample_interval * POINTS_PER_DIVISION
        if self._timing and abs(taken_with / self._timing.seconds_per_division - 1) > 1e-3:
            self._timing = None
