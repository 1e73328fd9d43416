"""A value with its uncertainty against a limit: in [limits] and in campaigns, and the worst of many.

Decision rules: JCGM 106:2012 (Evaluation of measurement data, the role of measurement uncertainty in conformity
assessment), sections 8.2 (simple acceptance) and 8.3 (guard bands).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from scipy.special import ndtr

from station.results.quantity import Value, value_at
from station.results.result import Result

Verdict = Literal["PASS", "FAIL", "MARGINAL", "ERROR", "ABORTED"]
Rule = Literal["none", "U95", "simple"]

PASS: Verdict = "PASS"
FAIL: Verdict = "FAIL"
MARGINAL: Verdict = "MARGINAL"
ERROR: Verdict = "ERROR"
ABORTED: Verdict = "ABORTED"

RESULT = "result."
"""Before the place of a number in a result's JSON that is none of those that the measurement gives by name."""

_FROM_BEST: tuple[Verdict, ...] = (PASS, MARGINAL, FAIL, ERROR, ABORTED)
_K95 = 1.959963984540054


@dataclass(frozen=True)
class Limit:
    """What a number has to keep to."""

    number: str  # name of the number, with its unit at the end
    at_least: float | None = None  # at least one of them is given
    at_most: float | None = None
    # {"none", "U95", "simple"}: "U95": the whole 95 % interval has to lie within. "simple": the value has to
    # (simple acceptance), and the risk that this is wrong is told. "none": the value has to, and its uncertainty
    # is not asked for.
    rule: Rule = "U95"
    highest_risk: float = 0.5  # with "simple": no PASS and no FAIL whose risk of being wrong is above this share


@dataclass(frozen=True)
class LimitOutcome:
    """A number against its limit."""

    limit: Limit
    measured: Value
    verdict: Verdict
    acceptance_low: float | None  # where the value has to lie for PASS, after the guard band
    acceptance_high: float | None
    risk: float | None  # probability that PASS or FAIL is wrong: that the true value lies on the other side
    margin: float  # from the value to the nearest limit, positive within
    sentence: str  # all of it in one line

    @property
    def name(self) -> str:
        """Name of the number, with what it is of where there are several."""
        return f"{self.limit.number} of {self.measured.of}" if self.measured.of else self.limit.number


def worst(verdicts: Iterable[Verdict]) -> Verdict | None:
    """Return the verdict of all: PASS only where all are; ``None`` of none.

    ERROR outranks FAIL: what failed on a bench that failed too has to be measured again.

    Examples
    --------
    >>> worst(["PASS", "FAIL", "MARGINAL"]), worst(["FAIL", "ERROR"]), worst([])
    ('FAIL', 'ERROR', None)
    """
    found = list(verdicts)
    return max(found, key=_FROM_BEST.index) if found else None


def decide(limit: Limit, measured: Value) -> LimitOutcome:
    """Judge a number by a limit."""
    low = -math.inf if limit.at_least is None else limit.at_least
    high = math.inf if limit.at_most is None else limit.at_most
    value = measured.value
    if not math.isfinite(value):
        return _outcome(limit, measured, ERROR, (low, high), None, "the run gives no value")
    if limit.rule == "none":
        verdict = PASS if low <= value <= high else FAIL
        return _outcome(limit, measured, verdict, (low, high), None, "")
    if not measured.uncertain:
        why = 'the run gives no uncertainty of it: decide by guard_band = "none", or limit another number'
        return _outcome(limit, measured, ERROR, (low, high), None, why)
    inside = _probability_inside(measured, low, high)
    if limit.rule == "simple":
        return _simple(limit, measured, (low, high), inside)
    below, above = value - measured.low_95, measured.high_95 - value
    within = (low + below, high - above)
    if within[0] <= value <= within[1]:
        return _outcome(limit, measured, PASS, within, 1 - inside, "")
    if measured.high_95 < low or measured.low_95 > high:
        return _outcome(limit, measured, FAIL, within, inside, "")
    return _outcome(limit, measured, MARGINAL, within, None, "the limit lies within the 95 % interval")


def _simple(limit: Limit, measured: Value, ends: tuple[float, float], inside: float) -> LimitOutcome:
    verdict = PASS if ends[0] <= measured.value <= ends[1] else FAIL
    risk = 1 - inside if verdict == PASS else inside
    if risk > limit.highest_risk:
        allowed = f"{100 * limit.highest_risk:g} %"
        why = f"the risk of a wrong decision is {100 * risk:.2g} %, more than the {allowed} allowed"
        return _outcome(limit, measured, MARGINAL, ends, risk, why)
    return _outcome(limit, measured, verdict, ends, risk, "")


