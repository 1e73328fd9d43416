"""Numbers that both loop kernels work with: constants of the gates, state of the registers, inputs and sums.

Both kernels do the same operations on the same numbers in the same order, so that they agree to the last bit. The
cosine is therefore a polynomial here, and not the one of a library, which differs between NumPy and compiled code.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from analysis.arrays import Floats, Ints
from analysis.fibre_gyro.loop.design import GUARD_BITS, LoopDesign

COSINE = (
    6.28318530717927,
    -41.341702239903675,
    81.60524914901582,
    -76.7058475437728,
    42.058134871362796,
    -15.08148320681731,
    3.6658551593650577,
)
"""sin(2 pi u) = u (c0 + c1 u^2 + ...), |u| <= 1/4, to 1e-13; cos(2 pi t) = sin(2 pi (1/4 - |t|)), |t| <= 1/2."""

RAMP, REGISTER, SECOND_RAMP = range(3)
"""Columns of the integer state: staircase and injected staircase in 2^-F codes, accumulator of the loop."""
PHASE, SECOND_PHASE, SPAN = range(3)
"""Columns of the real state: phases one transit time ago in turns, span of the converter 1 + eps."""
STEPS, NORMAL, RESET, RESETS = range(4)
"""Columns of the sums: steps in 2^-F codes, errors of pairs without and with a reset, number of these."""


class LoopConstants(NamedTuple):
    """Fixed numbers of one loop; phases in turns, intensities in counts of the detector's converter."""

    fractional_bits: int
    guard_bits: int
    codes: int
    wrap_steps: int
    wrap: int
    quarter: int
    bias_in_wrap: bool
    gated: bool
    separate: bool
    error_gain: int
    register_limit: int
    mean_level: float
    amplitude: float
    adc_top: float
    second_span: float
    trim_gain: float


def loop_constants(design: LoopDesign, *, closed: bool) -> LoopConstants:
    """Constants of the design; an open loop has no error gain."""
    half_range = design.adc_half_range
    wrap_steps = design.wrap << design.fractional_bits
    return LoopConstants(
        fractional_bits=design.fractional_bits,
        guard_bits=GUARD_BITS,
        codes=design.codes,
        wrap_steps=wrap_steps,
        wrap=design.wrap,
        quarter=design.codes // 4,
        bias_in_wrap=design.bias_in_wrap,
        gated=design.gated,
        separate=design.injection_path == "separate",
        error_gain=design.error_gain() if closed else 0,
        register_limit=(wrap_steps // 2 - 1) << GUARD_BITS,
        mean_level=half_range * design.light_level + design.adc_offset,
        amplitude=half_range * design.light_level * design.contrast,
        adc_top=2.0 * half_range - 1.0,
        second_span=(1.0 + design.injection_two_pi_error) / design.codes,
        trim_gain=design.two_pi_loop_gain / (2.0 * np.pi * half_range),
    )


class LoopInput(NamedTuple):
    """What drives the loops over some segments of time: each has one injected step and belongs to one output."""

    pairs: Ints  # (segments,): Sample pairs of each segment
    injected: Ints  # (runs, segments): Injected step in 2^-F codes
    sagnac: Floats  # (runs, segments): Sagnac phase in turns, by segment or by pair
    by_pair: bool  # which of the two
    noise: Floats  # (runs, 2 pairs): Detector noise of every sample, in counts of its converter
