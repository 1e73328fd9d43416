"""Complex ratios of many records, gathered for a fit over several rates: which can be used, which are locked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.arrays import Bools, Complexes, Floats
from analysis.budget.unstated import SECOND_ORDER_LIMIT
from analysis.flags import Flag
from analysis.lockin_rate import LockInEstimate

SMALLEST_U = 1e-7
"""Least uncertainty of a ratio, far below any converter's: noise-free records must not weigh without limit."""

FASTER_THAN_POSSIBLE = 2e-3
"""f may exceed K|W| by this share (conservative coupling, K, rate): more means a rate that is too low."""


@dataclass(frozen=True)
class RatioRecords:
    """n records; nan where a record has no beat.

    rate : deg/s, signed
    beat_frequency, beat_frequency_u : Hz
    ratio, covariance : rho (n,) and that of its two parts (n, 2, 2)
    amplitude : over the mean of the usable records
    third, third_u : third harmonic beyond the waveform in phase with distortion, over the amplitude; inf: unknown
    usable, locked : records with a ratio; records that show no beat
    misfit : records whose waveform is not the lock-in one within its noise
    rate_of_beat : whether the rates are those that the records themselves gave, and test no beat
    """

    rate: Floats
    beat_frequency: Floats
    beat_frequency_u: Floats
    ratio: Complexes
    covariance: Floats
    amplitude: Floats
    third: Floats
    third_u: Floats
    usable: Bools
    locked: Bools
    misfit: Bools
    scale_factor: float
    noise_model: str
    rate_of_beat: bool


def records_of_estimates(
    estimates: LockInEstimate | Sequence[LockInEstimate], input_rate: ArrayLike | None
) -> RatioRecords:
    """Records of one or several estimates.

    Raises
    ------
    ValueError
        No records; estimates without a given rate and none given here; different scale factors.
    """
    several = [estimates] if isinstance(estimates, LockInEstimate) else list(estimates)
    flat = [e.reshaped(-1) for e in several]
    if sum(e.flags.size for e in flat) == 0:
        raise ValueError("no record to fit")
    if len({e.scale_factor for e in flat}) > 1:
        raise ValueError("the records have different scale factors: fit one gyro at a time")
    if input_rate is None and not all(e.rate_given for e in flat):
        raise ValueError(
            "the sense of rotation must be known: estimate the records with their signed input_rate, or give "
            "it here"
        )
    own = np.concatenate([e.input_rate for e in flat])
    rate = own if input_rate is None else np.broadcast_to(np.asarray(input_rate, dtype=float).ravel(), own.shape)
    flags = np.concatenate([e.flags for e in flat])
    # A gyro inside lock-in gives a constant or nothing but noise; other faults say nothing about its rate.
    no_beat = (flags & int(Flag.NO_BEAT | Flag.CONSTANT)) != 0
    measured = [_as_measured(e) for e in flat]
    return records_of_arrays(
        rate,
        np.concatenate([ratio for ratio, _ in measured]),
        np.concatenate([covariance for _, covariance in measured]),
        np.where(no_beat, 0.0, np.concatenate([e.beat_frequency for e in flat])),
        scale_factor=flat[0].scale_factor,
        beat_frequency_u=np.concatenate([e.beat_frequency_u for e in flat]),
        amplitude=np.concatenate([e.amplitude for e in flat]),
        third_harmonic=np.concatenate([e.third_harmonic.real for e in flat]),
        third_harmonic_u=np.concatenate([e.third_harmonic_u for e in flat]),
        misfit=(flags & int(Flag.MISFIT)) != 0,
        noise_model="; ".join(dict.fromkeys(e.noise_model for e in flat)),
        rate_of_beat=not any(e.rate_given for e in flat)
        and np.allclose(np.abs(rate), own, rtol=_THE_SAME, equal_nan=True),
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
    misfit: ArrayLike = False,
    noise_model: str = "the covariances given",
    rate_of_beat: bool = False,
) -> RatioRecords:
    """Records of plain arrays of n values; a beat frequency of 0 marks a record without a beat.

    Raises
    ------
    ValueError
        Rates that are zero or not finite, shapes that do not fit, a scale factor that is not positive.
    """
    w = np.asarray(rate, dtype=np.float64).ravel()
    if not np.all(np.isfinite(w)) or np.any(w == 0):
        raise ValueError("every input rate must be finite and not zero (deg/s, signed): its sense is needed")
    if not np.isfinite(scale_factor) or scale_factor <= 0:
        raise ValueError(f"scale_factor must be positive (pulses per degree), not {scale_factor!r}")
    rho = _column("ratio", ratio, w.size).astype(np.complex128)
    f = _column("beat_frequency", beat_frequency, w.size).astype(np.float64)
    fu = _column("beat_frequency_u", beat_frequency_u, w.size).astype(np.float64)
    size = _column("amplitude", amplitude, w.size).astype(np.float64)
    third = _column("third_harmonic", third_harmonic, w.size).astype(np.float64)
    third_u = _column("third_harmonic_u", third_harmonic_u, w.size).astype(np.float64)
    if not (np.all(third_u > 0) and np.all(np.isfinite(third))):
        raise ValueError("third_harmonic must be finite and third_harmonic_u positive; inf where it is not known")
    spread = np.asarray(covariance, dtype=np.float64)
    if spread.shape not in ((w.size, 2, 2), (2, 2)):
        raise ValueError(f"covariance must have shape ({w.size}, 2, 2), not {spread.shape}")
    spread = np.broadcast_to(spread, (w.size, 2, 2))
    locked = f == 0
    usable = ~locked & (f > 0) & np.isfinite(rho) & np.isfinite(fu) & np.isfinite(size) & (size > 0)
    usable &= np.isfinite(spread).all(axis=(-1, -2))
    mean = size[usable].mean() if usable.any() else 1.0
    return RatioRecords(
        rate=w,
        beat_frequency=f,
        beat_frequency_u=fu,
        ratio=rho,
        covariance=spread,
        amplitude=size / mean,
        third=third,
        third_u=third_u,
        usable=usable,
        locked=locked,
        misfit=_column("misfit", misfit, w.size).astype(bool),
        scale_factor=float(scale_factor),
        noise_model=noise_model,
        rate_of_beat=rate_of_beat,
    )


