"""What every measurement gives, in one form: parts of a report, numbers as text, plain JSON, the budget."""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from station.errors import StationError, one_line
from station.results.quantity import Quantities, Quantity, Value, decimals_of, limited_values

# --------------------
# What a report or a page on the terminal is put together from


Rows = Sequence[tuple[str, str]]  # names and values


@dataclass(frozen=True)
class PlacedFigure:
    """An SVG element with its caption."""

    svg: str
    caption: str


@dataclass(frozen=True)
class TextTable:
    """Columns of text; in the first one stands what a row is about."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Section:
    """A heading with sentences, figures (up to two side by side) and a table."""

    title: str
    text: str = ""
    figures: tuple[PlacedFigure, ...] = ()
    sentences: tuple[str, ...] = ()
    table: TextTable | None = None


@dataclass(frozen=True)
class FactTable:
    """A small table of names and values."""

    title: str
    rows: Rows


@dataclass(frozen=True)
class Excluded:
    """Something that was taken, or should have been, and is not in the result."""

    name: str
    reason: str

    @property
    def sentence(self) -> str:
        """One line."""
        return f"{self.name} is left out: {self.reason}"

    @classmethod
    @contextmanager
    def by_error(cls, name: str, left_out: list[Self]) -> Iterator[None]:
        """What cannot be used inside goes to `left_out`, with the reason that its error gives."""
        try:
            yield
        except ValueError as error:
            left_out.append(cls(name, str(error)))


@dataclass(frozen=True)
class Validity:
    """Whether a result holds, and what speaks against it."""

    # {"stands", "doubtful", "fails"}: "doubtful": something that was noticed, or that nobody knows, rules it.
    # "fails": there is no result, a check of it fails, or a simulation knows better.
    state: Literal["stands", "doubtful", "fails"]
    reasons: tuple[str, ...] = ()  # sentences; empty where it stands


@dataclass(frozen=True)
class Result:
    """What a run says."""

    name: str  # of the value: ``"lock-in rate"``
    value: str  # in large letters
    document: dict[str, Any]  # the body of the JSON document; arrays and nan may be in it
    quantities: Quantities = ()  # what the numbers of the document are
    lines: tuple[str, ...] = ()  # below the value in the report
    summary: Rows = ()  # (str, str): Below the value on the terminal
    brief: Rows = ()  # what a short page says in the place of value and summary
    sentences: tuple[str, ...] = ()  # what the result means
    to_watch: tuple[str, ...] = ()  # what spoils it or may spoil it
    flags: tuple[str, ...] = ()  # the same for programs
    left_out: tuple[Excluded, ...] = ()
    tables: tuple[TextTable, ...] = ()  # above the value on the terminal; on a short page where `brief` is empty
    problem: str = ""  # why there is no result; empty if there is one
    truth: str = ""  # truth of a simulated run, in words; empty: the run's facts tell it
    # what rules the result and is not known or not right; ``None``: whatever is `to_watch`
    doubts: tuple[str, ...] | None = None
    failures: tuple[str, ...] = ()  # checks of the result that fail

    @cached_property
    def measured(self) -> tuple[Value, ...]:
        """What limits can be set on."""
        return limited_values(self.document, self.quantities)

    @property
    def standing(self) -> Validity:
        """Whether it holds."""
        failures = (self.problem, *self.failures) if self.problem else self.failures
        doubts = self.to_watch if self.doubts is None else self.doubts
        if failures:
            return Validity("fails", (*failures, *doubts))
        return Validity("doubtful", doubts) if doubts else Validity("stands")

    @property
    def quality(self) -> str:
        """In one line whether it holds: ``"good"``, or the first sentence of what speaks against it."""
        standing = self.standing
        if standing.state == "stands":
            return "good"
        word = "DOUBTFUL" if standing.state == "doubtful" else "NO RESULT" if self.problem else "DOES NOT HOLD"
        first, more = standing.reasons[0], len(standing.reasons) - 1
        said = re.split(r"(?<=[a-z0-9)])[.;] (?=\S)", first.removeprefix(f"no {self.name}: "))[0].rstrip(".")
        return f"{word}: {said}" + (f" (and {more} more)" if more else "")


# --------------------
# Numbers as a person reads them


def with_uncertainty(value: float, u: float, unit: str = "") -> str:
    """Write a value with its standard uncertainty in the last digits."""
    tail = f" {unit}" if unit else ""
    if not math.isfinite(value):
        return "none"
    if not math.isfinite(u) or u <= 0:
        return f"{value:.6g}{tail}"
    digits = decimals_of(u)
    if digits <= 0:
        return f"{value:.0f}({u:.0f}){tail}"
    return f"{value:.{digits}f}({round(u * 10.0**digits)}){tail}"


def with_prefix(value: float, unit: str) -> str:
    """Write a value with the unit prefix that fits."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g} {unit}"
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")):
        if abs(value) >= factor * 0.9999995:
            return f"{value / factor:.4g} {prefix}{unit}"
    return f"{value:.4g} {unit}"


