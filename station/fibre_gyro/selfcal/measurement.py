"""The self-calibration by injected staircase: what is taken, and how it goes on from there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from analysis.fibre_gyro import InjectionPlan, steps_beyond_dac
from station.fibre_gyro.allan.noise_model import NOISE
from station.fibre_gyro.bench_or_logs import NamedSegment, gyro_measurement, listed_logs
from station.fibre_gyro.common import beyond_converter, truth_of
from station.fibre_gyro.logs import LogRow
from station.fibre_gyro.segments import PlannedSegment, take_segments
from station.fibre_gyro.selfcal.evaluate import PURPOSE, evaluate
from station.fibre_gyro.selfcal.numbers import NUMBERS, REFERENCE, numbers_for, numbers_of, numbers_u_of
from station.fibre_gyro.selfcal.result import LIMITED, result
from station.fibre_gyro.selfcal.sections import sections
from station.fibre_gyro.serial_bench import open_fog_bench
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.table.evaluate import PURPOSE as TABLE
from station.fibre_gyro.table.measurement import plan as plan_table
from station.runs.store import SavedRun
from station.runs.taking import Session


def plan(settings: FogSettings, numbers: InjectionPlan) -> tuple[list[PlannedSegment], dict[str, str]]:
    """List the segments: rest, every step, rest; steps beyond the converter are left out by name."""
    chosen, gyro = settings.selfcal, settings.gyro
    rest = PlannedSegment("static before", chosen.static_s, chosen.settle_s, _conditions("before", 0.0, 0.0, 0.0))
    planned, left_out = [rest], {}
    for rate, number, u in zip(numbers.rate_dps, numbers.number, numbers.number_u, strict=True):
        step = float(number) / gyro.counts_per_code
        if steps_beyond_dac(step, gyro.dac_bits):
            left_out[_key(rate)] = beyond_converter(step, gyro.dac_bits)
            continue
        conditions = {**_conditions(None, float(rate), float(number), step), "number_u": float(u)}
        planned.append(PlannedSegment(_key(rate), chosen.step_s, chosen.settle_s, conditions))
    rest = PlannedSegment("static after", chosen.static_s, chosen.settle_s, _conditions("after", 0.0, 0.0, 0.0))
    return [*planned, rest], left_out


def take(settings: FogSettings, session: Session) -> None:
    """Take the segments on the bench; a simulated one without the numbers of a table run takes that run first."""
    if not settings.simulated and NUMBERS not in session.facts:
        numbers_for(settings, None)  # says what is missing before anything moves

    def own_table(run: SavedRun) -> list[PlannedSegment]:
        needed = settings.simulated and REFERENCE not in run.facts
        return plan_table(settings, [settings.selfcal.axis]) if needed else []

    def injections(run: SavedRun) -> list[PlannedSegment]:
        planned, left_out = plan(settings, numbers_of(run, settings))
        session.note_left_out(left_out)
        return planned

    take_segments(settings, session, open_fog_bench(settings), [own_table, injections], truth_of(settings))


def take_files(settings: FogSettings, paths: Sequence[Path], session: Session) -> None:
    """Make a run of logs; each names the step and the rate that it stands for, 0 at rest."""
    mapping_u = numbers_u_of(session.facts, settings)

    def named(rows: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
        at_rest, found = [place for place, row in enumerate(rows) if row["number"] == 0], []
        for place, row in enumerate(rows):
            rate, number, static = row["stands_for_dps"], row["number"], None
            if place in at_rest:
                static = "between" if at_rest[0] < place < at_rest[-1] else "after"
                static = "before" if place == at_rest[0] and place < len(rows) - 1 else static
            conditions = _conditions(static, rate, number, number / settings.gyro.counts_per_code)
            if not static:
                conditions["number_u"] = row["number_u"] if "number_u" in row else mapping_u(rate)
            found.append((f"static {static}" if static else _key(rate), conditions))
        return found

    listed_logs(PURPOSE, ("stands_for_dps", "number"), named)(settings, paths, session)


def _key(rate_dps: float) -> str:
    return f"inject {rate_dps:+.10g}"


def _conditions(static: str | None, stands_for_dps: float, number: float, step_codes: float) -> dict[str, object]:
    """What a segment is; `static` names an output at rest: ``"before"``, ``"between"``, ``"after"`` the steps."""
    return {
        "purpose": PURPOSE,
        "static": static,
        "rate_dps": 0.0,
        "stands_for_dps": stands_for_dps,
        "number": number,
        "step_codes": step_codes,
    }


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Self-calibration by injected staircase",
    take=take,
    take_files=take_files,
    evaluate=evaluate,
    result=result,
    sections=sections,
    gives=LIMITED,
    purposes=(TABLE, PURPOSE),
    choices=(NOISE,),
)
