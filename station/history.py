"""Tests of a folder over time: control charts of a type of unit and of the bench, and their page."""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.control_chart import FEWEST, RULES, ControlChart, Trend, control_chart, trend
from station.campaign.journal import PAGE_FILE
from station.campaign.record import NAME, RECORD_FILE, as_csv
from station.files import version
from station.live.console import duration
from station.measurements import MEASUREMENTS, measurement
from station.report.figure import ACCENT, LINE, SECOND, SOFT, TALL, svg_element
from station.report.show import render_page, write_page
from station.results.quantity import Value
from station.results.result import PlacedFigure, Section

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Followed:
    """A number of a test."""

    name: str  # of the step and of the number: ``"lock-in rate: lock_in_rate_dps"``
    value: float
    u: float  # standard uncertainty; nan where nobody knows it
    axis: str = "value"  # what it is, and its unit
    limits: tuple[float | None, float | None] = (None, None)  # at least, at most
    failed: bool = False
    title: str = ""  # the name as a person reads it: ``"lock-in rate: lock-in rate"``


@dataclass(frozen=True)
class PastTest:
    """A test of a unit, as its record says."""

    path: Path
    unit: str
    unit_type: str
    is_reference: bool
    at: str  # when it began, UTC
    campaign: str
    verdict: str | None
    message: str
    simulated: bool
    operator: str
    numbers: tuple[Followed, ...]

    @property
    def page(self) -> Path:
        """The record as a page, beside the JSON."""
        return self.path.with_name(PAGE_FILE)


def read_tests(directory: Path) -> tuple[list[PastTest], list[Path]]:
    """Return the tests below a folder in the order of time, and the records that cannot be read."""
    found, unreadable = [], []
    for path in sorted(directory.rglob(RECORD_FILE)):
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            if document["schema"]["name"] == NAME:
                found.append(_test(path, document))
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            unreadable.append(path)
    return sorted(found, key=lambda one: one.at), unreadable


def _test(path: Path, record: Mapping[str, Any]) -> PastTest:
    unit, outcome = record["unit"], record["outcome"]
    numbers: dict[str, Followed] = {}
    for step in record["steps"]:
        for one in _numbers(step):
            before = numbers.setdefault(one.name, one)
            if before.limits == (None, None):
                numbers[one.name] = replace(before, limits=one.limits, failed=one.failed)
    return PastTest(
        path,
        str(unit["serial"]),
        str(unit["type"]),
        bool(unit["is_reference"]),
        str(record["started_at"]),
        str(record["campaign"]["name"]),
        outcome["verdict"],
        outcome["message"] or "",
        bool(record["simulated"]),
        record["operator"] or "",
        tuple(numbers.values()),
    )


def _numbers(step: Mapping[str, Any]) -> Iterator[Followed]:
    """Numbers of a step: its lock-in rate and scale factors, and whatever a limit is set on."""
    name, result = str(step["name"]), step["result"] or {}
    repeat = f", {step['repeat']} of {step['of_repeats']}" if step["of_repeats"] > 1 else ""
    known = step["measurement"] in MEASUREMENTS
    declared = measurement(step["measurement"]).quantities_in(result) if known else ()
    for group in declared:
        for value in group.values(result, lambda one: one.trend):
            of = f" {'by the' if group.each == 'by' else 'of'} {value.of}" if value.of else ""
            if math.isfinite(value.value):
                axis, title = _axis(value), f"{name}{repeat}: {value.quantity.words}{of}"
                yield Followed(f"{name}{repeat}: {value.name}{of}", value.value, value.u, axis, title=title)
    for limit in step["limits"]:
        if isinstance(limit["value"], int | float):
            ends = limit["low_95"], limit["high_95"]
            u = math.nan if None in ends else (ends[1] - ends[0]) / 3.92
            value, limits = Value.from_json({"of": "", **limit}), (limit["at_least"], limit["at_most"])
            of, failed = f"{name}{repeat}: {limit['name']}", limit.get("verdict") == "FAIL"
            title = f"{name}{repeat}: {value.words}"
            yield Followed(of, float(limit["value"]), u, _axis(value), limits, failed, title)


