"""A value with its uncertainty against a limit: one rule for [limits] and campaigns, and the worst of many.

Decision rules: JCGM 106:2012 (Evaluation of measurement data, the role of measurement uncertainty in conformity
assessment), sections 8.2 (simple acceptance) and 8.3 (guard bands).
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal

from scipy.special import ndtr

from analysis.arrays import NORMAL_95
from station.errors import EXIT_FAIL, EXIT_MARGINAL, EXIT_NO_SIGNAL, EXIT_OK
from station.results.quantity import Quantities, Quantity, Value, value_at
from station.results.result import Result, Validity

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
    # another number that is taken off, or that it is divided by: ``"NUMBER"`` of the same result, or of a step
    # before, ``"STEP: NUMBER"``
    less: str = ""
    over: str = ""

    @property
    def relation(self) -> str:
        """How the number goes with another one: ``" less cold: lock_in_rate_dps"``; empty if it stands alone."""
        return f" less {self.less}" if self.less else f" over {self.over}" if self.over else ""


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
    def passed(self) -> bool:
        """Whether it keeps to the limit."""
        return self.verdict == PASS

    def as_json(self) -> dict[str, object]:
        """Return name, size, limit and verdict, as the JSON of a result holds them."""
        return {
            "name": self.name,
            "value": abs(self.measured.value),
            "limit": self.limit.at_least if self.limit.at_most is None else self.limit.at_most,
            "passed": self.passed,
            "verdict": self.verdict,
            "low_95": self.measured.low_95,
            "high_95": self.measured.high_95,
        }

    @property
    def name(self) -> str:
        """Name of the number, with what it is of where there are several."""
        of = f" of {self.measured.of}" if self.measured.of else ""
        return f"{self.limit.number}{of}{self.limit.relation}"


def worst(verdicts: Iterable[Verdict]) -> Verdict | None:
    """Return the verdict of all: PASS only where all are; ``None`` of none."""
    # ERROR outranks FAIL: what failed on a bench that failed too has to be measured again.
    found = list(verdicts)
    return max(found, key=_FROM_BEST.index) if found else None


def exit_code_of(verdict: Verdict | None) -> int:
    """Return what a command ends with; without limits it is done."""
    codes = {MARGINAL: EXIT_MARGINAL, FAIL: EXIT_FAIL, ERROR: EXIT_NO_SIGNAL, ABORTED: EXIT_NO_SIGNAL}
    return codes.get(verdict, EXIT_OK) if verdict is not None else EXIT_OK


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
        ends = (low, high)
        verdict = PASS if ends[0] <= measured.value <= ends[1] else FAIL
        risk = 1 - inside if verdict == PASS else inside
        if risk > limit.highest_risk:
            allowed = f"{100 * limit.highest_risk:g} %"
            why = f"the risk of a wrong decision is {100 * risk:.2g} %, more than the {allowed} allowed"
            return _outcome(limit, measured, MARGINAL, ends, risk, why)
        return _outcome(limit, measured, verdict, ends, risk, "")
    below, above = value - measured.low_95, measured.high_95 - value
    within = (low + below, high - above)
    if within[0] <= value <= within[1]:
        return _outcome(limit, measured, PASS, within, 1 - inside, "")
    if measured.high_95 < low or measured.low_95 > high:
        return _outcome(limit, measured, FAIL, within, inside, "")
    return _outcome(limit, measured, MARGINAL, within, None, "the limit lies within the 95 % interval")


def _probability_inside(measured: Value, low: float, high: float) -> float:
    """Probability that the true value lies between the limits; each side of the interval has its own width."""

    def below(end: float) -> float:
        if not math.isfinite(end):
            return 0.0 if end < 0 else 1.0
        away = end - measured.value
        width = (measured.high_95 - measured.value if away >= 0 else measured.value - measured.low_95) / NORMAL_95
        if width <= 0:
            return 1.0 if away >= 0 else 0.0
        return float(ndtr(away / width))

    return below(high) - below(low)


def _outcome(
    limit: Limit, measured: Value, verdict: Verdict, acceptance: tuple[float, float], risk: float | None, why: str
) -> LimitOutcome:
    low, high = (end if math.isfinite(end) else None for end in acceptance)
    below = math.inf if limit.at_least is None else measured.value - limit.at_least
    above = math.inf if limit.at_most is None else limit.at_most - measured.value
    margin = min(below, above)
    name = number_words(limit, measured)
    value = "no value"
    if math.isfinite(measured.value):
        interval = f" [{interval_words(measured, ', ')}]" if measured.uncertain else ""
        value = f"{measured.digits(measured.value)}{interval} {measured.unit}".rstrip()
    sentence = f"{verdict} {name}: {value}, {limit_words(limit, measured.unit)}"
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
    if limit.at_least is not None and limit.at_least == -(limit.at_most or math.nan):
        return f"within ±{limit.at_most:g} {unit}".rstrip()
    ends = [
        f"{words} {end:g} {unit}".rstrip()
        for words, end in (("at least", limit.at_least), ("at most", limit.at_most))
        if end is not None
    ]
    return " and ".join(ends)


def interval_words(measured: Value, between: str = " to ") -> str:
    """Say a 95 % interval with the digits of its value."""
    return between.join(measured.digits(end) for end in (measured.low_95, measured.high_95))


def number_words(limit: Limit, measured: Value) -> str:
    """Say the name of a number, without the unit at its end: ``"lock-in rate"``, ``"scatter of X"``."""
    words = limit.number.removeprefix(RESULT).replace(measured.name, measured.quantity.words).replace("_", " ")
    if limit.number in (measured.name, measured.quantity.limit_name):
        words = measured.words
    form, (step, _, number) = "less" if limit.less else "over", (limit.less or limit.over).rpartition(": ")
    if not limit.relation:
        return words
    other = "that" if number == limit.number else number.replace("_", " ")
    return f"{words} {form} {other}" + (f" of {step}" if step else "")


Step = tuple[Mapping[str, Any], Quantities]  # the JSON of its result, and its numbers


def judged(
    result: Result,
    document: Mapping[str, Any],
    limits: Iterable[Limit],
    *,
    doubtful: str = "marginal",
    steps: Mapping[str, Step] = MappingProxyType({}),
) -> tuple[LimitOutcome, ...]:
    """Judge a result by limits; one that is doubtful passes nothing, one that fails decides nothing."""
    # `doubtful` is "as_it_is" where a doubtful result is judged like any other; `steps` are those before, by name.
    found: list[LimitOutcome] = []
    for limit in limits:
        values, standings = values_of(result, document, limit.number), [result.standing]
        if limit.relation:
            step, _, number = (limit.less or limit.over).rpartition(": ")
            other, declared = steps.get(step, ({}, ())) if step else (document, result.quantities)
            own = budgeted_values(document, result.quantities, limit.number)
            others = budgeted_values(other, declared, number)
            values = derived_values("less" if limit.less else "over", own, others, of_one=not step)
            reasons = tuple(f"{step}: {one}" for one in other.get("standing_reasons", ())) if step else ()
            standings.append(Validity(other.get("standing", "fails") if step else "stands", reasons))
        values = values or [Value(math.nan, quantity=Quantity(limit.number))]
        outcomes = [decide(limit, value) for value in values]
        for standing in standings:
            outcomes = _as_far_as_it_holds(outcomes, standing, doubtful)
        found += outcomes
    return tuple(found)


def _as_far_as_it_holds(outcomes: list[LimitOutcome], standing: Validity, doubtful: str) -> list[LimitOutcome]:
    """The verdicts where a result that they rest on is doubtful, or fails."""
    if standing.state == "fails":
        return [_instead(one, ERROR, "the result does not hold", standing.reasons) for one in outcomes]
    if standing.state == "stands" or doubtful != "marginal":
        return outcomes
    # what is decided without its uncertainty is not touched by what rules the uncertainty
    passing = (one.verdict == PASS and one.limit.rule != "none" for one in outcomes)
    return [
        _instead(one, MARGINAL, "the result is doubtful", standing.reasons) if passed else one
        for one, passed in zip(outcomes, passing, strict=True)
    ]


def _instead(outcome: LimitOutcome, verdict: Verdict, why: str, reasons: Sequence[str]) -> LimitOutcome:
    """Put another verdict where the value alone would have decided."""
    if outcome.verdict not in (PASS, FAIL, MARGINAL):
        return outcome
    sentence = outcome.sentence.replace(outcome.verdict, verdict, 1)
    return replace(outcome, verdict=verdict, sentence=f"{sentence}; {why}: {'; '.join(reasons)}")


def limits_in(settings: Mapping[str, float | None], result: Result) -> Iterator[Limit]:
    """Return the [limits] that a result has the numbers of: on sizes, with a guard band of U95."""
    # What has no uncertainty, or is one itself, is decided by its value.
    for name in dict.fromkeys(one.quantity.limit_name for one in result.measured):
        if (end := settings.get(name)) is not None:
            values = [one for one in result.measured if one.quantity.limit_name == name]
            signed = any(min(one.value, one.low_95) < 0 for one in values)
            rule: Rule = "U95" if all(one.uncertain for one in values) else "none"
            if values[0].quantity.at_least:
                yield Limit(name, end, None, rule)
            else:
                yield Limit(name, -end if signed else None, end, rule)


def values_of(result: Result, document: Mapping[str, Any], number: str) -> list[Value]:
    """Return a number of a result: one value, or several where it is of several axes; empty if there is none."""
    if not number.startswith(RESULT):
        return [one for one in result.measured if one.quantity.limit_name == number]
    found = value_at(document, number.removeprefix(RESULT), result.quantities)
    return [] if found is None else [found]


# --------------------
# What two results make together, a difference or a ratio, with what both share counted once.
#
#     y = a - b    u(y)^2 = u(a)^2 + u(b)^2 - 2 sum_k c_k(a) c_k(b)
#     y = a / b    u(y)^2 = (u(a)^2 + y^2 u(b)^2 - 2 y sum_k c_k(a) c_k(b)) / b^2
#
# c_k(a) is what the input k contributes to a, with its sign: scale factor, time base, table and channel are the
# same in two runs of a bench. Source: JCGM 100:2008, 5.2.2, equation (16), such inputs with correlation 1. The
# interval of a ratio is Fieller's (Biometrika 41, 175, 1954): wide, or none, where b is hardly known to be not 0


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
