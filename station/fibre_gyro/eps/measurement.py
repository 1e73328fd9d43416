"""The 2 pi error by injection in open loop: what is taken, and how it goes on from there."""

from __future__ import annotations

from collections.abc import Sequence

from analysis.fibre_gyro import steps_beyond_dac
from station.fibre_gyro.bench_or_logs import NamedSegment, gyro_measurement, listed_logs, planned_segments
from station.fibre_gyro.common import beyond_converter
from station.fibre_gyro.eps.evaluate import PURPOSE, evaluate
from station.fibre_gyro.eps.result import LIMITED, result
from station.fibre_gyro.eps.sections import sections
from station.fibre_gyro.logs import LogRow
from station.fibre_gyro.segments import PlannedSegment
from station.fibre_gyro.settings import FogSettings


def plan(settings: FogSettings) -> list[PlannedSegment]:
    """List the segments: every step in both senses that the converter can make."""
    chosen, bits = settings.eps, settings.gyro.dac_bits
    return [
        PlannedSegment(_key(step), chosen.record_s, chosen.settle_s, {"purpose": PURPOSE, **_conditions(step)})
        for step in _steps(settings)
        if not steps_beyond_dac(step, bits)
    ]


def beyond(settings: FogSettings) -> dict[str, str]:
    """Name the steps that are beyond the converter."""
    bits = settings.gyro.dac_bits
    return {_key(step): beyond_converter(step, bits) for step in _steps(settings) if steps_beyond_dac(step, bits)}


def named(rows: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by the step that was injected."""
    return [(_key(row["step_codes"]), _conditions(row["step_codes"])) for row in rows]


def _steps(settings: FogSettings) -> list[float]:
    return [step for size in settings.eps.steps_codes for step in (size, -size)]


def _key(step_codes: float) -> str:
    return f"open loop {step_codes:+.10g}"


def _conditions(step_codes: float) -> dict[str, object]:
    return {"loop": "held", "step_codes": step_codes, "rate_dps": 0.0}


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "2π error by open-loop injection",
    take=planned_segments(plan, beyond),
    take_files=listed_logs(PURPOSE, ("step_codes",), named),
    evaluate=evaluate,
    result=result,
    sections=sections,
    gives=LIMITED,
    plan=plan,
)