_THE_SAME = 1e-9


def common_mismatch(records: RatioRecords) -> float:
    """What all beats have in common against their rates: f/(K W), freed of lock-in by each record's own ratio.

    At least 1 where that is near 1, within `FASTER_THAN_POSSIBLE` and what distortion may do to those ratios; nan
    without a usable record. Anything else is a wrong scale factor, or an error that all rates share. The fast
    records say it, whose own ratio matters least.
    """
    if not records.usable.any():
        return float("nan")
    size = np.abs(records.ratio[records.usable])
    fast = size <= 2 * size.min()
    square = np.minimum(size[fast] ** 2, 0.99)
    own = records.beat_frequency[records.usable][fast] / records.scale_factor * (1 + square) / (1 - square)
    found = float(np.median(own / np.abs(records.rate[records.usable][fast])))
    # W = (f/K)(1 + r^2)/(1 - r^2), and r may be off by the distortion
    by_distortion = 4 * SECOND_ORDER_LIMIT * float(np.median(size[fast]))
    return max(found, 1.0) if abs(found - 1) < FASTER_THAN_POSSIBLE + by_distortion else found


def inconsistent_rate(records: RatioRecords, mismatch: float = 1.0) -> Bools:
    """Records whose beat is faster than their rate allows, f > K |W|, beyond the mismatch that all have."""
    fastest = records.scale_factor * mismatch * np.abs(records.rate) * (1 + FASTER_THAN_POSSIBLE)
    return np.asarray(records.usable & (records.beat_frequency > fastest + 4 * records.beat_frequency_u))


def _column(name: str, values: ArrayLike, n: int) -> NDArray[np.generic]:
    array = np.asarray(values)
    if array.ndim > 0 and array.size not in (1, n):
        raise ValueError(f"{name} must hold {n} values, one for every rate, not {array.size}")
    return np.broadcast_to(array.ravel(), (n,))


def _as_measured(estimate: LockInEstimate) -> tuple[Complexes, Floats]:
    """rho and its covariance as the record has them; a mean of records in the negative sense is turned back.

    Such a mean holds the value of the positive sense. Which of the two it is shows in the backscatter phase, which
    is the same in both senses: the angle of -rho in the positive one, the negative angle of rho in the other.
    """
    rho, phase = estimate.complex_ratio, np.exp(1j * estimate.backscatter_phase)
    size = np.maximum(np.abs(rho), 1e-300)
    with np.errstate(invalid="ignore"):  # records without a beat are nan
        as_it_is = np.abs(phase - np.conj(rho) / size)
        mirrored = np.abs(phase + rho / size)
    turned = estimate.rate_given & (estimate.input_rate < 0) & (mirrored < as_it_is)
    off_diagonal = np.where(turned, -1.0, 1.0)[:, np.newaxis, np.newaxis]
    covariance = estimate.complex_ratio_covariance * np.where(np.eye(2, dtype=bool), 1.0, off_diagonal)
    return np.where(turned, -np.conj(rho), rho), covariance
