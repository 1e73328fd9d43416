"""The 2 pi error by injection in open loop: what is taken, and how it goes on from there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from analysis.fibre_gyro import steps_beyond_dac
from station.fibre_gyro.at_once import watch
from station.fibre_gyro.common import beyond_converter, output_facts, truth_of, with_link_remarks
from station.fibre_gyro.eps.evaluate import PURPOSE, evaluate
from station.fibre_gyro.eps.result import LIMITED, result
from station.fibre_gyro.eps.sections import sections
from station.fibre_gyro.examine import examine
from station.fibre_gyro.logs import LogRow, read_logs
from station.fibre_gyro.segments import PlannedSegment, seconds_of, take_logs, take_segments, unusable_segments
from station.fibre_gyro.serial_bench import open_fog_bench
from station.fibre_gyro.settings import FIBRE_GYRO, FogSettings
from station.measurements import Measurement
from station.runs.taking import Session


def plan(settings: FogSettings) -> tuple[list[PlannedSegment], dict[str, str]]:
    """List the segments: every step in both senses; steps beyond the converter are left out by name."""
    chosen, planned, left_out = settings.eps, [], {}
    for size in chosen.steps_codes:
        for step in (size, -size):
            key = _key(step)
            if steps_beyond_dac(step, settings.gyro.dac_bits):
                left_out[key] = beyond_converter(step, settings.gyro.dac_bits)
                continue
            conditions = {"purpose": PURPOSE, **_conditions(step)}
            planned.append(PlannedSegment(key, chosen.record_s, chosen.settle_s, conditions))
    return planned, left_out


def take(settings: FogSettings, session: Session) -> None:
    """Take the segments on the bench."""
    planned, left_out = plan(settings)
    take_segments(settings, session, open_fog_bench(settings), [lambda run: planned], truth_of(settings), left_out)


def take_files(settings: FogSettings, paths: Sequence[Path], session: Session) -> None:
    """Make a run of logs; each names the step that was injected."""

    def named(rows: Sequence[LogRow]) -> list[tuple[str, dict[str, object]]]:
        return [(_key(row["step_codes"]), _conditions(row["step_codes"])) for row in rows]

    take_logs(session, paths, read_logs(paths, PURPOSE, ("step_codes",), named, settings))


def _key(step_codes: float) -> str:
    return f"open loop {step_codes:+.10g}"


def _conditions(step_codes: float) -> dict[str, object]:
    return {"loop": "held", "step_codes": step_codes, "rate_dps": 0.0}


MEASUREMENT = Measurement(
    name=PURPOSE,
    command="gyrolock fog eps",
    title="2π error by open-loop injection",
    kind=FIBRE_GYRO,
    take=take,
    take_files=take_files,
    evaluate=evaluate,
    result=with_link_remarks(result),
    sections=sections,
    facts=output_facts,
    gives=LIMITED,
    watch=watch,
    examine=examine,
    unusable=lambda run, settings: unusable_segments(run, settings, [PURPOSE]),
    seconds=lambda settings: seconds_of(plan(settings)[0]),
)
