"""Sine and cosine photodiodes of one acquisition: records corrected with each other, and what that shows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.arrays import Floats
from analysis.channel import ChannelResponse
from analysis.errors import OutsideResponse
from analysis.harmonics import fit_harmonics
from analysis.lock_in_run.estimates import Method, joined, without_channel_model
from analysis.lock_in_run.records import RecordArrays
from analysis.quadratures import QuadratureEstimate, QuadratureFlag, estimate_quadratures

_HARMONICS = 5
_BY_CHANCE = 0.05
"""What so few of many records show may be chance."""


@dataclass(frozen=True)
class QuadratureResult:
    """What two channels say of each other; means over the records that could be used."""

    records: int  # that the means rest on
    sense: int  # +1, -1, or 0 where the records differ or it cannot be told
    gain_ratio: float  # amplitude of the sine over that of the cosine
    gain_ratio_u: float
    phase_error: float  # rad, beyond a right angle
    phase_error_u: float
    # second harmonic that the receivers of sine and cosine make, over the fundamental
    distortion: tuple[float, float]
    distortion_u: tuple[float, float]
    # image of the first harmonic before the correction, of the second and third after it, over the first
    images: tuple[float, float, float]
    sine_alone: float  # lock-in rate that each channel alone would give, deg/s: mean over the records
    cosine_alone: float
    flags: tuple[str, ...]  # names of `QuadratureFlag`, lower case


def estimate_pairs(
    records: RecordArrays, method: Method, response: ChannelResponse | None = None
) -> QuadratureEstimate:
    """Estimate records of two channels, each pair corrected for distortion."""
    parts, rows = [], []
    for batch in records.batches:
        sine, cosine = batch.volts
        if response is not None:
            sine, cosine = (equalised(volts, batch.sample_interval, response) for volts in batch.volts)
        pairs = estimate_quadratures(
            sine,
            cosine,
            batch.sample_interval,
            scale_factor=method.scale_factor,
            input_rate=method.input_rate,
            relation=method.relation,
            clipped=(batch.clipped[0], batch.clipped[1]),
            nan_policy="omit",
        )
        parts.append(pairs)
        rows.append(batch.rows)
    whole = joined(parts, rows)
    if response is None:
        return whole
    return replace(whole, estimate=replace(whole.estimate, noise_model=without_channel_model(whole.estimate)))


def equalised(volts: Floats, sample_interval: float, response: ChannelResponse) -> Floats:
    """Give the harmonics of records the size and phase that they had before the channel; noise stays as it is.

    For two channels that are corrected with each other: distortion arises before the filters, and is a real share
    of the beat only there.

    Shapes: volts (n_records, n_samples).
    """
    fit = fit_harmonics(volts, sample_interval, harmonics=_HARMONICS, nan_policy="omit")
    beating = np.isfinite(fit.frequency)
    frequency = np.where(beating, fit.frequency, 1.0)
    times, restored = np.arange(volts.shape[-1]) * sample_interval, volts.copy()
    for order in range(1, _HARMONICS + 1):
        inside = beating & response.reach(order * frequency)
        if order <= 2 and not np.all(inside | ~beating):
            raise OutsideResponse(f"{order * frequency[beating & ~inside][0]:.6g} Hz lies outside the table")
        gain = np.ones(frequency.shape, dtype=np.complex128)
        gain[inside] = response.at(order * frequency[inside])
        change = np.where(inside, fit.amplitudes[..., order - 1] * (1 / gain - 1), 0.0)
        turns = 2 * np.pi * order * frequency[:, np.newaxis] * times
        restored += (change[:, np.newaxis] * np.exp(1j * turns)).real
    return restored


def mean_of_pairs(pairs: QuadratureEstimate) -> QuadratureResult | None:
    """Summarise what two channels say of each other in records (n,); ``None`` if no record can be used."""
    used = pairs.estimate.usable & np.isfinite(pairs.gain_ratio)
    if not used.any():
        return None
    count = int(used.sum())
    senses = set(pairs.sense[used].tolist())
    seen = [flag for flag in QuadratureFlag if np.mean((pairs.flags[used] & flag) != 0) > _BY_CHANCE]
    first, second, third = pairs.images[used].mean(axis=0).tolist()
    by_sine, by_cosine = pairs.distortion[used].mean(axis=0).tolist()
    by_sine_u, by_cosine_u = np.sqrt(np.mean(pairs.distortion_u[used] ** 2, axis=0) / count).tolist()
    return QuadratureResult(
        records=count,
        sense=senses.pop() if len(senses) == 1 else 0,
        gain_ratio=float(pairs.gain_ratio[used].mean()),
        gain_ratio_u=_mean_u(pairs.gain_ratio_u[used]),
        phase_error=float(pairs.phase_error[used].mean()),
        phase_error_u=_mean_u(pairs.phase_error_u[used]),
        distortion=(by_sine, by_cosine),
        distortion_u=(by_sine_u, by_cosine_u),
        images=(first, second, third),
        sine_alone=float(np.nanmean(pairs.sine.lock_in_rate[used])),
        cosine_alone=float(np.nanmean(pairs.cosine.lock_in_rate[used])),
        flags=tuple(str(flag.name).lower() for flag in seen),
    )


def _mean_u(us: Floats) -> float:
    return float(np.sqrt(np.sum(us**2)) / us.size)
