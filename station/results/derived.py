"""What two results make together, a difference or a ratio, with what both share counted once.

    y = a - b    u(y)^2 = u(a)^2 + u(b)^2 - 2 sum_k c_k(a) c_k(b)
    y = a / b    u(y)^2 = (u(a)^2 + y^2 u(b)^2 - 2 y sum_k c_k(a) c_k(b)) / b^2

c_k(a) is what the input k contributes to a, with its sign: scale factor, time base, table and channel are one and
the same in two runs of a bench. Source: JCGM 100:2008, 5.2.2, equation (16), such inputs with correlation 1. The
interval of a ratio is Fieller's (Biometrika 41, 175, 1954): wide, or none, where b is hardly known to be not 0.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from analysis.arrays import NORMAL_95
from station.results.quantity import Quantities, Value

_OF_THE_UNIT = {"scale_factor", "gain_corner", "table"}
_OF_THE_BENCH = {
    *("time_base", "table_rate", "tilt", "latitude", "earth_rate", "table rate", "clock"),
    *("bandwidth", "high_pass", "response"),
}
"""Lines of a budget that are constants of the unit, and of the bench; every other is of a run, distortion too."""


Form = Literal["less", "over"]


@dataclass(frozen=True)
class BudgetedValue:
    """A number, and what each input contributes to it that another run may have too."""

    value: Value
    # by name, whose constant it is and the value stated for it; in the unit of the number
    shared: Mapping[tuple[str, str, Any], float]


def derived(form: Form, first: BudgetedValue, second: BudgetedValue, *, of_one: bool = False) -> Value:
    """The first number less the second, or over it; a ratio to zero is nan."""
    # numbers `of_one` result have more in common than its budget says: the worst of it counts
    a, b, u_a, u_b = first.value, second.value, _u(first.value), _u(second.value)
    both = sum(first.shared[one] * second.shared[one] for one in shared_inputs(first, second))
    if of_one:
        both = -u_a * u_b * (-1 if form == "over" and a.value * b.value < 0 else 1)
    if form == "less":
        value, u = a.value - b.value, math.sqrt(max(u_a**2 + u_b**2 - 2 * both, 0.0))
        return Value(value, a.unit, value - NORMAL_95 * u, value + NORMAL_95 * u, a.of, u, a.quantity)
    value = a.value / b.value if b.value else math.nan
    variance, slope = u_a**2 + value**2 * u_b**2 - 2 * value * both, both / u_b**2 if u_b else 0.0
    far = (NORMAL_95 * u_b / b.value) ** 2 if b.value else math.inf  # 1: b may be 0, and nothing bounds the ratio
    middle = (value - far * slope) / (1 - far) if far < 1 else math.nan
    reach = (
        NORMAL_95 * math.sqrt(max(variance - far * (u_a**2 - slope * both), 0.0)) / abs((b.value or 1) * (1 - far))
    )
    u = math.sqrt(max(variance, 0.0)) / abs(b.value or 1)
    return Value(value, "", middle - reach, middle + reach, a.of, u, a.quantity)


def derived_values(
    form: Form, first: Iterable[BudgetedValue], second: Iterable[BudgetedValue], *, of_one: bool
) -> list[Value]:
    """Each axis of one result with the same axis of the other; a number that has none goes with every axis."""
    others = list(second)
    fits = ((a, b) for a in first for b in others if a.value.of == b.value.of or not (a.value.of and b.value.of))
    return [derived(form, a, b, of_one=of_one) for a, b in fits]


def budgeted_values(document: Mapping[str, Any], declared: Quantities, number: str) -> Iterator[BudgetedValue]:
    """A number of a result by the name that limits have for it: one value, or that of each axis."""
    for group in declared:
        for of, holder in group.objects(document):
            for one in group.quantities:
                if one.limit_name == number:
                    value = one.value_in(holder, of)
                    budget = holder.get("budget") if one.headline else None
                    yield BudgetedValue(value, _shared(budget, value, document))


def shared_inputs(first: BudgetedValue, second: BudgetedValue) -> list[tuple[str, str, Any]]:
    """Inputs that both have, and that matter."""
    return sorted((one for one in first.shared.keys() & second.shared.keys() if first.shared[one]), key=str)


def _shared(budget: Any, value: Value, document: Mapping[str, Any]) -> dict[tuple[str, str, Any], float]:
    """What constants of a named unit and of a known bench contribute to the number that a budget is of."""
    # every scope of the first models says 0 for its serial number
    unit, scope = document.get("unit") or "", ((document.get("instrument") or {}).get("serial") or "").strip("0")
    found: dict[tuple[str, str, Any], float] = {}
    for line, name in ((one, one["name"]) for one in (budget or {}).get("inputs", ())):
        whose = unit if name in _OF_THE_UNIT else scope if name in _OF_THE_BENCH else ""
        if whose:
            by_unit = line.get("sensitivity_dps_per_unit")
            part = 1e-6 * line["contribution_ppm"] * value.value if by_unit is None else by_unit * line["u"]
            # a corner's share differs from beat to beat; of all else the same value makes it the same input
            found[name, whose, None if line.get("unit", "1") == "1" else line["value"]] = part
    return found


def _u(value: Value) -> float:
    """Standard uncertainty, or half of the wider side of the 95 % interval if it is more; nan where not known."""
    side = max(value.value - value.low_95, value.high_95 - value.value)
    return max(value.u, side / 2 if math.isfinite(side) else 0.0) if math.isfinite(value.u) else side / NORMAL_95