def _probability_inside(measured: Value, low: float, high: float) -> float:
    """Probability that the true value lies between the limits; each side of the interval has its own width."""

    def below(end: float) -> float:
        if not math.isfinite(end):
            return 0.0 if end < 0 else 1.0
        away = end - measured.value
        width = (measured.high_95 - measured.value if away >= 0 else measured.value - measured.low_95) / _K95
        if width <= 0:
            return 1.0 if away >= 0 else 0.0
        return float(ndtr(away / width))

    return below(high) - below(low)


def _outcome(
    limit: Limit,
    measured: Value,
    verdict: Verdict,
    acceptance: tuple[float, float],
    risk: float | None,
    why: str,
) -> LimitOutcome:
    low, high = (end if math.isfinite(end) else None for end in acceptance)
    below = math.inf if limit.at_least is None else measured.value - limit.at_least
    above = math.inf if limit.at_most is None else limit.at_most - measured.value
    margin = min(below, above)
    name = number_words(limit.number, measured)
    sentence = f"{verdict} {name}: {_value_words(measured)}, {limit_words(limit, measured.unit)}"
    if math.isfinite(margin):
        sentence += f", margin {margin_words(measured, margin)} {measured.unit}".rstrip()
    if risk is not None and limit.rule == "simple":
        sentence += f", risk {100 * risk:.2g} %"
    return LimitOutcome(
        limit, measured, verdict, low, high, risk, margin, f"{sentence}; {why}" if why else sentence
    )


def margin_words(measured: Value, margin: float) -> str:
    """Say a margin with its sign and the digits of its value."""
    return f"{'' if margin < 0 else '+'}{measured.digits(margin, 3)}"


def limit_words(limit: Limit, unit: str) -> str:
    """Say a limit: ``"at most 0.012 deg/s"``."""
    ends = [
        f"{words} {end:g} {unit}".rstrip()
        for words, end in (("at least", limit.at_least), ("at most", limit.at_most))
        if end is not None
    ]
    return " and ".join(ends)


def _value_words(measured: Value) -> str:
    if not math.isfinite(measured.value):
        return "no value"
    interval = f" [{interval_words(measured, ', ')}]" if measured.uncertain else ""
    return f"{measured.digits(measured.value)}{interval} {measured.unit}".rstrip()


def interval_words(measured: Value, between: str = " to ") -> str:
    """Say a 95 % interval with the digits of its value."""
    return between.join(measured.digits(end) for end in (measured.low_95, measured.high_95))


def number_words(number: str, measured: Value) -> str:
    """Say the name of a number, without the unit at its end: ``"lock-in rate"``, ``"scatter of X"``."""
    words = number.removeprefix(RESULT).replace(measured.name, measured.quantity.words)
    return f"{words.replace('_', ' ')} of {measured.of}" if measured.of else words.replace("_", " ")


# --------------------
# Verdict: what was measured against the limits of the settings


@dataclass(frozen=True)
class Tested:
    """One number against its limit."""

    measured: Value  # its size counts; nan where the run gave none, which fails
    limit: float

    @property
    def passed(self) -> bool:
        """Whether the value keeps within the limit."""
        return abs(self.measured.value) <= self.limit

    @property
    def name(self) -> str:
        """Name of the limit, with what it is of where there are several."""
        return self.measured.limit_name

    @property
    def sentence(self) -> str:
        """One line."""
        words, size, unit = self.measured.words, abs(self.measured.value), self.measured.unit
        if math.isnan(size):
            return f"FAIL {words}: the run gives no value, the limit is {self.limit:g} {unit}".rstrip()
        said = f"{words}: {self.measured.digits(size, 4)} {unit}".rstrip()
        return f"{'PASS' if self.passed else 'FAIL'} {said}, limit {self.limit:g} {unit}".rstrip()

    def as_json(self) -> dict[str, object]:
        """Return name, value, limit and verdict, as the JSON of a result holds them."""
        return {
            "name": self.name,
            "value": abs(self.measured.value),
            "limit": self.limit,
            "passed": self.passed,
        }


def check_limits(measured: Sequence[Value], limits: Mapping[str, float | None]) -> tuple[Tested, ...]:
    """Test what was measured against the limits that are set; one that nothing has the name of is not tested."""
    pairs = ((one, limits.get(one.quantity.limit_name)) for one in measured)
    return tuple(Tested(one, limit) for one, limit in pairs if limit is not None)


def verdict(tested: Sequence[Tested]) -> str | None:
    """Return ``"PASS"`` or ``"FAIL"``, ``None`` without limits."""
    if not tested:
        return None
    return "PASS" if all(one.passed for one in tested) else "FAIL"


def values_of(result: Result, document: Mapping[str, Any], number: str) -> list[Value]:
    """Return a number of a result: one value, or several where it is of several axes; empty if there is none."""
    if not number.startswith(RESULT):
        return [one for one in result.measured if one.quantity.limit_name == number]
    found = value_at(document, number.removeprefix(RESULT), result.quantities)
    return [] if found is None else [found]