def failures(tests: Iterable[PastTest]) -> list[tuple[str, int]]:
    """Limits that were not held, with the number of tests, from the most frequent on."""
    return Counter(one.title for test in tests for one in test.numbers if one.failed).most_common()


def history_csv(tests: Iterable[PastTest], number: str = "") -> str:
    """A row for each number of each test, of a test without any its verdict alone."""
    about = ("unit", "unit_type", "is_reference", "started_at", "campaign", "verdict", "operator", "record")
    names, nothing = ("number", "value", "u", "at_least", "at_most"), ("", *(None,) * 4)
    rows = []
    for test in tests:
        told = (test.unit, test.unit_type, test.is_reference, test.at, test.campaign, test.verdict, test.operator)
        for of in [one for one in test.numbers if number in one.name] or (None,):
            said = (of.name, of.value, of.u if math.isfinite(of.u) else None, *of.limits) if of else nothing
            rows.append(dict(zip((*about, *names), (*told, str(test.path), *said), strict=True)))
    return as_csv([*about, *names], rows)


def _axis(value: Value) -> str:
    """A number as the axis of a picture: what it is, and its unit."""
    return f"{value.quantity.words}, {value.unit}" if value.unit else value.quantity.words


# --------------------
# Control charts of what is followed: of a type of unit, and of the bench by its reference unit


BASELINE = 25


@dataclass(frozen=True)
class ControlSeries:
    """One number over time, of one type of unit or of one reference unit."""

    of: str  # ``"RLG-2000"``, or ``"bench, by REF-1"``
    name: str  # of step and number
    tests: tuple[PastTest, ...]  # in the order of time
    numbers: tuple[Followed, ...]  # of each test
    chart: ControlChart

    @property
    def title(self) -> str:
        """The same, as a person reads it."""
        return f"{self.of}: {self.numbers[-1].title}"

    @property
    def us(self) -> tuple[float, ...]:
        """Standard uncertainty of each value; nan where nobody knows it."""
        return tuple(one.u for one in self.numbers)

    def unit_at(self, number: int) -> str:
        """The unit of a test, and its day, from 1; empty where there is none."""
        test = self.tests[number - 1] if 1 <= number <= len(self.tests) else None
        return "" if test is None else f"{test.unit[:12]}\n{test.at[5:10]}"

    @property
    def sentences(self) -> list[str]:
        """What the chart says, in words."""
        chart = self.chart
        if chart.values.size < FEWEST:
            few = f"No limits yet: they need {FEWEST} values, there are {chart.values.size}."
            return [few, *self._trend_words]
        if not chart.has_limits:
            return ["All values of the baseline are the same: there are no limits."]
        said = [
            *self._trend_words,
            *self._capability,
            f"Centre {chart.centre:.6g}, sigma {chart.sigma:.2g} by the moving range of the first "
            f"{chart.baseline}, limits {chart.centre - 3 * chart.sigma:.6g} to "
            f"{chart.centre + 3 * chart.sigma:.6g}.",
        ]
        if not chart.signals:
            return [*said, "In control: nothing stands out."]
        for one in chart.signals:
            test = self.tests[one.place]
            said.append(f"{test.at[:16].replace('T', ' ')} UTC, {test.unit}: {RULES[one.rule]}.")
        return said

    @property
    def trend(self) -> Trend | None:
        """How fast the number of the same unit changes; ``None`` where too few units were tested again."""
        days = [datetime.fromisoformat(one.at).timestamp() / 86400 for one in self.tests]
        return trend(days, self.chart.values, self.us, [one.unit for one in self.tests])

    @property
    def _trend_words(self) -> list[str]:
        """The trend, or that there is none."""
        if (found := self.trend) is None or not found.high_95 > found.low_95:
            return []
        interval = f"{found.low_95:+.2g} to {found.high_95:+.2g} a day (95 %, {found.days:.3g} days)"
        if found.low_95 < 0 < found.high_95:
            return [f"The same unit shows no trend: {interval}."]
        return [f"The same unit drifts by {found.per_day:+.2g} a day: {interval}."]

    @property
    def _capability(self) -> list[str]:
        """How many standard deviations lie between the mean and the nearer limit, over three: Cpk."""
        low, high = self.numbers[-1].limits
        mean, spread = float(np.mean(self.chart.values)), float(np.std(self.chart.values, ddof=1))
        room = min(math.inf if high is None else high - mean, math.inf if low is None else mean - low)
        return [f"Cpk {room / (3 * spread):.2f}."] if math.isfinite(room) and spread > 0 else []


