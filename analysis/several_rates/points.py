"""How records become points: those at one rate in one sense tell the same of the unknowns, their scatter is noise.

Records are read some at a time, and only sums of them are kept: a million need no more room than a thousand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.arrays import Bools, Complexes, Floats, Indices, Stacked
from analysis.budget import SECOND_ORDER_LIMIT
from analysis.flags import Flag
from analysis.lockin_rate import LockInEstimate
from analysis.several_rates.ratio_model import (
    RatioData,
    Reference,
    in_standard_uncertainties,
    predicted,
    whitening_factor,
)

# --------------------
# Complex ratios of many records for a fit over several rates: which can be used, and whether beats fit rates


AT_ONCE = 1 << 14
"""Records that are looked at together: all that a fit works out of each of a million would take much memory."""

SMALLEST_U = 1e-7
"""Least uncertainty of a ratio, far below any converter's: noise-free records must not weigh without limit."""

FASTER_THAN_POSSIBLE = 2e-3
"""f may exceed K|W| by this share (conservative coupling, K, rate): more means a rate that is too low."""

MISMATCH = 0.005
"""A rate that misses the one of the beat by more is worth a flag: it goes 1:1 into the lock-in rate."""

_FAST = 0.5


@dataclass(frozen=True)
class RatioBlock(Stacked):
    """Some records, arrays of one value each; nan where a record has no beat."""

    rate: Floats  # deg/s, signed
    beat_frequency: Floats  # Hz; 0 where there is no beat
    beat_frequency_u: Floats
    ratio: Complexes  # rho (m,) and that of its two parts (m, 2, 2)
    covariance: Floats
    amplitude: Floats  # any unit; those that :class:`RatioRecords` gives are over the mean of its usable records
    when: Floats  # place in the run, from -1/2 to 1/2; 0 where nobody knows it
    third: Floats  # third harmonic beyond the waveform in phase with distortion, over the amplitude; inf: unknown
    third_u: Floats
    misfit: Bools  # records whose waveform is not the lock-in one within its noise

    @property
    def locked(self) -> Bools:
        """Records that show no beat."""
        return np.asarray(self.beat_frequency == 0)

    @property
    def usable(self) -> Bools:
        """Records with a ratio."""
        numbers = (self.ratio, self.beat_frequency_u, self.amplitude)
        there = (self.beat_frequency > 0) & (self.amplitude > 0) & np.isfinite(self.covariance).all(axis=(-1, -2))
        return np.asarray(there & np.logical_and.reduce([np.isfinite(values) for values in numbers]))


@dataclass(frozen=True)
class RatioRecords:
    """n records, of which little is held: the rest is read some records at a time."""

    rate: Floats  # (n,) deg/s, signed
    usable: Bools  # (n,) records with a ratio; records that show no beat
    locked: Bools
    mean_amplitude: float  # of the usable records
    scale_factor: float  # pulses per degree
    noise_model: str  # what the uncertainties rest on
    rate_of_beat: bool  # whether the rates are those that the records themselves gave, and test no beat
    # place in the run at which each visit of a rate begins, rising; one value where no order is known
    visits: Floats
    read: Callable[[slice], RatioBlock]  # gives some of the records

    def blocks(self) -> Iterator[tuple[slice, RatioBlock]]:
        """All records in their order: which they are, and they."""
        for some in in_blocks(self.rate.size):
            block = self.read(some)
            yield some, replace(block, amplitude=block.amplitude / self.mean_amplitude)

    def times(self, factor: Callable[[Floats], Complexes]) -> RatioRecords:
        """The same records with the ratio of each times a factor of its beat frequency, Hz."""

        def read(some: slice) -> RatioBlock:
            block = self.read(some)
            frequency = np.where(block.locked, np.nan, block.beat_frequency)
            return replace(block, ratio=block.ratio * factor(frequency))

        return replace(self, read=read)


def in_blocks(count: int) -> Iterator[slice]:
    """So many records, `AT_ONCE` of them at a time."""
    return (slice(first, min(first + AT_ONCE, count)) for first in range(0, count, AT_ONCE))


