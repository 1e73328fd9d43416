"""Records as the fits want them: checked, two-dimensional, centred, missing samples weighted 0."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

Floats = NDArray[np.float64]
Samples = NDArray[Any]
"""float32 or float64"""
Bools = NDArray[np.bool_]

MINIMUM_SAMPLES = 8
"""The lock-in waveform has six parameters; two more samples are the least that leaves any noise estimate."""

NO_DATA = -128
LARGEST_INTEGER = 2**52

SAMPLES_AT_ONCE = 2_500_000
"""Samples worked on together: enough that the cost of calling NumPy does not count, and a bound on the memory of
any batch."""

RECORDS_AT_ONCE = 40
"""Records centred together: 1 MB, which the second-level cache holds until all passes over them are done."""

LIFTED = 10.0
"""Mean over swing beyond which a record must be centred in double precision."""

# The C library of Linux gives large blocks back to the system as soon as they are free, and a block asked for
# again is then made of fresh pages, which takes longer than the arithmetic on it. Once it has seen a block of this
# size come and go it keeps them. Nothing is written to it, so it costs no memory.
np.empty(30 << 20, dtype=np.uint8)


@dataclass(frozen=True)
class Records:
    """Some records of a stack, ready to be fitted.

    values : (R, N) volts less `centre`, 0 where missing
    weights : (R, N) 1 or 0 in the same precision, or None where nothing is missing
    centre, count : (R,) volts, and valid samples
    constant : (R,) all valid samples equal, or none valid
    highest, lowest : (R,) of `values`
    """

    values: Samples
    weights: Samples | None
    centre: Floats
    count: Floats
    constant: Bools
    highest: Samples
    lowest: Samples


@dataclass(frozen=True)
class Stack:
    """A checked stack of records, (R, N) of any real type, and the leading shape of the caller's array."""

    volts: NDArray[Any]
    shape: tuple[int, ...]

    @property
    def n_samples(self) -> int:
        """Samples per record, missing ones included."""
        return int(self.volts.shape[1])

    def parts(self) -> Iterator[slice]:
        """Slices of the stack that fit into the cache; at least one, so that an empty stack works too."""
        at_once = max(1, SAMPLES_AT_ONCE // self.n_samples)
        for start in range(0, max(len(self.volts), 1), at_once):
            yield slice(start, start + at_once)

    def take(self, part: slice | NDArray[np.intp], precision: DTypeLike = np.float64) -> Records:
        """Centre some records.

        Raises
        ------
        ValueError
            Infinite values.
        """
        raw, kind = self.volts[part], np.dtype(precision)
        count = np.full(len(raw), float(self.n_samples))
        weights = None
        values, centre = _centred(raw, count, kind)
        if not np.all(np.isfinite(centre)):
            missing = np.isnan(raw)
            count -= missing.sum(axis=-1)
            values, centre = _centred(np.where(missing, raw.dtype.type(0), raw), count, kind)
            if not np.all(np.isfinite(centre)):
                raise ValueError("volts holds infinite values")
            values[missing] = 0.0
            weights = (~missing).astype(kind)
        highest, lowest = values.max(axis=-1, initial=-np.inf), values.min(axis=-1, initial=np.inf)
        # Rounding of the mean leaves about 1e-16 of the level in a record that is really constant.
        constant = (highest - lowest <= 1e-12 * np.abs(centre)) | (count < 1)
        return Records(values, weights, centre, count, constant, highest, lowest)


def _centred(raw: NDArray[Any], count: Floats, precision: np.dtype[Any]) -> tuple[Samples, Floats]:
    """Records less their mean, and the mean; in blocks that are still in the cache for the next pass."""
    values: Samples = np.empty(raw.shape, dtype=precision)
    centre = np.empty(len(raw))
    ones = np.ones(raw.shape[1])
    with np.errstate(over="ignore", invalid="ignore"):  # infinite: the caller's concern
        for start in range(0, len(raw), RECORDS_AT_ONCE):
            here = slice(start, start + RECORDS_AT_ONCE)
            some = raw[here]
            centre[here] = some @ ones / np.maximum(count[here], 1)
            values[here] = some
            values[here] -= centre[here, np.newaxis].astype(precision)
        if precision == np.float32 and len(raw):
            # Where the mean is large beside the swing, single precision must begin after the subtraction.
            swing = values.max(axis=-1) - values.min(axis=-1)
            lifted = np.flatnonzero(~(np.abs(centre) < LIFTED * swing))
            values[lifted] = raw[lifted] - centre[lifted, np.newaxis]
    return values, centre


def as_stack(volts: ArrayLike, sample_interval: float) -> Stack:
    """Check an array of records.

    Parameters
    ----------
    volts : (..., n_samples)
        nan marks a missing sample; so does -128 in raw codes of int8, which a scope sends where scan mode has no
        sample yet.
    sample_interval : float
        Seconds.

    Raises
    ------
    ValueError
        Says what is wrong: type, shape, number of samples, sample interval.
    """
    array = np.asarray(volts)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"volts must be real numbers, not {array.dtype}")
    if array.ndim == 0 or array.shape[-1] < MINIMUM_SAMPLES:
        found = array.shape[-1] if array.ndim else 1
        raise ValueError(f"a record needs at least {MINIMUM_SAMPLES} samples, this one has {found}")
    if np.ndim(sample_interval) != 0 or not np.isfinite(sample_interval) or sample_interval <= 0:
        raise ValueError(f"sample_interval must be one positive number of seconds, not {sample_interval!r}")
    if array.dtype == np.int8 and (array == NO_DATA).any():
        array = np.where(array == NO_DATA, np.float32(np.nan), array)
    elif array.dtype.kind in "iu" and array.size and max(int(array.max()), -int(array.min())) > LARGEST_INTEGER:
        raise ValueError("volts holds integers beyond 2^52: raw codes that have overflowed?")
    return Stack(array.reshape(-1, array.shape[-1]), array.shape[:-1])
