"""The modulator staircase on an oscilloscope: what is taken, and how it goes on from there."""

from __future__ import annotations

from dataclasses import replace

from station.fibre_gyro.settings import FIBRE_GYRO
from station.fibre_gyro.witness.at_once import watch
from station.fibre_gyro.witness.evaluate import PURPOSE, evaluate
from station.fibre_gyro.witness.result import LIMITED, result
from station.fibre_gyro.witness.sections import facts, sections
from station.fibre_gyro.witness.take import is_simulated, take, take_files
from station.measurements import Measurement

_KNOWN = ("half_wave_v", "half_wave_u_v", "gain_u", "time_base_u")

MEASUREMENT = Measurement(
    name=PURPOSE,
    command="gyrolock fog witness",
    title="Modulator staircase by oscilloscope",
    kind=replace(FIBRE_GYRO, knowledge=("limits.*", *(f"witness.{name}" for name in _KNOWN))),
    take=take,
    take_files=take_files,
    evaluate=evaluate,
    result=result,
    sections=sections,
    facts=facts,
    gives=LIMITED,
    simulated=is_simulated,
    watch=watch,
)
