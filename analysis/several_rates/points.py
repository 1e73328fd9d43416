"""How records become points: those at one rate in one sense tell the same of the unknowns, their scatter is noise.

Records are read some at a time, and only sums of them are kept: a million need no more room than a thousand.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from analysis.arrays import Bools, Complexes, Floats, Indices
from analysis.several_rates.least_squares import in_standard_uncertainties
from analysis.several_rates.ratio_model import RatioData, Reference, predicted, whitening_factor
from analysis.several_rates.ratio_records import SMALLEST_U, RatioBlock, RatioRecords

SAME_RATE = 0.01
SAME_AMPLITUDE = 0.05


@dataclass(frozen=True)
class UsedRecords:
    """The records of a fit.

    records : RatioRecords
        All n that there are.
    used : (n,)
        Which of them are fitted.
    rate_u : (n,)
        deg/s, standard uncertainty of each rate.
    reference : {"rate", "beat"}
    """

    records: RatioRecords
    used: Bools
    rate_u: Floats
    reference: Reference

    def blocks(self) -> Iterator[tuple[Indices, RatioBlock]]:
        """Some of them at a time, and which they are."""
        for some, block in self.records.blocks():
            rows = np.flatnonzero(self.used[some])
            if rows.size:
                yield some.start + rows, block[rows]

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
            third=block.third,
            third_weight=1 / block.third_u,
            reference=self.reference,
        )
        return data, covariance


@dataclass(frozen=True)
class Places:
    """Which point a record belongs to: by its rate, its sense and its amplitude.

    rates, amplitudes : least |W| and least amplitude of each group of them, rising
    keys : rate, sense and amplitude of each point as one number, rising
    """

    rates: Floats
    amplitudes: Floats
    keys: Indices

    @classmethod
    def of(cls, records: UsedRecords) -> Places:
        """The points that some records make."""
        rates = first_of_groups((np.abs(block.rate) for _, block in records.blocks()), SAME_RATE)
        amplitudes = first_of_groups((block.amplitude for _, block in records.blocks()), SAME_AMPLITUDE)
        found = cls(rates, amplitudes, np.empty(0, dtype=np.intp))
        each = [np.unique(found._key(block)) for _, block in records.blocks()]
        return cls(rates, amplitudes, np.unique(np.concatenate(each)))

    def __len__(self) -> int:
        return self.keys.size

    def __getitem__(self, data: RatioData | RatioBlock) -> Indices:
        """Point of each record."""
        return np.searchsorted(self.keys, self._key(data))

    def _key(self, data: RatioData | RatioBlock) -> Indices:
        rate_and_sense = 2 * groups_of(np.abs(data.rate), self.rates) + (data.rate > 0)
        return rate_and_sense * self.amplitudes.size + groups_of(data.amplitude, self.amplitudes)

    def sums(self, data: RatioData | RatioBlock, *columns: Floats) -> Floats:
        """Sums (columns, points) of columns of one number for each record."""
        place = self[data]
        return np.stack([np.bincount(place, column, len(self)) for column in columns])


@dataclass(frozen=True)
class Points:
    """Records gathered into points.

    records : UsedRecords
    places : Places
        Of the records among the points.
    points : RatioData
        One set of p means.
    rate_group : (p,)
        Which of the different |W| each point has.
    """

    records: UsedRecords
    places: Places
    points: RatioData
    rate_group: Indices

    def scatter(self, parameters: Floats) -> tuple[float, int]:
        """Chi-square of the records about the means of their points, and its degrees of freedom.

        What the model says of each record's own rate and amplitude is taken out first.
        """
        mean, mean_third = self._left_of_means(parameters)
        chi_square, thirds_known = 0.0, np.zeros(len(self.places))
        for _, data, _ in self.records.data():
            left, rest = _left(parameters, data)
            place = self.places[data]
            of_ratio, of_third = in_standard_uncertainties(left - mean[place], rest - mean_third[place], data)
            chi_square += float(np.sum(of_ratio**2) + np.sum(of_third**2))
            thirds_known += self.places.sums(data, np.sign(data.third_weight))[0]
        free = 2 * (int(self.records.used.sum()) - len(self.places))
        return chi_square, free + int(thirds_known.sum()) - int(np.count_nonzero(thirds_known))

    def _left_of_means(self, parameters: Floats) -> tuple[Complexes, Floats]:
        """Mean of what the model leaves of the records of each point: of ratios and of third harmonics, (p,)."""
        sums = np.zeros((5, len(self.places)))
        for _, data, _ in self.records.data():
            left, rest = _left(parameters, data)
            weights, precision = _weights(data), data.third_weight**2
            columns = weights, weights * left.real, weights * left.imag, precision, precision * rest
            sums += self.places.sums(data, *columns)
        total, real, imaginary, precision, third = sums
        return np.asarray((real + 1j * imaginary) / total), third / np.maximum(precision, 1e-300)


def gather(records: UsedRecords) -> Points:
    """Mean of the records of each rate, sense and amplitude, and its covariance."""
    places = Places.of(records)
    sums, spread = np.zeros((9, len(places))), np.zeros((4, len(places)))
    for _, data, _ in records.data():
        weights, precision = _weights(data), data.third_weight**2
        means = data.rate, data.beat_rate, data.angular, data.ratio.real, data.ratio.imag, data.amplitude
        weighted = (weights * values for values in means)
        sums += places.sums(data, weights, *weighted, precision, precision * data.third)
    total, precision, third = sums[[0, 7, 8]]
    rate, beat_rate, angular, real, imaginary, amplitude = sums[1:7] / total
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
        third=third / np.maximum(precision, 1e-300),
        third_weight=np.sqrt(precision),
        reference=records.reference,
    )
    return Points(records, places, points, rate_groups(rate))


def with_rate_noise(points: Points, share: float) -> Points:
    """The points with one more uncertainty of their rates, a share of each: common to all records of a point."""
    data = points.points
    whitening = data.whitening[0]
    covariance = np.linalg.inv(whitening @ whitening.swapaxes(-1, -2)) + _by_rate(data.ratio, share)
    return replace(points, points=replace(data, whitening=whitening_factor(covariance)[np.newaxis]))


def _by_rate(ratio: Complexes, relative: Floats | float) -> Floats:
    """Covariance (..., 2, 2) of ratios (...) by the relative u of their rates.

    d ln r = -(1 + r^2)/(1 - r^2) d ln W.
    """
    square = np.minimum(np.abs(ratio) ** 2, _LARGEST_SQUARE)
    # far from lock-in the factor is 1 to 8 % of that u, and saved runs give what they gave
    steeper = np.where(square > _NEAR, (1 + square) / (1 - square), 1.0)
    return _along(ratio * (steeper * relative))


def _along(step: Complexes) -> Floats:
    """Covariance (..., 2, 2) of complex numbers that are uncertain by so much, in one direction."""
    parts = np.stack([step.real, step.imag], axis=-1)
    return np.asarray(parts[..., :, np.newaxis] * parts[..., np.newaxis, :])


_NEAR, _LARGEST_SQUARE = 0.04, 0.99


def rate_groups(rate: Floats) -> Indices:
    """Which of the different |W| each rate belongs to, 0, 1, ...; |W| within 1 % count as one rate."""
    size = np.abs(rate)
    return groups_of(size, first_of_groups([size], SAME_RATE))


def first_of_groups(sizes: Iterable[Floats], share: float) -> Floats:
    """Least value of each group, rising, where neighbours within a share of each other belong to one group.

    Examples
    --------
    >>> first_of_groups([np.array([1.0, 2.0]), np.array([2.01, 1.009, 1.018])], 0.01)
    array([1., 2.])
    """
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
