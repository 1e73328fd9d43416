"""Records at one rate in one sense are one point: they tell the same of the unknowns, their scatter is noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.arrays import Floats, Indices
from analysis.several_rates.least_squares import whitened
from analysis.several_rates.ratio_model import RatioData, predicted, whitening_factor

SAME_RATE = 0.01
SAME_AMPLITUDE = 0.05


def rate_groups(rate: Floats) -> Indices:
    """Which of the different |W| each rate belongs to, 0, 1, ...; |W| within 1 % count as one rate."""
    return _groups(np.abs(rate), SAME_RATE)


@dataclass(frozen=True)
class Points:
    """Records gathered into points.

    records, points : RatioData
        One set of n records, and of p means.
    place : (n,)
        Point of each record.
    rate_group : (p,)
        Which of the different |W| each point has.
    """

    records: RatioData
    points: RatioData
    place: Indices
    rate_group: Indices

    def scatter(self, parameters: Floats) -> tuple[float, int]:
        """Chi-square of the records about the means of their points, and its degrees of freedom.

        What the model says of each record's own rate and amplitude is taken out first.
        """
        ratio, third = predicted(parameters, self.records)
        left = (self.records.ratio - ratio)[0]
        left = left - self._mean(left)[self.place]
        rest = (self.records.third - third)[0]
        known = self.records.third_weight > 0
        weights = self.records.third_weight**2
        totals = np.maximum(np.bincount(self.place, weights), 1e-300)
        rest = rest - (np.bincount(self.place, weights * rest) / totals)[self.place]
        moved = replace(self.records, ratio=left + ratio[0], third=rest + third[0])
        ratios, thirds = whitened(parameters, moved)
        several = int(known.sum()) - np.unique(self.place[known]).size
        return float(np.sum(ratios**2) + np.sum(thirds**2)), 2 * (left.size - self.rate_group.size) + several

    def _mean(self, values: Floats) -> Floats:
        weights = _weights(self.records)
        total = np.bincount(self.place, weights)
        real, imaginary = (np.bincount(self.place, weights * part) for part in (values.real, values.imag))
        return np.asarray((real + 1j * imaginary) / total)


def gather(records: RatioData, covariance: Floats) -> Points:
    """Mean of the records of each rate, sense and amplitude, and its covariance.

    Parameters
    ----------
    records : RatioData
        One set of n records; the whitening is made here.
    covariance : (n, 2, 2)
        Of the two parts of their ratios.
    """
    records = replace(records, whitening=whitening_factor(covariance)[np.newaxis])
    group = rate_groups(records.rate)
    key = np.stack([group, records.rate > 0, _groups(records.amplitude, SAME_AMPLITUDE)], axis=-1)
    _, place = np.unique(key, axis=0, return_inverse=True)
    place = place.ravel()
    weights = _weights(records)
    total = np.bincount(place, weights)

    def mean(values: Floats) -> Floats:
        return np.asarray(np.bincount(place, weights * values) / total)

    spread = np.zeros((total.size, 2, 2))
    np.add.at(spread, place, (weights / total[place])[:, np.newaxis, np.newaxis] ** 2 * covariance)
    precision = np.bincount(place, records.third_weight**2)
    third = np.bincount(place, records.third_weight**2 * records.third) / np.maximum(precision, 1e-300)
    points = RatioData(
        rate=mean(records.rate),
        beat_rate=mean(records.beat_rate),
        angular=mean(records.angular),
        ratio=mean(records.ratio.real) + 1j * mean(records.ratio.imag),
        whitening=whitening_factor(spread)[np.newaxis],
        amplitude=mean(records.amplitude),
        third=third,
        third_weight=np.sqrt(precision),
        reference=records.reference,
    )
    return Points(records, points, place, rate_groups(points.rate))


def _groups(sizes: Floats, share: float) -> Indices:
    """Number of each value, where neighbours within a share of each other have the same."""
    order = np.argsort(sizes)
    sorted_sizes = sizes[order]
    group = np.empty(sizes.size, dtype=np.intp)
    group[order] = np.concatenate([[0], np.cumsum(np.diff(sorted_sizes) > share * sorted_sizes[1:])])
    return group


def _weights(records: RatioData) -> Floats:
    """Of the records in the mean of their point: one number for both parts of the ratio."""
    return np.asarray(np.square(records.whitening[0]).sum(axis=(-1, -2)))