def records_of_estimates(
    estimates: LockInEstimate | Sequence[LockInEstimate], input_rate: ArrayLike | None, *, in_order: bool
) -> RatioRecords:
    """Records of one or several estimates."""
    several = [estimates] if isinstance(estimates, LockInEstimate) else list(estimates)
    flat = [e.reshaped(-1) for e in several]
    count = sum(len(e) for e in flat)
    if count == 0:
        raise ValueError("no record to fit")
    if len({e.scale_factor for e in flat}) > 1:
        raise ValueError("the records have different scale factors: fit one gyro at a time")
    if input_rate is None and not all(e.rate_given for e in flat):
        raise ValueError(
            "the sense of rotation must be known: estimate the records with their signed input_rate, or give "
            "it here"
        )
    if input_rate is None:
        rate = np.concatenate([e.input_rate for e in flat])
    else:
        rate = np.broadcast_to(np.asarray(input_rate, dtype=np.float64).ravel(), (count,))
    when = place_in_run(count) if in_order else np.broadcast_to(0.0, count)
    # whether the rates are those that the records themselves gave, whatever their sense
    own = flat[0].input_rate if len(flat) == 1 else np.concatenate([e.input_rate for e in flat])
    is_own = not any(e.rate_given for e in flat) and all(
        np.allclose(np.abs(rate[some]), own[some], rtol=_THE_SAME, equal_nan=True) for some in in_blocks(count)
    )
    parts = np.split(np.arange(count), np.cumsum([len(e) for e in flat])[:-1])
    blocks = [_block(e, rate[its], when[its]) for e, its in zip(flat, parts, strict=True)] if len(flat) > 1 else []
    read = RatioBlock.joined(blocks).take if blocks else lambda some: _block(flat[0][some], rate[some], when[some])
    return _records(
        rate,
        read,
        scale_factor=flat[0].scale_factor,
        noise_model="; ".join(dict.fromkeys(e.noise_model for e in flat)),
        rate_of_beat=is_own,
        when=when,
    )


def records_of_arrays(
    rate: ArrayLike,
    ratio: ArrayLike,
    covariance: ArrayLike,
    beat_frequency: ArrayLike,
    *,
    scale_factor: float,
    beat_frequency_u: ArrayLike = 0.0,
    amplitude: ArrayLike = 1.0,
    third_harmonic: ArrayLike = 0.0,
    third_harmonic_u: ArrayLike = np.inf,
    rate_of_beat: bool = False,
    in_order: bool = False,
) -> RatioRecords:
    """Records of plain arrays of n values; a beat frequency of 0 marks a record without a beat."""
    w = np.asarray(rate, dtype=np.float64).ravel()
    when = place_in_run(w.size) if in_order else np.broadcast_to(0.0, w.size)
    spread = np.asarray(covariance, dtype=np.float64)
    if spread.shape not in ((w.size, 2, 2), (2, 2)):
        raise ValueError(f"covariance must have shape ({w.size}, 2, 2), not {spread.shape}")
    whole = RatioBlock(
        rate=w,
        beat_frequency=_column("beat_frequency", beat_frequency, w.size).astype(np.float64),
        beat_frequency_u=_column("beat_frequency_u", beat_frequency_u, w.size).astype(np.float64),
        ratio=_column("ratio", ratio, w.size).astype(np.complex128),
        covariance=np.broadcast_to(spread, (w.size, 2, 2)),
        amplitude=_column("amplitude", amplitude, w.size).astype(np.float64),
        when=when,
        third=_column("third_harmonic", third_harmonic, w.size).astype(np.float64),
        third_u=_column("third_harmonic_u", third_harmonic_u, w.size).astype(np.float64),
        misfit=np.zeros(w.size, dtype=bool),
    )
    return _records(
        w,
        whole.take,
        scale_factor=scale_factor,
        noise_model="the covariances given",
        rate_of_beat=rate_of_beat,
        when=when,
    )


