"""Uncertainty budget after the GUM (JCGM 100): inputs, sensitivities, combination, coverage."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import scipy.special

from analysis.lockin_rate import size_interval

Distribution = Literal["normal", "rectangular", "arcsine"]
Reference = Literal["beat", "rate"]
"""What WL is measured against: f/K of the record itself, or the rate given by a table."""

NORMAL_95 = float(scipy.special.ndtri(0.975))
"""Standard deviations of a normal distribution to either side that hold 95 % of it."""


@dataclass(frozen=True)
class BudgetInput:
    """One line of a budget."""

    name: str  # one word for programs
    quantity: str  # in words
    unit: str  # of `value` and `u`
    value: float  # estimate and standard uncertainty (k = 1)
    u: float
    distribution: Distribution  # {"normal", "rectangular", "arcsine"}: What is known of the input
    # derivative of the lock-in rate by this input, deg/s per `unit`. 0: the input does not enter.
    sensitivity: float
    degrees_of_freedom: float = math.inf  # of `u`; inf where it was not found by repeating
    note: str = ""  # where the number comes from, or why it does not enter
    # whether it acts on every rate alike: a fit over several rates leaves its share as it is at one
    common: bool = False
    # whether somebody stated or measured it; otherwise it is a bound of `analysis.budget.unstated`
    stated: bool = True

    def __post_init__(self) -> None:
        if not (math.isfinite(self.u) and self.u >= 0 and math.isfinite(self.sensitivity)):
            raise ValueError(
                f"{self.name}: the uncertainty must be finite and not negative and the sensitivity finite, "
                f"not {self.u!r} and {self.sensitivity!r}"
            )
        if not self.degrees_of_freedom > 0:
            raise ValueError(f"{self.name}: degrees of freedom must be positive, not {self.degrees_of_freedom!r}")

    @property
    def contribution(self) -> float:
        """Standard uncertainty that this input gives to the lock-in rate, deg/s."""
        return abs(self.sensitivity) * self.u


@dataclass(frozen=True)
class Budget:
    """All inputs of a lock-in rate, the largest contribution first."""

    lock_in_rate: float  # deg/s
    reference: Reference  # {"beat", "rate"}
    inputs: tuple[BudgetInput, ...]  # independent of each other

    def __post_init__(self) -> None:
        ordered = tuple(sorted(self.inputs, key=lambda line: -line.contribution))
        object.__setattr__(self, "inputs", ordered)

    @property
    def combined_u(self) -> float:
        """Standard uncertainty of the lock-in rate, deg/s."""
        return math.hypot(*(line.contribution for line in self.inputs))

    @property
    def effective_degrees_of_freedom(self) -> float:
        """After Welch and Satterthwaite (JCGM 100, G.4); inf where no line has any."""
        total = self.combined_u
        terms = sum((line.contribution / total) ** 4 / line.degrees_of_freedom for line in self.inputs if total)
        return 1 / terms if terms > 0 else math.inf

    @property
    def coverage_factor(self) -> float:
        """k of the 95 % interval: Student's factor for the effective degrees of freedom, cut to an integer."""
        freedom = self.effective_degrees_of_freedom
        if freedom > 1e6:
            return NORMAL_95
        return float(scipy.special.stdtrit(max(math.floor(freedom), 1), 0.975))

    @property
    def expanded_u_95(self) -> float:
        """Half width of the 95 % interval, deg/s."""
        return self.coverage_factor * self.combined_u

    @property
    def interval_95(self) -> tuple[float, float]:
        """Ends of the 95 % interval, deg/s; it begins at zero where a size may be nothing but uncertainty.

        Far above its uncertainty they lie U95 to both sides; near zero the interval is that of Feldman and Cousins
        (:func:`analysis.lockin_rate.size_interval`) with the combined uncertainty.
        """
        wide = self.expanded_u_95 / NORMAL_95
        if wide == 0:
            return self.lock_in_rate, self.lock_in_rate
        # the value is freed of the bias that noise gives to a size; the interval is made for one that has it
        low, high = size_interval(math.hypot(self.lock_in_rate, wide) / wide)
        return float(low) * wide, float(high) * wide

    @property
    def relative_u(self) -> float:
        """Combined standard uncertainty over the lock-in rate."""
        return self.combined_u / self.lock_in_rate if self.lock_in_rate else math.inf

    def share(self, line: BudgetInput) -> float:
        """Share of one line in the variance, 0 to 1."""
        total = self.combined_u
        return (line.contribution / total) ** 2 if total else 0.0

    @property
    def not_stated(self) -> tuple[BudgetInput, ...]:
        """Lines that are bounds of what nobody stated or measured."""
        return tuple(line for line in self.inputs if not line.stated)

    def with_line(self, line: BudgetInput, share: float) -> Budget:
        """The budget with one of its lines known so much better: `share` of its uncertainty is left."""
        better = replace(line, u=share * line.u)
        return replace(self, inputs=tuple(better if one is line else one for one in self.inputs))
