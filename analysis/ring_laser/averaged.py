"""The mean of many stretches of a beat, as an oscilloscope averages: without working out each of them.

In stretch k the phase runs as psi_k(t) = psi_0(t) + d_k(t), where d_k changes little in a stretch: it is worked
out at few times. With the harmonics c_n of the beat the mean of all stretches is

    Re sum c_n exp(i n psi_0(t)) Z_n(t),    Z_n(t) = mean over k of exp(i n d_k(t)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial import chebyshev

from analysis.arrays import Complexes, Floats
from analysis.ring_laser.beat import beat_phase_on_table
from analysis.ring_laser.detector import Detector, amplitudes_at
from analysis.ring_laser.gyro import Gyro
from analysis.ring_laser.motion import Motion
from analysis.ring_laser.rate_grid import six_weights
from analysis.ring_laser.signals import UNSEEN, signal_above, smooth_interval

_FEW = 8  # times at which d_k is worked out; as many again for each turn of the ripple
_FEWEST_NODES, _NODES_A_TURN = 8, 24  # of Z_n; 8 for each turn of the third harmonic
_MOST_PHASES = 60_000
_NEGLIGIBLE = 1e-5  # of the largest harmonic


def mean_beat_on_table(
    gyro: Gyro,
    detector: Detector,
    motion: Sequence[Motion],
    starts: Floats,
    times: Floats,
    *,
    corner_hz: float = 0.0,
    settling_s: float = 0.0,
) -> Floats | None:
    """Mean over several starts of the volts at the detector at some times behind each.

    Shapes: starts (k,), times (n,).
    """
    segments, span = tuple(motion), float(times[-1])
    first, last = float(starts[0]), float(starts[-1]) + span
    steady = [piece for piece in segments if piece.start <= last]
    turns = len(steady) == 1 or steady[-1].start <= first - settling_s
    if not turns or detector.pump_ripple >= 2 * UNSEEN or not smooth_interval(gyro, detector, motion, first, last):
        return None
    if corner_hz and signal_above(gyro, detector, motion, corner_hz, first - settling_s, last) is None:
        return None
    middle = starts[len(starts) // 2]
    few = chebyshev.chebpts1(_FEW + math.ceil(_FEW * gyro.ripple_hz * span) if gyro.ripple_dps else _FEW)
    rates, slow = _differences(gyro, segments, starts, middle, (few + 1) * span / 2)
    nodes = _FEWEST_NODES + math.ceil(_NODES_A_TURN * float(np.ptp(slow, axis=1).max()) / (2 * math.pi))
    if nodes * len(starts) > _MOST_PHASES:
        return None
    series = np.linalg.solve(chebyshev.chebvander(few, len(few) - 1), slow.T)
    differences = (chebyshev.chebvander(np.linspace(-1, 1, nodes), len(few) - 1) @ series).T
    coupled = replace(detector, coupling_hz=corner_hz, pump_ripple=0.0)
    begin, end = (amplitudes_at(gyro, coupled, float(rates[:, at].mean())) for at in (0, -1))
    order = int(np.count_nonzero(np.abs(begin) > _NEGLIGIBLE * np.abs(begin).max()))
    order, sense = max(min(order + 1, begin.size, end.size), 2), 1 if rates[0, 0] > 0 else -1
    apart = np.exp(1j * sense * differences)
    power, together = np.ones_like(apart), np.empty((order - 1, nodes), dtype=np.complex128)
    for n in range(order - 1):
        power *= apart
        together[n] = power.mean(axis=0)
    shares = _between(together, times / span)
    turning = np.exp(1j * sense * beat_phase_on_table(gyro, segments, middle + times)[1])
    growing = begin[1:order, np.newaxis] + (end - begin)[1:order, np.newaxis] * (times / span)
    volts: Floats = begin[0].real + _sum_of_powers(growing * shares, turning)
    if not detector.pump_ripple:
        return volts
    swing = detector.mean_swing(starts, times)
    return np.asarray(volts * swing + (detector.offset * (swing - 1) if corner_hz else 0.0))


def _differences(
    gyro: Gyro, motion: tuple[Motion, ...], starts: Floats, middle: float, places: Floats
) -> tuple[Floats, Floats]:
    """Rates on the axis, and phases over those of the stretch in the middle, (k, places)."""
    rates, phases = beat_phase_on_table(gyro, motion, (starts[:, np.newaxis] + places).ravel())
    reference = beat_phase_on_table(gyro, motion, middle + places)[1]
    return rates.reshape(len(starts), -1), phases.reshape(len(starts), -1) - reference


def _sum_of_powers(factors: Complexes, base: Complexes) -> Floats:
    """Real part of the sum of factors[n - 1] base^n (Horner)."""
    total = factors[-1] * base
    for factor in factors[-2::-1]:
        total += factor
        total *= base
    return np.ascontiguousarray(total.real)


def _between(values: Complexes, places: Floats) -> Complexes:
    """Values (m, nodes) at even steps from 0 to 1, at places (n,) between them: quintic polynomials."""
    at = places * (values.shape[1] - 1)
    cells = np.minimum(np.maximum(at.astype(np.intp), 2), values.shape[1] - 4)
    weights = six_weights(at - cells)
    return np.asarray(sum(weight * values[:, cells + n] for n, weight in zip(range(-2, 4), weights, strict=True)))