def courses(tests: Sequence[PastTest], *, baseline: int = BASELINE) -> list[ControlSeries]:
    """Return every number that is followed: those of the bench first, then by type of unit."""
    # A test without a verdict counts; one that was aborted, or that the bench spoilt, does not. Simulated benches
    # are not mixed with real ones.
    counted = [one for one in tests if one.verdict not in ("ABORTED", "ERROR")]
    groups: dict[str, list[PastTest]] = {}
    campaigns = {one.campaign for one in counted}
    for one in sorted(counted, key=lambda test: not test.is_reference):
        kind = f"bench, by {one.unit}" if one.is_reference else one.unit_type or "units of no type"
        if len(campaigns) > 1:  # another campaign may measure the same number in another way
            kind = f"{kind}, {one.campaign}"
        groups.setdefault(f"{kind} (simulated)" if one.simulated else kind, []).append(one)
    return [course for of, group in groups.items() for course in _of_group(of, group, baseline)]


def _of_group(of: str, tests: Iterable[PastTest], baseline: int) -> list[ControlSeries]:
    ordered = sorted(tests, key=lambda one: one.at)
    names = dict.fromkeys(number.name for test in ordered for number in test.numbers)
    found = []
    for name in names:
        pairs = [(test, one) for test in ordered for one in test.numbers if one.name == name]
        chart = control_chart([one.value for _, one in pairs], baseline=baseline)
        found.append(
            ControlSeries(of, name, tuple(test for test, _ in pairs), tuple(one for _, one in pairs), chart)
        )
    return found


def course_svg(course: ControlSeries, name: str) -> str:
    """Draw a course as individuals above and moving range below; `name` sets its ids apart."""
    chart, number = course.chart, np.arange(1, course.chart.values.size + 1)
    flagged = sorted({one.place for one in chart.signals if one.rule < 5})
    jumps = sorted({one.place for one in chart.signals if one.rule == 5})

    def draw(figure: Figure) -> None:
        from matplotlib.ticker import FuncFormatter, MaxNLocator

        above, below = figure.subplots(2, sharex=True, height_ratios=(2.2, 1))
        us = np.array(course.us)
        if np.isfinite(us).any():
            above.errorbar(number, chart.values, yerr=np.nan_to_num(us), fmt="none", ecolor=SOFT, linewidth=0.8)
        above.plot(number, chart.values, "o-", color=ACCENT, ms=4, linewidth=0.8)
        below.plot(number[1:], chart.moving_range[1:], "o-", color=ACCENT, ms=3.5, linewidth=0.8)
        if chart.has_limits:
            above.axhline(chart.centre, color=ACCENT, linewidth=1.0)
            for sigmas in (1, 2):
                for sign in (1, -1):
                    above.axhline(chart.centre + sign * sigmas * chart.sigma, color=LINE, linewidth=0.9)
            for sign in (1, -1):
                above.axhline(
                    chart.centre + 3 * sign * chart.sigma, color=SECOND, linewidth=1.0, linestyle=(0, (5, 3))
                )
            below.axhline(chart.range_limit, color=SECOND, linewidth=1.0, linestyle=(0, (5, 3)))
        for axes, values, places in ((above, chart.values, flagged), (below, chart.moving_range, jumps)):
            axes.plot(number[places], values[places], "s", ms=8, mfc="none", mec=SECOND, mew=1.6)
        for limit in course.numbers[-1].limits:
            if limit is not None:
                above.axhline(limit, color="#a93226", linewidth=1.2)
        above.set(ylabel=course.numbers[-1].axis)
        above.ticklabel_format(axis="y", useOffset=False)
        below.set(xlabel="unit, in the order of its test", ylabel="moving range", xlim=(0.4, number.size + 0.6))
        largest = np.max(chart.moving_range[1:], initial=chart.range_limit if chart.has_limits else 0.0)
        below.set_ylim(0, 1.15 * largest if largest > 0 else None)
        below.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1, nbins=8))
        below.xaxis.set_major_formatter(FuncFormatter(lambda at, _: course.unit_at(round(at))))

    return svg_element(name, TALL, draw)


