"""Records of many sources through the estimator: batch by batch, none of their samples kept."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from analysis import LockInEstimate
from analysis.lock_in_run import Batch, Method, joined
from instrument import InstrumentError, Preamble
from instrument.scpi import HIGHEST_CODE, NO_DATA
from station.errors import RunError, StationError, UsageError
from station.files import keep_for_batches
from station.results.numbers import (
    AMPLITUDE,
    BACKSCATTER_PHASE,
    BEAT_FREQUENCY,
    INPUT_RATE,
    LOCK_IN_RATE,
    LOCK_IN_RATE_NOISE_U,
    NOISE_RMS,
    SCALE_FACTOR,
)
from station.runs.store import SavedRecord, damaged_record
from station.sources.batches import (
    AT_ONCE,
    ExcludedRecord,
    RecordBatch,
    Source,
    Stretch,
    codes_of,
    preamble_of,
    why_not,
)
from station.sources.find import open_source
from station.sources.run import RunSource

MEASURE, FAST, SECOND = "measure", "tilt", "quadrature"
CONDITIONS = ("table_rate_dps", "azimuth_start_deg", "azimuth_end_deg", "over_lock_in")


@dataclass(frozen=True)
class Piece:
    """Some records of one source."""

    path: Path | Source
    numbers: range | None = None  # of the records; ``None``: all
    # of :class:`analysis.lock_in_run.Method`, what the user wants; a run knows its own scale factor. And
    # ``front_end``: the channel as it is stated now
    choices: Mapping[str, Any] = field(default_factory=dict)
    known: frozenset[str] = frozenset()  # SHA-256 of sources whose estimates are there already: not read again
    sha256: str = ""  # of the whole source, where this is a part of it


@dataclass(frozen=True)
class Gathered:
    """Estimates of the records of one source, or of a piece of it, and what the results need besides."""

    name: str  # of the source
    method: Method | None  # ``None`` where it could not be read, or was known
    sha256: str  # of the source; empty where only a piece of it was read that does not know it
    about: dict[str, str | None]  # unit, gyro, operator, instrument and software as the source names them
    # (n,): Number in the source of each record that was estimated, and its place among those that were taken, from
    # 0
    numbers: NDArray[np.int64]
    places: NDArray[np.int64]
    taken: int  # records that were taken for the measurement, damaged ones too
    # ``samples``, ``sample_interval_s``, ``level_spacing_v`` and the conditions, nan where not known
    columns: dict[str, NDArray[np.float64]]
    labels: dict[str, list[str]]  # ``key``, ``taken_at``, ``channel``, ``wfid`` of each record
    truth: Mapping[str, NDArray[np.float64]]  # (n,): True values of a simulated bench
    each: LockInEstimate | None  # fields of shape (n,); ``None`` where there is no record
    fast: tuple[SavedRecord, ...]  # the fast run
    damaged: tuple[int, ...]  # places of damaged records
    damage: tuple[str, ...]  # damaged records of every purpose, one sentence each
    left_out: tuple[ExcludedRecord, ...]  # what could not be read
    paired: bool  # whether there are records of a second photodiode
    # (n,): Number in the source of the record of the second photodiode that belongs to each; 0: there is none, -1:
    # it is damaged
    seconds: NDArray[np.int64]
    # settings of the run, where they describe a channel that is to be taken out of its records
    front_end: dict[str, Any] | None = None

    def __len__(self) -> int:
        return int(self.numbers.size)


_COLUMNS = ("samples", "sample_interval_s", "level_spacing_v", *CONDITIONS)
_NAN = math.nan
V = TypeVar("V", np.float64, np.int64)


def described_records(piece: Piece) -> Gathered:
    """Read a source, and say all of its records but their estimates."""
    reading = _Reading(piece, None)
    reading.read()
    return reading.gathered()


def estimate_pieces(pieces: Sequence[Piece], at_once: int = AT_ONCE) -> list[Gathered]:
    """Estimate the records of some pieces; those of small ones go through the estimator together."""
    room = Room(at_once)
    found = [_Reading(piece, room) for piece in pieces]
    for one in found:
        one.read()
    room.estimate_all()
    return [one.gathered() for one in found]


@dataclass
class _Alike:
    """Records one behind the other that share preamble and conditions, as most of a run do."""

    preamble: Preamble
    known: Mapping[str, Any]
    count: int = 1

    @property
    def columns(self) -> list[float]:
        """Values of `_COLUMNS`; nan where not known."""
        one = self.preamble
        values = (one.nr_pt, one.xincr, abs(one.ymult), *map(self.known.get, CONDITIONS))
        return [_NAN if value is None else float(value) for value in values]


class _Reading:
    """One piece while it is read."""

    def __init__(self, piece: Piece, room: Room | None) -> None:
        self._piece, self._room, self._wanted = piece, room, SourceEstimates()
        self._name, self._sha256, self._about = str(piece.path), "", dict[str, str | None]()
        self._numbers: list[int] = []
        self._places: list[int] = []
        self._taken = 0
        self._keys: list[str] = []
        self._taken_at: list[str] = []
        self._alike: list[_Alike] = []
        self._truth: dict[str, list[float]] = {}
        self._fast: list[SavedRecord] = []
        self._damaged: list[int] = []
        self._damage: list[str] = []
        self._left_out: list[ExcludedRecord] = []
        self._paired, self._last = False, 0
        self._seconds: dict[int, int] = {}
        self._front_end: dict[str, Any] | None = None

    def read(self) -> None:
        """Read the source; what is wrong with it is kept as a sentence."""
        try:
            with ExitStack() as held:
                self._read_from(open_source(self._piece.path, held))
        except (StationError, InstrumentError, OSError) as error:
            reason = (isinstance(error, OSError) and error.strerror) or str(error)
            self._left_out.append(ExcludedRecord(self._name, None, reason.removeprefix(f"{self._name}: ")))

    def _read_from(self, source: Source) -> None:
        piece, self._name = self._piece, source.name
        if piece.known and source.sha256 in piece.known:
            self._sha256 = source.sha256
            return
        self._about = about(source)
        self._wanted.method = method_of(source, piece.choices)
        settings = source.facts.settings
        self._front_end = settings if any((settings.get("front_end") or {}).values()) else None
        for stretch in source.stretches(piece.numbers):
            self._take(stretch, source)
        self._sha256 = source.sha256 if piece.numbers is None else piece.sha256

    def _take(self, stretch: Stretch, source: Source) -> None:
        if stretch.purpose != MEASURE:
            self._take_others(stretch)
            return
        preamble = preamble_of(stretch)
        if preamble is None and len(stretch) > 1:
            for record in stretch.records():
                self._take(Stretch.of(record), source)
            return
        place, row, count = self._taken, len(self._numbers), len(stretch)
        self._taken, self._last = place + count, stretch.numbers[-1]
        if preamble is None:
            (record,) = stretch.records()
            self._leave_out(record, place, source)
            return
        if self._room is not None:
            self._room.add(self._wanted, row, stretch.payloads, preamble)
        self._numbers += stretch.numbers
        self._places += range(place, place + count)
        self._keys += stretch.keys
        self._taken_at += stretch.taken_at
        known = stretch.conditions
        if self._alike and self._alike[-1].preamble is preamble and self._alike[-1].known is known:
            self._alike[-1].count += count
        else:
            self._alike.append(_Alike(preamble, known, count))
        for name, value in (known.get("truth") or {}).items():
            # a record that does not say it makes the mean of the run unknown, as it should be
            here = self._truth.setdefault(name, [])
            here += [_NAN] * (row - len(here)) + [float(value)] * count

    def _take_others(self, stretch: Stretch) -> None:
        for record in stretch.records():
            if not record.intact:
                self._damage += filter(None, [damaged_record(record)])
            elif record.purpose == FAST and not record.aside:
                self._fast.append(record)
            if record.purpose == SECOND:
                self._paired = True
                # saved in one commit with the record before it
                self._seconds[self._last] = record.number if record.intact else -1

    def _leave_out(self, record: SavedRecord, place: int, source: Source) -> None:
        if not record.intact:
            self._damage += filter(None, [damaged_record(record)])
            self._damaged.append(place)
        self._left_out.append(ExcludedRecord(source.name, record.key, why_not(record), damaged=not record.intact))

    def gathered(self) -> Gathered:
        """What was found, when everything that waited has been estimated."""
        rows = [rows for rows, _ in self._wanted.parts]
        count, alike = len(self._numbers), self._alike
        columns = np.array([one.columns for one in alike], dtype=np.float64).reshape(len(alike), len(_COLUMNS))
        times = [one.count for one in alike]
        return Gathered(
            name=self._name,
            method=self._wanted.method,
            sha256=self._sha256,
            about=self._about,
            numbers=np.array(self._numbers, dtype=np.int64),
            places=np.array(self._places, dtype=np.int64),
            taken=self._taken,
            columns={name: _repeated(columns[:, place], times) for place, name in enumerate(_COLUMNS)},
            labels={
                "key": self._keys,
                "taken_at": self._taken_at,
                "channel": [text for one in alike for text in [str(one.known.get("channel", ""))] * one.count],
                "wfid": [text for one in alike for text in [one.preamble.wfid] * one.count],
            },
            truth={
                name: np.array([*values, *[_NAN] * (count - len(values))]) for name, values in self._truth.items()
            },
            each=joined([estimate for _, estimate in self._wanted.parts], rows) if rows else None,
            fast=tuple(self._fast),
            damaged=tuple(self._damaged),
            damage=tuple(self._damage),
            left_out=tuple(self._left_out),
            paired=self._paired,
            seconds=np.array([self._seconds.get(number, 0) for number in self._numbers], dtype=np.int64)
            if self._paired
            else np.zeros(count, dtype=np.int64),
            front_end=self._front_end,
        )


def method_of(source: Source, choices: Mapping[str, Any]) -> Method:
    """Return how the records of a source are evaluated: as wanted, and with the scale factor of its run."""
    wanted = {name: value for name, value in choices.items() if value is not None and name != "front_end"}
    if source.is_run and source.facts.command != MEASURE:
        raise RunError(
            f"{source.name}: is a run of {source.facts.command!r}: its records give no lock-in rate each"
        )
    if "scale_factor" not in wanted:
        known = source.facts.settings.get("gyro", {}).get(SCALE_FACTOR.key())
        if not isinstance(known, int | float) or not known > 0:
            raise UsageError(f"{source.name}: does not say how many pulses per degree: give --scale-factor")
        wanted["scale_factor"] = float(known)
    mains = source.facts.settings.get("site", {}).get("mains_hz") if source.is_run else None
    return Method(**{"mains_hz": mains, **wanted})


def about(source: Source) -> dict[str, str | None]:
    """Return what a source says of unit, gyro, operator, oscilloscope and program, for the rows of its records."""
    facts = source.facts
    scope, made = facts.get("identity") or {}, facts.get("provenance") or {}
    return {
        "unit": facts.labels.get("unit"),
        "gyro": facts.settings.get("gyro", {}).get("name"),
        "operator": facts.labels.get("operator"),
        "model": scope.get("model"),
        "serial": scope.get("serial"),
        "firmware": scope.get("firmware"),
        "taken_with": made.get("gyrolock"),
        "probe": None if "probe" not in facts else f"{facts['probe']:g}X",
    }


def pieces_of(source: Source, choices: Mapping[str, Any], *, whole: bool = False) -> list[list[Piece]]:
    """Cut a source into pieces of so many records that their estimates take about a tenth of a second."""
    first, last = source.span
    opened_by, sha256 = source.path if isinstance(source, RunSource) else source, source.sha256 if whole else ""
    if last - first < AT_ONCE:
        return [[Piece(opened_by, None, choices, sha256=sha256)]]
    begins = range(first, last + 1, AT_ONCE)
    return [[Piece(opened_by, range(begin, begin + AT_ONCE), choices, sha256=sha256)] for begin in begins]


def together(parts: Sequence[Gathered]) -> Gathered:
    """Put pieces behind each other: those of one source, or sources that are to be one result."""
    first = parts[0]
    if len(parts) == 1:
        return first
    begins = np.concatenate([[0], np.cumsum([part.taken for part in parts])])
    filled = [part.each for part in parts if part.each is not None]
    ends = np.cumsum([0, *map(len, filled)])
    rows = [np.arange(begin, end) for begin, end in itertools.pairwise(ends)]
    truths = dict.fromkeys(name for part in parts for name in part.truth)
    return replace(
        first,
        numbers=np.concatenate([part.numbers for part in parts]),
        places=np.concatenate([part.places + begin for part, begin in zip(parts, begins, strict=False)]),
        taken=int(begins[-1]),
        columns={name: _one_behind_the_other([part.columns[name] for part in parts]) for name in first.columns},
        labels={name: [text for part in parts for text in part.labels[name]] for name in first.labels},
        truth={
            name: np.concatenate([part.truth.get(name, np.full(len(part), _NAN)) for part in parts])
            for name in truths
        },
        each=joined(filled, rows) if filled else None,
        fast=tuple(record for part in parts for record in part.fast),
        damaged=tuple(
            place + int(begin) for part, begin in zip(parts, begins, strict=False) for place in part.damaged
        ),
        damage=tuple(sentence for part in parts for sentence in part.damage),
        left_out=tuple(one for part in parts for one in part.left_out),
        paired=any(part.paired for part in parts),
        seconds=_spread(np.concatenate([part.seconds for part in parts])),
    )


def _spread(values: NDArray[V]) -> NDArray[V]:
    """The same values; where all have the same bits, they stand in the memory once."""
    values = np.ascontiguousarray(values)
    bits = values.view(np.int64)
    return np.broadcast_to(values[:1].copy(), values.shape) if np.all(bits == bits[:1]) else values


def _repeated(values: NDArray[np.float64], times: Sequence[int]) -> NDArray[np.float64]:
    """Each value so many times; where all have the same bits, they stand in the memory once."""
    if len(times) == 1 or (one := _spread(values)).strides == (0,):
        return np.broadcast_to(values[:1].copy(), (sum(times),))
    return one.repeat(times)


def _one_behind_the_other(columns: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    filled = [column for column in columns if column.size]
    alike = all(column.size == 1 or column.strides == (0,) for column in filled)
    firsts = _spread(np.array([column[0] for column in filled])) if alike else np.empty(0)
    if firsts.size > 1 and firsts.strides == (0,):
        return np.broadcast_to(firsts[:1], (sum(column.size for column in filled),))
    return np.concatenate(columns)


# --------------------
# A batch of saved records to estimates, one row a record: the same numbers whatever the batch


_IN_CACHE = 16  # records of 2500 samples that are 0.3 MB as volts

# name of the column: field of the estimate, and what of it
COLUMNS: Mapping[str, tuple[str, Any]] = {
    LOCK_IN_RATE.key(): ("lock_in_rate", None),
    LOCK_IN_RATE_NOISE_U.key(): ("lock_in_rate_u", None),
    "lock_in_rate_noise_low_95_dps": ("lock_in_rate_low_95", None),
    "lock_in_rate_noise_high_95_dps": ("lock_in_rate_high_95", None),
    INPUT_RATE.key(): ("input_rate", None),
    BEAT_FREQUENCY.key(): ("beat_frequency", None),
    BEAT_FREQUENCY.key("u"): ("beat_frequency_u", None),
    "ratio": ("ratio", None),
    "ratio_u": ("ratio_u", None),
    "ratio_misfit_u": ("misfit_u", None),
    "complex_ratio_re": ("complex_ratio", np.real),
    "complex_ratio_im": ("complex_ratio", np.imag),
    "complex_ratio_var_re": ("complex_ratio_covariance", lambda c: c[:, 0, 0]),
    "complex_ratio_cov_re_im": ("complex_ratio_covariance", lambda c: c[:, 0, 1]),
    "complex_ratio_var_im": ("complex_ratio_covariance", lambda c: c[:, 1, 1]),
    BACKSCATTER_PHASE.key(): ("backscatter_phase", None),
    AMPLITUDE.key(): ("amplitude", None),
    NOISE_RMS.key(): ("noise_rms", None),
    "third_harmonic_re": ("third_harmonic", np.real),
    "third_harmonic_im": ("third_harmonic", np.imag),
    "third_harmonic_u": ("third_harmonic_u", None),
    "periods": ("periods", None),
    "flag_bits": ("flags", None),
}


def batch_arrays(batch: RecordBatch, room: NDArray[np.float64] | None = None) -> Batch:
    """Volts and clipped samples of a batch; all its records must have one time base."""
    codes, wide = batch.codes, batch.codes.dtype != np.int8
    highest = HIGHEST_CODE * 256 if wide else HIGHEST_CODE
    clipped = (codes >= highest) | (codes <= -highest)
    volts = _volts(batch, room)
    if not wide:
        blank = codes == NO_DATA
        if blank.any():
            volts[blank] = np.nan
            clipped &= ~blank
    rows = np.arange(len(batch))
    return Batch(rows, batch.sample_interval, volts[np.newaxis], clipped[np.newaxis])


def _volts(batch: RecordBatch, room: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """(code - YOFF) YMULT + YZERO, some records at a time: they stay in the processor's cache meanwhile."""
    fits = room is not None and room.shape[1:] == batch.codes.shape[1:] and len(room) >= len(batch)
    volts = room[: len(batch)] if room is not None and fits else np.empty(batch.codes.shape)
    # one number for all rows is quicker than one for each, and most batches have one preamble
    alike = all(preamble is batch.preambles[0] for preamble in batch.preambles)
    preambles = batch.preambles[:1] if alike else batch.preambles
    yoff, ymult, yzero = (
        np.array([getattr(preamble, name) for preamble in preambles])[:, np.newaxis]
        for name in ("yoff", "ymult", "yzero")
    )
    for first in range(0, len(batch), _IN_CACHE):
        rows = slice(first, first + _IN_CACHE)
        of = slice(None) if alike else rows
        some = volts[rows]
        some[...] = batch.codes[rows]
        some -= yoff[of]
        some *= ymult[of]
        if yzero.any():
            some += yzero[of]
    return volts


