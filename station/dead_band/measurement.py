"""The dead band of a ring laser gyro: the skeleton of measurements, filled in."""

from __future__ import annotations

from station.dead_band.at_once import watch
from station.dead_band.evaluate import evaluate
from station.dead_band.result import LIMITED, record_rows, result
from station.dead_band.sections import facts, sections
from station.dead_band.settings import DEAD_BAND
from station.dead_band.sweep import fastest_table_rate, seconds
from station.dead_band.take import PURPOSE, take
from station.measurements import Measurement
from station.ring_laser.examine import examine

MEASUREMENT = Measurement(
    name=PURPOSE,
    command="gyrolock deadband",
    title="Dead band",
    kind=DEAD_BAND,
    take=take,
    evaluate=evaluate,
    choices=("scale_factor",),
    result=result,
    sections=sections,
    facts=facts,
    rows=record_rows,
    gives=LIMITED,
    watch=watch,
    seconds=seconds,
    examine=lambda settings: examine(settings, fastest_table_rate(settings)),
)
