"""The oscilloscope as a QCoDeS instrument: parameters for its knobs, and each channel's record over its times.

>>> from instrument.adapters.qcodes_scope import QCoDeSScope                # doctest: +SKIP
>>> scope = QCoDeSScope("scope", "GPIB0::1::INSTR")                         # doctest: +SKIP
>>> scope.ch1.scale(0.5)                                                    # doctest: +SKIP
>>> volts = scope.ch1.record()                                              # doctest: +SKIP
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qcodes.instrument import Instrument, InstrumentChannel
from qcodes.parameters import Parameter, ParameterWithSetpoints
from qcodes.validators import Arrays, Bool, Enum, Numbers

from instrument import TDS2014, Waveform
from instrument.scpi import POINTS

_COUPLINGS = ("DC", "AC", "GND")


class QcodesChannel(InstrumentChannel):
    """One channel: its knobs, the record of the last acquisition and the times of its samples."""

    def __init__(self, parent: QCoDeSScope, name: str, channel: str) -> None:
        super().__init__(parent, name)
        self._channel, self._driver = channel, parent.driver
        self._waveform: Waveform | None = None
        knobs: dict[str, tuple[str, Any]] = {
            "scale": ("V/div", Numbers()),
            "position": ("div", Numbers()),
            "coupling": ("", Enum(*_COUPLINGS)),
            "probe": ("", Numbers()),
            "bandwidth_limit": ("", Bool()),
            "invert": ("", Bool()),
            "displayed": ("", Bool()),
        }
        for knob, (unit, allowed) in knobs.items():
            self.add_parameter(
                knob, unit=unit, vals=allowed, get_cmd=self._reader(knob), set_cmd=self._writer(knob)
            )
        self.add_parameter("times", unit="s", vals=Arrays(shape=(POINTS,)), get_cmd=self._times)
        self.add_parameter(
            "record",
            parameter_class=ParameterWithSetpoints,
            unit="V",
            setpoints=(self.parameters["times"],),
            vals=Arrays(shape=(POINTS,)),
            get_cmd=self._volts,
        )

    def acquire(self) -> Waveform:
        """One fresh record; `times` and `record` are those of it until the next one."""
        self._waveform = self._driver.acquire(self._channel)
        return self._waveform

    def _reader(self, knob: str) -> Callable[[], Any]:
        return lambda: getattr(self._driver.channel_settings(self._channel), knob)

    def _writer(self, knob: str) -> Callable[[Any], Any]:
        return lambda value: self._driver.set_channel(self._channel, **{knob: value})

    def _times(self) -> NDArray[np.float64]:
        return (self._waveform or self.acquire()).times

    def _volts(self) -> NDArray[np.float64]:
        """A fresh record."""
        return self.acquire().volts


class QCoDeSScope(Instrument):
    """A TDS1000, TDS2000 or TPS2000 in QCoDeS."""

    def __init__(self, name: str, address: str, **options: Any) -> None:
        super().__init__(name)
        self.driver = TDS2014(address, **options)
        for number, channel in enumerate(self.driver.channels, start=1):
            self.add_submodule(f"ch{number}", QcodesChannel(self, f"ch{number}", channel))
        self.seconds_per_division: Parameter[float, Any] = self.add_parameter(
            "seconds_per_division",
            unit="s/div",
            vals=Numbers(min_value=0),
            get_cmd="HORIZONTAL:MAIN:SCALE?",
            get_parser=float,
            set_cmd=self.driver.set_timebase,
        )

    def get_idn(self) -> dict[str, str | None]:
        """Vendor, model, serial number and firmware."""
        return dict(self.driver.get_idn())

    def ask_raw(self, cmd: str) -> str:
        """A question in the scope's own words."""
        return self.driver.query(cmd)

    def write_raw(self, cmd: str) -> None:
        """A command in the scope's own words."""
        self.driver.write(cmd)

    def close(self) -> None:
        """Put the front panel back, and close the link."""
        if hasattr(self, "driver"):
            self.driver.close()
        super().close()