def ppm(value: float, u: float = math.nan) -> str:
    """Write a signed value in ppm with its uncertainty."""
    if not math.isfinite(value):
        return "none"
    text = with_uncertainty(value, u) if math.isfinite(u) and u > 0 else f"{value:.4g}"
    return f"{'' if text.startswith('-') else '+'}{text} ppm"


def table(evaluation: Any, columns: Sequence[Quantity]) -> TextTable:
    """Return columns of numbers as a person reads them; one without a label is for programs."""
    shown = [one for one in columns if one.label]
    return TextTable(
        tuple(one.label for one in shown), tuple(zip(*(_cells(evaluation, one) for one in shown), strict=True))
    )


def _cells(evaluation: Any, column: Quantity) -> list[str]:
    found = column.values(evaluation)
    values = list(found[column.key()])
    if not column.u:
        cells = [column.form.format(value) for value in values]
        return [{"True": "yes", "False": "no"}.get(cell, cell) for cell in cells]
    return [
        with_uncertainty(float(value), float(u)) for value, u in zip(values, found[column.key("u")], strict=True)
    ]


# --------------------
# The one way from values to plain JSON: what is not finite becomes null, arrays become lists


def plain(value: Any) -> Any:
    """Return a value as plain JSON.

    Examples
    --------
    >>> plain({"a": np.float64("nan"), "b": np.arange(2), "c": (1.5, None)})
    {'a': None, 'b': [0, 1], 'c': [1.5, None]}
    """
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(name): plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(one) for one in value]
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return str(value) if isinstance(value, Path) else value


def picked(source: object, names: Mapping[str, str]) -> dict[str, Any]:
    """Return attributes of an object under the names that programs rely on."""
    return {key: getattr(source, attribute) for key, attribute in names.items()}


# --------------------
# A budget in parts per million of the result: what each input contributes to its uncertainty


@dataclass(frozen=True)
class Contribution:
    """One line of a budget."""

    name: str  # for programs
    quantity: str  # in words
    # standard uncertainty that it makes of the result, ppm of it; 0 where it is taken out or not counted
    ppm: float
    stated: bool  # whether it is known: stated, measured, or taken out; else `note` says what counts instead
    note: str  # where it comes from


def budget_document(reference: str, lines: Sequence[Contribution], combined_ppm: float) -> dict[str, Any]:
    """Return a budget for the JSON document, the largest contribution first."""
    ordered = sorted(lines, key=lambda line: -line.ppm)
    total = sum(line.ppm**2 for line in lines) or 1.0
    return {
        "reference": reference,
        "combined_u_ppm": combined_ppm,
        "inputs": [
            {
                "name": line.name,
                "quantity": line.quantity,
                "contribution_ppm": line.ppm,
                "share_of_variance": line.ppm**2 / total,
                "stated": line.stated,
                "note": line.note,
            }
            for line in ordered
        ],
        "not_stated": [line.name for line in ordered if not line.stated],
        "largest_part": ordered[0].name if ordered and ordered[0].ppm > 0 else None,
    }


def budget_table(of: str, document: Mapping[str, Any]) -> TextTable:
    """Return a budget as a table; `of` names the result."""
    rows = [
        (
            line["quantity"] if line["stated"] else f"{line['quantity']} (not stated)",
            f"{line['contribution_ppm']:.2g}" if line["contribution_ppm"] else "0",
            f"{100 * line['share_of_variance']:.0f} %",
            line["note"],
        )
        for line in document["inputs"]
    ]
    combined = (f"{of}, combined", f"{document['combined_u_ppm']:.2g}", "100 %", "")
    return TextTable(("input", "u, ppm", "share", "from"), (*rows, combined))


# --------------------
# A finding of `gyrolock doctor`: what was looked at, and what to do about it


@dataclass(frozen=True)
class Check:
    """One finding."""

    name: str
    # {"ok", "note", "bad"}: ``note``: works, but something cannot be used or is not known; ``bad``: must be mended
    state: Literal["ok", "note", "bad"]
    text: str  # what was found, and where it is not well what to do


def guarded(name: str, check: Callable[[], Check]) -> Check:
    """Turn an error of the instruments or the store into a finding."""
    from instrument import InstrumentError

    try:
        return check()
    except (InstrumentError, StationError, OSError) as error:
        return Check(name, "bad", one_line(error))
