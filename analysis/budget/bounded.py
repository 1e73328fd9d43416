"""What is known of a bench, with a bound in the place of everything that nobody stated."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from analysis.budget.knowledge import BenchKnowledge, Corner
from analysis.budget.unstated import (
    AC_CORNER_HZ,
    SCALE_FACTOR_LIMIT,
    SECOND_ORDER_LIMIT,
    THIRD_ORDER_LIMIT,
    lowest_bandwidth,
    lowest_gain_corner,
)

_RECTANGLE = math.sqrt(3.0)


@dataclass(frozen=True)
class Bounded:
    """Knowledge without gaps."""

    # without nan, but for `response_u`, which is nan where there is no measured response
    knowledge: BenchKnowledge
    assumed: frozenset[str]  # names of the lines that rest on a bound

    def note(self, name: str, bound: str, otherwise: str) -> str:
        """Say of a line where its size comes from."""
        return f"not stated: bound of {bound}" if name in self.assumed else otherwise


def bounded(knowledge: BenchKnowledge, slowest_beat_hz: float) -> Bounded:
    """Put bounds where nothing is known."""
    bounds = {
        "scale_factor": ("scale_factor_u_ppm", 1e6 * SCALE_FACTOR_LIMIT / _RECTANGLE),
        "distortion": ("distortion_limit", SECOND_ORDER_LIMIT),
        "third_order": ("third_order_limit", THIRD_ORDER_LIMIT),
        "bandwidth": ("bandwidth", Corner(lowest_bandwidth(slowest_beat_hz))),
        "high_pass": ("high_pass", Corner(AC_CORNER_HZ)),
        "gain_corner": ("gain", Corner(lowest_gain_corner(slowest_beat_hz))),
    }
    missing = {line: bound for line, bound in bounds.items() if _unknown(getattr(knowledge, bound[0]))}
    return Bounded(replace(knowledge, **dict(missing.values())), frozenset(missing))  # type: ignore[arg-type]


def _unknown(value: float | Corner) -> bool:
    return math.isnan(value.hz if isinstance(value, Corner) else value)