def columns_of(estimate: LockInEstimate) -> dict[str, NDArray[Any]]:
    """Return estimates (n,) as columns, units in their names; :func:`estimate_of` is the way back."""
    return {
        name: np.ascontiguousarray(getattr(estimate, field) if part is None else part(getattr(estimate, field)))
        for name, (field, part) in COLUMNS.items()
    }


# --------------------
# Records that wait until there are enough of them for the estimator


@dataclass
class SourceEstimates:
    """Estimates of one source."""

    method: Method | None = None  # ``None``: nobody wants them
    # (rows, LockInEstimate): What there is so far, and of which rows of the source
    parts: list[tuple[NDArray[np.intp], LockInEstimate]] = field(default_factory=list)


@dataclass
class _Waits:
    """Codes of some records of one source, and the row of the first."""

    wanted: SourceEstimates
    row: int
    payloads: Sequence[bytes]
    preamble: Preamble
    end: int  # records that wait up to and with these


class Room:
    """Records that wait, by what a batch must have in common."""

    def __init__(self, at_once: int) -> None:
        keep_for_batches()
        self._at_once = at_once
        self._batches: dict[tuple[int, float, int, Method | None], list[_Waits]] = {}

    def add(self, wanted: SourceEstimates, row: int, payloads: Sequence[bytes], preamble: Preamble) -> None:
        """Take records of one source whose rows follow each other, from `row` on."""
        key = preamble.nr_pt, preamble.xincr, preamble.byt_nr, wanted.method
        while payloads:
            batch = self._batches.setdefault(key, [])
            before = batch[-1].end if batch else 0
            some = payloads[: self._at_once - before]
            batch.append(_Waits(wanted, row, some, preamble, before + len(some)))
            row, payloads = row + len(some), payloads[len(some) :]
            if batch[-1].end >= self._at_once:
                self._estimate(self._batches.pop(key))

    def estimate_all(self) -> None:
        """Estimate what waits."""
        while self._batches:
            self._estimate(self._batches.popitem()[1])

    def _estimate(self, batch: Sequence[_Waits]) -> None:
        first = batch[0]
        if first.wanted.method is None:
            return
        codes = codes_of([payload for one in batch for payload in one.payloads], first.preamble)
        preambles = tuple(one.preamble for one in batch for _ in one.payloads)
        room: NDArray[np.float64] | None = getattr(_OF_THREAD, "room", None)
        if room is None or room.shape[1:] != codes.shape[1:] or len(room) < codes.shape[0]:
            room = _OF_THREAD.room = np.empty(codes.shape)
        estimate = first.wanted.method.estimate(batch_arrays(RecordBatch(codes, preambles), room))
        for one in batch:
            rows = np.arange(one.row, one.row + len(one.payloads))
            one.wanted.parts.append((rows, estimate[one.end - rows.size : one.end]))


_OF_THREAD = threading.local()


def give_back_room() -> None:
    """Free the memory that the batches of this thread used in turn: no further one comes."""
    _OF_THREAD.__dict__.clear()
