"""Verdict: what was measured against the limits of the settings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from station.results.result import Measured, plain_words


@dataclass(frozen=True)
class Tested:
    """One number against its limit."""

    measured: Measured  # its size counts; nan where the run gave none, which fails
    limit: float

    @property
    def passed(self) -> bool:
        """Whether the value keeps within the limit."""
        return abs(self.measured.value) <= self.limit

    @property
    def name(self) -> str:
        """Name of the limit, with what it is of where there are several."""
        return f"{self.measured.name} of {self.measured.of}" if self.measured.of else self.measured.name

    @property
    def sentence(self) -> str:
        """One line."""
        words = plain_words(self.name.replace(f"_{self.measured.unit_suffix}", ""))
        size, unit = abs(self.measured.value), self.measured.unit
        if math.isnan(size):
            return f"FAIL {words}: the run gives no value, the limit is {self.limit:g} {unit}".rstrip()
        verdict = "PASS" if self.passed else "FAIL"
        return f"{verdict} {words}: {size:.4g} {unit}, limit {self.limit:g} {unit}".replace(" ,", ",").rstrip()

    def as_json(self) -> dict[str, object]:
        """Return name, value, limit and verdict, as the JSON of a result holds them."""
        return {
            "name": self.name,
            "value": abs(self.measured.value),
            "limit": self.limit,
            "passed": self.passed,
        }


def check_limits(measured: Sequence[Measured], limits: Mapping[str, float | None]) -> tuple[Tested, ...]:
    """Test what was measured against the limits that are set; one that nothing has the name of is not tested."""
    pairs = ((one, limits.get(one.name)) for one in measured)
    return tuple(Tested(one, limit) for one, limit in pairs if limit is not None)


def verdict(tested: Sequence[Tested]) -> str | None:
    """Return ``"PASS"`` or ``"FAIL"``, ``None`` without limits."""
    if not tested:
        return None
    return "PASS" if all(one.passed for one in tested) else "FAIL"
