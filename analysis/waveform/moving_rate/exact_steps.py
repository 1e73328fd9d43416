"""The lock-in equation from one sample to the next, exactly, and how the step moves with what it starts from.

    d(phi)/dt = a(t) - s sin(phi) + c cos(phi),     s + i c = b exp(i gamma)

phi is the phase that the detector sees, so v = C + A sin(phi) holds without another angle; a = 2 pi K W,
b = 2 pi K WL, gamma = readout phase less backscatter phase. With tan(phi/2) = n/d the equation is linear,

    d(n, d)/dt = M (n, d),    M = [[-s, a + c], [c - a, s]] / 2

and a step is one matrix exponential. While a changes by D within the step, the two first terms of Magnus' series
turn gamma by D/12; what is left out is of fourth order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats

LOCKED_AT_MOST = 50.0
"""Relaxation times in one step beyond which exponentials are cut off: no beat is sampled so coarsely."""


@dataclass(frozen=True)
class Steps:
    """What each of (N - 1,) steps does.

    advance : rad, phase gained
    by_phase, by_rate, by_sine, by_cosine : derivatives of the phase at its end by that at its start, by a, s and c
    """

    advance: Floats
    by_phase: Floats
    by_rate: Floats
    by_sine: Floats
    by_cosine: Floats


def exact_steps(
    phase: Floats, mean_rate: Floats, rate: Floats, sine: float | Floats, cosine: float | Floats
) -> Steps:
    """Steps from the first N - 1 of N phases."""
    n0, d0 = np.sin(phase[:-1] / 2), np.cos(phase[:-1] / 2)
    turn = (rate[1:] - rate[:-1]) / 12
    s, c = sine - turn * cosine, cosine + turn * sine
    square = (mean_rate**2 - s**2 - c**2) / 4
    root = np.sqrt(np.abs(square))
    even, odd = np.cos(root), np.sinc(root / np.pi)
    locked = np.flatnonzero(square < 0)
    if locked.size:
        slow = np.clip(root[locked], 1e-9, LOCKED_AT_MOST)
        even[locked], odd[locked] = np.cosh(slow), np.sinh(slow) / slow
    odd /= 2
    n1 = even * n0 + odd * ((mean_rate + c) * d0 - s * n0)
    d1 = even * d0 + odd * ((c - mean_rate) * n0 + s * d0)
    # The matrix has determinant 1, so the square of the length says how neighbouring phases spread.
    by_phase = 1 / (n1 * n1 + d1 * d1)
    start = _Edge.of(2 * n0 * d0, (d0 - n0) * (d0 + n0), rate[:-1], sine, cosine)
    end = _Edge.of(2 * n1 * d1 * by_phase, (d1 - n1) * (d1 + n1) * by_phase, rate[1:], sine, cosine)

    def integrated(at_start: Floats, at_end: Floats, slope_at_start: Floats, slope_at_end: Floats) -> Floats:
        # Hermite's rule: exact for cubics
        return (at_start * by_phase + at_end) / 2 + (slope_at_start * by_phase - slope_at_end) / 12

    one = np.ones_like(by_phase)
    return Steps(
        2 * np.arctan2(n1 * d0 - d1 * n0, d1 * d0 + n1 * n0),
        by_phase,
        integrated(one, one, start.pull, end.pull),
        integrated(-start.sin, -end.sin, start.sine_slope, end.sine_slope),
        integrated(start.cos, end.cos, start.cosine_slope, end.cosine_slope),
    )


@dataclass(frozen=True)
class _Edge:
    """At one end of the steps: sine and cosine, the rate at which a disturbance dies, and the slopes of what a
    change of s and c adds to the phase, as seen at the end of the step.
    """

    sin: Floats
    cos: Floats
    pull: Floats
    sine_slope: Floats
    cosine_slope: Floats

    @staticmethod
    def of(sin: Floats, cos: Floats, rate: Floats, sine: float | Floats, cosine: float | Floats) -> _Edge:
        pull = sine * cos + cosine * sin
        speed = rate - sine * sin + cosine * cos
        return _Edge(sin, cos, pull, -cos * speed - sin * pull, -sin * speed + cos * pull)
