"""Sine and cosine photodiodes of one acquisition: records corrected with each other, and what that shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis import LockInEstimate
from analysis.channel import ChannelResponse
from analysis.quadratures import QuadratureEstimate, QuadratureFlag, estimate_quadratures
from instrument import Waveform
from station.lock_in.estimates import Method, batches, clipped_samples, joined, only_beats
from station.lock_in.front_end import equalised, noise_model_without_channel

Array = NDArray[np.float64]

_SENTENCES = {
    QuadratureFlag.NOT_IN_QUADRATURE: "The two channels are nearly in phase: they hold one signal twice.",
    QuadratureFlag.POOR_QUADRATURE: "The channels are far from a right angle: corrected, but less certain.",
    QuadratureFlag.FREQUENCIES_DIFFER: "The two channels show two different beats.",
    QuadratureFlag.SENSE_DISAGREES: "The channels see another sense of rotation than the table has: are they "
    "exchanged, or is one inverted?",
    QuadratureFlag.LARGE_DISTORTION: "The second harmonic of a receiver is above -34 dBc: a rest of it is left.",
    QuadratureFlag.IMAGE_LEFT: "The third harmonic has an image that neither imbalance nor distortion of second "
    "order makes: look for distortion of third order or stray light.",
}


@dataclass(frozen=True)
class QuadratureResult:
    """What two channels say of each other; means over the records that could be used.

    Attributes
    ----------
    records : int
        That the means rest on.
    sense : int
        +1, -1, or 0 where the records differ or it cannot be told.
    gain_ratio, gain_ratio_u : float
        Amplitude of the sine over that of the cosine.
    phase_error, phase_error_u : float
        rad, beyond a right angle.
    distortion, distortion_u : tuple of float
        Second harmonic that the receivers of sine and cosine make, over the fundamental.
    images : tuple of float
        Image of the first harmonic before the correction, of the second and third after it, over the first.
    sine_alone, cosine_alone : float
        Lock-in rate that each channel alone would give, deg/s: mean over the records.
    flags : tuple of str
    """

    records: int
    sense: int
    gain_ratio: float
    gain_ratio_u: float
    phase_error: float
    phase_error_u: float
    distortion: tuple[float, float]
    distortion_u: tuple[float, float]
    images: tuple[float, float, float]
    sine_alone: float
    cosine_alone: float
    flags: tuple[str, ...]

    @property
    def sentences(self) -> list[str]:
        """What was noticed, in words."""
        return [_SENTENCES[QuadratureFlag[name.upper()]] for name in self.flags]


def estimate_pairs(
    sines: Sequence[Waveform],
    cosines: Sequence[Waveform],
    method: Method,
    response: ChannelResponse | None = None,
) -> tuple[LockInEstimate, QuadratureEstimate]:
    """Estimate records of two channels, each pair corrected for distortion.

    Parameters
    ----------
    sines, cosines : sequence of Waveform
        Of the same acquisitions.
    method : Method
    response : ChannelResponse, optional
        Of both channels: taken out first.

    Returns
    -------
    LockInEstimate
        Fields of shape (n,).
    QuadratureEstimate
        Of the same shape.

    Raises
    ------
    RunError
        If a beat or its second harmonic lies outside a measured response.
    """
    parts, order = [], []
    for indices in batches(sines):
        pair = [np.array([waves[index].volts for index in indices]) for waves in (sines, cosines)]
        interval = sines[indices[0]].sample_interval
        if response is not None:
            pair = [equalised(volts, interval, response) for volts in pair]
        masks = [clipped_samples([waves[index] for index in indices]) for waves in (sines, cosines)]
        parts.append(
            estimate_quadratures(
                pair[0],
                pair[1],
                interval,
                scale_factor=method.scale_factor,
                input_rate=method.input_rate,
                relation=method.relation,
                clipped=(masks[0], masks[1]),
                nan_policy="omit",
            )
        )
        order += indices
    whole = _joined(parts, np.argsort(order))
    each = only_beats(whole.estimate)
    if response is not None:
        each = replace(each, noise_model=noise_model_without_channel(each))
    return each, whole


def quadrature_result(pairs: QuadratureEstimate) -> QuadratureResult | None:
    """Summarise what two channels say of each other; ``None`` if no record can be used.

    Parameters
    ----------
    pairs : QuadratureEstimate
        Of shape (n,).
    """
    used = pairs.estimate.usable & np.isfinite(pairs.gain_ratio)
    if not used.any():
        return None
    count = int(used.sum())
    senses = set(pairs.sense[used].tolist())
    # what one record of many shows may be chance
    seen = [flag for flag in QuadratureFlag if np.mean((pairs.flags[used] & flag) != 0) > 0.05]
    images = pairs.images[used].mean(axis=0)
    distortion = pairs.distortion[used].mean(axis=0)
    distortion_u = np.sqrt(np.mean(pairs.distortion_u[used] ** 2, axis=0) / count)
    return QuadratureResult(
        records=count,
        sense=senses.pop() if len(senses) == 1 else 0,
        gain_ratio=float(pairs.gain_ratio[used].mean()),
        gain_ratio_u=_mean_u(pairs.gain_ratio_u[used]),
        phase_error=float(pairs.phase_error[used].mean()),
        phase_error_u=_mean_u(pairs.phase_error_u[used]),
        distortion=(float(distortion[0]), float(distortion[1])),
        distortion_u=(float(distortion_u[0]), float(distortion_u[1])),
        images=(float(images[0]), float(images[1]), float(images[2])),
        sine_alone=float(np.nanmean(pairs.sine.lock_in_rate[used])),
        cosine_alone=float(np.nanmean(pairs.cosine.lock_in_rate[used])),
        flags=tuple(str(flag.name).lower() for flag in seen),
    )


def _mean_u(us: Array) -> float:
    return float(np.sqrt(np.sum(us**2)) / us.size)


def _joined(parts: list[QuadratureEstimate], order: NDArray[np.intp]) -> QuadratureEstimate:
    values: dict[str, Any] = {}
    for field in fields(QuadratureEstimate):
        each = [getattr(part, field.name) for part in parts]
        if isinstance(each[0], LockInEstimate):
            values[field.name] = joined(each, order)
        else:
            values[field.name] = np.concatenate(each)[order]
    return QuadratureEstimate(**values)
