"""Verdict: results against the limits of the settings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from station.fibre_gyro.settings import LimitSettings


@dataclass(frozen=True)
class Tested:
    """One value against its limit.

    Attributes
    ----------
    name : str
        With the axis where there are several: ``"nominal_difference_ppm of X"``.
    value : float
        Its size; nan where the run gave none, which fails.
    limit : float
    """

    name: str
    value: float
    limit: float

    @property
    def passed(self) -> bool:
        """Whether the value keeps within the limit."""
        return self.value <= self.limit

    @property
    def sentence(self) -> str:
        """One line."""
        words = self.name.replace("_ppm", "").replace("_", " ")
        if math.isnan(self.value):
            return f"FAIL {words}: the run gives no value, the limit is {self.limit:g} ppm"
        return f"{'PASS' if self.passed else 'FAIL'} {words}: {self.value:.4g} ppm, limit {self.limit:g} ppm"

    def as_json(self) -> dict[str, Any]:
        """Plain JSON."""
        value = self.value if math.isfinite(self.value) else None
        return {"name": self.name, "value": value, "limit": self.limit, "passed": self.passed}


def check_limits(values: Mapping[str, float], limits: LimitSettings) -> tuple[Tested, ...]:
    """Test values against the limits that are set.

    Parameters
    ----------
    values : mapping
        By the name of the limit, perhaps followed by `` of `` and what it is of. A limit that no value has the
        name of is not tested: it belongs to another command.
    limits : LimitSettings
    """
    tested = []
    for name, value in values.items():
        limit = getattr(limits, name.split(" of ")[0])
        if limit is not None:
            tested.append(Tested(name, abs(value), limit))
    return tuple(tested)


def verdict(tested: tuple[Tested, ...]) -> str | None:
    """Return ``"PASS"`` or ``"FAIL"``, ``None`` without limits."""
    if not tested:
        return None
    return "PASS" if all(one.passed for one in tested) else "FAIL"
