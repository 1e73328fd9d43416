"""A simulated ring laser gyro: what its beat does at a given rate on its axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from analysis import lockin_equation
from analysis.arrays import Bools, Complexes, Floats
from analysis.ring_laser.winking import Winking
from analysis.rotation import rate_on_axis

_SECONDS_PER_HOUR = 3600.0


@dataclass(frozen=True)
class Gyro:
    """A ring laser gyro on a tilted axis."""

    scale_factor: float  # k, beat periods per degree, at time zero
    lock_in_rate: float  # WL, deg/s, not negative
    backscatter_phase: float  # beta of the lock-in equation, rad
    # angle between gyro axis and (vertical) table axis; site; table azimuth at which the axis points north
    tilt_deg: float
    latitude_deg: float
    north_azimuth_deg: float = 0.0
    start_phase: float = 0.0  # phase of the beat at the start of the motion, rad
    scale_factor_drift_ppm_per_hour: float = 0.0  # K grows by so much
    # A swing of the rate on the axis. Its frequency has to be far below that of the beat.
    ripple_dps: float = 0.0
    ripple_hz: float = 0.0
    winking: Winking | None = None  # gain saturation; ``None``: the lock-in equation holds

    def axis_rate(
        self, table_rate_dps: ArrayLike, azimuth_deg: ArrayLike, ripple_phase: ArrayLike = 0.0
    ) -> Floats:
        """Rate W on the gyro's axis in deg/s, from rate and azimuth of the table and the phase of the ripple."""
        azimuth = np.subtract(azimuth_deg, self.north_azimuth_deg)
        steady = rate_on_axis(table_rate_dps, self.tilt_deg, self.latitude_deg, azimuth)
        return np.asarray(steady + self.ripple_dps * np.sin(ripple_phase)) if self.ripple_dps else steady

    def ripple_phase(self, times: ArrayLike) -> Floats:
        """Phase of the ripple in rad at absolute times in s."""
        return np.asarray(2 * np.pi * np.mod(self.ripple_hz * np.asarray(times, dtype=np.float64), 1.0))

    def drift(self, times: ArrayLike) -> Floats:
        """K at absolute times in s over K at time zero."""
        return np.asarray(1.0 + self.drift_per_s * np.asarray(times, dtype=np.float64))

    @property
    def drift_per_s(self) -> float:
        """Relative growth of K in 1/s."""
        return 1e-6 * self.scale_factor_drift_ppm_per_hour / _SECONDS_PER_HOUR

    def beat_frequency(self, axis_rate: Floats) -> Floats:
        """Beat frequency in Hz at time zero, with the sign of the rate; zero where the gyro is locked."""
        frequency = lockin_equation.beat_frequency(self.scale_factor, axis_rate, self.lock_in_rate)
        turning = ~self.locked(axis_rate)
        if self.winking is not None:
            frequency[turning] *= self.winking.frequency_factor(axis_rate[turning])
        return np.asarray(np.sign(axis_rate) * frequency)

    def harmonic_ratio(self, axis_rate: Floats) -> Floats:
        """Ratio r of successive harmonics of the beat, 1 at and below the threshold."""
        size = np.maximum(np.abs(axis_rate), self.lock_in_rate)
        over_rate = np.divide(self.lock_in_rate, size, out=np.zeros_like(size), where=size > 0)
        return lockin_equation.harmonic_ratio(over_rate)

    def fringe(self, axis_rate: Floats, beat_phase: Floats) -> Complexes:
        """exp(i (phi + beta)) for given rate on the axis and slow beat phase.

        Shapes: axis_rate (...), beat_phase (...).
        """
        ratio = self.harmonic_ratio(axis_rate)
        rotating = np.exp(1j * np.where(axis_rate < 0, -beat_phase, beat_phase))
        denominator = 1.0 - ratio * rotating
        at_threshold = np.abs(denominator) < 1e-12
        fringe = 1j * (ratio - rotating) / np.where(at_threshold, 1.0, denominator)
        fringe = np.where(at_threshold, 1j, fringe)
        fringe = np.where(axis_rate < 0, np.conj(fringe), fringe)
        locked = self.locked(axis_rate)
        if np.any(locked):
            sine = np.clip(axis_rate / self.lock_in_rate, -1.0, 1.0)
            fringe = np.where(locked, np.exp(1j * np.arcsin(sine)), fringe)
        return np.asarray(fringe, dtype=np.complex128)

    def without_winking(self) -> Gyro:
        """The same gyro with a laser that follows at once."""
        return self if self.winking is None else replace(self, winking=None)

    def locked(self, axis_rate: Floats) -> Bools:
        """Where the beat stands still."""
        return np.asarray((self.lock_in_rate > 0) & (np.abs(axis_rate) <= self.lock_in_rate))
