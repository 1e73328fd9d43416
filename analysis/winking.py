"""The beat of a ring laser whose intensities answer to the backscatter ("winking") with finite speed.

Two beams of intensity I1, I2 (1 without backscatter) and beat phase psi obey the semiclassical equations of a
two-mode ring laser (Aronowitz; Spreeuw et al., Phys. Rev. A 42, 4315 (1990)), here with equal gains:

    d(ln I1)/dt = g [1 - (I1 + xi I2)/(1 + xi)] + 2 a2 sqrt(I2/I1) cos(psi + eps/2)
    d(ln I2)/dt = g [1 - (I2 + xi I1)/(1 + xi)] + 2 a1 sqrt(I1/I2) cos(psi - eps/2)                    (1)
    d(psi)/dt   = 2 pi K W - a1 sqrt(I1/I2) sin(psi - eps/2) - a2 sqrt(I2/I1) sin(psi + eps/2)

g relaxation rate of the common intensity (rad/s; g/2 pi is the gain corner), xi cross over self saturation, a1 and
a2 backscatter of the beams (rad/s), eps the sum of their phases. With infinite g this is the lock-in equation with

    2 pi K WL exp(i beta) = a1 exp(-i eps/2) + a2 exp(i eps/2).                                        (2)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

POINTS = 512
"""Of one beat period; harmonics up to half of it, far more than a gyro at 1.05 times its threshold shows."""

NEGLIGIBLE = 1e-9
STANDSTILL = 1e-4
"""A phase that turns by less than this share of its free speed counts as locked; no integrator gets through."""

SHOTS = 30


@dataclass(frozen=True)
class WinkingLaser:
    """Ring laser of equations (1).

    Attributes
    ----------
    scale_factor : float
        K, pulses per degree.
    backscatter : (float, float)
        a1 and a2, rad/s.
    phase_sum : float
        eps, rad.
    gain_rate : float
        g, rad/s.
    cross_saturation : float
        xi, 0 <= xi < 1.
    """

    scale_factor: float
    backscatter: tuple[float, float]
    phase_sum: float
    gain_rate: float
    cross_saturation: float

    def __post_init__(self) -> None:
        values = (self.scale_factor, *self.backscatter, self.phase_sum, self.gain_rate, self.cross_saturation)
        if not all(np.isfinite(values)):
            raise ValueError("every parameter of the laser must be finite")
        if self.scale_factor <= 0 or self.gain_rate <= 0 or min(self.backscatter) < 0:
            raise ValueError("scale_factor and gain_rate must be positive, backscatter must not be negative")
        if not 0 <= self.cross_saturation < 1:
            raise ValueError(f"cross_saturation must be at least 0 and below 1, not {self.cross_saturation!r}")

    @property
    def coupling(self) -> complex:
        """Right side of equation (2), rad/s."""
        a1, a2 = self.backscatter
        return complex(a1 * np.exp(-0.5j * self.phase_sum) + a2 * np.exp(0.5j * self.phase_sum))

    @property
    def lock_in_rate(self) -> float:
        """WL of equation (2), deg/s."""
        return abs(self.coupling) / (2 * np.pi * self.scale_factor)

    @property
    def backscatter_phase(self) -> float:
        """beta of equation (2), rad."""
        return float(np.angle(self.coupling))

    @property
    def differential_rate(self) -> float:
        """Relaxation rate of the difference of the intensities, rad/s."""
        return self.gain_rate * (1 - self.cross_saturation) / (1 + self.cross_saturation)


def symmetric_laser(
    lock_in_rate: float,
    *,
    scale_factor: float,
    gain_corner_hz: float,
    phase_sum: float = 0.0,
    cross_saturation: float = 0.5,
) -> WinkingLaser:
    """Laser with equal backscatter of both beams that locks at a given rate (deg/s); beta is 0 for |eps| < pi."""
    each = np.pi * scale_factor * lock_in_rate / abs(np.cos(phase_sum / 2))
    return WinkingLaser(scale_factor, (each, each), phase_sum, 2 * np.pi * gain_corner_hz, cross_saturation)


@dataclass(frozen=True)
class SteadyBeat:
    """Periodic signals of a laser turning at constant rate, as harmonics: x = Re sum c_n exp(2 pi i n f t).

    frequency : Hz, positive
    beat : (n,) of sqrt(I1 I2) exp(i psi), two-sided, order -n/2 .. n/2 - 1
    beams : (2, n) of I1 and I2, the same order
    """

    frequency: float
    beat: Complexes
    beams: Complexes

    def signal(
        self,
        times: ArrayLike,
        *,
        amplitude: float = 1.0,
        readout_phase: float = 0.0,
        start_phase: float = 0.0,
        contrast: float = np.inf,
    ) -> Floats:
        """Detector signal A [sqrt(I1 I2) sin(psi + delta) + (I1 + I2)/(2 contrast)], the latter without its mean.

        Parameters
        ----------
        times : (...)
            Seconds.
        amplitude, readout_phase : float
            A, and delta in rad.
        start_phase : float
            Of the fundamental at time 0, rad.
        contrast : float
            Of the fringes; inf leaves out the light of the single beams.
        """
        orders = np.arange(self.beat.size) - self.beat.size // 2
        # The imaginary part of a two-sided series, and the real part of another: one real series for both.
        lines = self.beat * np.exp(1j * readout_phase)
        lines = (lines - np.conj(_mirrored(lines))) / 2j + self.beams.sum(axis=0) / (2 * contrast)
        keep = (orders > 0) & (np.abs(lines) > NEGLIGIBLE)
        offset = float((self.beat[orders == 0] * np.exp(1j * readout_phase)).imag[0])
        turns = np.multiply.outer(
            2 * np.pi * self.frequency * np.asarray(times, dtype=float) + start_phase, orders[keep]
        )
        waves = 2 * (np.cos(turns) @ lines[keep].real - np.sin(turns) @ lines[keep].imag)
        return np.asarray(amplitude * (offset + waves))


def _mirrored(lines: Complexes) -> Complexes:
    """c_-n in the place of c_n; the lowest order, which has no partner, is dropped."""
    turned = np.zeros_like(lines)
    turned[1:] = lines[:0:-1]
    return turned


def steady_beat(laser: WinkingLaser, input_rate: float) -> SteadyBeat:
    """Periodic solution of equations (1) at a constant rate.

    The phase is the independent variable: over one turn of it the intensities must come back to where they were.
    Newton's method finds the start for which they do, however slow the transients are.

    Parameters
    ----------
    laser : WinkingLaser
    input_rate : float
        deg/s, either sign.

    Raises
    ------
    ValueError
        The phase does not turn at this rate: the gyro is locked.

    Examples
    --------
    With fast gain, the beat of the lock-in equation: A2/A1 = tan(asin(0.5)/2).

    >>> laser = symmetric_laser(0.05, scale_factor=2000, gain_corner_hz=1e6)
    >>> beat = steady_beat(laser, 0.1)
    >>> middle = beat.beat.size // 2
    >>> round(float(abs(beat.beat[middle + 2] / beat.beat[middle + 1])), 4), round(beat.frequency, 2)
    (0.2679, 173.21)
    """
    turn = 2 * np.pi * np.sign(input_rate)
    start = np.zeros(2)
    for _ in range(SHOTS):
        end = _one_turn(laser, input_rate, start, turn)[:2, -1]
        if np.max(np.abs(end - start)) < 1e-12:
            break
        jacobian = np.empty((2, 2))
        for place in range(2):
            moved = start + 1e-6 * (np.arange(2) == place)
            jacobian[:, place] = (_one_turn(laser, input_rate, moved, turn)[:2, -1] - end) / 1e-6
        start = start - np.linalg.solve(jacobian - np.eye(2), end - start)
    else:
        raise ValueError("no steady beat was found: backscatter is too strong for its gain")
    return _harmonics(_one_turn(laser, input_rate, start, turn), turn)


def _one_turn(laser: WinkingLaser, input_rate: float, start: Floats, turn: float) -> Floats:
    """ln I1, ln I2 and time (3, POINTS + 1) at equal steps of the phase over one turn."""
    from scipy.integrate import solve_ivp  # costs as much to import as the whole of NumPy

    a1, a2 = laser.backscatter
    half, gain, xi = laser.phase_sum / 2, laser.gain_rate, laser.cross_saturation
    sagnac = 2 * np.pi * laser.scale_factor * input_rate

    def slopes(psi: float, state: Floats) -> list[float]:
        first, second = np.exp(state[:2])
        ratio = np.exp((state[0] - state[1]) / 2)
        speed = sagnac - a1 * ratio * np.sin(psi - half) - a2 / ratio * np.sin(psi + half)
        if speed * turn <= STANDSTILL * abs(sagnac * turn):
            raise ValueError(f"the gyro is locked at {input_rate:.6g} deg/s: there is no beat")
        by_first = gain * (1 - (first + xi * second) / (1 + xi)) + 2 * a2 / ratio * np.cos(psi + half)
        by_second = gain * (1 - (second + xi * first) / (1 + xi)) + 2 * a1 * ratio * np.cos(psi - half)
        return [by_first / speed, by_second / speed, 1 / speed]

    solved = solve_ivp(
        slopes,
        (0.0, turn),
        [*start, 0.0],
        method="LSODA",
        t_eval=np.linspace(0.0, turn, POINTS + 1),
        rtol=1e-11,
        atol=1e-13,
    )
    return np.asarray(solved.y)


def _harmonics(path: Floats, turn: float) -> SteadyBeat:
    """Harmonics in time from a path in phase: c_n = (1/T) integral of x exp(-i n w t) (dt/dpsi) over psi."""
    times = path[2]
    period = times[-1]
    psi = np.linspace(0.0, turn, POINTS + 1)[:-1]
    # dt/dpsi of a periodic function, from its own Fourier series: exact to rounding for a smooth path.
    ripple = np.fft.fft(times[:-1] - period * psi / turn)
    orders = np.fft.fftfreq(POINTS, 1 / POINTS)
    weight = 1 + np.fft.ifft(1j * orders * ripple).real * (2 * np.pi / turn) * turn / period
    kernel = np.exp(-2j * np.pi * np.outer(np.arange(POINTS) - POINTS // 2, times[:-1] / period)) * weight / POINTS
    intensities = np.exp(path[:2, :-1])
    field = np.sqrt(intensities[0] * intensities[1]) * np.exp(1j * psi)
    return SteadyBeat(float(1 / abs(period)), kernel @ field, intensities @ kernel.T)
