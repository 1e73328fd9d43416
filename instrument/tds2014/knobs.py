"""The knobs of the front panel as methods: channels, time base, trigger, acquisition mode, each read back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from instrument import scpi
from instrument.errors import SettingError
from instrument.facts import LEVELS_PER_DIVISION
from instrument.tds2014.front_panel import Change, ChannelSettings, group_commands, is_on, one_of, optional
from instrument.tds2014.session import Session

_TRIGGER_SOURCES = ("EXT", "EXT5", "EXT10", "LINE", "AC LINE")


class Knobs:
    """Makes settings and reads them back; what is changed is remembered and put back on closing."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._panel = session.panel

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
        name = self._session.channel(channel)
        word = None if coupling is None else one_of("the coupling", coupling, ("DC", "AC", "GND"))
        # Changing a channel moves the trigger level, which is given in its volts.
        self._session.before_changing(name, "TRIGGER", "CURSOR")
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
        name = self._session.channel(channel)
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
        self._session.before_changing("HORIZONTAL", "CURSOR")
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
        self._session.before_changing("TRIGGER")
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
        self._session.before_changing("ACQUIRE")
        self._panel.change(Change(":ACQUIRE:MODE", word), *optional(":ACQUIRE:NUMAVG", averages))

    # ------------------------------------------------------------------ inside

    def _trigger_source(self, source: str | int) -> str:
        if isinstance(source, str) and source.strip().upper() in _TRIGGER_SOURCES:
            return source.strip().upper()
        return self._session.channel(source)

    def _level_step(self) -> float:
        """One converter level of the trigger's channel in V; an external input shows at most 16 V in 200."""
        (source,) = self._panel.read((":TRIGGER:MAIN:EDGE:SOURCE",))
        if source not in self._session.channels:
            return 16.0 / 200
        (scale,) = self._panel.read((f":{source}:SCALE",))
        return scpi.number(scale) / LEVELS_PER_DIVISION
