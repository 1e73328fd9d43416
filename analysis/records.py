"""Records as the fits want them: checked, two-dimensional, centred, of unit scale, missing samples weighted 0."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

MINIMUM_SAMPLES = 8
"""The lock-in waveform has six parameters; two more samples are the least that leaves any noise estimate."""

SAMPLES_AT_ONCE = 160_000
"""Samples worked on together: about what stays in a core's cache, and what bounds the memory."""


@dataclass(frozen=True)
class Records:
    """A stack of records, flattened to (R, N).

    values : (R, N) (volts - centre) / scale, 0 where missing
    weights : (R, N) 1 or 0, or None where nothing is missing
    centre, scale, count : (R,) volts, volts, valid samples
    constant : (R,) all valid samples equal, or too few of them
    shape : leading shape of the caller's array
    """

    values: Floats
    weights: Floats | None
    centre: Floats
    scale: Floats
    count: Floats
    constant: Bools
    shape: tuple[int, ...]

    @property
    def n_samples(self) -> int:
        """Samples per record, missing ones included."""
        return int(self.values.shape[1])

    def parts(self, wanted: Bools) -> Iterator[NDArray[np.intp]]:
        """Indices of the wanted records, in parts that fit into the cache."""
        indices = np.flatnonzero(wanted)
        at_once = max(1, SAMPLES_AT_ONCE // self.n_samples)
        for start in range(0, indices.size, at_once):
            yield indices[start : start + at_once]

    def take(self, part: NDArray[np.intp]) -> tuple[Floats, Floats | None]:
        """Values and weights of some records; weights None if nothing is missing in any of them."""
        weights = None if self.weights is None else self.weights[part]
        if weights is not None and bool(weights.all()):
            weights = None
        return self.values[part], weights


def as_records(volts: ArrayLike, sample_interval: float, left_out: ArrayLike | None = None) -> Records:
    """Check and normalise a stack of records.

    Parameters
    ----------
    volts : (..., n_samples)
        nan marks a missing sample.
    sample_interval : float
        Seconds.
    left_out : (..., n_samples) of bool, optional
        Samples to leave out, such as clipped ones.

    Raises
    ------
    ValueError
        Says what is wrong: shape, number of samples, infinite values, sample interval.
    """
    array = np.asarray(volts)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"volts must be real numbers, not {array.dtype}")
    if array.ndim == 0 or array.shape[-1] < MINIMUM_SAMPLES:
        found = array.shape[-1] if array.ndim else 1
        raise ValueError(f"a record needs at least {MINIMUM_SAMPLES} samples, this one has {found}")
    if np.ndim(sample_interval) != 0 or not np.isfinite(sample_interval) or sample_interval <= 0:
        raise ValueError(f"sample_interval must be one positive number of seconds, not {sample_interval!r}")
    shape = array.shape[:-1]
    values = array.astype(np.float64).reshape(-1, array.shape[-1])
    missing = np.isnan(values)
    if np.isinf(values).any():
        raise ValueError("volts holds infinite values")
    if left_out is not None:
        missing |= np.broadcast_to(np.asarray(left_out, dtype=bool), array.shape).reshape(values.shape)

    any_missing = bool(missing.any())
    count = np.full(len(values), float(values.shape[1]))
    if any_missing:
        count = (~missing).sum(axis=-1).astype(np.float64)
        values[missing] = 0.0
    enough = count >= MINIMUM_SAMPLES
    centre = values.sum(axis=-1) / np.maximum(count, 1)
    values -= centre[:, np.newaxis]
    if any_missing:
        values[missing] = 0.0
    scale = np.sqrt(np.einsum("rn,rn->r", values, values) / np.maximum(count, 1))
    # Rounding of the mean leaves about 1e-16 of the level in a record that is really constant.
    constant = ~enough | (scale <= 1e-12 * np.abs(centre)) | (scale == 0)
    scale = np.where(constant, 1.0, scale)
    values /= scale[:, np.newaxis]
    weights = (~missing).astype(np.float64) if any_missing else None
    return Records(values, weights, centre, scale, count, constant, shape)
