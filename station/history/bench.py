"""Whether the bench may test units: its reference unit was measured lately, and is what it always was."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from analysis.control_chart import RULES
from station.display.sentences import duration
from station.history.charts import courses
from station.history.past_tests import PastTest, read_tests


@dataclass(frozen=True)
class BenchCheck:
    """Whether units may be tested."""

    ok: bool
    sentence: str  # why, and what to do if not


def in_control(
    directory: Path, reference_unit: str, unit_type: str, now: datetime, every_s: float, *, simulated: bool = False
) -> BenchCheck:
    """Say whether the bench is in control."""
    tests = [
        one
        for one in read_tests(directory)[0]
        if one.is_reference
        and one.unit == reference_unit
        and one.unit_type == unit_type
        and one.simulated == simulated
    ]
    advice = f"test the reference unit {reference_unit} first"
    if not tests:
        return BenchCheck(False, f"the bench was never checked with {reference_unit}: {advice}")
    last = tests[-1]
    age = (now - datetime.fromisoformat(last.at)).total_seconds()
    when = f"{last.at[:16].replace('T', ' ')} UTC"
    if age < 0:
        return BenchCheck(
            False, f"the last check of the bench, {when}, lies in the future: set the clock, then {advice}"
        )
    if age > every_s:
        return BenchCheck(
            False, f"the last check of the bench was {duration(age)} ago, more than {duration(every_s)}: {advice}"
        )
    if last.verdict != "PASS":
        reason = f" ({last.message})" if last.message else ""
        said = f"{reference_unit} was {last.verdict or 'measured without limits'} on {when}{reason}"
        return BenchCheck(False, f"{said}: find out what has changed on the bench, then {advice}")
    if signals := _signals_of(last, tests):
        told = "; ".join(signals)
        return BenchCheck(
            False,
            f"the bench is out of control: {reference_unit} on {when}: {told}: find out what has changed "
            "(`gyrolock history` shows the charts), then test it again",
        )
    return BenchCheck(True, f"the bench was checked with {reference_unit} {duration(age)} ago: PASS, in control")


def _signals_of(last: PastTest, tests: list[PastTest]) -> list[str]:
    """What the control charts say of the last test."""
    said = []
    for course in courses(tests):
        if course.tests[-1] is last:
            rules = [one.rule for one in course.chart.signals if one.place == len(course.tests) - 1]
            said += [f"{course.name} {RULES[rule]}" for rule in rules]
    return said