def _records(
    rate: Floats,
    read: Callable[[slice], RatioBlock],
    *,
    scale_factor: float,
    noise_model: str,
    rate_of_beat: bool,
    when: Floats,
) -> RatioRecords:
    """Records that are read once, to see which can be used; ValueError where a number makes no sense."""
    if not np.all(np.isfinite(rate)) or np.any(rate == 0):
        raise ValueError("every input rate must be finite and not zero (deg/s, signed): its sense is needed")
    if not np.isfinite(scale_factor) or scale_factor <= 0:
        raise ValueError(f"scale_factor must be positive (pulses per degree), not {scale_factor!r}")
    usable, locked, total = np.empty(rate.size, dtype=bool), np.empty(rate.size, dtype=bool), 0.0
    for some in in_blocks(rate.size):
        block = read(some)
        if not (np.all(block.third_u > 0) and np.all(np.isfinite(block.third))):
            raise ValueError(
                "third_harmonic must be finite and third_harmonic_u positive; inf where it is not known"
            )
        usable[some], locked[some] = block.usable, block.locked
        total += float(block.amplitude[usable[some]].sum())
    return RatioRecords(
        rate=rate,
        usable=usable,
        locked=locked,
        mean_amplitude=total / int(usable.sum()) if usable.any() else 1.0,
        scale_factor=float(scale_factor),
        noise_model=noise_model,
        rate_of_beat=rate_of_beat,
        visits=when[visits_of_rates(rate)] if np.ptp(when) > 0 else when[:1],
        read=read,
    )


_THE_SAME = 1e-9


def common_mismatch(records: RatioRecords) -> float:
    """What all beats have in common against their rates: f/(K W), freed of lock-in by each record's own ratio."""
    # At least 1 where that is near 1, within `FASTER_THAN_POSSIBLE` and what distortion may do to those ratios;
    # nan without a usable record. Anything else is a wrong scale factor, or an error that all rates share. The
    # fast records say it, whose own ratio matters least.
    if not records.usable.any():
        return float("nan")
    smallest = min(float(np.abs(block.ratio).min()) for block in _usable(records))
    sizes, rates = [], []
    for block in _usable(records):
        fast = block.take(np.abs(block.ratio) <= 2 * smallest)
        size = np.abs(fast.ratio)
        square = np.minimum(size**2, 0.99)
        # W = (f/K)(1 + r^2)/(1 - r^2), and r may be off by the distortion
        own = fast.beat_frequency / records.scale_factor * (1 + square) / (1 - square)
        sizes.append(size)
        rates.append(own / np.abs(fast.rate))
    found = float(np.median(np.concatenate(rates)))
    by_distortion = 4 * SECOND_ORDER_LIMIT * float(np.median(np.concatenate(sizes)))
    return max(found, 1.0) if abs(found - 1) < FASTER_THAN_POSSIBLE + by_distortion else found


def _usable(records: RatioRecords) -> Iterator[RatioBlock]:
    """The records with a ratio, some at a time."""
    for some, block in records.blocks():
        if records.usable[some].any():
            yield block.take(records.usable[some])


def inconsistent_rate(records: RatioRecords, rate_u: Floats, mismatch: float = 1.0) -> Bools:
    """Records whose beat is faster than their rate (n,) allows, f > K |W|, beyond the mismatch that all have."""
    found = np.empty(records.rate.size, dtype=bool)
    for some, block in records.blocks():
        most = np.abs(block.rate) * (1 + FASTER_THAN_POSSIBLE) + 3 * rate_u[some]
        fastest = records.scale_factor * mismatch * most
        found[some] = block.beat_frequency > fastest + 4 * block.beat_frequency_u
    return found & records.usable


def rate_mismatch(records: RatioRecords, lock_in_rate: float, drift: float) -> Floats:
    """f/(K sqrt(W^2 - WL^2)) - 1 of every record, (n,), WL drifting by so much over the run; nan: not known."""
    mismatch = np.full(records.rate.shape, np.nan)
    for some, block in records.blocks():
        rate = np.abs(block.rate)
        then = lock_in_rate * (1 + drift * block.when)
        square = (rate - then) * (rate + then)
        known = records.usable[some] & (square > 0)
        expected = records.scale_factor * np.sqrt(square[known])
        mismatch[some][known] = block.beat_frequency[known] / expected - 1
    return mismatch


