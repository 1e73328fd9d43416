"""What two results make together, a difference or a ratio, with what both share counted once.

    y = a - b    u(y)^2 = u(a)^2 + u(b)^2 - 2 sum_k c_k(a) c_k(b)
    y = a / b    the same with contributions relative to a and b, times y^2

c_k(a) is what the input k contributes to a, with its sign: scale factor, time base, table and channel are one and
the same in two runs of a bench. Source: JCGM 100:2008, 5.2.2, equation (16), such inputs with correlation 1.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from station.results.quantity import Quantities, Value

_OF_THE_UNIT = {"scale_factor", "gain_corner", "table"}
_OF_THE_BENCH = {
    *("time_base", "table_rate", "tilt", "latitude", "earth_rate", "table rate", "clock"),
    *("bandwidth", "high_pass", "response"),
}
"""Lines of a budget that are constants of the unit, and of the bench; every other is of a run, distortion too."""


@dataclass(frozen=True)
class BudgetedValue:
    """A number, and what each input contributes to it that another run may have too."""

    value: Value
    # by name, whose constant it is and the value stated for it; in the unit of the number
    shared: Mapping[tuple[str, str, Any], float]


def derived(form: Literal["less", "over"], first: BudgetedValue, second: BudgetedValue) -> Value:
    """The first number less the second, or over it; a ratio to zero is nan."""
    a, b = first.value, second.value
    ratio = form == "over"
    value = (a.value / b.value if b.value else math.nan) if ratio else a.value - b.value
    by_a, by_b = (1 / a.value, 1 / b.value) if ratio and a.value and b.value else (1.0, 1.0)
    both = sum(first.shared[one] * second.shared[one] for one in shared_inputs(first, second))
    variance = (_u(a) * by_a) ** 2 + (_u(b) * by_b) ** 2 - 2 * both * by_a * by_b
    u = (abs(value) if ratio else 1.0) * math.sqrt(max(variance, 0.0))
    of_same = not ratio and a.unit == b.unit
    return Value(value, a.unit if of_same else "", value - 1.96 * u, value + 1.96 * u, a.of, u, a.quantity)


def derived_values(
    form: Literal["less", "over"], first: Iterable[BudgetedValue], second: Iterable[BudgetedValue]
) -> list[Value]:
    """Each axis of one result with the same axis of the other; a number that has none goes with every axis."""
    others = list(second)
    fits = ((a, b) for a in first for b in others if a.value.of == b.value.of or not (a.value.of and b.value.of))
    return [derived(form, a, b) for a, b in fits]


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
    unit, scope = document.get("unit") or "", (document.get("instrument") or {}).get("serial") or ""
    found: dict[tuple[str, str, Any], float] = {}
    for line in budget["inputs"] if isinstance(budget, dict) else ():
        name = line["name"]
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
    return max(value.u, side / 2 if math.isfinite(side) else 0.0) if math.isfinite(value.u) else side / 1.96
