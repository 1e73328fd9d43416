"""Records of a gyro behind an imperfect laser, detector and oscilloscope.

One period of the exact beat is taken apart into harmonics; each imperfection acts where it acts in the apparatus:
gain saturation on the harmonics of the beat, distortion on the detector's signal, the filters behind it, noise and
rounding in the end.
"""

from __future__ import annotations

import numpy as np

from analysis.arrays import Complexes, Floats
from analysis.budget import RecordShape
from analysis.channel import gain_on_ratio, high_pass, low_pass
from analysis.lockin_equation import beat_frequency, beat_signal
from benchmarks.monte_carlo.draws import Draws

_POINTS = 128
"""Points of one period: the harmonics are then exact to r^64."""

_NEGLIGIBLE = 1e-6
"""Harmonics below this share of the amplitude are left out: 70 dB below one level of the converter."""

_TOP_LEVEL = 127


def make_records(draws: Draws, shape: RecordShape, rng: np.random.Generator) -> Floats:
    """Volts (R, samples) of the records that were drawn, each with its own phase, offset and noise."""
    frequency = beat_frequency(draws.scale_factor, draws.input_rate, draws.lock_in_rate)
    lines = _harmonics(draws, shape.amplitude, frequency)
    index = np.arange(shape.samples)
    turn = 2 * np.pi * frequency * shape.sample_interval * draws.stretch
    start = rng.uniform(0, 2 * np.pi, frequency.size)
    u = np.exp(1j * (start[:, np.newaxis] + turn[:, np.newaxis] * index))
    # Horner from the highest harmonic down
    total = np.zeros_like(u)
    for line in lines[:, :0:-1].T:
        total += line[:, np.newaxis]
        total *= u
    volts = total.real + lines[:, :1].real
    volts += shape.noise_rms * rng.standard_normal(volts.shape)
    if shape.level_spacing > 0:
        levels = volts / shape.level_spacing + rng.uniform(-0.5, 0.5, (frequency.size, 1))
        volts = shape.level_spacing * np.clip(np.rint(levels), -_TOP_LEVEL, _TOP_LEVEL)
    return np.asarray(volts)


def _harmonics(draws: Draws, amplitude: float, frequency: Floats) -> Complexes:
    """Complex amplitudes (R, H) of mean, fundamental, second harmonic... behind everything but the noise."""
    times = np.arange(_POINTS) / (_POINTS * frequency[:, np.newaxis])
    beat = beat_signal(
        times,
        scale_factor=draws.scale_factor,
        input_rate=draws.input_rate,
        lock_in_rate=draws.lock_in_rate,
        amplitude=amplitude,
        readout_phase=draws.phase,
    )
    order = np.arange(_POINTS // 2 + 1)
    f = frequency[:, np.newaxis] * np.maximum(order, 1)
    lines = np.fft.rfft(beat) / _POINTS
    # the laser: each further harmonic of the beat is one more step through the saturating gain
    weaker = (1 - draws.share_lost[:, np.newaxis]) * gain_on_ratio(frequency, draws.gain)[:, np.newaxis]
    lines = lines * np.where(order > 1, weaker ** np.maximum(order - 1, 0), 1.0)
    volts = np.fft.irfft(lines * _POINTS, _POINTS)
    bent = volts + 2 * draws.distortion[:, np.newaxis] / amplitude * volts**2
    passed = low_pass(f, draws.low_pass[:, np.newaxis]) * high_pass(f, draws.high_pass[:, np.newaxis])
    lines = np.fft.rfft(bent) / _POINTS * np.where(order > 0, passed, 1.0)
    lines[:, 1:] *= 2
    strong = np.flatnonzero(np.abs(lines).max(axis=0) > _NEGLIGIBLE * amplitude)
    return np.asarray(lines[:, : max(int(strong[-1]), 2) + 1])
