"""The TDS2014 and its relatives as a Python object.

>>> from instrument import TDS2014                               # doctest: +SKIP
>>> with TDS2014("GPIB0::1::INSTR") as scope:                    # doctest: +SKIP
...     waveform = scope.acquire("CH1")

Nothing on the front panel is changed by opening. Each group of settings is remembered before its first change
and put back when the ``with`` block ends, also after an exception.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from types import TracebackType
from typing import Any

import pyvisa

from instrument import scpi
from instrument.acquisition_time import INTERVALS_PER_DIVISION, AcquisitionTime
from instrument.dialogue import RECORD_LENGTH, Dialogue
from instrument.errors import InstrumentError, LinkError, NoTrigger, ScopeEvent, SettingError
from instrument.identity import Identity
from instrument.link import Link, NoAnswer
from instrument.settings import (
    Change,
    ChannelSettings,
    FrontPanel,
    group_commands,
    is_on,
    one_of,
    optional,
)
from instrument.waveform import LEVELS_PER_DIVISION, Waveform

_TIMING_COMMANDS = (
    ":HORIZONTAL:MAIN:SCALE",
    ":ACQUIRE:MODE",
    ":ACQUIRE:NUMAVG",
    ":TRIGGER:MAIN:MODE",
    ":TRIGGER:MAIN:HOLDOFF:VALUE",
)
_POLLS_PER_RECORD = 10  # a finished acquisition is noticed within a tenth of its own length
_TRIGGER_SOURCES = ("EXT", "EXT5", "EXT10", "LINE", "AC LINE")


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
    ) -> None:
        link = Link(resource_name, resource_manager, baud_rate)
        try:
            self._dialogue = Dialogue(link)
        except BaseException:
            link.close()
            raise
        self._panel = FrontPanel(self._dialogue)
        self._timing: AcquisitionTime | None = None
        self._single_is_set = False
        self._closed = False

    def __enter__(self) -> TDS2014:
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

    # ------------------------------------------------------------------ settings

    def setup(
        self,
        *,
        channels: Mapping[str | int, Mapping[str, Any]] | None = None,
        timebase: Mapping[str, Any] | None = None,
        trigger: Mapping[str, Any] | None = None,
        acquisition: Mapping[str, Any] | None = None,
    ) -> None:
        """Set several groups at once; the keys are the arguments of the ``set_...`` methods.

        ``setup(channels={"CH1": {"scale": 0.5}}, timebase={"seconds_per_division": 5e-3})``
        """
        for channel, arguments in (channels or {}).items():
            self.set_channel(channel, **arguments)
        if timebase:
            self.set_timebase(**timebase)
        if trigger:
            self.set_trigger(**trigger)
        if acquisition:
            self.set_acquisition(**acquisition)

    def restore(self) -> None:
        """Put back every group of settings that was changed, as it was found."""
        self._forget()
        self._panel.restore()

    def set_channel(
        self,
        channel: str | int,
        *,
        scale: float | None = None,
        position: float | None = None,
        coupling: str | None = None,
        probe: float | None = None,
        bandwidth_limit: bool | None = None,
        invert: bool | None = None,
        displayed: bool | None = True,
    ) -> ChannelSettings:
        """Set one channel and read it back; what is None stays as it is.

        Parameters
        ----------
        scale : float
            V/div at the probe tip, from 2 mV to 5 V in steps of 1-2-5, times the probe factor.
        position : float
            Divisions above the centre, in steps of 0.04.
        coupling : {"DC", "AC", "GND"}
        probe : float
            Attenuation factor of the probe.
        bandwidth_limit, invert, displayed : bool
            Only a displayed channel can be read.

        Raises
        ------
        SettingError
            If this model has no such channel, or the scope holds another value than the one asked for.
        """
        name = self._channel(channel)
        word = None if coupling is None else one_of("the coupling", coupling, ("DC", "AC", "GND"))
        # Changing a channel moves the trigger level, which is given in its volts.
        self._panel.remember(name, "TRIGGER", "CURSOR")
        self._forget()
        half_step = 0.5 / LEVELS_PER_DIVISION
        self._panel.change(
            *optional(f":SELECT:{name}", displayed),
            *optional(f":{name}:PROBE", probe),
            *optional(f":{name}:SCALE", scale, 0.0 if scale is None else 1e-3 * scale),
            *optional(f":{name}:POSITION", position, half_step),
            *optional(f":{name}:COUPLING", word),
            *optional(f":{name}:BANDWIDTH", bandwidth_limit),
            *optional(f":{name}:INVERT", invert),
        )
        return self.channel_settings(name)

    def channel_settings(self, channel: str | int) -> ChannelSettings:
        """Read how a channel is set now."""
        name = self._channel(channel)
        factor, scale, position, coupling, limit, invert, shown = self._panel.read(group_commands(name))
        return ChannelSettings(
            channel=name,
            scale=scpi.number(scale),
            position=scpi.number(position),
            coupling=coupling,
            probe=scpi.number(factor),
            bandwidth_limit=is_on(limit),
            invert=is_on(invert),
            displayed=is_on(shown),
        )

    def set_timebase(self, seconds_per_division: float, *, position: float | None = None) -> float:
        """Set the main time base; returns the s/div read back.

        Parameters
        ----------
        seconds_per_division : float
            In steps of 1-2.5-5.
        position : float, optional
            Time in s from the trigger to the centre of the record.
        """
        if not seconds_per_division > 0:
            raise SettingError(f"the time base cannot be {seconds_per_division} s/div; give a positive time")
        self._panel.remember("HORIZONTAL", "CURSOR")
        self._forget()
        answers = self._panel.change(
            Change(":HORIZONTAL:MAIN:SCALE", seconds_per_division, 1e-3 * seconds_per_division),
            # The trigger can stand on whole points only.
            *optional(":HORIZONTAL:MAIN:POSITION", position, seconds_per_division / LEVELS_PER_DIVISION),
        )
        return scpi.number(answers[0])

    def set_trigger(
        self,
        *,
        source: str | int | None = None,
        level: float | None = None,
        slope: str | None = None,
        coupling: str | None = None,
        mode: str | None = None,
        holdoff: float | None = None,
    ) -> None:
        """Set the edge trigger and read it back; what is None stays as it is.

        Parameters
        ----------
        source : str or int
            A channel, ``EXT``, ``EXT5`` (external over 5) or ``LINE`` (mains).
        level : float
            In V, at most 8 divisions from the centre of a channel.
        slope : {"RISE", "FALL"}
        coupling : {"DC", "AC", "HFREJ", "LFREJ", "NOISEREJ"}
        mode : {"AUTO", "NORMAL"}
            AUTO goes on without a trigger.
        holdoff : float
            Time in s, 500 ns to 10 s.
        """
        words = {
            ":TRIGGER:MAIN:EDGE:SOURCE": None if source is None else self._trigger_source(source),
            ":TRIGGER:MAIN:EDGE:SLOPE": slope and one_of("the trigger slope", slope, ("RISE", "FALL")),
            ":TRIGGER:MAIN:EDGE:COUPLING": coupling
            and one_of("the trigger coupling", coupling, ("DC", "AC", "HFREJ", "LFREJ", "NOISEREJ")),
            ":TRIGGER:MAIN:MODE": mode and one_of("the trigger mode", mode, ("AUTO", "NORMAL")),
        }
        self._panel.remember("TRIGGER")
        self._forget()
        self._panel.change(
            Change(":TRIGGER:MAIN:TYPE", "EDGE"),
            *(Change(command, word) for command, word in words.items() if word),
            *optional(":TRIGGER:MAIN:HOLDOFF:VALUE", holdoff, 0.0 if holdoff is None else 0.05 * holdoff),
        )
        if level is not None:
            self._panel.change(Change(":TRIGGER:MAIN:LEVEL", level, self._level_step()))

    def set_acquisition(self, *, mode: str = "SAMPLE", averages: int | None = None) -> None:
        """Set the acquisition mode: ``SAMPLE``, ``PEAKDETECT``, or ``AVERAGE`` of 4, 16, 64 or 128."""
        word = one_of("the acquisition mode", mode, ("SAMPLE", "PEAKDETECT", "AVERAGE"))
        self._panel.remember("ACQUIRE")
        self._forget()
        self._panel.change(Change(":ACQUIRE:MODE", word), *optional(":ACQUIRE:NUMAVG", averages))

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

    def _trigger_source(self, source: str | int) -> str:
        if isinstance(source, str) and source.strip().upper() in _TRIGGER_SOURCES:
            return source.strip().upper()
        return self._channel(source)

    def _level_step(self) -> float:
        """One converter level of the trigger's channel in V; an external input shows at most 16 V in 200."""
        (source,) = self._panel.read((":TRIGGER:MAIN:EDGE:SOURCE",))
        if source not in self.channels:
            return 16.0 / 200
        (scale,) = self._panel.read((f":{source}:SCALE",))
        return scpi.number(scale) / LEVELS_PER_DIVISION

    def _forget(self) -> None:
        """Settings may have changed: what was derived from them must be read again."""
        self._timing = None
        self._single_is_set = False
        self._dialogue.source = None

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

    def __repr__(self) -> str:
        return f"<{self.identity.model} at {self.resource_name}, {RECORD_LENGTH} points>"