# --------------------
# Whether the bench may test units: its reference unit was measured lately, and is what it always was


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
            said += [f"{course.numbers[-1].title} {RULES[rule]}" for rule in rules]
    return said


# --------------------
# The index of all tested units as a page: what became of each, and the control charts


INDEX_FILE, _MOST = "index.html", 3
_STATES = {"PASS": "good", "MARGINAL": "doubtful", "FAIL": "bad", "ERROR": "bad", "ABORTED": "bad"}


def write_index(
    directory: Path, tests: Sequence[PastTest], courses: Sequence[ControlSeries], path: Path | None = None
) -> Path:
    """Write the page, by default ``index.html`` in the folder of the tests; OSError if it cannot be written."""
    path = path or directory / INDEX_FILE
    newest: dict[str, PastTest] = {one.unit: one for one in tests}
    counted = {verdict: sum(one.verdict == verdict for one in newest.values()) for verdict in _STATES}
    summary = ", ".join(f"{count} {verdict}" for verdict, count in counted.items() if count)
    units = "unit" if len(newest) == 1 else "units"
    judged = [one for one in tests if one.verdict in ("PASS", "MARGINAL", "FAIL") and not one.is_reference]
    first = {one.unit: one.verdict for one in reversed(judged)}
    if first:
        passed = sum(verdict == "PASS" for verdict in first.values())
        summary += f"; first-pass yield {passed} of {len(first)} ({passed / len(first):.0%})"
    most = failures(tests)[:_MOST]
    summary += "; failed most: " + ", ".join(f"{name} ({count})" for name, count in most) if most else ""
    rows = [
        {
            "at": one.at[:16].replace("T", " "),
            "unit": one.unit,
            "type": f"{one.unit_type}{', reference' if one.is_reference else ''}",
            "verdict": one.verdict or "measured",
            "state": _STATES.get(one.verdict or "", "good"),
            "message": one.message,
            "link": Path(os.path.relpath(one.page, path.parent)).as_posix(),
            "simulated": one.simulated,
        }
        for one in reversed(tests)
    ]
    sections = [
        Section(
            course.title,
            figures=(PlacedFigure(course_svg(course, f"chart{place}"), _CAPTION),),
            sentences=tuple(course.sentences),
        )
        for place, course in enumerate(courses)
    ]
    text = render_page(
        "history.html.j2",
        version=version("gyrolock"),
        summary=f"{len(newest)} {units}: {summary}" if newest else "No unit was tested yet.",
        rows=rows,
        sections=sections,
        footer=f"Made by gyrolock {version('gyrolock')} from the records of {len(tests)} tests.",
    )
    return write_page(path, text)


_CAPTION = (
    "Above the values with their standard uncertainty, below the distance of each from the one before. Lines at "
    "1, 2 and 3 sigma, in red the limit; a square marks what the rules of Western Electric call out of control."
)
