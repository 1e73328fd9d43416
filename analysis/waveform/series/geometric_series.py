"""The lock-in waveform with all its harmonics tied into one geometric series.

    v = c0 + Re[ H e / (1 - q e) ],    e = exp(i w m),    harmonics c_k = H q^(k-1),    r = |q|

Six real parameters: c0, H, q and w. Every harmonic helps to find them, and those that fold back below half the
sampling rate are part of the model instead of an error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from analysis.arrays import Bools, Complexes, Floats, Indices, Phasors, Samples
from analysis.waveform.records import are_all, never_alone, records_at_once
from analysis.waveform.series.harmonic_sums import harmonic_powers, phasors, record_grid

Selection = Indices | Bools

LARGEST_RATIO = 0.995
"""|q| is kept below this: x = 0.99999, where a record of a few periods holds no more information."""

NEGLIGIBLE = {np.dtype(np.float32): 2e-5, np.dtype(np.float64): 1e-12}
"""Harmonics below this share of the fundamental are left out. The first cannot move an estimate from eight-bit
samples, which single precision is for."""

RATIO_CLASSES = (0.01, 0.03, 0.06, 0.1, 0.2, 0.45, 0.7, 0.86)
"""Records are fitted together up to these ratios, each of which says how many harmonics its class needs: a number
that must not depend on what else is in the batch, or the last digits would."""

MANY_HARMONICS = 40
"""Beyond this many, the closed form on the samples is cheaper than the sum of the harmonics."""


@dataclass(frozen=True)
class Series:
    """Parameters of records, phases counted from the middle of the record.

    offset (R,) real; first (R,) H; ratio (R,) q; omega (R,) rad per sample.
    """

    offset: Floats
    first: Complexes
    ratio: Complexes
    omega: Floats

    def moved(self, change: Floats, n_samples: int) -> Series:
        """The parameters after a change (R, 6) in the order c0, Re H, Im H, Re q, Im q, w (rad at the record's
        ends), kept inside their domain.
        """
        ratio = self.ratio + change[:, 3] + 1j * change[:, 4]
        size = np.abs(ratio)
        ratio = np.where(size > LARGEST_RATIO, ratio * (LARGEST_RATIO / np.maximum(size, 1e-300)), ratio)
        turned = np.clip(change[:, 5], -1.0, 1.0) * (2 / n_samples)
        return Series(
            self.offset + change[:, 0],
            self.first + change[:, 1] + 1j * change[:, 2],
            ratio,
            np.clip(self.omega + turned, 0.5 / n_samples, np.pi),
        )

    def where(self, chosen: Bools, other: Series) -> Series:
        """This series where chosen, the other elsewhere."""
        return Series(
            np.where(chosen, self.offset, other.offset),
            np.where(chosen, self.first, other.first),
            np.where(chosen, self.ratio, other.ratio),
            np.where(chosen, self.omega, other.omega),
        )

    def take(self, part: Selection) -> Series:
        """Some of the records."""
        return Series(self.offset[part], self.first[part], self.ratio[part], self.omega[part])

    def put(self, part: Selection, other: Series) -> None:
        """Write the other's records into the places `part` of this one."""
        self.offset[part], self.first[part] = other.offset, other.first
        self.ratio[part], self.omega[part] = other.ratio, other.omega


def orders_needed(ratio: float, negligible: float, fewest: int) -> int:
    """How many powers of a ratio are not negligible, at least `fewest`."""
    return max(fewest, math.ceil(math.log(negligible) / math.log(ratio)))


def ratio_classes(ratio: Complexes) -> Iterator[tuple[float, Indices]]:
    """Largest ratio of each class that occurs, and its records; that of the last is `LARGEST_RATIO`."""
    numbers = np.searchsorted(RATIO_CLASSES, np.abs(ratio))
    for number in np.flatnonzero(np.bincount(numbers)):
        yield (*RATIO_CLASSES, LARGEST_RATIO)[number], never_alone(np.flatnonzero(numbers == number))


def sampled_series(series: Series, n_samples: int, precision: DTypeLike = np.float64) -> Samples:
    """The model on the samples, (R, N)."""
    grid: Samples = np.empty((series.omega.size, n_samples), dtype=precision)
    for rows, model in sampled_blocks(series, n_samples, np.dtype(precision)):
        grid[rows] = model
    return grid


def sampled_blocks(
    series: Series, n_samples: int, precision: np.dtype[Any]
) -> Iterator[tuple[slice | Indices, Samples]]:
    """The model on the samples, a few records (r,) at a time, (r, N): they stay in the cache for the next pass."""
    at_once = records_at_once(n_samples, precision)
    for largest, part in ratio_classes(series.ratio):
        some = series.take(part)
        n_harmonics = orders_needed(largest, NEGLIGIBLE[precision], 3)
        closed = n_harmonics > MANY_HARMONICS
        sides = None if closed else _sides(some, n_samples, precision, n_harmonics)
        for start in range(0, part.size, at_once):
            here = slice(start, start + at_once)
            rows = here if are_all(part, series.omega.size) else part[here]
            if sides is None:
                yield rows, _in_closed_form(series.take(part[here]), n_samples, precision)
            else:
                product = np.matmul(sides[0][here], sides[1][here])
                yield rows, product.reshape(len(product), -1)[:, :n_samples]


def _in_closed_form(series: Series, n_samples: int, precision: np.dtype[Any]) -> Samples:
    outer, inner = record_grid(n_samples)
    carrier = carrier_of(
        phasors(series.omega, outer, precision), phasors(series.omega, inner, precision), n_samples
    )
    first, ratio = (p.astype(carrier.dtype)[:, np.newaxis] for p in (series.first, series.ratio))
    beat = (first * carrier / (1 - ratio * carrier)).real
    return np.asarray(beat + series.offset.astype(precision)[:, np.newaxis])


def _sides(series: Series, n_samples: int, precision: np.dtype[Any], n_harmonics: int) -> tuple[Samples, Samples]:
    """Two real matrices per record, (R, rows, 2K + 2) and (R, 2K + 2, length), whose product is the waveform.

    The real parts of K complex products of a coarse and a fine phasor, and the offset.
    """
    outer, inner = record_grid(n_samples)
    coarse, fine = phasors(series.omega, outer, precision), phasors(series.omega, inner, precision)
    first, ratio = (p.astype(coarse.dtype)[:, np.newaxis] for p in (series.first, series.ratio))
    left = np.empty((*coarse.shape, n_harmonics + 1), dtype=coarse.dtype)
    left[..., 0] = first * coarse
    turn = ratio * coarse
    for k in range(1, n_harmonics):
        np.multiply(left[..., k - 1], turn, out=left[..., k])
    left[..., -1] = series.offset[:, np.newaxis]
    powers = harmonic_powers(fine, n_harmonics, 1, axis=1)
    right = np.zeros((len(fine), 2 * n_harmonics + 2, inner.size), dtype=precision)
    right[:, :-2:2] = powers.real
    np.negative(powers.imag, out=right[:, 1:-2:2])
    right[:, -2] = 1.0
    return left.view(precision), right


def carrier_of(coarse: Phasors, fine: Phasors, n_samples: int) -> Phasors:
    """exp(i w m) on the samples from its two short factors; (R, rows), (R, length) -> (R, N)."""
    product = coarse[:, :, np.newaxis] * fine[:, np.newaxis, :]
    return np.asarray(product.reshape(len(coarse), -1)[:, :n_samples])
