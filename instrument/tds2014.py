"""The TDS2014 and its relatives as a Python object.

>>> from instrument import TDS2014                               # doctest: +SKIP
>>> with TDS2014("GPIB0::1::INSTR") as scope:                    # doctest: +SKIP
...     waveform = scope.acquire("CH1")

Nothing on the front panel is changed by opening. Each group of settings is remembered before its first change
and put back when the ``with`` block ends, also after an exception.
"""

from __future__ import annotations

import time

from instrument import scpi
from instrument.acquisition_time import INTERVALS_PER_DIVISION, AcquisitionTime
from instrument.controls import Controls
from instrument.errors import InstrumentError, NoTrigger
from instrument.link import NoAnswer
from instrument.settings import is_on
from instrument.waveform import Waveform

_TIMING_COMMANDS = (
    ":HORIZONTAL:MAIN:SCALE",
    ":ACQUIRE:MODE",
    ":ACQUIRE:NUMAVG",
    ":TRIGGER:MAIN:MODE",
    ":TRIGGER:MAIN:HOLDOFF:VALUE",
)
_POLLS_PER_RECORD = 10  # a finished acquisition is noticed within a tenth of its own length


class TDS2014(Controls):
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

    def acquire(self, channel: str | int, *, timeout: float | None = None) -> Waveform:
        """Make one single-sequence acquisition and return its record.

        Start, wait, preamble and curve are one exchange, except on a stream that could hang for ever waiting
        for a trigger: there the scope is asked whether it is still busy.

        Parameters
        ----------
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
            If the record was damaged on its way: a wrong one is never returned; the caller may try again.
        ExecutionError
            If the channel is not displayed.
        """
        source = self._channel(channel)
        self._panel.remember("ACQUIRE")
        timing = self._read_timing()
        wait = timing.longest if timeout is None else timeout
        start = f"{self._single_commands(source)}:ACQ:STATE RUN"
        if self._dialogue.link.can_clear or timing.surely_ends:
            waveform = self._acquire_at_once(start, source, wait)
        else:
            waveform = self._acquire_by_asking(start, source, wait, timing)
        self._remember_timebase(waveform)
        return waveform

    def fetch(self, channel: str | int) -> Waveform:
        """Return the record that the scope holds now, without a new acquisition. Errors as `acquire`."""
        source = self._channel(channel)
        try:
            return self._record(self._source_command(source), source)
        except NoAnswer as silence:
            raise self._dialogue.explain_silence("WAVFrm?", silence) from None

    def _acquire_at_once(self, start: str, source: str, wait: float) -> Waveform:
        try:
            return self._record(f"{start};*WAI", source, wait=wait)
        except NoAnswer as silence:
            self._dialogue.resynchronise_or_raise(silence)
            return self._finished_or_no_trigger(source, wait)

    def _acquire_by_asking(self, start: str, source: str, wait: float, timing: AcquisitionTime) -> Waveform:
        deadline = time.monotonic() + wait
        self._dialogue.command(start)
        self._single_is_set = True
        self._dialogue.source = source
        pause = timing.record_time
        while True:
            time.sleep(max(0.0, min(pause, deadline - time.monotonic())))
            if not is_on(self._dialogue.ask(":BUSY?")[0]):
                return self.fetch(source)
            if time.monotonic() >= deadline:
                return self._finished_or_no_trigger(source, wait)
            pause = timing.record_time / _POLLS_PER_RECORD

    def _record(self, commands: str, source: str, *, wait: float = 0.0) -> Waveform:
        try:
            waveform = self._dialogue.record(commands.rstrip(";"), source, wait=wait)
        except InstrumentError:
            self._forget()
            raise
        self._single_is_set = self._single_is_set or "STOPAFTER" in commands
        self._dialogue.source = source
        return waveform

    def _finished_or_no_trigger(self, source: str, wait: float) -> Waveform:
        running, state = self._dialogue.ask(":ACQUIRE:STATE?;:TRIGGER:STATE?", parts=2)
        if not is_on(running):
            return self.fetch(source)  # it ended just now
        self._dialogue.command(":ACQUIRE:STATE STOP")
        raise NoTrigger(
            f"the acquisition did not complete within {wait:.3g} s (trigger state {state}); "
            "check signal, trigger source and level, or use trigger mode AUTO"
        )

    # ------------------------------------------------------------------ inside

    def _single_commands(self, source: str) -> str:
        single = "" if self._single_is_set else ":ACQUIRE:STOPAFTER SEQUENCE;"
        return f"{single}{self._source_command(source)}"

    def _source_command(self, source: str) -> str:
        return "" if self._dialogue.source == source else f":DATA:SOURCE {source};"

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
        taken_with = waveform.sample_interval * INTERVALS_PER_DIVISION
        if self._timing and abs(taken_with / self._timing.seconds_per_division - 1) > 1e-3:
            self._timing = None
