"""Records as the fits want them: checked, two-dimensional, centred, missing samples weighted 0."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from analysis.arrays import Bools, Floats, Indices, Samples

Counts = NDArray[np.uint32]
NanPolicy = Literal["raise", "omit"]

MINIMUM_SAMPLES = 8
"""The lock-in waveform has six parameters; two more samples are the least that leaves any noise estimate."""

NO_DATA, LARGEST_CODE = -128, 127
LARGEST_INTEGER = 2**52

SAMPLES_AT_ONCE = 5_000_000
"""Samples worked on together: enough that the cost of calling NumPy does not count, and a bound on the memory of
any batch."""

AT_ONCE_BYTES = 2**21
"""Bytes of samples that go through several passes together: so few that a cache holds them until all passes are
done, so many that the cost of calling NumPy does not count."""

THINNING = 5
"""A fifth of the samples is enough to see whether a level may be crowded."""

LIFTED = 10.0
"""Mean over swing beyond which a record must be centred in double precision."""

# The C library of Linux gives large blocks back to the system as soon as they are free, and a block asked for
# again is then made of fresh pages, which takes longer than the arithmetic on it. Once it has seen a block of this
# size come and go it keeps them. Nothing is written to it, so it costs no memory.
np.empty(30 << 20, dtype=np.uint8)


def records_at_once(n_samples: int, precision: DTypeLike) -> int:
    """How many records to work on together so that they stay in the cache."""
    return max(1, AT_ONCE_BYTES // (n_samples * np.dtype(precision).itemsize))


def sums(values: Samples) -> Floats:
    """Sum over the last axis, (R, N) -> (R,); a product with ones is several times faster than `np.sum`.

    One product for each record: in a product of the whole matrix the last digits depend on the place in it.
    """
    return np.asarray(np.vecdot(values, np.ones(values.shape[1], dtype=values.dtype)).astype(np.float64))


def sums_of_squares(values: Samples) -> Floats:
    """Sum over the last axis; (R, N) -> (R,)."""
    return np.asarray(np.vecdot(values, values).astype(np.float64))


def never_alone(rows: Indices) -> Indices:
    """The rows, a single one twice.

    NumPy multiplies one complex number by itself in another way than several, so that the last digits of a record
    would depend on whether others are fitted with it. What is found twice is the same and is put to one place.
    """
    return np.repeat(rows, 2) if rows.size == 1 else rows


def are_all(rows: Indices, n_records: int) -> bool:
    """Whether rising rows of :func:`never_alone` are those of all records (never one)."""
    return rows.size == n_records and (n_records == 0 or bool(rows[0] != rows[-1]))


@dataclass(frozen=True)
class Records:
    """Some records of a stack, ready to be fitted.

    values : (R, N) volts less `centre`, 0 where missing
    weights : (R, N) 1 or 0 in the same precision, or None where nothing is missing
    centre, count : (R,) volts, and valid samples
    constant : (R,) all valid samples equal, or none valid
    lowest, highest : (R,) of `values`
    at_lowest, at_highest : (R,) how many of one in `THINNING` samples have that value
    """

    values: Samples
    weights: Samples | None
    centre: Floats
    count: Floats
    constant: Bools
    lowest: Samples
    highest: Samples
    at_lowest: Counts
    at_highest: Counts

    def take(self, rows: Indices) -> Records:
        """Some of the records."""
        picked: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        for name, part in picked.items():
            picked[name] = None if part is None else part[rows]
        return Records(**picked)

    def groups(self) -> Iterator[tuple[Indices, Records]]:
        """Records without and with missing samples, and which they are: sums over all samples have a closed form,
        which none of them may lose by its neighbours.
        """
        if self.weights is None and len(self.values) != 1:
            yield np.arange(len(self.values)), self
            return
        whole = np.ones(len(self.values), dtype=bool) if self.weights is None else self.weights.all(axis=-1)
        if (rows := never_alone(np.flatnonzero(whole))).size:
            yield rows, replace(self.take(rows), weights=None)
        if (rows := never_alone(np.flatnonzero(~whole))).size:
            yield rows, self.take(rows)


@dataclass(frozen=True)
class Stack:
    """A checked stack of records, (R, N) of any real type, and the leading shape of the caller's array."""

    volts: Samples
    shape: tuple[int, ...]
    nan_policy: NanPolicy

    @property
    def n_samples(self) -> int:
        """Samples per record, missing ones included."""
        return int(self.volts.shape[1])

    def parts(self) -> Iterator[slice]:
        """Slices of the stack that fit into the cache; at least one, so that an empty stack works too."""
        at_once = max(1, SAMPLES_AT_ONCE // self.n_samples)
        for start in range(0, max(len(self.volts), 1), at_once):
            yield slice(start, start + at_once)

    def take(self, part: slice | Indices, precision: DTypeLike = np.float64) -> Records:
        """Centre some records."""
        raw, kind, missing = self.volts[part], np.dtype(precision), None
        centred = _Centred.of(raw, missing, kind)
        if not np.all(np.isfinite(centred.centre)):
            missing = np.isnan(raw)
            if self.nan_policy == "raise" and missing.any():
                where = np.argwhere(missing)[0]
                raise ValueError(
                    f"volts holds nan ({missing.sum()} samples, the first is sample {where[1]} of its record): "
                    'nan_policy="omit" leaves such samples out'
                )
            centred = _Centred.of(raw, missing, kind)
            if not np.all(np.isfinite(centred.centre)):
                raise ValueError("volts holds infinite values")
        blank = _blank_samples(raw, centred)
        if blank is not None:
            missing = blank if missing is None else missing | blank
            centred = _Centred.of(raw, missing, kind)
        weights = None if missing is None else (~missing).astype(kind)
        # Rounding of the mean leaves about 1e-16 of the level in a record that is really constant.
        constant = centred.highest - centred.lowest <= 1e-12 * np.abs(centred.centre)
        constant |= centred.count < 1
        return Records(weights=weights, constant=constant, **vars(centred))


def _blank_samples(raw: Samples, centred: _Centred) -> Bools | None:
    """Where records of raw codes, of whatever type, hold what a scope sends where scan mode has no sample yet."""
    blank = None
    for row in np.flatnonzero(np.abs(centred.centre + centred.lowest - NO_DATA) < 1e-3):
        codes = raw[row][np.isfinite(raw[row])]
        if codes.max() <= LARGEST_CODE and np.array_equal(codes, np.rint(codes)):
            blank = np.zeros(raw.shape, dtype=bool) if blank is None else blank
            blank[row] = raw[row] == NO_DATA
    return blank


@dataclass(frozen=True)
class _Centred:
    """The part of `Records` that is found in passes over the samples."""

    values: Samples
    centre: Floats
    count: Floats
    lowest: Samples
    highest: Samples
    at_lowest: Counts
    at_highest: Counts

    @staticmethod
    def of(raw: Samples, missing: Bools | None, precision: np.dtype[Any]) -> _Centred:
        n_records, n_samples = raw.shape
        ends: Samples = np.empty((2, n_records), dtype=precision)
        at_ends: Counts = np.empty((2, n_records), dtype=np.uint32)
        count = np.full(n_records, float(n_samples))
        if missing is not None:
            count -= missing.sum(axis=-1)
        found = _Centred(np.empty(raw.shape, dtype=precision), np.empty(n_records), count, *ends, *at_ends)
        ones, places = np.ones(n_samples), _some_places(n_samples)
        at_once = records_at_once(n_samples, raw.dtype)
        for start in range(0, n_records, at_once):
            here = slice(start, start + at_once)
            some, block = raw[here], found.values[here]
            if missing is not None:
                some = np.where(missing[here], raw.dtype.type(0), some)
            with np.errstate(over="ignore", invalid="ignore"):  # infinite: the caller's concern
                mean = np.vecdot(some, ones) / np.maximum(count[here], 1)
                block[...] = some
                block -= mean[:, np.newaxis].astype(precision)
            if missing is not None:
                block[missing[here]] = 0.0
            found.centre[here], ends[0, here], ends[1, here] = mean, block.min(axis=-1), block.max(axis=-1)
            few = block.take(places, axis=1)
            low, high = few <= ends[0, here, np.newaxis], few >= ends[1, here, np.newaxis]
            # several times faster than counting booleans
            at_ends[0, here] = low.view(np.uint8).sum(axis=-1, dtype=np.uint32)
            at_ends[1, here] = high.view(np.uint8).sum(axis=-1, dtype=np.uint32)
        if precision == np.float32:
            # Where the mean is large beside the swing, single precision must begin after the subtraction.
            size, swing = np.abs(found.centre), ends[1] - ends[0]
            lifted = np.flatnonzero(np.isfinite(size) & ~(size < LIFTED * swing))
            if lifted.size:
                absent = None if missing is None else missing[lifted]
                again = _Centred.of(raw[lifted], absent, np.dtype(np.float64))
                with np.errstate(over="ignore"):  # beyond single precision: such records are fitted in double
                    for name, fine in vars(again).items():
                        getattr(found, name)[lifted] = fine
        return found


@cache
def _some_places(n_samples: int) -> Indices:
    """One in `THINNING` samples, at random: at regular distances they might all fall on few phases of a beat."""
    order = np.random.default_rng(n_samples).permutation(n_samples)
    return np.sort(order[: -(-n_samples // THINNING)])


def as_stack(volts: ArrayLike, sample_interval: float, nan_policy: NanPolicy = "raise") -> Stack:
    """Check an array of records."""
    array = np.asarray(volts)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"volts must be real numbers, not {array.dtype}")
    if array.ndim == 0 or array.shape[-1] < MINIMUM_SAMPLES:
        found = array.shape[-1] if array.ndim else 1
        raise ValueError(f"a record needs at least {MINIMUM_SAMPLES} samples, this one has {found}")
    if np.ndim(sample_interval) != 0 or not np.isfinite(sample_interval) or sample_interval <= 0:
        raise ValueError(f"sample_interval must be one positive number of seconds, not {sample_interval!r}")
    if nan_policy not in ("raise", "omit"):
        raise ValueError(f"nan_policy must be 'raise' or 'omit', not {nan_policy!r}")
    if array.dtype.kind in "iu" and array.size and max(int(array.max()), -int(array.min())) > LARGEST_INTEGER:
        raise ValueError("volts holds integers beyond 2^52: raw codes that have overflowed?")
    return Stack(array.reshape(-1, array.shape[-1]), array.shape[:-1], nan_policy)
