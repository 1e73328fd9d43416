"""Records as they come, and first values of frequency and harmonics from the spectrum of each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, DTypeLike, NDArray

from analysis.arrays import Bools, Complexes, Floats, Indices, Samples, Stacked

Sizes = NDArray[np.float32]

TAKEN = 2.5  # bins on either side of a line that are taken to belong to it


@dataclass(frozen=True)
class SpectralStart(Stacked):
    """omega (R,) rad per sample; first, second (R,) amplitudes of the strongest line and at twice its frequency,
    phases from the middle of the record.
    """

    omega: Floats
    first: Complexes
    second: Complexes

    @staticmethod
    def of(values: Samples) -> SpectralStart:
        """From centred records (R, N), a few at a time: their spectra are used up at once."""
        n_records, n_samples = values.shape
        at_once = records_at_once(n_samples, np.float32)
        begins = range(0, max(n_records, 1), at_once)  # one of no records too
        return SpectralStart.joined([Spectra.of(values[first : first + at_once]).start() for first in begins])


@dataclass(frozen=True)
class Spectra:
    """Spectra of centred records."""

    # Single precision: they only start the fits, and eight-bit samples do not fill its 24 bits.

    lines: NDArray[np.complex64]  # (R, N//2 + 1) complex64
    strongest: Indices  # (R,) bin of the strongest line beside the mean value
    n_samples: int  # N

    @staticmethod
    def of(values: Samples) -> Spectra:
        """Spectra of centred records (R, N)."""
        lines = _transformed(values)
        return Spectra(lines, _strongest(lines), values.shape[1])

    def start(self) -> SpectralStart:
        """Frequency of the strongest line, its amplitude, and that at twice its frequency."""
        # The strongest line is taken to be the fundamental, as it is above lock-in. The lines are read through the
        # Hann window (a convolution of three bins), whose low side lobes keep the mean value, the negative
        # frequency and the other harmonics away. A line and its neighbours have the same phase there.
        n = self.n_samples
        seen, bins = self._windowed(self.strongest)
        here = seen[:, 1]
        slope = ((seen[:, 2] - seen[:, 0]) * np.conj(here)).real / np.maximum(np.abs(here) ** 2, 1e-300)
        line = np.clip(bins[:, 1] + np.interp(slope, *_slope_at()), 0.5, n / 2)
        doubled = np.abs((2 * line + n / 2) % n - n / 2)
        at_second, second_bins = self._windowed(np.rint(doubled).astype(np.intp))
        second = _amplitude(at_second, second_bins - doubled[:, np.newaxis], n)
        # A folded line is the conjugate of the harmonic that it comes from.
        second = np.where(2 * line > n / 2, np.conj(second), second)
        return SpectralStart(line * (2 * np.pi / n), _amplitude(seen, bins - line[:, np.newaxis], n), second)

    def candidates(self, n_candidates: int) -> Floats:
        """Frequencies of the strongest lines, for records in which the strongest may not be the fundamental."""
        # Close to lock-in the harmonics are nearly as strong as the fundamental, and where few samples fall into a
        # period several of them fold onto one line.
        remaining, strongest = self.lines.copy(), self.strongest
        bins = np.arange(remaining.shape[1])
        found = np.empty((len(remaining), n_candidates))
        for column in range(n_candidates):
            found[:, column] = Spectra(remaining, strongest, self.n_samples).start().omega
            line = found[:, column, np.newaxis] * (self.n_samples / (2 * np.pi))
            remaining[np.abs(bins - line) < TAKEN] = 0.0
            strongest = _strongest(remaining)
        return found

    def _windowed(self, centre: Indices) -> tuple[Complexes, Indices]:
        """Three Hann-windowed bins around `centre`, phases from the middle of the record, and their numbers."""
        first = np.clip(centre - 2, 0, max(self.lines.shape[1] - 5, 0))
        bins = first[:, np.newaxis] + np.arange(5)
        picked = neighbours(self.lines, first, 5) * _to_the_middle(self.n_samples)[bins]
        return picked[:, 1:-1] / 2 + (picked[:, :-2] + picked[:, 2:]) / 4, bins[:, 1:-1]


def _transformed(values: Samples) -> NDArray[np.complex64]:
    return np.asarray(scipy.fft.rfft(values.astype(np.float32, copy=False), axis=-1))


def _strongest(lines: NDArray[np.complex64]) -> Indices:
    sizes = np.abs(lines)
    sizes[:, 0] = 0.0
    return np.asarray(sizes.argmax(axis=-1))


def neighbours(lines: Samples, first: Indices, n_bins: int) -> Samples:
    """`n_bins` bins of each row from bin `first` (R,) on, (R, n_bins)."""
    shape = (len(lines), lines.shape[1] - n_bins + 1, n_bins)
    windows = np.lib.stride_tricks.as_strided(lines, shape, (*lines.strides, lines.strides[1]), writeable=False)
    return np.asarray(windows[np.arange(len(first)), first])


@cache
def _to_the_middle(n_samples: int) -> Complexes:
    """Factors that make the phases of a spectrum count from the middle of the record."""
    return np.asarray(np.exp(1j * np.pi * np.arange(n_samples) * ((n_samples - 1) / n_samples)))


@cache
def _slope_at() -> tuple[Floats, Floats]:
    """Difference of the bins above and below a bin over that bin, and where between them the line is."""
    place = np.linspace(-0.75, 0.75, 301)
    rise = _hann_response(1 - place) - _hann_response(1 + place)
    return rise / _hann_response(place), place


def _hann_response(distance: Floats) -> Floats:
    """Size of a line seen through the Hann window at a distance in bins, for many samples; 1/2 at its own bin."""
    away = 1 - distance * distance
    edge = np.abs(away) < 1e-6
    return np.asarray(np.where(edge, 0.25, np.sinc(distance) / np.where(edge, 2.0, 2 * away)))


def _amplitude(seen: Complexes, distance: Floats, n_samples: int) -> Complexes:
    """Least-squares amplitude of one line seen in a few bins at `distance` (in bins) from it."""
    response = _hann_response(distance)
    return np.asarray(2 / n_samples * np.sum(response * seen, axis=-1) / np.sum(response**2, axis=-1))


def line_sizes(values: Samples) -> Sizes:
    """Size of each line of the spectra, (R, N) -> (R, N//2 + 1)."""
    return np.asarray(np.abs(_transformed(values)))


# --------------------
# Records as the fits want them: checked, two-dimensional, centred, missing samples weighted 0


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

THINNING = 5  # a fifth of the samples is enough to see whether a level may be crowded
LIFTED = 10.0  # mean over swing beyond which a record must be centred in double precision

# The C library of Linux gives large blocks back to the system as soon as they are free, and a block asked for
# again is then made of fresh pages, which takes longer than the arithmetic on it. Once it has seen a block of this
# size come and go it keeps them. Nothing is written to it, so it costs no memory.
np.empty(30 << 20, dtype=np.uint8)


def records_at_once(n_samples: int, precision: DTypeLike) -> int:
    """How many records to work on together so that they stay in the cache."""
    return max(1, AT_ONCE_BYTES // (n_samples * np.dtype(precision).itemsize))


def sums(values: Samples) -> Floats:
    """Sum over the last axis, (R, N) -> (R,); a product with ones is several times faster than `np.sum`."""
    # One product for each record: in a product of the whole matrix the last digits depend on the place in it.
    return np.asarray(np.vecdot(values, np.ones(values.shape[1], dtype=values.dtype)).astype(np.float64))


def sums_of_squares(values: Samples) -> Floats:
    """Sum over the last axis; (R, N) -> (R,)."""
    return np.asarray(np.vecdot(values, values).astype(np.float64))


def never_alone(rows: Indices) -> Indices:
    """The rows, a single one twice."""
    # NumPy multiplies one complex number by itself in another way than several, so that the last digits of a
    # record would depend on whether others are fitted with it. What is found twice is the same and is put to one
    # place.
    return np.repeat(rows, 2) if rows.size == 1 else rows


def are_all(rows: Indices, n_records: int) -> bool:
    """Whether rising rows of :func:`never_alone` are those of all records (never one)."""
    return rows.size == n_records and (n_records == 0 or bool(rows[0] != rows[-1]))


@dataclass(frozen=True)
class _Centred(Stacked):
    """What passes over the samples of some records find."""

    values: Samples  # (R, N) volts less `centre`, 0 where missing
    centre: Floats  # (R,) volts
    count: Floats  # (R,) of valid samples
    lowest: Samples  # (R,) of `values`
    highest: Samples
    at_lowest: Counts  # (R,) how many of one in `THINNING` samples have that value
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


@dataclass(frozen=True)
class Records(_Centred):
    """Some records of a stack, ready to be fitted."""

    weights: Samples | None  # (R, N) 1 or 0 in the precision of `values`, or None where nothing is missing
    constant: Bools  # (R,) all valid samples equal, or none valid
    exact: Bools  # (R,) whether the exact fit is worth its time where the rate moves

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
    exact: bool = True  # see `Records`

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
                row, first = np.argwhere(missing)[0]
                raise ValueError(
                    f"volts holds nan ({missing[row].sum()} samples, the first is sample {first} of its record): "
                    'nan_policy="omit" leaves such samples out'
                )
            centred = _Centred.of(raw, missing, kind)
            if not np.all(np.isfinite(centred.centre)):
                raise ValueError("volts holds infinite values")
        blank = None  # where raw codes hold what a scope sends where scan mode has no sample yet
        for row in np.flatnonzero(np.abs(centred.centre + centred.lowest - NO_DATA) < 1e-3):
            codes = raw[row][np.isfinite(raw[row])]
            if codes.max() <= LARGEST_CODE and np.array_equal(codes, np.rint(codes)):
                blank = np.zeros(raw.shape, dtype=bool) if blank is None else blank
                blank[row] = raw[row] == NO_DATA
        if blank is not None:
            missing = blank if missing is None else missing | blank
            centred = _Centred.of(raw, missing, kind)
        weights = None if missing is None else (~missing).astype(kind)
        # Rounding of the mean leaves about 1e-16 of the level in a record that is really constant.
        constant = centred.highest - centred.lowest <= 1e-12 * np.abs(centred.centre)
        constant |= centred.count < 1
        exact = np.full(len(raw), self.exact)
        return Records(weights=weights, constant=constant, exact=exact, **vars(centred))


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
