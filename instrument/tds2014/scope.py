"""The TDS2014 and its relatives as a Python object.

>>> from instrument import TDS2014                               # doctest: +SKIP
>>> with TDS2014("GPIB0::1::INSTR") as scope:                    # doctest: +SKIP
...     waveform = scope.acquire("CH1")

Nothing on the front panel is changed by opening. Each group of settings is remembered before its first change
and put back when the ``with`` block ends, also after an exception.
"""

from __future__ import annotations

import contextlib
import itertools
import time
from collections.abc import Callable, Iterator
from typing import cast, overload

from instrument import scpi
from instrument.dialogue.acquisition_time import AcquisitionTime
from instrument.dialogue.link import NoAnswer
from instrument.errors import InstrumentError, LinkError, NoTrigger, SettingError, TransferError
from instrument.facts import POINTS_PER_DIVISION
from instrument.tds2014 import setups
from instrument.tds2014.front_panel import Change, is_on
from instrument.tds2014.math_waveform import set_math
from instrument.tds2014.measurement import Cursors, Measurement, measure, read_cursors, set_cursors
from instrument.tds2014.screen import ScreenPicture, read_screen
from instrument.tds2014.snapshot import Snapshots
from instrument.waveform import Waveform

_TIMING_COMMANDS = (
    ":HORIZONTAL:MAIN:SCALE",
    ":ACQUIRE:MODE",
    ":ACQUIRE:NUMAVG",
    ":TRIGGER:MAIN:MODE",
    ":TRIGGER:MAIN:HOLDOFF:VALUE",
)
# A hand on RUN/STOP ends the single sequence, so it is asked for with every record: else an old one would come.
_START = "ACQ:STOPA SEQ;STATE RUN"
_POLLS_PER_RECORD = 10  # a finished acquisition is noticed within a tenth of its own length

Several = tuple[str | int, ...] | list[str | int] | tuple[str, ...] | list[str] | list[int]
"""Names or numbers of several channels."""


