"""Numbers of a result with their 95 % intervals, as verdicts need them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from station.results.result import UNITS, Measured, Result
from station.results.verdict import Value

_COVERAGE = 2.0
"""Half a 95 % interval in standard uncertainties where a result gives no interval (GUM 6.3.3)."""


def values_of(result: Result, document: Mapping[str, Any], number: str, prefix: str = "result.") -> list[Value]:
    """Return a number of a result: one value, or several where it is of several axes; empty if there is none."""
    if number.startswith(prefix):
        *way, name = number.removeprefix(prefix).split(".")
        inner = _at(document, way)
        return [] if inner is None else [_value(inner, name)]
    return [_of_measured(one, document) for one in result.measured if one.name == number]


def _of_measured(one: Measured, document: Mapping[str, Any]) -> Value:
    if math.isfinite(one.u):
        half = _COVERAGE * one.u
        return Value(one.value, one.unit, one.value - half, one.value + half, one.of)
    holder = document if not one.of else next(_named(document, one.of), {})
    low, high = _interval(holder, one.name, one.value)
    return Value(one.value, one.unit, low, high, one.of)


def _named(document: Mapping[str, Any], name: str) -> Iterator[Mapping[str, Any]]:
    """Parts of a result that are of one axis."""
    for value in document.values():
        if isinstance(value, list):
            yield from (one for one in value if isinstance(one, dict) and one.get("axis") == name)


def _at(document: Any, way: list[str]) -> Mapping[str, Any] | None:
    for name in way:
        if isinstance(document, list) and name.isdecimal() and int(name) < len(document):
            document = document[int(name)]
        elif isinstance(document, dict):
            document = document.get(name)
        else:
            return None
    return document if isinstance(document, dict) else None


def _value(holder: Mapping[str, Any], name: str) -> Value:
    found = holder.get(name)
    value = float(found) if isinstance(found, int | float) and not isinstance(found, bool) else math.nan
    end = name.rpartition("_")[2]
    return Value(value, UNITS.get(end, ""), *_interval(holder, name, value))


def _interval(holder: Mapping[str, Any], name: str, value: float) -> tuple[float, float]:
    """Ends of the 95 % interval by the names that stand beside a number; nan where there are none.

    A number that is an end of an interval itself, or an uncertainty, has none.
    """
    stem, unit = _parted(name)
    low, high = (_number(holder.get(f"{stem}_{end}_95{unit}")) for end in ("low", "high"))
    if math.isfinite(low) and math.isfinite(high):
        return low, high
    u = _number(holder.get(f"{stem}_u{unit}"))
    return (value - _COVERAGE * u, value + _COVERAGE * u) if math.isfinite(u) else (math.nan, math.nan)


def _parted(name: str) -> tuple[str, str]:
    """Stem and unit of a name, the unit with its line: ``("lock_in_rate", "_dps")``."""
    for unit in sorted((*UNITS, *_LONG_UNITS), key=len, reverse=True):
        if name.endswith(f"_{unit}"):
            return name.removesuffix(f"_{unit}"), f"_{unit}"
    return name, ""


_LONG_UNITS = ("pulses_per_deg", "counts_per_dps", "deg_per_sqrt_h", "counts", "codes")


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