def rates_differ(
    rate: Floats, size: float, u: float, mismatch: Floats, rate_u: Floats, common: float = 0.0
) -> bool:
    """Whether a rate of some (n,) does not fit its beat, beyond what a lock-in rate `size` with `u` explains."""
    for some in in_blocks(rate.size):
        beside, speed = (1 + mismatch[some]) / (1 + common) - 1, np.abs(rate[some])
        by_rate = rate_u[some] * speed / np.maximum(speed**2 - size**2, 1e-300)
        if np.any(np.abs(beside) > MISMATCH + 3 * (_stretch(speed, size, u) + by_rate)):
            return True
    return False


def mismatch_of_all(rate: Floats, size: float, u: float, mismatch: Floats) -> float:
    """What all beats have in common against their rates (n,), by the fast ones; 0 where that may be chance."""
    # Less than what `rates_differ` asks of a single record is enough. nan where no mismatch is known.
    fastest = 0.0
    for some in in_blocks(rate.size):
        known = np.isfinite(mismatch[some])
        fastest = max(fastest, float(np.max(np.abs(rate[some]), where=known, initial=0.0)))
    if fastest == 0:
        return float("nan")
    seen, explained = [], []
    for some in in_blocks(rate.size):
        speed = np.abs(rate[some])
        fast = np.isfinite(mismatch[some]) & (speed >= _FAST * fastest)
        seen.append(mismatch[some][fast])
        explained.append(_stretch(speed[fast], size, u))
    found, stretch = (float(np.median(np.concatenate(each), overwrite_input=True)) for each in (seen, explained))
    return found if abs(found) > FASTER_THAN_POSSIBLE + 3 * stretch else 0.0


def _stretch(rate: Floats, size: float, u: float) -> Floats:
    """Relative uncertainty of the beats at rates (n,) that a lock-in rate `size` with `u` leaves."""
    with np.errstate(over="ignore"):
        return np.asarray(size**2 / np.maximum(rate**2 - size**2, 1e-300) * (u / size if size else 0.0))


def _column(name: str, values: ArrayLike, n: int) -> NDArray[np.generic]:
    array = np.asarray(values)
    if array.ndim > 0 and array.size not in (1, n):
        raise ValueError(f"{name} must hold {n} values, one for every rate, not {array.size}")
    return np.broadcast_to(array.ravel(), (n,))


def place_in_run(count: int) -> Floats:
    """Place of each record in its run, (n,), from -1/2 to 1/2."""
    return np.arange(count) / max(count - 1, 1) - 0.5