class TDS2014(Snapshots):
    """An oscilloscope of the TDS1000/TDS2000 family (also B and C, TPS2000); a context manager.

    Parameters
    ----------
    resource_name : str
        VISA resource name.
    resource_manager : pyvisa.ResourceManager, optional
        Default: PyVISA's own choice.
    baud_rate : int, optional
        Speed of an RS-232 line (default 9600, the scope's factory setting).

    Raises
    ------
    LinkError
        If the resource cannot be opened or does not answer.
    WrongInstrument
        If what answers is not of this family.
    """

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
        names = self._several(channel, self._channel)
        self._panel.remember("ACQUIRE")
        timing = self._read_timing()
        wait = timing.longest if timeout is None else timeout
        with self._held_panel(names) as (lock, unlock):
            try:
                if self._dialogue.link.can_clear or timing.surely_ends:
                    waveforms = self._acquire_at_once(names, wait, lock, unlock)
                else:
                    waveforms = self._acquire_by_asking(names, wait, timing, lock, unlock)
            except SettingError as error:
                raise TransferError(f"the scope was set running while it was read; ask again ({error})") from None
        self._remember_timebase(waveforms[0])
        return waveforms[0] if isinstance(channel, str | int) else waveforms

    @overload
    def fetch(self, channel: str | int) -> Waveform: ...

    @overload
    def fetch(self, channel: Several) -> tuple[Waveform, ...]: ...

    def fetch(self, channel: str | int | Several) -> Waveform | tuple[Waveform, ...]:
        """Return the record that the scope holds now, without a new acquisition. Errors as `acquire`.

        Besides channels, ``"MATH"`` and the references ``"REFA"``... can be read while they are displayed.
        Several of them are read in one exchange, and only from a scope that is stopped (SettingError else).
        """
        names = self._several(channel, self._source)
        with self._held_panel(names) as (lock, unlock):
            waveforms = self._fetch(names, lock, unlock)
        return waveforms[0] if isinstance(channel, str | int) else waveforms

    def _several(self, channel: str | int | Several, name_of: Callable[[str | int], str]) -> tuple[str, ...]:
        names = tuple(map(name_of, (channel,) if isinstance(channel, str | int) else channel))
        if not names:
            raise SettingError("no channel to acquire; name at least one")
        if len(set(names)) < len(names):
            raise SettingError(f"a channel is named twice in {', '.join(names)}; name each once")
        return names

    @contextlib.contextmanager
    def _held_panel(self, names: tuple[str, ...]) -> Iterator[tuple[str, str]]:
        """Commands that keep hands off the scope while several channels are read, and those that end it."""
        if len(names) == 1:
            yield "", ""
            return
        self._panel.remember("LOCK")
        (found,) = self._panel.read((":LOCK",)) if self._lock is None else (self._lock,)
        self._lock = found
        if found == "ALL":
            yield "", ""
            return
        try:
            yield ":LOCK ALL", f":LOCK {found}"
        except LinkError:
            raise
        except InstrumentError:
            with contextlib.suppress(InstrumentError):
                self._dialogue.command(f":LOCK {found}")
            raise

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
            self._dialogue.resynchronise_or_raise(silence)
            return self._finished_or_no_trigger(names, wait, lock, unlock)

    def _acquire_by_asking(
        self, names: tuple[str, ...], wait: float, timing: AcquisitionTime, lock: str, unlock: str
    ) -> tuple[Waveform, ...]:
        deadline = time.monotonic() + wait
        self._dialogue.command(";".join(filter(None, (lock, _START))))
        pause = timing.record_time
        while True:
            time.sleep(max(0.0, min(pause, deadline - time.monotonic())))
            if not is_on(self._dialogue.ask(":BUSY?")[0]):
                return self._fetch(names, "", unlock)
            if time.monotonic() >= deadline:
                return self._finished_or_no_trigger(names, wait, "", unlock)
            pause = timing.record_time / _POLLS_PER_RECORD

    def _records(
        self, commands: str, names: tuple[str, ...], unlock: str, *, wait: float = 0.0
    ) -> tuple[Waveform, ...]:
        try:
            return self._dialogue.records(commands, names, wait=wait, afterwards=unlock)
        except InstrumentError:
            self._forget()
            raise

    def _finished_or_no_trigger(
        self, names: tuple[str, ...], wait: float, lock: str, unlock: str
    ) -> tuple[Waveform, ...]:
        running, state = self._dialogue.ask(":ACQUIRE:STATE?;:TRIGGER:STATE?", parts=2)
        if not is_on(running):
            return self._fetch(names, lock, unlock)  # it ended just now
        self._dialogue.command(":ACQUIRE:STATE STOP")
        raise NoTrigger(
            f"the acquisition did not complete within {wait:.3g} s (trigger state {state}); "
            "check signal, trigger source and level, or use trigger mode AUTO"
        )

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

    # ------------------------------------------------------------------ math, references, measurements

    def set_math(self, expression: str, *, displayed: bool = True) -> None:
        """Define the math waveform, ``"CH1 - CH2"`` or ``"FFT(CH1, HANNING)"``; read it with ``fetch("MATH")``."""
        self._panel.remember("MATH")
        self._forget()
        set_math(self._dialogue, expression, displayed)

    def save_reference(self, reference: str, source: str | int) -> None:
        """Store a displayed waveform in ``REFA``..., over what was there, and show it. It stays stored."""
        name = self._source(reference)
        if not name.startswith("REF"):
            raise SettingError(f"there is no reference {name}; choose REFA, REFB...")
        self._panel.remember(name)
        self._forget()
        self._dialogue.command(f":SAVE:WAVEFORM {self._source(source)},{name}")
        self._panel.change(Change(f":SELECT:{name}", True))

    def measure(self, kind: str, channel: str | int) -> Measurement:
        """One of `MEASUREMENTS` on the record that the scope holds; ExecutionError says why there is none."""
        self._panel.remember("MEASUREMENT")
        return measure(self._dialogue, kind, self._source(channel), wait=self._read_timing().longest)

    def set_cursors(
        self, bars: str, *, source: str | int = "CH1", positions: tuple[float, float] | None = None
    ) -> Cursors:
        """Show cursors: ``VBARS`` at two times in s, ``HBARS`` at two values in V, or ``OFF``."""
        return set_cursors(self._panel, bars, self._source(source), positions)

    def cursors(self) -> Cursors:
        """The cursors as they stand now."""
        return read_cursors(self._panel)

    # ------------------------------------------------------------------ whole setups, screen, front panel

    def read_setup(self) -> str:
        """All settings as a text that `write_setup` takes."""
        return setups.read_setup(self._dialogue)

    def write_setup(self, setup: str) -> None:
        """Make all settings as in a text from `read_setup`; SettingError if one cannot be made."""
        self._panel.remember_all()
        self._forget()
        setups.write_setup(self._dialogue, setup)

    def save_setup(self, memory: int) -> None:
        """Keep the present settings in memory 1 to 10 of the scope, over what was there."""
        setups.save_setup(self._dialogue, memory)

    def recall_setup(self, memory: int | str) -> None:
        """Make all settings as in memory 1 to 10, or as at the ``"FACTORY"``; put back on closing."""
        self._panel.remember_all()
        self._forget()
        setups.recall_setup(self._dialogue, memory)

    def autoset(self) -> None:
        """Let the scope choose scales, time base and trigger; put back on closing."""
        self._panel.remember_all()
        self._forget()
        setups.autoset(self._dialogue)

    def screen(self) -> ScreenPicture:
        """Picture of the screen, as PNG. Over RS-232 it takes about 80 s at 9600 baud."""
        self._panel.remember("HARDCOPY")
        return read_screen(self._dialogue)

    @contextlib.contextmanager
    def front_panel_locked(self) -> Iterator[None]:
        """Lock the knobs while a ``with`` block runs; afterwards they are as found, also after an exception."""
        (found,) = self._panel.read((":LOCK",))
        self._panel.change(Change(":LOCK", "ALL"))
        self._lock = "ALL"
        try:
            yield
        except LinkError:
            raise  # a scope that is gone cannot be unlocked
        except BaseException:
            with contextlib.suppress(InstrumentError):
                self._dialogue.command(f":LOCK {found}")
            raise
        finally:
            self._lock = None
        self._dialogue.command(f":LOCK {found}")

    # ------------------------------------------------------------------ inside

    def _source(self, name: str | int) -> str:
        """A channel, MATH, or one of the references (as many as channels)."""
        word = str(name).strip().upper()
        references = [f"REF{letter}" for letter in "ABCD"[: self.identity.channel_count]]
        return word if word in ("MATH", *references) else self._channel(name)

    def _read_timing(self) -> AcquisitionTime:
        if self._timing is None:
            scale, mode, averages, trigger_mode, holdoff = self._panel.read(_TIMING_COMMANDS)
            self._timing = AcquisitionTime(
                seconds_per_division=scpi.number(scale),
                acquisitions=scpi.integer(averages) if mode.startswith("AVE") else 1,
                automatic=trigger_mode.startswith("AUTO"),
                holdoff=scpi.number(holdoff),
            )
        return self._timing

    def _remember_timebase(self, waveform: Waveform) -> None:
        """Somebody may have turned the knob: the record tells the time base it was taken with."""
        taken_with = waveform.sample_interval * POINTS_PER_DIVISION
        if self._timing and abs(taken_with / self._timing.seconds_per_division - 1) > 1e-3:
            self._timing = None
