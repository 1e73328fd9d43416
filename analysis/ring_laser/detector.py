"""What a photodiode and its amplifier make of the beat: readout phase, distortion, bandwidth, coupling.

At a constant rate the detector's signal is a periodic function of the beat phase. Behind a filter its harmonic n
is multiplied by the response at n f. The rate changes little in one period, so the harmonics are worked out on a
grid of rates once and interpolated; without a filter the signal is computed sample by sample.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from analysis.arrays import Bools, Complexes, Floats, Indices
from analysis.channel import high_pass, low_pass
from analysis.ring_laser.gyro import Gyro
from analysis.ring_laser.rate_grid import FINER, beat_rate_at, grid_place, interpolate, rate_at, weights_at

_FEWEST_POINTS, _MOST_POINTS = 128, 8192
_NEGLIGIBLE = 1e-9
_FEW_CELLS = 6
_OVERSHOOT = 0.05  # of the swing: more than a polynomial between points of the grid leaves them by


@dataclass(frozen=True)
class Detector:
    """A photodiode that looks at the fringes, with its amplifier."""

    readout_phase: float  # delta, where it reads the fringes, rad
    amplitude: float = 1.0  # of its signal, V
    offset: float = 0.0
    # distortion: s + second_order s^2 + third_order s^3 of the signal s in units of the amplitude. The harmonics
    # of a pure beat are then second_order / 2 and third_order / 4 of it.
    second_order: float = 0.0
    third_order: float = 0.0
    low_pass_hz: float = 0.0  # corners of one pole each; 0: there is none
    ac_corner_hz: float = 0.0
    pump_ripple: float = 0.0  # the light swings by this share
    pump_hz: float = 0.0
    # light of the single beams over that of the fringes: how much of their winking is seen
    single_beams: float = 0.0
    coupling_hz: float = 0.0  # corner of the AC coupling of what looks at the signal, as `ac_corner_hz`

    @property
    def filtered(self) -> bool:
        """Whether anything in it depends on the frequency."""
        return self.low_pass_hz > 0 or self.ac_corner_hz > 0 or self.coupling_hz > 0

    def without_filters(self) -> Detector:
        """The same detector with an amplifier for all frequencies."""
        return replace(self, low_pass_hz=0.0, ac_corner_hz=0.0, coupling_hz=0.0) if self.filtered else self

    def volts(self, fringe: Complexes, backscatter_phase: float) -> Floats:
        """Signal before any filter, V, for exp(i (phi + beta))."""
        turned = fringe * np.exp(1j * (self.readout_phase - backscatter_phase))
        s = turned.imag
        distorted = s + self.second_order * s**2 + self.third_order * s**3
        return np.asarray(self.offset + self.amplitude * distorted, dtype=np.float64)

    def response(self, frequency: Floats) -> Complexes:
        """Gain of the filters at frequencies in Hz."""
        gain = np.ones_like(frequency, dtype=np.complex128)
        if self.low_pass_hz > 0:
            gain *= low_pass(frequency, self.low_pass_hz)
        for corner in (self.ac_corner_hz, self.coupling_hz):
            if corner > 0:
                gain *= high_pass(frequency, corner)
        return gain

    def swing(self, times: Floats) -> Floats:
        """The light at absolute times in s over its mean."""
        return np.asarray(1 + self.pump_ripple * np.sin(self._pump_phase(times)))

    def mean_swing(self, starts: Floats, times: Floats) -> Floats:
        """Mean over several starts (absolute, s) of `swing` at times in s behind each."""
        together = np.exp(1j * self._pump_phase(starts)).mean()
        return np.asarray(1 + self.pump_ripple * (np.exp(1j * self._pump_phase(times)) * together).imag)

    def _pump_phase(self, times: Floats) -> Floats:
        """Phase of the light's swing in rad, less whole turns."""
        cycles = self.pump_hz * times
        return np.asarray(2 * np.pi * (cycles - np.floor(cycles)))


def detector_signal(gyro: Gyro, detector: Detector, axis_rate: Floats, beat_phase: Floats) -> Floats:
    """Volts at the detector for given rate on the axis and slow beat phase.

    Shapes: axis_rate (n,), beat_phase (n,).
    """
    if not detector.filtered and gyro.winking is None:
        return detector.volts(gyro.fringe(axis_rate, beat_phase), gyro.backscatter_phase)
    locked, senses = gyro.locked(axis_rate), np.sign(axis_rate)
    if senses.size and not locked.any() and (senses == senses[0]).all():
        return _by_harmonics(gyro, detector, axis_rate, beat_phase, int(senses[0]))
    volts = np.empty(axis_rate.shape)
    # behind a filter a locked gyro's signal is what the filter leaves of a constant
    if locked.any():
        still = detector.volts(gyro.fringe(axis_rate[locked], beat_phase[locked]), gyro.backscatter_phase)
        volts[locked] = still * float(detector.response(np.zeros(1))[0].real)
    for sense in (1, -1):
        inside = np.flatnonzero(~locked & (senses == sense))
        if inside.size:
            volts[inside] = _by_harmonics(gyro, detector, axis_rate[inside], beat_phase[inside], sense)
    return volts


