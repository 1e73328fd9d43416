"""The TDS2014 and its relatives as a Python object.

>>> from instrument import TDS2014                               # doctest: +SKIP
>>> with TDS2014("GPIB0::1::INSTR") as scope:                    # doctest: +SKIP
...     waveform = scope.acquire("CH1")

Nothing on the front panel is changed by opening. Each group of settings is remembered before its first change
and put back when the ``with`` block ends, also after an exception.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import itertools
import re
import threading
from collections.abc import Callable, Iterator
from typing import Any, Concatenate, ParamSpec, Self, TypeVar, cast, overload

import pyvisa

from instrument import scpi
from instrument.dialogue.identify import Identity
from instrument.dialogue.link import NoAnswer
from instrument.dialogue.retry import Persistence, Tally
from instrument.errors import InstrumentError, NoTrigger, SettingError, TransferError
from instrument.scpi import POINTS
from instrument.tds2014.front_panel import (
    AcquisitionTime,
    FoundPanel,
    FrontPanel,
    ScopeConnection,
    is_on,
    read_setup,
    settings_of,
)
from instrument.tds2014.knobs import Knobs, Measurements, Screen, Setups
from instrument.waveform import Waveform

# --------------------
# What measurement frameworks expect of an instrument: a name, an identity, a snapshot of all settings.
#
# QCoDeS takes any object with ``name`` and ``snapshot`` into its station, and PyMeasure procedures call ``id``,
# ``check_errors`` and ``shutdown``. So the driver serves both without either being installed


# Settings whose unit does not follow from the setting alone (cursors) are left without one.
_UNITS = (
    (re.compile(r"CH\d:SCALE"), "V/div"),
    (re.compile(r"CH\d:POSITION"), "div"),
    (re.compile(r"HORIZONTAL:(MAIN|DELAY):SCALE"), "s/div"),
    (re.compile(r"HORIZONTAL:(MAIN|DELAY):POSITION"), "s"),
    (re.compile(r"TRIGGER:MAIN:LEVEL"), "V"),
    (re.compile(r"TRIGGER:MAIN:(HOLDOFF:VALUE|PULSE:WIDTH:WIDTH)"), "s"),
)


class Snapshot:
    """All settings of one scope as a dictionary.

    Parameters
    ----------
    class_name : str
        What the dictionary names as the class of the instrument, with its module.
    """

    def __init__(self, session: ScopeConnection, class_name: str) -> None:
        self._session, self._class_name = session, class_name
        self._last: dict[str, Any] | None = None

    @property
    def name(self) -> str:
        """Model without blanks, such as ``TDS2014``."""
        return self._session.dialogue.identity.model.replace(" ", "")

    def get_idn(self) -> dict[str, str]:
        """Vendor, model, serial number and firmware."""
        known = self._session.dialogue.identity
        return {
            "vendor": known.manufacturer,
            "model": known.model,
            "serial": known.serial,
            "firmware": known.firmware,
        }

    def snapshot(self, update: bool | None = True) -> dict[str, Any]:
        """All settings of the scope as a dictionary that goes into JSON.

        Parameters
        ----------
        update : bool, optional
            Read them from the scope; otherwise those of the last snapshot serve, if there is one.
        """
        if update or self._last is None:
            found = settings_of(read_setup(self._session.dialogue))
            parameters = [_parameter(command.lstrip(":"), text) for command, text in found.items()]
            self._last = {
                "name": self.name,
                "__class__": self._class_name,
                "address": self._session.dialogue.link.name,
                "functions": {},
                "submodules": {},
                "parameters": {
                    "IDN": {"name": "IDN", "value": self.get_idn(), "unit": ""},
                    **{parameter["name"]: parameter for parameter in parameters},
                },
            }
        return self._last


def _parameter(name: str, text: str) -> dict[str, Any]:
    try:
        value: float | str = scpi.number(text)
    except TransferError:
        value = scpi.unquote(text)
    unit = next((unit for pattern, unit in _UNITS if pattern.fullmatch(name)), "")
    return {"name": name, "value": value, "unit": unit}


# A hand on RUN/STOP ends the single sequence, so it is asked for with every record: else an old one would come.
_START = "ACQ:STOPA SEQ;STATE RUN"
_POLLS_PER_RECORD = 10  # a finished acquisition is noticed within a tenth of its own length

Several = tuple[str | int, ...] | list[str | int] | tuple[str, ...] | list[str] | list[int]
"""Names or numbers of several channels."""


_Part = TypeVar("_Part")
_Arguments = ParamSpec("_Arguments")
_Answer = TypeVar("_Answer")


def _of(
    part: Callable[[TDS2014], _Part], method: Callable[Concatenate[_Part, _Arguments], _Answer]
) -> Callable[Concatenate[TDS2014, _Arguments], _Answer]:
    """A method of the scope that one of its parts carries out; name, signature and docstring are the part's."""

    @functools.wraps(method)
    def carry_out(scope: TDS2014, /, *args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Answer:
        with scope.alone:
            return method(part(scope), *args, **kwargs)

    return carry_out


class TDS2014:
    """An oscilloscope of the TDS1000/TDS2000 family (also B and C, TPS2000); a context manager.

    Parameters
    ----------
    resource_name : str
        VISA resource name.
    resource_manager : pyvisa.ResourceManager, optional
        Default: PyVISA's own choice.
    baud_rate : int, optional
        Speed of an RS-232 line (default 9600, the scope's factory setting).
    persistence : Persistence, optional
        How hard to try on a bad link; by default every fault is raised.

    Raises
    ------
    LinkError
        If the resource cannot be opened or does not answer.
    WrongInstrument
        If what answers is not of this family.
    """

    def __init__(
        self,
        resource_name: str,
        *,
        resource_manager: pyvisa.ResourceManager | None = None,
        baud_rate: int | None = None,
        persistence: Persistence | None = None,
    ) -> None:
        self.alone = threading.RLock()
        """Held by the thread whose exchange is under way; hold it for several that belong together."""
        self._session = ScopeConnection(resource_name, resource_manager, baud_rate, persistence)
        self._panel = self._session.panel
        self._dialogue = self._session.dialogue
        self._knobs = Knobs(self._session)
        self._measurements = Measurements(self._session)
        self._setups = Setups(self._session)
        self._screen = Screen(self._session)
        self._snapshot = Snapshot(self._session, f"{type(self).__module__}.{type(self).__qualname__}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        if error is not None and not isinstance(error, Exception):
            self._session.hurry()
        try:
            self.close()
        except InstrumentError as restoring:
            # What went wrong inside the block matters more than what it left behind.
            if error is None:
                raise
            error.add_note(f"besides, the scope's settings could not be put back: {restoring}")

    def __repr__(self) -> str:
        return f"<{self.identity.model} at {self.resource_name}, {POINTS} points>"

    @property
    def identity(self) -> Identity:
        """Manufacturer, model, serial number and firmware, as asked for on opening."""
        return self._dialogue.identity

    @property
    def resource_name(self) -> str:
        """The VISA resource name that was opened."""
        return self._dialogue.link.name

    @property
    def link_faults(self) -> Tally:
        """What it took so far to keep the link: exchanges repeated, connections, settings made again."""
        return self._session.link_faults

    @property
    def link_is_down(self) -> bool:
        """Whether the link is lost, and tried again at this moment."""
        return self._dialogue.reconnecting

    @property
    def front_panel_found(self) -> FoundPanel | None:
        """The front panel as it will be put back; None without persistence: groups are then read as needed."""
        return self._session.front_panel_found

    @property
    def front_panel_is_back(self) -> bool:
        """Whether the front panel was put back on closing."""
        return self._session.panel_is_back

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels of this model, ``("CH1", "CH2", ...)``."""
        return self._session.channels

    # ------------------------------------------------------------------ what the parts do

    close = _of(lambda self: self._session, ScopeConnection.close)
    restore = _of(lambda self: self._session, ScopeConnection.restore)
    step = _of(lambda self: self._session, ScopeConnection.step)
    abandon = _of(lambda self: self._session, ScopeConnection.abandon)
    put_back_in_the_end = _of(lambda self: self._session, ScopeConnection.put_back_in_the_end)
    events = _of(lambda self: self._session, ScopeConnection.events)
    query = _of(lambda self: self._session, ScopeConnection.query)
    write = _of(lambda self: self._session, ScopeConnection.write)

    setup = _of(lambda self: self._knobs, Knobs.setup)
    set_channel = _of(lambda self: self._knobs, Knobs.set_channel)
    channel_settings = _of(lambda self: self._knobs, Knobs.channel_settings)
    set_timebase = _of(lambda self: self._knobs, Knobs.set_timebase)
    set_trigger = _of(lambda self: self._knobs, Knobs.set_trigger)
    set_acquisition = _of(lambda self: self._knobs, Knobs.set_acquisition)
    front_panel_locked = _of(lambda self: self._panel, FrontPanel.front_panel_locked)

    read_setup = _of(lambda self: self._setups, Setups.read_setup)
    write_setup = _of(lambda self: self._setups, Setups.write_setup)
    save_setup = _of(lambda self: self._setups, Setups.save_setup)
    recall_setup = _of(lambda self: self._setups, Setups.recall_setup)
    autoset = _of(lambda self: self._setups, Setups.autoset)

    measure = _of(lambda self: self._measurements, Measurements.measure)
    cursors = _of(lambda self: self._measurements, Measurements.cursors)
    set_cursors = _of(lambda self: self._measurements, Measurements.set_cursors)
    set_math = _of(lambda self: self._measurements, Measurements.set_math)
    save_reference = _of(lambda self: self._measurements, Measurements.save_reference)
    screen = _of(lambda self: self._screen, Screen.screen)

    # QCoDeS looks for name, get_idn and snapshot, PyMeasure for id, check_errors and shutdown.
    snapshot = _of(lambda self: self._snapshot, Snapshot.snapshot)
    get_idn = _of(lambda self: self._snapshot, Snapshot.get_idn)
    check_errors = events
    shutdown = close

    @property
    def name(self) -> str:
        """Model without blanks, such as ``TDS2014``."""
        return self._snapshot.name

    @property
    def id(self) -> str:
        """The answer to ``*IDN?``, as asked for on opening."""
        return self.identity.text

    # ------------------------------------------------------------------ records

    @overload
    def acquire(self, channel: str | int, *, timeout: float | None = None) -> Waveform: ...

    @overload
    def acquire(self, channel: Several, *, timeout: float | None = None) -> tuple[Waveform, ...]: ...

    def acquire(
        self, channel: str | int | Several, *, timeout: float | None = None
    ) -> Waveform | tuple[Waveform, ...]:
        """Make one single-sequence acquisition and return its record.

        Start, wait, preamble and curve are one exchange, except on a stream that could hang for ever waiting
        for a trigger: there the scope is asked whether it is still busy.

        Parameters
        ----------
        channel : str or int, or several of them
            Of several channels the records of the same acquisition are returned, in their order and in the same
            exchange; meanwhile the front panel is locked.
        timeout : float, optional
            Time in s within which the acquisition must complete. Default: two record lengths for each
            acquisition of the sequence (see `AcquisitionTime.longest`).

        Raises
        ------
        NoTrigger
            If it did not complete in time although the scope answers; the acquisition is stopped.
        LinkError
            If the scope does not answer.
        TransferError
            If a record was damaged on its way: a wrong one is never returned; the caller may try again.
        ExecutionError
            If a channel is not displayed.
        """
        names = self._several(channel, self._session.channel)
        with self.alone:
            waveforms = self._session.step(lambda: self._acquire(names, timeout))
        return waveforms[0] if isinstance(channel, str | int) else waveforms

    def _acquire(self, names: tuple[str, ...], timeout: float | None) -> tuple[Waveform, ...]:
        self._panel.remember("ACQUIRE")
        timing = self._session.acquisition_time()
        wait = timing.longest if timeout is None else timeout
        with self._held_panel(names) as (lock, unlock):
            try:
                if self._dialogue.link.can_clear or timing.surely_ends:
                    waveforms = self._acquire_at_once(names, wait, lock, unlock)
                else:
                    waveforms = self._acquire_by_asking(names, wait, timing, lock, unlock)
            except SettingError as error:
                raise TransferError(f"the scope was set running while it was read; ask again ({error})") from None
        self._session.check_time_base(waveforms[0])
        return waveforms

    @overload
    def fetch(self, channel: str | int) -> Waveform: ...

    @overload
    def fetch(self, channel: Several) -> tuple[Waveform, ...]: ...

    def fetch(self, channel: str | int | Several) -> Waveform | tuple[Waveform, ...]:
        """Return the record that the scope holds now, without a new acquisition. Errors as `acquire`.

        Besides channels, ``"MATH"`` and the references ``"REFA"``... can be read while they are displayed.
        Several of them are read in one exchange, and only from a scope that is stopped (SettingError else).
        """
        names = self._several(channel, self._session.source)
        with self.alone:
            waveforms = self._session.step(lambda: self._fetch_held(names))
        return waveforms[0] if isinstance(channel, str | int) else waveforms

    @overload
    async def acquire_async(self, channel: str | int, *, timeout: float | None = None) -> Waveform: ...

    @overload
    async def acquire_async(self, channel: Several, *, timeout: float | None = None) -> tuple[Waveform, ...]: ...

    async def acquire_async(
        self, channel: str | int | Several, *, timeout: float | None = None
    ) -> Waveform | tuple[Waveform, ...]:
        """The same as `acquire` without blocking the event loop: ``await asyncio.gather(...)`` of several scopes.

        A task that is cancelled stops waiting at once; the exchange that is under way ends by itself, and the next
        one waits for it.
        """
        return await asyncio.to_thread(self.acquire, channel, timeout=timeout)

    def _fetch_held(self, names: tuple[str, ...]) -> tuple[Waveform, ...]:
        with self._held_panel(names) as (lock, unlock):
            return self._fetch(names, lock, unlock)

    @overload
    def records(
        self, channel: str | int, count: int | None = None, *, timeout: float | None = None, attempts: int = 3
    ) -> Iterator[Waveform]: ...

    @overload
    def records(
        self, channel: Several, count: int | None = None, *, timeout: float | None = None, attempts: int = 3
    ) -> Iterator[tuple[Waveform, ...]]: ...

    def records(
        self,
        channel: str | int | Several,
        count: int | None = None,
        *,
        timeout: float | None = None,
        attempts: int = 3,
    ) -> Iterator[Waveform] | Iterator[tuple[Waveform, ...]]:
        """Fresh records one after the other, `count` of them or without end.

        A record that is damaged on its way is taken anew, up to `attempts` times in a row; then its
        `TransferError` is raised. Of several channels each item is a tuple. Other errors as `acquire`.
        """
        return cast("Iterator[Waveform]", self._fresh(channel, count, timeout, attempts))

    def _fresh(
        self, channel: str | int | Several, count: int | None, timeout: float | None, attempts: int
    ) -> Iterator[Waveform | tuple[Waveform, ...]]:
        numbers = itertools.count() if count is None else range(count)
        for _ in numbers:
            for attempt in range(1, attempts + 1):
                try:
                    waveform = self.acquire(channel, timeout=timeout)
                except TransferError:
                    if attempt == attempts:
                        raise
                else:
                    yield waveform
                    break

    # ------------------------------------------------------------------ inside

    def _several(self, channel: str | int | Several, name_of: Callable[[str | int], str]) -> tuple[str, ...]:
        names = tuple(map(name_of, (channel,) if isinstance(channel, str | int) else channel))
        if not names:
            raise SettingError("no channel to acquire; name at least one")
        if len(set(names)) < len(names):
            raise SettingError(f"a channel is named twice in {', '.join(names)}; name each once")
        return names

    def _held_panel(self, names: tuple[str, ...]) -> contextlib.AbstractContextManager[tuple[str, str]]:
        """Hands are kept off the scope while several channels are read; of one it does not matter."""
        return contextlib.nullcontext(("", "")) if len(names) == 1 else self._panel.held()

    def _fetch(self, names: tuple[str, ...], lock: str = "", unlock: str = "") -> tuple[Waveform, ...]:
        try:
            return self._records(lock, names, unlock)
        except NoAnswer as silence:
            raise self._dialogue.explain_silence("WAVFrm?", silence) from None

    def _acquire_at_once(
        self, names: tuple[str, ...], wait: float, lock: str, unlock: str
    ) -> tuple[Waveform, ...]:
        try:
            return self._records(";".join(filter(None, (lock, f"{_START};*WAI"))), names, unlock, wait=wait)
        except NoAnswer as silence:
            hasty = self._dialogue.hasty
            self._dialogue.resynchronise_or_raise(silence)
            if hasty:  # too early to say that no trigger came
                raise TransferError(f"{silence}; ask again") from None
            # Did it never start, because the message was lost? Then what the scope holds is an old record.
            after, running = self._dialogue.ask(":ACQUIRE:STOPAFTER?;:ACQUIRE:STATE?", parts=2, twice=True)
            if not is_on(running) or not after.upper().startswith("SEQ"):
                raise TransferError(f"{silence}, and the scope acquires nothing; ask again") from None
            raise self._no_trigger(wait) from None

    def _acquire_by_asking(
        self, names: tuple[str, ...], wait: float, timing: AcquisitionTime, lock: str, unlock: str
    ) -> tuple[Waveform, ...]:
        self._dialogue.command(";".join(filter(None, (lock, _START))))
        clock = self._dialogue.link.clock
        began, pause = clock.now(), timing.record_time
        while True:
            clock.sleep(max(0.0, min(pause, began + wait - clock.now())))
            over = clock.now() - began >= wait
            (busy,) = self._dialogue.ask(":BUSY?", twice=True)
            if not is_on(busy):
                return self._fetch(names, "", unlock)
            if over:
                raise self._no_trigger(wait)
            pause = timing.record_time / _POLLS_PER_RECORD

    def _records(
        self, commands: str, names: tuple[str, ...], unlock: str, *, wait: float = 0.0
    ) -> tuple[Waveform, ...]:
        try:
            return self._dialogue.records(commands, names, wait=wait, afterwards=unlock)
        except InstrumentError:
            self._session.forget()
            raise

    def _no_trigger(self, wait: float) -> NoTrigger:
        """Stop the acquisition that does not complete; returns the error to raise."""
        (state,) = self._dialogue.ask(":TRIGGER:STATE?", twice=True)
        self._dialogue.command(":ACQUIRE:STATE STOP")
        return NoTrigger(
            f"the acquisition did not complete within {wait:.3g} s (trigger state {state}); "
            "check signal, trigger source and level, or use trigger mode AUTO"
        )
