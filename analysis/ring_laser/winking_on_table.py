"""A laser whose intensities follow the backscatter with finite speed: its beat from the integrated equations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from analysis.arrays import Complexes, Floats, Indices
from analysis.ring_laser.rate_grid import beat_rate_at, interpolate, rate_at
from analysis.ring_laser.winking import SteadyBeat, steady_beat, symmetric_laser


@dataclass(frozen=True)
class Winking:
    """Gain saturation of a laser with equal backscatter of both beams.

    Attributes
    ----------
    scale_factor : float
        Pulses per degree.
    lock_in_rate : float
        deg/s, at low rates.
    gain_corner_hz : float
        Relaxation rate of the common intensity over 2 pi.
    phase_sum : float
        Sum of the phases of the backscatter, rad: 0 is the dissipative kind, which locks.
    cross_saturation : float
        Over self saturation.
    """

    scale_factor: float
    lock_in_rate: float
    gain_corner_hz: float
    phase_sum: float = 0.0
    cross_saturation: float = 0.5

    def frequency_factor(self, rates: Floats) -> Floats:
        """Beat frequency at rates in deg/s over that of the lock-in equation; all beyond the lock-in rate."""

        def factor(point: int, _: Indices) -> float:
            return self.frequency(point) / (self.scale_factor * beat_rate_at(point))

        return interpolate(rates, self.lock_in_rate, factor)

    def frequency(self, point: int) -> float:
        """Beat frequency in Hz at a point of the grid."""
        return _beat(self, point).frequency

    def fringe(self, point: int) -> Complexes:
        """Light of the fringes sqrt(I1 I2) exp(i psi) over one period, evenly in time, at a point of the grid."""
        return _over_a_period(_beat(self, point).beat)

    def pedestal(self, point: int) -> Floats:
        """Mean light (I1 + I2)/2 of the single beams over one period, less its mean."""
        light = _over_a_period(_beat(self, point).beams.sum(axis=0) / 2).real
        return np.asarray(light - light.mean())


@lru_cache(maxsize=1024)
def _beat(winking: Winking, point: int) -> SteadyBeat:
    laser = symmetric_laser(
        winking.lock_in_rate,
        scale_factor=winking.scale_factor,
        gain_corner_hz=winking.gain_corner_hz,
        phase_sum=winking.phase_sum,
        cross_saturation=winking.cross_saturation,
    )
    return steady_beat(laser, rate_at(point, winking.lock_in_rate))


def _over_a_period(harmonics: Complexes) -> Complexes:
    """Values of a series with the orders -n/2 ... n/2 - 1 at n even steps of one period."""
    return np.asarray(np.fft.ifft(np.fft.ifftshift(harmonics)) * harmonics.size)
