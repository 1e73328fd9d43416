"""The lock-in waveform with all its harmonics tied into one geometric series.

    v = c0 + Re[ H e / (1 - q e) ],    e = exp(i w m),    harmonics c_k = H q^(k-1),    r = |q|

Six real parameters: c0, H, q and w. Every harmonic helps to find them, and those that fold back below half the
sampling rate are part of the model instead of an error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Selection = NDArray[np.intp] | NDArray[np.bool_]

LARGEST_RATIO = 0.995
"""|q| is kept below this: x = 0.99999, where a record of a few periods holds no more information."""

NEGLIGIBLE = 5e-6
"""Harmonics below this share of the fundamental cannot move an estimate from eight-bit samples."""


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
        ends), kept inside their domain."""
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

    def where(self, chosen: NDArray[np.bool_], other: Series) -> Series:
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


def harmonics_needed(ratio: Complexes) -> int:
    """How many harmonics of the largest ratio are not negligible, at least 3."""
    largest = min(float(np.abs(ratio).max(initial=0.0)), LARGEST_RATIO)
    return max(3, math.ceil(math.log(NEGLIGIBLE) / math.log(max(largest, 1e-3))))


def carrier_grid(omega: Floats, n_samples: int) -> tuple[Complexes, Complexes]:
    """exp(i w m) of a record as an outer product of two short vectors, (R, rows) and (R, length).

    rows times length is at least n_samples: the surplus lies behind the record's end.
    """
    length = math.isqrt(n_samples - 1) + 1
    rows = -(-n_samples // length)
    middle = (n_samples - 1) / 2
    coarse = np.exp(1j * omega[:, np.newaxis] * (np.arange(rows) * length - middle))
    fine = np.exp(1j * omega[:, np.newaxis] * np.arange(length))
    return coarse, fine


def sampled_series(series: Series, n_samples: int) -> Floats:
    """The model on the samples, (R, N): from its harmonics where they are few, else in closed form."""
    coarse, fine = carrier_grid(series.omega, n_samples)
    n_harmonics = harmonics_needed(series.ratio)
    if n_harmonics > 24:
        carrier = (coarse[:, :, np.newaxis] * fine[:, np.newaxis, :]).reshape(len(coarse), -1)[:, :n_samples]
        wave = carrier / (1 - series.ratio[:, np.newaxis] * carrier)
        return np.asarray(series.offset[:, np.newaxis] + (series.first[:, np.newaxis] * wave).real)
    left = np.empty((*coarse.shape, n_harmonics + 1), dtype=np.complex128)
    right = np.empty((*fine.shape, n_harmonics + 1), dtype=np.complex128)
    left[..., 0], right[..., 0] = series.offset[:, np.newaxis], 1.0
    left[..., 1], right[..., 1] = coarse * series.first[:, np.newaxis], np.conj(fine)
    step = coarse * series.ratio[:, np.newaxis]
    for k in range(2, n_harmonics + 1):
        np.multiply(left[..., k - 1], step, out=left[..., k])
        np.multiply(right[..., k - 1], right[..., 1], out=right[..., k])
    # The real part of a product is the real product of interleaved parts, one of them conjugate.
    grid = np.matmul(left.view(np.float64), right.view(np.float64).swapaxes(-1, -2))
    return np.asarray(grid.reshape(len(coarse), -1)[:, :n_samples])
