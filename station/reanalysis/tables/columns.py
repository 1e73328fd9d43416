"""The columns of a results table: one row a record, units in the names."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from analysis import flag_names
from analysis.lock_in_run import by_themselves
from station.errors import StationError
from station.lock_in.found import describe_method
from station.lock_in.knowledge import channel_response
from station.lock_in.records.estimates import COLUMNS, columns_of
from station.lock_in.records.pieces import Gathered, Piece, estimate_pieces
from station.lock_in.settings import RING_LASER
from station.provenance import program
from station.settings.load import saved_settings
from station.sources.batches import LeftOut

NAME, VERSION = "gyrolock results", 1
"""Of the layout of a results table; apart from the version of the package."""

TEXTS = (
    *("source", "source_sha256", "analysis", "key", "taken_at", "unit", "gyro", "operator", "channel"),
    *("model", "serial", "firmware", "probe", "taken_with", "method", "relation", "flags", "software"),
)
INTEGERS = ("schema_version", "record", "samples", "flag_bits")
NUMBERS = (
    *("sample_interval_s", "table_rate_dps", "azimuth_start_deg", "azimuth_end_deg", "over_lock_in"),
    *("scale_factor_pulses_per_deg", "given_input_rate_dps"),
    *(name for name in COLUMNS if name != "flag_bits"),
)
ORDER = (
    *("source", "record", "key", "taken_at", "unit", "gyro", "operator", "channel"),
    *("lock_in_rate_dps", "lock_in_rate_noise_u_dps"),
    *("lock_in_rate_noise_low_95_dps", "lock_in_rate_noise_high_95_dps"),
    *(name for name in NUMBERS if name in COLUMNS and not name.startswith("lock_in_rate")),
    *("flags", "flag_bits", "method", "relation", "scale_factor_pulses_per_deg", "given_input_rate_dps"),
    *("table_rate_dps", "azimuth_start_deg", "azimuth_end_deg", "over_lock_in", "samples", "sample_interval_s"),
    *("model", "serial", "firmware", "probe", "taken_with"),
    *("source_sha256", "analysis", "software", "schema_version"),
)
"""All columns, as a reader meets them."""

_PAIRED = (
    "its records are pairs of two photodiodes, and a row of one of them would hold its distortion: "
    "`gyrolock analyze --jsonl` evaluates them together"
)

Texts = str | list[str | None] | None
Values = Texts | int | float | NDArray[Any]
Column = Sequence[Any] | NDArray[Any]
"""One value for each row; None, or nan of a number: not known."""


@dataclass(frozen=True)
class Repeated(Sequence[Any]):
    """One value that all rows share."""

    value: Any
    size: int

    def __len__(self) -> int:
        return self.size

    @overload
    def __getitem__(self, place: int) -> Any: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[Any]: ...
    def __getitem__(self, place: int | slice) -> Any:
        return ([self.value] * self.size)[place]

    def __iter__(self) -> Iterator[Any]:
        return itertools.repeat(self.value, self.size)


@dataclass(frozen=True)
class Rows:
    """Rows of one source, or of a piece of it."""

    source: str
    count: int
    # by the names of `ORDER`: an array or list of `count` values, or one value that all rows share; None: not
    # known. Empty where the rows were known already.
    columns: dict[str, Values]
    left_out: tuple[LeftOut, ...]  # what could not be read
    known: bool = False  # whether the table has them already

    def column(self, name: str) -> Column:
        """One value for each row."""
        values = self.columns[name]
        return values if isinstance(values, list | np.ndarray) else Repeated(values, self.count)


def joined_columns(parts: Sequence[Rows]) -> dict[str, Column]:
    """Put rows of several sources behind each other; every one of `ORDER` is there."""
    filled = [part for part in parts if part.count]
    if len(filled) == 1:
        return {name: filled[0].column(name) for name in ORDER}
    return {name: _joined([part.column(name) for part in filled]) for name in ORDER}


def _joined(columns: Sequence[Column]) -> Column:
    arrays = [column for column in columns if isinstance(column, np.ndarray)]
    if len(arrays) == len(columns):
        return np.concatenate(arrays)
    shared = {column.value for column in columns if isinstance(column, Repeated)}
    if len(shared) == 1 and all(isinstance(column, Repeated) for column in columns):
        return Repeated(shared.pop(), sum(map(len, columns)))
    return [value for column in columns for value in column]


def analysis_of(choices: Mapping[str, Any]) -> str:
    """Say by which method, settings and program rows are made: those with the same need no new ones."""
    wanted = {name: value for name, value in choices.items() if value is not None}
    scale = f"{wanted['scale_factor']!r} pulses/deg" if "scale_factor" in wanted else "scale factor of the source"
    rate = f"input rate {wanted['input_rate']!r} deg/s" if "input_rate" in wanted else "self-referenced"
    return f"{wanted.get('relation', 'exact')}; {scale}; {rate}; {software()}"


@cache
def software() -> str:
    """Version of this program, with the state of its source where it runs from one."""
    return " ".join(filter(None, program()))


def rows_of_pieces(pieces: Sequence[Piece]) -> list[Rows]:
    """Estimate the records of some pieces and make rows of them; a source that does not go is left out."""
    return [_rows(piece, gathered) for piece, gathered in zip(pieces, estimate_pieces(pieces), strict=True)]


def _rows(piece: Piece, gathered: Gathered) -> Rows:
    if gathered.method is None:
        return Rows(gathered.name, 0, {}, gathered.left_out, known=bool(gathered.sha256))
    if gathered.paired:
        return Rows(gathered.name, 0, {}, (LeftOut(gathered.name, None, _PAIRED),))
    try:
        return Rows(gathered.name, len(gathered), _columns(piece, gathered), gathered.left_out)
    except StationError as error:
        return Rows(gathered.name, 0, {}, (*gathered.left_out, LeftOut(gathered.name, None, str(error))))


def _columns(piece: Piece, gathered: Gathered) -> dict[str, Values]:
    each, method = gathered.each, gathered.method
    if each is None or method is None:
        return {}
    response = None
    if gathered.front_end is not None:
        settings = saved_settings(RING_LASER, dict(gathered.front_end), gathered.name)
        response = channel_response(settings.front_end)
    each = by_themselves(each, response)
    known, labels = gathered.columns, gathered.labels
    columns: dict[str, Values] = {
        **dict.fromkeys(ORDER),
        **columns_of(each),
        **gathered.about,
        **{name: known[name] for name in known if name in NUMBERS},
        "source": gathered.name,
        "source_sha256": gathered.sha256,
        "analysis": analysis_of(piece.choices),
        "software": software(),
        "schema_version": VERSION,
        "record": gathered.numbers,
        "samples": known["samples"].astype(np.int64),
        "key": list(labels["key"]),
        "taken_at": list(labels["taken_at"]),
        "channel": list(labels["channel"]),
        "flags": [_flags(bits) for bits in each.flags.tolist()],
        "method": describe_method(method),
        "relation": method.relation,
        "scale_factor_pulses_per_deg": method.scale_factor,
        "given_input_rate_dps": math.nan if method.input_rate is None else method.input_rate,
    }
    columns["third_harmonic_u"] = np.where(np.isfinite(each.third_harmonic_u), each.third_harmonic_u, np.nan)
    return {name: columns[name] for name in ORDER}


@cache
def _flags(bits: int) -> str:
    return " ".join(flag_names(bits))
