"""A random gyro on a scope, and its beat at any rate W(t): the truth of the hostile records.

Written from the equation itself, and not from `analysis`, so that a mistake there cannot hide here. With
psi = phi + beta, a = 2 pi K W and b = 2 pi K WL,

    dpsi/dt = a - b sin psi,    z = exp(i psi) = u/v,    d(u, v)/dt = [[i a/2, b/2], [b/2, -i a/2]] (u, v)

and the square of that matrix is (b^2 - a^2)/4: while W is constant a step is cosh and sinh, exact for any length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Complexes, Floats
from benchmarks.hostile.record_class import HostileRecord

N_SAMPLES = 2500
STEPS = 8
"""Steps of constant rate per sample."""

LAST_CODE = 127

RATE_OVER_LOCK_IN = (1.05, 100.0)
PERIODS = (5.0, 200.0)
NOISE = (0.2, 3.0)
AMPLITUDE = (40.0, 115.0)


@dataclass(frozen=True)
class Gyro:
    """Truth of one record: rates in deg/s, phases in rad, the rest in levels of the converter."""

    lock_in_rate: float
    input_rate: float
    scale_factor: float
    sample_interval: float
    periods: float
    start: float
    backscatter: float
    readout: float
    amplitude: float
    offset: float
    noise: float
    volts_per_level: float

    @property
    def beat_frequency(self) -> float:
        """Hz, at the steady rate."""
        return self.periods / (N_SAMPLES * self.sample_interval)

    @property
    def radians(self) -> float:
        """Phase in rad that one deg/s of rate adds in one sample."""
        return 2 * np.pi * self.scale_factor * self.sample_interval


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A size spread evenly over its logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def draw_gyro(
    rng: np.random.Generator,
    *,
    rate_over_lock_in: tuple[float, float] = RATE_OVER_LOCK_IN,
    periods: tuple[float, float] = PERIODS,
    noise: tuple[float, float] = NOISE,
    amplitude: tuple[float, float] = AMPLITUDE,
) -> Gyro:
    """A gyro anywhere in these ranges, of either sense, at any phases; seen in codes or in volts."""

    lock_in, scale = log_uniform(rng, 0.002, 1.0), log_uniform(rng, 200.0, 5000.0)
    rate = lock_in * log_uniform(rng, *rate_over_lock_in)
    turns = log_uniform(rng, *periods)
    levels, offset = log_uniform(rng, *noise), rng.uniform(-4, 4)
    return Gyro(
        lock_in_rate=lock_in,
        input_rate=rate * rng.choice([-1.0, 1.0]),
        scale_factor=scale,
        sample_interval=turns / (N_SAMPLES * scale * np.sqrt(rate**2 - lock_in**2)),
        periods=turns,
        start=rng.uniform(-np.pi, np.pi),
        backscatter=rng.uniform(-np.pi, np.pi),
        readout=rng.uniform(-np.pi, np.pi),
        amplitude=min(log_uniform(rng, *amplitude), LAST_CODE - 1 - abs(offset) - 5 * levels),
        offset=offset,
        noise=levels,
        volts_per_level=rng.choice([1.0, 0.04, 0.0008]),
    )


def steady(gyro: Gyro) -> Floats:
    """The rate in every step of a record, deg/s; (N_SAMPLES * STEPS,)."""
    return np.full(N_SAMPLES * STEPS, gyro.input_rate)


def step_times() -> Floats:
    """Middles of the steps, as shares of the record."""
    return np.asarray((np.arange(N_SAMPLES * STEPS) + 0.5) / (N_SAMPLES * STEPS))


def sample_times() -> Floats:
    """The samples, as shares of the record."""
    return np.asarray(np.arange(N_SAMPLES) / N_SAMPLES)


def beat(gyro: Gyro, rates: Floats, sample_interval: float | Floats | None = None) -> Floats:
    """What the photodiode sees at the samples: sin(phi + readout), (N_SAMPLES,).

    Parameters
    ----------
    rates : (N_SAMPLES * STEPS,)
        deg/s in each step.
    sample_interval : float or (N_SAMPLES * STEPS,), optional
        s, where the samples lie differently from what the scope states.
    """
    interval = gyro.sample_interval if sample_interval is None else sample_interval
    turn = 2 * np.pi * gyro.scale_factor * np.asarray(interval) / STEPS
    p, q = _products(*_steps(rates * turn, gyro.lock_in_rate * turn * np.ones_like(rates)))
    z0 = np.exp(1j * (gyro.start + gyro.backscatter))
    z = (p * z0 + q) / (np.conj(q) * z0 + np.conj(p))
    after = np.concatenate([[z0], z[STEPS - 1 :: STEPS][: N_SAMPLES - 1]])
    return np.asarray((after * np.exp(1j * (gyro.readout - gyro.backscatter))).imag)


def _steps(a: Floats, b: Floats) -> tuple[Complexes, Complexes]:
    """First row of the matrix of each step of angles a and b; the second row is its conjugate, turned round."""
    s = np.sqrt(b * b - a * a + 0j) / 2
    small = np.abs(s) < 1e-8
    sinh = np.where(small, 1.0, np.sinh(s) / np.where(small, 1.0, s))
    return np.asarray(np.cosh(s) + 1j * a / 2 * sinh), np.asarray(b / 2 * sinh + 0j)


def _products(p: Complexes, q: Complexes) -> tuple[Complexes, Complexes]:
    """All products of the steps from the first one on: in runs side by side, then from run to run."""
    run = 100
    p, q = p.reshape(-1, run).copy(), q.reshape(-1, run).copy()
    for place in range(1, run):
        p[:, place], q[:, place] = _times(p[:, place], q[:, place], p[:, place - 1], q[:, place - 1])
    for row in range(1, len(p)):
        p[row], q[row] = _times(p[row], q[row], p[row - 1, -1], q[row - 1, -1])
        size = np.abs(p[row, -1])  # grows without end in lock-in; only the quotient counts
        p[row], q[row] = p[row] / size, q[row] / size
    return p.ravel(), q.ravel()


def _times(p2: Complexes, q2: Complexes, p1: Complexes, q1: Complexes) -> tuple[Complexes, Complexes]:
    return p2 * p1 + q2 * np.conj(q1), p2 * q1 + q2 * np.conj(p1)


def levels_of(gyro: Gyro, signal: Floats) -> Floats:
    """A signal of unit size in levels of the converter, without noise."""
    return gyro.offset + gyro.amplitude * signal


def noisy(rng: np.random.Generator, gyro: Gyro, levels: Floats) -> Floats:
    """With the white noise of the receiver."""
    return levels + rng.normal(scale=gyro.noise, size=levels.shape)


def converted(levels: Floats) -> Floats:
    """Codes of a good eight-bit converter."""
    return np.clip(np.rint(levels), -LAST_CODE, LAST_CODE)


def record_of(gyro: Gyro, codes: Floats) -> HostileRecord:
    """The record as the scope gives it: codes, or volts."""
    scale = gyro.volts_per_level
    volts = codes if scale == 1.0 else codes * scale + 0.3 * scale
    return HostileRecord(volts, gyro.sample_interval, gyro.scale_factor, gyro.lock_in_rate, gyro.input_rate)


def recorded(rng: np.random.Generator, gyro: Gyro, signal: Floats) -> HostileRecord:
    """A signal of unit size through a good receiver, converter and scope."""
    return record_of(gyro, converted(noisy(rng, gyro, levels_of(gyro, signal))))
