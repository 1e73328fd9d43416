"""A number of a result, declared once: its key, its unit, where an evaluation holds it, and how well it is known.

JSON, limits, verdicts, the list of runs, control charts and docs/results.md are loops over declarations; nobody
takes a key apart. The key of ``Quantity("lock_in_rate", "dps")`` is ``lock_in_rate_dps``; beside it stand its
uncertainty, ``lock_in_rate_u_dps``, and its 95 % interval, ``lock_in_rate_low_95_dps`` and ``..._high_95_dps``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

UNITS = {
    "dps": "deg/s",
    "dph": "deg/h",
    "hz": "Hz",
    "v": "V",
    "s": "s",
    "c": "°C",
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
    "deg_per_sqrt_s": "deg/√s",
    "dph_per_k": "deg/h/K",
    "dph_per_k_per_min": "deg/h per K/min",
    "ppm_per_k_per_min": "ppm per K/min",
    "k_per_min": "K/min",
    "dph_per_unit": "deg/h per unit of the stimulus",
    "ppm_per_unit": "ppm per unit of the stimulus",
}
"""Unit at the end of a key, and as a person reads it."""

_COVERAGE = 2.0  # half a 95 % interval in standard uncertainties where a result gives no interval (GUM 6.3.3)

Get = str | Callable[[Any], Any]
"""Where an evaluation holds something: the way of its attribute, ``"fit.slope"``, or a function."""


@dataclass(frozen=True)
class Quantity:
    """One number, or one column of numbers, of a result."""

    name: str  # without its unit: "lock_in_rate"
    unit: str = ""  # end of its key, one of `UNITS`; "" for a pure number or a text
    of: Get = ""  # by default the attribute called `name`
    u: Get | bool = False  # standard uncertainty (k = 1); True: the attribute `of` with "_u" at its end
    interval: Get | tuple[Get, Get] | bool = False  # 95 %, both ends; True: `of` with "_low_95" and "_high_95"
    scale: float = 1.0  # from the unit of the analysis to this one
    limit: bool | str = False  # whether [limits] may name it; a text: by another name than its key
    at_least: bool = False  # whether what [limits] name is the least that it may be, not the most
    headline: bool = False  # whether the list of runs shows it
    trend: bool = False  # whether control charts follow it though no limit is set on it
    bound: bool = False  # where there is no value, the upper end of its interval is judged: it is below that
    optional: bool = False  # whether a run may be without it: a limit on it is then not tested
    u_at: str = ""  # key of its uncertainty where that has another name
    label: str = ""  # heading of its column; a column without is for programs only
    form: str = "{}"  # how a value without uncertainty is written: "{:+g} codes"
    u_last: bool = False  # "bias_instability_dph_u": older keys have the word behind the unit
    doc: str = ""  # what it is, where its name does not say it
    shown: str = ""  # its unit as a person reads it, where its key has none
    expected: Get = ""  # where settings say about how large it will be

    def key(self, what: str = "") -> str:
        """Name in JSON; `what` is one of "u", "low_95", "high_95"."""
        parts = (self.name, self.unit, what) if self.u_last else (self.name, what, self.unit)
        return "_".join(filter(None, parts))

    @property
    def words(self) -> str:
        """Its name as a person says it: ``"lock-in rate"``."""
        name = self.limit.removesuffix(f"_{self.unit}") if isinstance(self.limit, str) else self.name
        return name.replace("_", " ").replace("lock in", "lock-in")

    @property
    def text_of_unit(self) -> str:
        """Its unit as a person reads it."""
        return UNITS.get(self.unit, self.shown)

    @property
    def limit_name(self) -> str:
        """What [limits] call it; empty where they may not."""
        return self.limit if isinstance(self.limit, str) else self.key() if self.limit else ""

    def expected_by(self, settings: Any) -> float | None:
        """About how large settings expect it to be; ``None`` where they do not say it."""
        return float(_got(settings, self.expected)) if self.expected else None

    def values(self, evaluation: Any) -> dict[str, Any]:
        """Value, uncertainty and 95 % interval of an evaluation, by their keys."""
        of = self.of or self.name
        found = {self.key(): self._got(evaluation, of)}
        if self.u:
            found[self.u_at or self.key("u")] = self._got(evaluation, f"{of}_u" if self.u is True else self.u)
        if self.interval:
            ends: Any = self.interval
            if ends is True:
                ends = f"{of}_low_95", f"{of}_high_95"
            if not isinstance(ends, tuple):
                low, high = _got(evaluation, ends) or (None, None)
            else:
                low, high = (_got(evaluation, end) for end in ends)
            found |= {self.key("low_95"): self._scaled(low), self.key("high_95"): self._scaled(high)}
        return found

    def _got(self, evaluation: Any, at: Get) -> Any:
        return self._scaled(_got(evaluation, at))

    def _scaled(self, value: Any) -> Any:
        return value if value is None or self.scale == 1.0 else self.scale * value

    def value_in(self, document: Mapping[str, Any], of: str = "") -> Value:
        """The number as a JSON document holds it; nan for what it does not hold."""
        value, u, low, high = (
            _number(document.get(key))
            for key in (self.key(), self.u_at or self.key("u"), self.key("low_95"), self.key("high_95"))
        )
        if self.bound and math.isnan(value):
            value = high
        if not math.isfinite(high - low):
            low, high = (
                (value - _COVERAGE * u, value + _COVERAGE * u) if math.isfinite(u) else (math.nan, math.nan)
            )
        return Value(value, self.text_of_unit, low, high, of, u, self)


_NUMBERS = ("value", "u", "low_95", "high_95")


@dataclass(frozen=True)
class Value:
    """A number as a run gives it."""

    value: float  # nan where the run gives none
    unit: str = ""  # as a person reads it
    low_95: float = math.nan  # ends of its 95 % interval, every input counted; nan where nobody knows them
    high_95: float = math.nan
    of: str = ""  # what it is of, where a run gives several: ``"X"``
    u: float = field(default=math.nan, compare=False)  # standard uncertainty
    quantity: Quantity = field(default=Quantity(""), compare=False)

    @property
    def name(self) -> str:
        """Its key in the JSON."""
        return self.quantity.key()

    @property
    def limit_name(self) -> str:
        """What a limit calls it, with what it is of where there are several."""
        name = self.quantity.limit_name or self.name
        return f"{name} of {self.of}" if self.of else name

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
    def text(self) -> str:
        """What it is of, the number with its 95 % interval, and its unit."""
        if not self.uncertain:
            return f"{self.of} {self.digits(self.value)} {self.unit}".strip()
        return f"{self.of} {within(self.value, self.low_95, self.high_95, self.unit)}".strip()

    def as_json(self) -> dict[str, Any]:
        """Return it as plain JSON; :meth:`from_json` is the way back."""
        numbers = {name: getattr(self, name) for name in _NUMBERS}
        plain = {name: value if math.isfinite(value) else None for name, value in numbers.items()}
        return {
            "name": self.name,
            "of": self.of or None,
            **plain,
            "unit": self.unit,
            "quantity": self.quantity.name,
        }

    @classmethod
    def from_json(cls, saved: Mapping[str, Any]) -> Self:
        """Return what was saved; an early version has the key alone."""
        name = saved.get("name") or ""
        ends = (f"_{key}" for key, unit in UNITS.items() if unit == saved["unit"] and name.endswith(f"_{key}"))
        stem = saved.get("quantity") or name.removesuffix(next(ends, ""))
        quantity = Quantity(stem, name.removeprefix(stem)[1:])
        numbers = {one: _number(saved.get(one)) for one in _NUMBERS}
        return cls(unit=saved["unit"], of=saved["of"] or "", quantity=quantity, **numbers)

    @property
    def words(self) -> str:
        """Its name as a person says it: ``"lock-in rate"``, ``"scatter of X"``."""
        return f"{self.quantity.words} of {self.of}" if self.of else self.quantity.words


@dataclass(frozen=True)
class QuantityGroup:
    """Quantities that stand together in one object of the JSON document, or in each of a list."""

    quantities: tuple[Quantity, ...]
    place: str = ""  # way to it: "axes", "several_rates.by_beat"; "": the document itself
    each: str = ""  # of a list: key of what tells its objects apart: "axis"
    alone: bool = True  # whether a list of one object says what it is of

    def objects(self, document: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
        """Every object of a document that holds them, and what it is of."""
        found: list[tuple[str, Any]] = [("", document)]
        for name in filter(None, self.place.split(".")):
            found = [pair for _, holder in found for pair in self._inside(holder, name)]
        return ((of, holder) for of, holder in found if isinstance(holder, Mapping))

    def _inside(self, holder: Any, name: str) -> Iterator[tuple[str, Any]]:
        inner = holder.get(name) if isinstance(holder, Mapping) else None
        if not isinstance(inner, list | tuple):
            yield "", inner
            return
        named = self.each and (self.alone or len(inner) > 1)
        for one in inner:
            yield str(one.get(self.each, "")) if named and isinstance(one, Mapping) else "", one

    def values(self, document: Mapping[str, Any], wanted: Callable[[Quantity], object]) -> Iterator[Value]:
        """The wanted numbers of a document, object by object."""
        for of, holder in self.objects(document):
            for quantity in self.quantities:
                if wanted(quantity):
                    yield quantity.value_in(holder, of)


Quantities = Sequence[QuantityGroup]  # all numbers of a measurement


# --------------------
# Loops over declarations


def document(evaluation: Any, quantities: Iterable[Quantity]) -> dict[str, Any]:
    """JSON of some quantities; null for each where there is no evaluation."""
    return {key: value for one in quantities for key, value in one.values(evaluation).items()}


def rows(evaluation: Any, columns: Iterable[Quantity]) -> list[dict[str, Any]]:
    """JSON of a table: one object a row."""
    made = document(evaluation, columns)
    return [dict(zip(made, row, strict=True)) for row in zip(*made.values(), strict=True)]


def limited_values(document: Mapping[str, Any], declared: Quantities) -> tuple[Value, ...]:
    """What of a result limits can be set on."""
    found = (value for group in declared for value in group.values(document, lambda one: one.limit))
    return tuple(one for one in found if not (one.quantity.optional and math.isnan(one.value)))


def headline_values(document: Mapping[str, Any], declared: Quantities) -> tuple[Value, ...]:
    """What the list of runs shows of a result: one number, or that of each axis."""
    # an older document may lack a number
    there = {key for group in declared for _, holder in group.objects(document) for key in holder}
    wanted = (group.values(document, lambda one: one.headline) for group in declared)
    found = (tuple(one for one in values if one.name in there) for values in wanted)
    return next((values for values in found if values), ())


def limit_names(declared: Quantities) -> tuple[str, ...]:
    """Names that [limits] of a measurement may have."""
    names = (quantity.limit_name for group in declared for quantity in group.quantities)
    return tuple(dict.fromkeys(filter(None, names)))


def value_at(document: Mapping[str, Any], place: str, declared: Quantities) -> Value | None:
    """Any number of a result by its way in the JSON, ``"axes.1.scale_factor_counts_per_dps"``."""
    # ``None`` where no object stands there; without uncertainty where the number is not declared.
    *way, key = place.split(".")
    inner: Any = document
    for step in way:
        if isinstance(inner, list) and step.isdecimal() and int(step) < len(inner):
            inner = inner[int(step)]
        else:
            inner = inner.get(step) if isinstance(inner, Mapping) else None
    if not isinstance(inner, Mapping):
        return None
    above = ".".join(step for step in way if not step.isdecimal())
    groups = sorted(declared, key=lambda group: group.place != above)
    known = (one for group in groups for one in group.quantities if one.key() == key)
    return next(known, Quantity(key)).value_in(inner)


def repeated(quantities: Iterable[Quantity]) -> tuple[Quantity, ...]:
    """The same numbers where the document of one axis has them once more."""
    return tuple(replace(one, limit=False, trend=False) for one in quantities)


# --------------------
# Digits


def decimals_of(u: float) -> int:
    """Places behind the point of two digits of an uncertainty."""
    places = 1 - math.floor(math.log10(u))
    return places - (round(u * 10.0**places) >= 100)  # 0.0996 is written with the digits of 0.10


def within(value: float, low: float, high: float, unit: str = "") -> str:
    """Write a value with its 95 % interval, to two digits of its half width."""
    tail, half = f" {unit}" if unit else "", (high - low) / 2
    if not math.isfinite(value):
        return "none"
    if not (math.isfinite(half) and half > 0):
        return f"{value:.6g}{tail}{'' if half == 0 else ', interval not known'}"
    digits = max(0, decimals_of(half))
    if low == 0 or value == high:
        return f"below {high:.{digits}f}{tail}"
    if abs((low + high) / 2 - value) > 0.1 * half:
        return f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f}){tail}"
    return f"{value:.{digits}f} ± {half:.{digits}f}{tail}"


def _got(evaluation: Any, at: Get) -> Any:
    """What an evaluation holds somewhere; ``None`` where the way ends before."""
    if callable(at):
        return at(evaluation)
    for name in at.split("."):
        if evaluation is None:
            return None
        evaluation = getattr(evaluation, name)
    return evaluation


def _number(value: Any) -> float:
    if getattr(value, "ndim", None) == 0:  # an array of no dimensions
        value = value.item()
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
