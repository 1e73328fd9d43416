"""Random gyros and their records: the truth against which every method is measured.

Written from the closed form exp(i(phi + beta)) = i (r - u)/(1 - r u), u = exp(i(w t + theta)), and not from
`analysis`, so that a mistake there cannot hide here. One sample is the unit of time and the scale factor is one
pulse per degree: frequencies are in cycles per sample, rates in the same number.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from analysis.arrays import Bools, Complexes, Floats, Indices

N_SAMPLES = 2500
CLIP = 127
ROUNDING_RMS = 1 / np.sqrt(12)

RATE_OVER_LOCK_IN = (1.02, 100.0)
PERIODS = (2.5, 595.0)
NOISE = (0.3, 4.0)
AMPLITUDE = (20.0, 120.0)

_RUN = 50
"""Samples per run; 2500 is 50 runs of 50, which makes exp(i w n) an outer product."""


@dataclass(frozen=True)
class Gyros:
    """Truths of (R,) records: frequency in cycles per sample, ratio r, phases in rad, the rest in levels."""

    frequency: Floats
    ratio: Floats
    theta: Floats
    delta: Floats
    sense: Floats
    amplitude: Floats
    offset: Floats
    noise: Floats

    def __len__(self) -> int:
        return len(self.frequency)

    def take(self, part: slice | Bools | Indices) -> Gyros:
        """Some of the gyros."""
        return Gyros(**{f.name: getattr(self, f.name)[part] for f in fields(self)})

    @property
    def lock_in_rate(self) -> Floats:
        """WL = (f/K) 2r/(1 - r^2)."""
        return self.frequency * 2 * self.ratio / (1 - self.ratio**2)

    @property
    def input_rate(self) -> Floats:
        """W, signed."""
        return self.sense * self.frequency * (1 + self.ratio**2) / (1 - self.ratio**2)

    @property
    def rate_over_lock_in(self) -> Floats:
        """|W|/WL."""
        return np.asarray((1 + self.ratio**2) / np.maximum(2 * self.ratio, 1e-300))

    @property
    def periods(self) -> Floats:
        """Beat periods in the record."""
        return self.frequency * N_SAMPLES

    @property
    def total_noise(self) -> Floats:
        """Standard deviation of noise and rounding together, levels."""
        return np.asarray(np.hypot(self.noise, ROUNDING_RMS))


def draw_gyros(
    rng: np.random.Generator,
    n_records: int,
    *,
    rate_over_lock_in: tuple[float, float] = RATE_OVER_LOCK_IN,
    periods: tuple[float, float] = PERIODS,
    noise: tuple[float, float] = NOISE,
    amplitude: tuple[float, float] = AMPLITUDE,
) -> Gyros:
    """Gyros spread evenly over the logarithms of the ranges, any phases, either sense.

    The amplitude is lowered where amplitude, offset and five standard deviations of noise would clip.
    """

    def spread(limits: tuple[float, float]) -> Floats:
        return np.asarray(np.exp(rng.uniform(np.log(limits[0]), np.log(limits[1]), n_records)))

    x = 1 / spread(rate_over_lock_in)
    levels = spread(noise) if noise[0] > 0 else rng.uniform(noise[0], noise[1], n_records)
    offset = rng.uniform(-2, 2, n_records)
    room = CLIP - 1 - np.abs(offset) - 5 * levels
    return Gyros(
        frequency=spread(periods) / N_SAMPLES,
        ratio=x / (1 + np.sqrt(1 - x * x)),
        theta=rng.uniform(-np.pi, np.pi, n_records),
        delta=rng.uniform(-np.pi, np.pi, n_records),
        sense=rng.choice([-1.0, 1.0], n_records),
        amplitude=np.minimum(spread(amplitude), room),
        offset=offset,
        noise=levels,
    )


def with_ratio(gyros: Gyros, ratio: Floats) -> Gyros:
    """The same gyros with other harmonic ratios."""
    return replace(gyros, ratio=ratio)


def phasor(frequency: Floats, theta: Floats) -> Complexes:
    """u = exp(i(2 pi f n + theta)), (R, N)."""
    run = np.exp(2j * np.pi * frequency[:, np.newaxis] * np.arange(_RUN))
    starts = np.exp(
        1j * (2 * np.pi * frequency[:, np.newaxis] * np.arange(0, N_SAMPLES, _RUN) + theta[:, np.newaxis])
    )
    return np.asarray((starts[:, :, np.newaxis] * run[:, np.newaxis, :]).reshape(len(frequency), N_SAMPLES))


def unit_beat(ratio: Floats, u: Complexes) -> Complexes:
    """z = exp(i(phi + beta)) for the positive sense, (R, N)."""
    r = ratio[:, np.newaxis]
    return np.asarray(1j * (r - u) / (1 - r * u))


def waveform(gyros: Gyros) -> Floats:
    """The noiseless signal in levels, (R, N)."""
    z = unit_beat(gyros.ratio, phasor(gyros.frequency, gyros.theta))
    sine, cosine = np.sin(gyros.delta), gyros.sense * np.cos(gyros.delta)
    shape = sine[:, np.newaxis] * z.real + cosine[:, np.newaxis] * z.imag
    return np.asarray(gyros.offset[:, np.newaxis] + gyros.amplitude[:, np.newaxis] * shape)


def codes_of(gyros: Gyros, noise: Floats) -> Floats:
    """What an eight-bit scope makes of signal and noise: (R, N) whole numbers as float64."""
    return np.asarray(np.clip(np.rint(waveform(gyros) + noise), -CLIP, CLIP))


def white_noise(rng: np.random.Generator, gyros: Gyros) -> Floats:
    """Gaussian noise of each gyro's strength, (R, N)."""
    return rng.normal(size=(len(gyros), N_SAMPLES)) * gyros.noise[:, np.newaxis]
