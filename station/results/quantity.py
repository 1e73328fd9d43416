"""A number of a result: its value, its 95 % interval and its unit, and how they stand in a JSON document.

This is the one place where a key is read. The uncertainty of a number stands beside it, its name with ``u`` at any
of its joints: ``ratio_u``, ``lock_in_rate_u_dps``, ``bias_instability_dph_u``; the ends of its interval in the
same way with ``low_95`` and ``high_95``. The end of the name is its unit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

UNITS = {
    "dps": "deg/s",
    "dph": "deg/h",
    "hz": "Hz",
    "v": "V",
    "s": "s",
    "deg": "deg",
    "rad": "rad",
    "mrad": "mrad",
    "ppm": "ppm",
    "counts": "counts",
    "codes": "codes",
    "pulses_per_deg": "pulses/deg",
    "counts_per_dps": "counts/(deg/s)",
    "deg_per_sqrt_h": "deg/√h",
    "dph_per_sqrt_h": "deg/h/√h",
    "dph_per_h": "deg/h/h",
}
"""End of a name, and the unit that it stands for."""

_COVERAGE = 2.0
"""Half a 95 % interval in standard uncertainties where a result gives no interval (GUM 6.3.3)."""


@dataclass(frozen=True)
class Value:
    """A number as a run gives it."""

    value: float  # nan where the run gives none
    unit: str = ""  # as a person reads it
    low_95: float = math.nan  # ends of its 95 % interval, every input counted; nan where nobody knows them
    high_95: float = math.nan
    of: str = ""  # what it is of, where a run gives several: ``"X"``
    name: str = field(default="", compare=False)  # its key, with the unit at its end
    u: float = field(default=math.nan, compare=False)  # standard uncertainty

    @classmethod
    def named(
        cls,
        name: str,
        value: float | None,
        u: float | None = None,
        *,
        low_95: float | None = None,
        high_95: float | None = None,
        of: str = "",
    ) -> Value:
        """By the key of a number; ``None`` is not known, and where there is no interval it is twice `u` wide."""
        size, spread, low, high = (math.nan if one is None else float(one) for one in (value, u, low_95, high_95))
        if not math.isfinite(high - low) and math.isfinite(spread):
            low, high = size - _COVERAGE * spread, size + _COVERAGE * spread
        return cls(size, UNITS.get(unit_at_end(name), ""), low, high, of, name, spread)

    @property
    def uncertain(self) -> bool:
        """Whether its 95 % interval is known."""
        return math.isfinite(self.low_95) and math.isfinite(self.high_95)

    @property
    def decimals(self) -> int | None:
        """Places behind the point that its uncertainty leaves; ``None`` where nobody knows it."""
        u = (self.high_95 - self.low_95) / (2 * _COVERAGE) if self.uncertain else self.u
        return max(0, decimals_of(u)) if math.isfinite(u) and u > 0 else None

    def digits(self, number: float, significant: int = 6) -> str:
        """A number of the same kind with as many digits as this one; without an uncertainty so many of its own."""
        if self.decimals is None or abs(number) >= 1e15:
            return f"{number:.{significant}g}"
        return f"{number:.{self.decimals}f}"

    @property
    def words(self) -> str:
        """Its name as a person says it: ``"lock-in rate"``, ``"scatter of X"``."""
        words = plain_words(without_unit(self.name))
        return f"{words} of {self.of}" if self.of else words


def value_beside(document: Mapping[str, Any], name: str, of: str = "") -> Value:
    """Return a number of a document with what stands beside it of its uncertainty.

    Examples
    --------
    >>> value_beside({"ratio": 0.1, "ratio_u": 0.01}, "ratio").high_95
    0.12000000000000001
    >>> value_beside({"walk_deg_per_sqrt_h": 5.0, "walk_deg_per_sqrt_h_low_95": 4.0}, "walk_deg_per_sqrt_h").low_95
    4.0
    """
    low, high = (_beside(document, name, f"{end}_95") for end in ("low", "high"))
    return Value.named(
        name, _number(document.get(name)), _beside(document, name, "u"), low_95=low, high_95=high, of=of
    )


def decimals_of(u: float) -> int:
    """Places behind the point of two digits of an uncertainty.

    >>> decimals_of(1.2e-5), decimals_of(0.0996), decimals_of(120.0)
    (6, 2, -1)
    """
    places = 1 - math.floor(math.log10(u))
    return places - (round(u * 10.0**places) >= 100)  # 0.0996 is written with the digits of 0.10


def has_uncertainty(document: Mapping[str, Any], name: str) -> bool:
    """Whether a document has a place for the standard uncertainty of a number, though it may be empty."""
    return any(_is_number(document[key]) for key in _names_with(name, "u") if key in document)


def unit_at_end(name: str) -> str:
    """End of a name that stands for its unit; empty for a pure number.

    >>> unit_at_end("angle_random_walk_deg_per_sqrt_h"), unit_at_end("ratio")
    ('deg_per_sqrt_h', '')
    """
    return max((unit for unit in UNITS if name.endswith(f"_{unit}")), key=len, default="")


def without_unit(name: str) -> str:
    """Return a name without its unit."""
    unit = unit_at_end(name)
    return name.removesuffix(f"_{unit}") if unit else name


def plain_words(name: str) -> str:
    """Say a name of the JSON as a person writes it.

    >>> plain_words("lock_in_rate")
    'lock-in rate'
    """
    return name.replace("_", " ").replace("lock in", "lock-in")


def _beside(document: Mapping[str, Any], name: str, what: str) -> float | None:
    found = (_number(document.get(key)) for key in _names_with(name, what))
    return next((one for one in found if one is not None), None)


def _names_with(name: str, what: str) -> Iterator[str]:
    """The name with a word at each of its joints, before its unit first."""
    parts = name.split("_")
    unit = unit_at_end(name)
    joint = len(parts) - (unit.count("_") + 1 if unit else 0)
    for at in (joint, *range(len(parts), 0, -1)):
        yield "_".join([*parts[:at], what, *parts[at:]])


def _is_number(value: object) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def _number(value: Any) -> float | None:
    if getattr(value, "ndim", None) == 0:  # an array of no dimensions
        value = value.item()
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
