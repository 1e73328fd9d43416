"""What is known of receiver and laser before a fit over several rates: bounds where nobody said anything."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from analysis.budget import BenchKnowledge, Corner
from analysis.budget.unstated import SECOND_ORDER_LIMIT, THIRD_ORDER_LIMIT, lowest_bandwidth, lowest_gain_corner
from analysis.several_rates.ratio_model import N_PARAMETERS, Prior

_RECTANGLE = math.sqrt(3.0)

WEAK = 3.0
"""Distortion that nobody stated is fitted freely: it is looked for within this many times the usual bound, which
matters only where the records themselves cannot tell it."""


@dataclass(frozen=True)
class ReceiverKnowledge:
    """What somebody knows of the receiver and of the laser's gain; nan: nothing, then the usual bounds hold."""

    # largest second and third harmonic that the receiver makes of a pure sine of the beat's size, over its
    # amplitude
    second_order_limit: float = math.nan
    third_order_limit: float = math.nan
    # -3 dB corner of the receiver (one pole), as in `BenchKnowledge`: corrected for, or its effect a limit
    bandwidth: Corner = field(default_factory=Corner)
    # g_c/2 pi; with an uncertainty it is a value, without one it is the lowest that is possible
    gain_corner: Corner = field(default_factory=Corner)

    @staticmethod
    def of(bench: BenchKnowledge) -> ReceiverKnowledge:
        """The part of what is known of a bench that a fit over several rates uses."""
        return ReceiverKnowledge(
            second_order_limit=math.nan if "distortion" in bench.separated else bench.distortion_limit,
            third_order_limit=bench.third_order_limit,
            bandwidth=bench.bandwidth,
            gain_corner=bench.gain,
        )

    def prior(self, slowest_beat_hz: float) -> Prior:
        """Mean and standard deviation of every parameter of the fit before there are data.

        Limits count as rectangular: half width over the root of three.
        """
        mean, sd = np.zeros(N_PARAMETERS), np.full(N_PARAMETERS, np.inf)
        second, third = self.second_order_limit, self.third_order_limit
        sd[2] = WEAK * SECOND_ORDER_LIMIT if math.isnan(second) else second / _RECTANGLE
        mean[3], sd[3] = self._gain_time(slowest_beat_hz)
        sd[4] = self._lag_square_u(slowest_beat_hz)
        sd[5] = (THIRD_ORDER_LIMIT if math.isnan(third) else third) / _RECTANGLE
        return Prior(mean, sd)

    def _gain_time(self, slowest_beat_hz: float) -> tuple[float, float]:
        corner = self.gain_corner
        if math.isnan(corner.hz):
            return 0.0, _time(lowest_gain_corner(slowest_beat_hz)) / _RECTANGLE
        if corner.u_hz > 0:
            return _time(corner.hz), _time(corner.hz) * corner.u_hz / corner.hz
        return 0.0, _time(corner.hz) / _RECTANGLE

    def _lag_square_u(self, slowest_beat_hz: float) -> float:
        corner = self.bandwidth
        if math.isnan(corner.hz):
            return _time(lowest_bandwidth(slowest_beat_hz)) ** 2 / _RECTANGLE
        if corner.corrected and math.isfinite(corner.hz):
            return 2 * _time(corner.hz) ** 2 * corner.u_hz / corner.hz
        return _time(corner.hz) ** 2 / _RECTANGLE


def _time(corner_hz: float) -> float:
    """Time constant of a corner, s."""
    return 0.0 if corner_hz == math.inf else 1 / (2 * math.pi * corner_hz)
