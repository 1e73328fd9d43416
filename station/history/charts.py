"""Control charts of what is followed: of a type of unit, and of the bench by its reference unit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.control_chart import FEWEST, RULES, ControlChart, control_chart
from station.history.past_tests import PastTest
from station.report.figure import ACCENT, LINE, SECOND, SOFT, TALL, svg_element

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BASELINE = 25


@dataclass(frozen=True)
class Course:
    """One number over time, of one type of unit or of one reference unit."""

    of: str  # ``"RLG-2000"``, or ``"bench, by REF-1"``
    name: str  # of step and number
    tests: tuple[PastTest, ...]  # in the order of time
    us: tuple[float, ...]  # standard uncertainty of each value; nan where nobody knows it
    chart: ControlChart

    @property
    def sentences(self) -> list[str]:
        """What the chart says, in words."""
        chart = self.chart
        if chart.values.size < FEWEST:
            return [f"{chart.values.size} of {FEWEST} values that limits need: there are none yet."]
        if not chart.has_limits:
            return ["All values of the baseline are the same: there are no limits."]
        said = [
            f"Centre {chart.centre:.6g}, sigma {chart.sigma:.2g} by the moving range of the first "
            f"{chart.baseline}, limits {chart.centre - 3 * chart.sigma:.6g} to "
            f"{chart.centre + 3 * chart.sigma:.6g}."
        ]
        if not chart.signals:
            return [*said, "In control: nothing stands out."]
        for one in chart.signals:
            test = self.tests[one.place]
            said.append(f"{test.at[:16].replace('T', ' ')} UTC, {test.unit}: {RULES[one.rule]}.")
        return said


def courses(tests: Sequence[PastTest], *, baseline: int = BASELINE) -> list[Course]:
    """Return every number that is followed: those of the bench first, then by type of unit.

    A test without a verdict counts; one that was aborted, or that the bench spoilt, does not. Simulated benches
    are not mixed with real ones.
    """
    counted = [one for one in tests if one.verdict not in ("ABORTED", "ERROR")]
    groups: dict[str, list[PastTest]] = {}
    for one in sorted(counted, key=lambda test: not test.is_reference):
        kind = f"bench, by {one.unit}" if one.is_reference else one.unit_type or "units of no type"
        groups.setdefault(f"{kind} (simulated)" if one.simulated else kind, []).append(one)
    return [course for of, group in groups.items() for course in _of_group(of, group, baseline)]


def _of_group(of: str, tests: Iterable[PastTest], baseline: int) -> list[Course]:
    ordered = sorted(tests, key=lambda one: one.at)
    names = dict.fromkeys(number.name for test in ordered for number in test.numbers)
    found = []
    for name in names:
        pairs = [(test, one) for test in ordered for one in test.numbers if one.name == name]
        chart = control_chart([one.value for _, one in pairs], baseline=baseline)
        found.append(Course(of, name, tuple(test for test, _ in pairs), tuple(one.u for _, one in pairs), chart))
    return found


def course_svg(course: Course, name: str) -> str:
    """Draw a course as individuals above and moving range below; `name` sets its ids apart."""
    chart, number = course.chart, np.arange(1, course.chart.values.size + 1)
    flagged = sorted({one.place for one in chart.signals if one.rule < 5})
    jumps = sorted({one.place for one in chart.signals if one.rule == 5})

    def draw(figure: Figure) -> None:
        from matplotlib.ticker import MaxNLocator

        above, below = figure.subplots(2, sharex=True, height_ratios=(2.2, 1))
        us = np.array(course.us)
        if np.isfinite(us).any():
            above.errorbar(number, chart.values, yerr=np.nan_to_num(us), fmt="none", ecolor=SOFT, linewidth=0.8)
        above.plot(number, chart.values, "o-", color=ACCENT, ms=4, linewidth=0.8)
        below.plot(number[1:], chart.moving_range[1:], "o-", color=ACCENT, ms=3.5, linewidth=0.8)
        if chart.has_limits:
            _limits(above, chart)
            below.axhline(chart.range_limit, color=SECOND, linewidth=1.0, linestyle=(0, (5, 3)))
        for axes, values, places in ((above, chart.values, flagged), (below, chart.moving_range, jumps)):
            axes.plot(number[places], values[places], "s", ms=8, mfc="none", mec=SECOND, mew=1.6)
        above.set(ylabel="value")
        above.ticklabel_format(axis="y", useOffset=False)
        below.set(xlabel="test, in the order of time", ylabel="moving range", xlim=(0.4, number.size + 0.6))
        largest = np.max(chart.moving_range[1:], initial=chart.range_limit if chart.has_limits else 0.0)
        below.set_ylim(0, 1.15 * largest if largest > 0 else None)
        below.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))

    return svg_element(name, TALL, draw)


def _limits(axes: Axes, chart: ControlChart) -> None:
    axes.axhline(chart.centre, color=ACCENT, linewidth=1.0)
    for sigmas in (1, 2):
        for sign in (1, -1):
            axes.axhline(chart.centre + sign * sigmas * chart.sigma, color=LINE, linewidth=0.9)
    for sign in (1, -1):
        axes.axhline(chart.centre + 3 * sign * chart.sigma, color=SECOND, linewidth=1.0, linestyle=(0, (5, 3)))