def volts_between(
    gyro: Gyro, detector: Detector, slowest: float, fastest: float, sense: int
) -> tuple[float, float]:
    """Volts that the detector does not leave at any phase of the beat."""
    low, high = np.inf, -np.inf
    first, last = grid_place(np.array([slowest, fastest]), gyro.lock_in_rate)
    for point in range(math.floor(first) - 2, math.ceil(last) + 4):  # those that are interpolated between
        harmonics = _harmonics(gyro, detector, point, sense)
        middle, swing = float(harmonics[0].real), float(np.abs(harmonics[1:]).sum())
        low, high = min(low, middle - swing), max(high, middle + swing)
    slack = _OVERSHOOT * (high - low)
    return low - slack, high + slack


def _by_harmonics(gyro: Gyro, detector: Detector, rates: Floats, phases: Floats, sense: int) -> Floats:
    """Sum of the harmonics, each interpolated between points of the grid of rates."""
    turning = np.exp(1j * sense * phases)
    place = grid_place(np.abs(rates), gyro.lock_in_rate) * FINER
    cells = np.floor(place).astype(np.intp)
    lowest, highest = int(cells.min()), int(cells.max())
    if highest - lowest > _FEW_CELLS:

        def at_point(point: int, inside: Indices) -> Floats:
            return _real_series(_harmonics(gyro, detector, point, sense), turning[inside])

        return interpolate(rates, gyro.lock_in_rate, at_point)
    # in a record the rate hardly changes: straight lines between the points of a finer grid are good enough
    volts = np.empty(rates.shape)
    for cell in range(lowest, highest + 1):
        inside: Bools | slice = cells == cell if lowest < highest else slice(None)
        left, right = _real_series(_either_side(gyro, detector, cell, sense), turning[inside])
        volts[inside] = left + (place[inside] - cell) * (right - left)
    return volts


def amplitudes_at(gyro: Gyro, detector: Detector, axis_rate: float) -> Complexes:
    """Complex amplitudes of the harmonics 0, 1, ... behind the filters, V, at a rate beyond lock-in in deg/s.

    That of the nearest point of the finer grid, a four thousandth of the rate away at most.
    """
    place = float(grid_place(np.array([abs(axis_rate)]), gyro.lock_in_rate)[0])
    return _between(gyro, detector, round(place * FINER), 1 if axis_rate > 0 else -1)


@lru_cache(maxsize=8192)
def _either_side(gyro: Gyro, detector: Detector, finer: int, sense: int) -> Complexes:
    """Harmonics (order, 2, 1) at a point of the finer grid and at the next."""
    low, high = (_between(gyro, detector, point, sense) for point in (finer, finer + 1))
    both = np.zeros((max(low.size, high.size), 2, 1), dtype=np.complex128)
    both[: low.size, 0, 0], both[: high.size, 1, 0] = low, high
    return both


@lru_cache(maxsize=8192)
def _between(gyro: Gyro, detector: Detector, finer: int, sense: int) -> Complexes:
    """Harmonics at a point of the finer grid."""
    found = [(_harmonics(gyro, detector, point, sense), weight) for point, weight in weights_at(finer / FINER)]
    total = np.zeros(max(series.size for series, _ in found), dtype=np.complex128)
    for series, weight in found:
        total[: series.size] += weight * series
    return total


def _real_series(amplitudes: Complexes, turning: Complexes) -> Floats:
    """Real part of sum amplitudes_n turning^n, for amplitudes (order, ...) that may hold several series."""
    total = amplitudes[-1] + np.zeros_like(turning)
    for amplitude in amplitudes[-2::-1]:
        total *= turning
        total += amplitude
    return np.ascontiguousarray(total.real)


@lru_cache(maxsize=4096)
def _harmonics(gyro: Gyro, detector: Detector, point: int, sense: int) -> Complexes:
    """Complex amplitudes of the harmonics 0, 1, ... behind the filters, V, at one point of the grid."""
    volts = _one_period(gyro, detector, point, sense)
    amplitudes: Complexes = np.fft.rfft(volts) / volts.size
    amplitudes[1:] *= 2
    frequency = gyro.scale_factor * beat_rate_at(point)
    if gyro.winking is not None:
        frequency = gyro.winking.frequency(point)
    amplitudes = amplitudes * detector.response(frequency * np.arange(amplitudes.size, dtype=np.float64))
    kept = np.flatnonzero(np.abs(amplitudes) > _NEGLIGIBLE * np.abs(amplitudes).max())
    return np.asarray(amplitudes[: kept[-1] + 1] if kept.size else amplitudes[:1])


def _one_period(gyro: Gyro, detector: Detector, point: int, sense: int) -> Floats:
    """Volts before any filter, evenly over one period of the beat."""
    if gyro.winking is not None:
        fringe, pedestal = gyro.winking.fringe(point), gyro.winking.pedestal(point)
        # the equations of equal beams are the same for the other sense, with the phase turned round
        fringe = fringe if sense > 0 else np.conj(fringe)
        return (
            detector.volts(fringe, gyro.backscatter_phase) + detector.amplitude * detector.single_beams * pedestal
        )
    rate = sense * rate_at(point, gyro.lock_in_rate)
    ratio = float(gyro.harmonic_ratio(np.array(rate)))
    # the harmonics that the grid cannot hold would fold back: they shall be negligible
    wanted = 4 * math.log(_NEGLIGIBLE) / math.log(min(max(ratio, 1e-9), 1 - 1e-9))
    points = 1 << math.ceil(math.log2(min(max(wanted, _FEWEST_POINTS), _MOST_POINTS)))
    phases = sense * np.arange(points, dtype=np.float64) * (2 * np.pi / points)
    return detector.volts(gyro.fringe(np.full(points, rate), phases), gyro.backscatter_phase)
