"""Records of a simulated bench with known contaminants, for the tests of what is beyond one record."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from analysis import beat_signal, estimate_lock_in
from analysis.ring_laser import SteadyBeat, steady_beat, symmetric_laser

K = 2000.0
WL = 0.05


def both_senses(*multiples):
    return np.array([*multiples, *(-m for m in multiples)], dtype=float)


def volts(
    rate, n_records, rng, *, noise=0.01, hd2=0.0, phase=0.7, gain_corner_hz=None, n_samples=2500, periods=100.3
):
    """(n_records, n_samples) of one rate, amplitude 1, square law of second harmonic hd2; and the interval."""
    frequency = K * np.sqrt(rate**2 - WL**2)
    interval = periods / frequency / n_samples
    times = np.arange(n_samples) * interval
    starts = rng.uniform(0, 2 * np.pi, n_records)
    if gain_corner_hz is None:
        clean = beat_signal(
            times, scale_factor=K, input_rate=rate, lock_in_rate=WL, initial_phase=starts, backscatter_phase=phase
        )
    else:
        beat = steady_beat(symmetric_laser(WL, scale_factor=K, gain_corner_hz=gain_corner_hz), rate)
        clean = np.array([seen(beat, times, readout_phase=-phase, start_phase=s) for s in starts])
    return clean + 2 * hd2 * clean**2 + rng.normal(scale=noise, size=clean.shape), interval


def estimates(multiples, n_records, rng, **bench):
    """One LockInEstimate of n_records a rate."""
    made = []
    for multiple in multiples:
        records, interval = volts(multiple * WL, n_records, rng, **bench)
        made.append(estimate_lock_in(records, interval, scale_factor=K, input_rate=multiple * WL))
    return made


def seen(beat: SteadyBeat, times, *, readout_phase=0.0, start_phase=0.0, contrast=np.inf):
    """Detector signal sqrt(I1 I2) sin(psi + readout) + (I1 + I2)/(2 contrast), the latter without its mean."""
    orders = np.arange(beat.beat.size) - beat.beat.size // 2
    lines = beat.beat * np.exp(1j * readout_phase)
    mirrored = np.zeros_like(lines)
    mirrored[1:] = lines[:0:-1]  # c_-n in the place of c_n
    # The imaginary part of a two-sided series, and the real part of another: one real series for both.
    sides = (lines - np.conj(mirrored)) / 2j + beat.beams.sum(axis=0) / (2 * contrast)
    keep = (orders > 0) & (np.abs(sides) > 1e-9)
    turns = np.multiply.outer(2 * np.pi * beat.frequency * times + start_phase, orders[keep])
    waves = 2 * (np.cos(turns) @ sides[keep].real - np.sin(turns) @ sides[keep].imag)
    return lines[orders == 0].imag[0] + waves


def ratios_of_slow_gain(multiples, corner, phase_sum=0.0, readout=0.4, **of_laser):
    """Rates, beat frequencies and complex ratios that records show, by the lines of the integrated equations."""
    # a record is fitted by the nearest geometric series; for equal backscatter in phase alone these lines are one
    rates, ratios, beats = np.array(multiples) * WL, [], []
    laser = symmetric_laser(WL, scale_factor=K, gain_corner_hz=corner, phase_sum=phase_sum, **of_laser)
    for rate in rates:
        steady = steady_beat(laser, rate)
        middle = steady.beat.size // 2
        turned = steady.beat * np.exp(1j * readout)
        lines = (turned[middle + 1 :] - np.conj(turned[middle - 1 : 0 : -1])[: middle - 1]) / 2j

        def missed(parts, lines=lines):
            series = complex(*parts) ** np.arange(lines.size)
            along = np.vdot(series, lines) / np.vdot(series, series)
            return np.concatenate([(left := lines - along * series).real, left.imag]) / abs(lines[0])

        guess = lines[1] / lines[0]
        q = complex(*least_squares(missed, [guess.real, guess.imag], xtol=1e-15, ftol=1e-15, gtol=1e-15).x)
        series = q ** np.arange(lines.size)
        ratios.append(q * np.exp(-1j * np.angle(np.vdot(series, lines))))
        beats.append(steady.frequency)
    return rates, np.array(ratios), np.array(beats)