def visits_of_rates(rate: Floats) -> Indices:
    """First record of each visit of a rate, rising; what drifts differs between visits."""
    # A long visit is cut in two, and with few settings or in one sense a shorter one is, so that it shows by
    # itself what drifts. Where the rates (n,) change all the time its quarters are the visits.
    groups = first_of_groups((np.abs(rate[some]) for some in in_blocks(rate.size)), SAME_RATE)
    changed, seen = [np.zeros(1, dtype=np.intp)], []
    for some in in_blocks(rate.size):
        here = rate[max(some.start - 1, 0) : some.stop]
        changes = np.abs(np.diff(here)) > SAME_RATE * np.abs(here[1:])
        changed.append(max(some.start, 1) + np.flatnonzero(changes))
        seen.append(np.unique(2 * groups_of(np.abs(here), groups) + (here > 0)))
    settings, first = np.unique(np.concatenate(seen)).size, np.concatenate(changed)
    if first.size > MOST_VISITS * settings:
        return np.unique(rate.size * np.arange(4) // 4)
    length = np.diff(np.append(first, rate.size))
    # the fewer settings, the more must the records of each say
    few = 2 if np.all(rate > 0) or np.all(rate < 0) or settings < 4 else 1 if settings < 6 else 0
    pieces = np.select([length >= LONG_VISIT, length >= LONG_VISIT >> few], [4 if few else 2, 2], 1)
    begins = [first + length * np.minimum(piece, pieces - 1) // pieces for piece in range(4)]
    return np.unique(np.concatenate(begins))


MOST_VISITS, LONG_VISIT = 4, 8


def _block(estimate: LockInEstimate, rate: Floats, when: Floats) -> RatioBlock:
    """Records of an estimate (m,), with their rates (m,) and their places in the run."""
    # Such a mean holds the value of the positive sense. Which of the two it is shows in the backscatter phase,
    # which is the same in both senses: the angle of -rho in the positive one, the negative angle of rho in the
    # other.
    rho, phase = estimate.complex_ratio, np.exp(1j * estimate.backscatter_phase)
    size = np.maximum(np.abs(rho), 1e-300)
    with np.errstate(invalid="ignore"):  # records without a beat are nan
        as_it_is = np.abs(phase - np.conj(rho) / size)
        mirrored = np.abs(phase + rho / size)
    turned = estimate.rate_given & (estimate.input_rate < 0) & (mirrored < as_it_is)
    off_diagonal = np.where(turned, -1.0, 1.0)[:, np.newaxis, np.newaxis]
    covariance = estimate.complex_ratio_covariance * np.where(np.eye(2, dtype=bool), 1.0, off_diagonal)
    ratio = np.where(turned, -np.conj(rho), rho)
    # A gyro inside lock-in gives a constant or nothing but noise; other faults say nothing about its rate.
    no_beat = (estimate.flags & int(Flag.NO_BEAT | Flag.CONSTANT)) != 0
    return RatioBlock(
        rate=rate,
        beat_frequency=np.where(no_beat, 0.0, estimate.beat_frequency),
        beat_frequency_u=estimate.beat_frequency_u,
        ratio=ratio,
        covariance=covariance,
        amplitude=estimate.amplitude,
        when=when,
        third=estimate.third_harmonic.real,
        third_u=estimate.third_harmonic_u,
        misfit=(estimate.flags & int(Flag.MISFIT)) != 0,
    )


SAME_RATE = 0.01
SAME_AMPLITUDE = 0.05


@dataclass(frozen=True)
class UsedRecords:
    """The records of a fit."""

    records: RatioRecords  # RatioRecords All n that there are.
    used: Bools  # (n,) Which of them are fitted.
    rate_u: Floats  # (n,) deg/s, standard uncertainty of each rate.
    reference: Reference  # {"rate", "beat"}

    def blocks(self) -> Iterator[tuple[Indices, RatioBlock]]:
        """Some of them at a time, and which they are."""
        for some, block in self.records.blocks():
            rows = np.flatnonzero(self.used[some])
            if rows.size:
                yield some.start + rows, block.take(rows)

    def data(self) -> Iterator[tuple[Indices, RatioData, Floats]]:
        """The same as one set of data (m,), and the covariance of their ratios."""
        for rows, block in self.blocks():
            yield rows, *self._data(block, self.rate_u[rows])

    def _data(self, block: RatioBlock, rate_u: Floats) -> tuple[RatioData, Floats]:
        frequency, ratio = block.beat_frequency, block.ratio
        if self.reference == "rate":
            by_reference = _by_rate(ratio, rate_u / np.abs(block.rate))
        else:
            by_reference = _along(ratio * (block.beat_frequency_u / frequency))
        covariance = block.covariance + by_reference + SMALLEST_U**2 * np.eye(2)
        data = RatioData(
            rate=block.rate,
            beat_rate=frequency / self.records.scale_factor,
            angular=2 * np.pi * frequency,
            ratio=ratio,
            whitening=whitening_factor(covariance)[np.newaxis],
            amplitude=block.amplitude,
            when=block.when,
            third=block.third,
            third_weight=1 / block.third_u,
            reference=self.reference,
        )
        return data, covariance


@dataclass(frozen=True)
class Places:
    """Which point a record belongs to: by its rate, its sense, its amplitude and the visit."""

    rates: Floats  # least |W| and least amplitude of each group of them, rising
    amplitudes: Floats
    visits: Floats  # place in the run at which each visit begins, rising
    keys: Indices  # rate, sense, amplitude and visit of each point as one number, rising

    @classmethod
    def of(cls, records: UsedRecords) -> Places:
        """The points that some records make."""
        rates = first_of_groups((np.abs(block.rate) for _, block in records.blocks()), SAME_RATE)
        amplitudes = first_of_groups((block.amplitude for _, block in records.blocks()), SAME_AMPLITUDE)
        found = cls(rates, amplitudes, records.records.visits, np.empty(0, dtype=np.intp))
        each = [np.unique(found._key(block)) for _, block in records.blocks()]
        return replace(found, keys=np.unique(np.concatenate(each)))

    @property
    def settings(self) -> Indices:
        """Rate, sense and amplitude of each point as one number: visits of one setting have the same."""
        return self.keys // self.visits.size

    def __len__(self) -> int:
        return self.keys.size

    def __getitem__(self, data: RatioData | RatioBlock) -> Indices:
        """Point of each record."""
        return np.searchsorted(self.keys, self._key(data))

    def _key(self, data: RatioData | RatioBlock) -> Indices:
        rate_and_sense = 2 * groups_of(np.abs(data.rate), self.rates) + (data.rate > 0)
        setting = rate_and_sense * self.amplitudes.size + groups_of(data.amplitude, self.amplitudes)
        return setting * self.visits.size + groups_of(data.when, self.visits)

    def sums(self, data: RatioData | RatioBlock, *columns: Floats) -> Floats:
        """Sums (columns, points) of columns of one number for each record."""
        place = self[data]
        return np.stack([np.bincount(place, column, len(self)) for column in columns])


_LASTS = 1e-4  # least standard deviation of places in the run whose third moment is told
_AT_ONE_TIME = 1e-7  # no run has so many records: rounding
CURVE = 3  # numbers of a parabola: what turns while records are taken leaves less beside it than their noise


@dataclass(frozen=True)
class Points:
    """Records gathered into points."""

    records: UsedRecords  # UsedRecords
    places: Places  # Places Of the records among the points.
    points: RatioData  # RatioData One set of p means.
    rate_group: Indices  # (p,) Which of the different |W| each point has.
    # two places in the run beside that of each point, and their weights: like its records to the third moment
    beside: Floats  # (2, p); (1, p), and that of each point, where all its records were taken at once
    beside_weights: Floats
    uneven: float = 0.0  # rms of what a converter's codes add to a third harmonic, over the beat

    @property
    def covariance(self) -> Floats:
        """Of real and imaginary part of each point, (p, 2, 2)."""
        whitening = self.points.whitening[0]
        return np.linalg.inv(whitening @ whitening.swapaxes(-1, -2))

    @property
    def lasts(self) -> Floats:
        """Standard deviation of the places in the run of the records of each point, (p,)."""
        return np.asarray(np.sqrt(np.sum(self.beside_weights * self.beside**2, axis=0)))

    @property
    def settings(self) -> int:
        """Different rates, senses and amplitudes among the points."""
        return int(np.unique(self.places.settings).size)

    def scatter(self, parameters: Floats, *, turning: bool = False) -> tuple[float, int]:
        """Chi-square of the records about the mean of each point, or its curve in time; degrees of freedom."""
        # What the model says of each record's own rate and amplitude is taken out first.
        order = CURVE if turning else 1

        def every(part: int) -> Iterator[tuple[RatioData, Floats, Complexes]]:
            for _, data, _ in self.records.data():
                weights = (_weights(data), data.third_weight**2)[part]
                yield data, weights, _left(parameters, data)[part].astype(np.complex128)

        (mean, _, fitted), (third, _, thirds) = (self.curves(every(part), order) for part in range(2))
        chi_square, values = 0.0, 2 * (int(self.records.used.sum()) - fitted) - thirds
        for _, data, _ in self.records.data():
            left, rest = _left(parameters, data)
            rest = rest - self.on_curves(third, data).real
            of_ratio, of_third = in_standard_uncertainties(left - self.on_curves(mean, data), rest, data)
            chi_square += float(np.sum(of_ratio**2) + np.sum(of_third**2))
            values += int(np.count_nonzero(data.third_weight))
        return chi_square, values

    def curves(
        self, every: Iterable[tuple[RatioData, Floats, Complexes]], order: int = CURVE
    ) -> tuple[Complexes, Floats, int]:
        """Curves in time (p, order) of complex values of records, weights (p,), and how many numbers they are."""
        columns, moments = range(order), 2 * order - 1
        sums = np.zeros((moments + 2 * order + 1, len(self.places)))
        for data, weight, value in every:
            times, there = self._times(data), (weight > 0).astype(np.float64)
            parts = [weight * times**n * part for part in (value.real, value.imag) for n in columns]
            sums += self.places.sums(data, *(weight * times**n for n in range(moments)), *parts, there)
        # no more than there are records, or times
        most = np.where(self.lasts > _AT_ONE_TIME, sums[-1], np.minimum(sums[-1], 1.0))
        known = np.arange(order) < most[:, np.newaxis]
        total = np.where(known[:, 0], sums[0], 1.0)[:, np.newaxis]
        normal = sums[np.add.outer(columns, columns)].T / total[..., np.newaxis]
        normal = np.where(known[:, np.newaxis] & known[..., np.newaxis], normal, np.eye(order))
        real, imaginary = sums[moments:-1].reshape(2, order, -1)
        aim = np.where(known, (real + 1j * imaginary).T / total, 0.0)
        curve = np.asarray(np.linalg.solve(normal, aim[..., np.newaxis])[..., 0])
        return curve, np.asarray(sums[0]), int(np.count_nonzero(known))

    def on_curves(self, curves: Complexes, data: RatioData) -> Complexes:
        """Values of such curves at the times of some records (m,)."""
        powers = self._times(data)[:, np.newaxis] ** np.arange(curves.shape[-1])
        return np.asarray(np.sum(curves[self.places[data]] * powers, axis=-1))

    def _times(self, data: RatioData) -> Floats:
        """Times of records beside the mean of their point, (m,), over the standard deviation of all of it."""
        place = self.places[data]
        return np.asarray((data.when - self.points.when[place]) / np.maximum(self.lasts[place], _AT_ONE_TIME))


def gather(records: UsedRecords) -> Points:
    """Mean of the records of each rate, sense, amplitude and visit, and its covariance."""
    places = Places.of(records)
    sums, spread = np.zeros((12, len(places))), np.zeros((4, len(places)))
    for _, data, _ in records.data():
        weights, precision = _weights(data), data.third_weight**2
        means = (
            *(data.rate, data.beat_rate, data.angular, data.ratio.real, data.ratio.imag),
            *(data.amplitude, data.when, data.when**2, data.when**3),
        )
        weighted = (weights * values for values in means)
        sums += places.sums(data, weights, *weighted, precision, precision * data.third)
    total, precision, third = sums[[0, 10, 11]]
    rate, beat_rate, angular, real, imaginary, amplitude, when, square, cube = sums[1:10] / total
    for _, data, covariance in records.data():
        share = (_weights(data) / total[places[data]]) ** 2
        spread += places.sums(data, *(share * values for values in covariance.reshape(-1, 4).T))
    points = RatioData(
        rate=rate,
        beat_rate=beat_rate,
        angular=angular,
        ratio=real + 1j * imaginary,
        whitening=whitening_factor(spread.T.reshape(-1, 2, 2))[np.newaxis],
        amplitude=amplitude,
        when=when,
        third=third / np.maximum(precision, 1e-300),
        third_weight=np.sqrt(precision),
        reference=records.reference,
    )
    group = groups_of(np.abs(rate), first_of_groups([np.abs(rate)], SAME_RATE))
    lasts = np.sqrt(np.maximum(square - when**2, 0.0))
    moment = np.where(lasts > _LASTS, cube - 3 * when * square + 2 * when**3, 0.0)
    skew = moment / np.maximum(lasts, _LASTS) ** 3 / 2
    ends = skew + np.hypot(skew, 1.0) * np.array([[-1.0], [1.0]]) if np.any(lasts > _LASTS) else skew[np.newaxis]
    return Points(records, places, points, group, lasts * ends, 1 / (1 + ends**2))


def at_mean_times(points: Points, parameters: Floats) -> Points:
    """The points with every record as it would be at the middle of its visit, by the drifts of a fit."""
    # The mean of ratios that turn while they are taken is smaller than they are.
    places, means = points.places, points.points
    moved = np.zeros((3, len(places)))
    for _, data, _ in points.records.data():
        at_mean = predicted(parameters, replace(data, when=means.when[places[data]]))[0]
        change, weights = (at_mean - predicted(parameters, data)[0])[0], _weights(data)
        moved += places.sums(data, weights, weights * change.real, weights * change.imag)
    shift = (moved[1] + 1j * moved[2]) / moved[0]
    return replace(points, points=replace(means, ratio=means.ratio + shift))


def with_rate_noise(points: Points, share: float) -> Points:
    """The points with one more uncertainty of their rates, a share of each: common to all records of a point."""
    return with_noise(points, _by_rate(points.points.ratio, share))


def with_noise(points: Points, more: Floats) -> Points:
    """The points with one more covariance (..., 2, 2) of their ratios."""
    whitening = whitening_factor(points.covariance + more)[np.newaxis]
    return replace(points, points=replace(points.points, whitening=whitening))


def _by_rate(ratio: Complexes, relative: Floats | float) -> Floats:
    """Covariance (..., 2, 2) of ratios (...) by the relative u of their rates."""
    # d ln r = -(1 + r^2)/(1 - r^2) d ln W.
    square = np.minimum(np.abs(ratio) ** 2, _LARGEST_SQUARE)
    # far from lock-in the factor is 1 to 8 % of that u, and saved runs give what they gave
    steeper = np.where(square > _NEAR, (1 + square) / (1 - square), 1.0)
    return _along(ratio * (steeper * relative))


def _along(step: Complexes) -> Floats:
    """Covariance (..., 2, 2) of complex numbers that are uncertain by so much, in one direction."""
    parts = np.stack([step.real, step.imag], axis=-1)
    return np.asarray(parts[..., :, np.newaxis] * parts[..., np.newaxis, :])


_NEAR, _LARGEST_SQUARE = 0.04, 0.99


def first_of_groups(sizes: Iterable[Floats], share: float) -> Floats:
    """Least value of each group, rising, where neighbours within a share of each other belong to one group."""
    first, last = np.empty(0), np.empty(0)
    for some in sizes:
        # a group that was found before is a value that reaches up to its last
        order = np.argsort(from_here := np.concatenate([first, some]))
        begins = from_here[order]
        ends = np.maximum.accumulate(np.concatenate([last, some])[order])
        new = np.flatnonzero(np.concatenate([[True], begins[1:] - ends[:-1] > share * begins[1:]]))
        first, last = begins[new], np.maximum.reduceat(ends, new)
    return first


def groups_of(sizes: Floats, first: Floats) -> Indices:
    """Number of the group of each value, by :func:`first_of_groups`."""
    return np.searchsorted(first, sizes, side="right") - 1


def _left(parameters: Floats, data: RatioData) -> tuple[Complexes, Floats]:
    """What the model leaves of the ratios and of the third harmonics of one set, (m,)."""
    ratio, third = predicted(parameters, data)
    return (data.ratio - ratio)[0], (data.third - third)[0]


def _weights(data: RatioData) -> Floats:
    """Of the records in the mean of their point: one number for both parts of the ratio."""
    return np.asarray(np.square(data.whitening[0]).sum(axis=(-1, -2)))
