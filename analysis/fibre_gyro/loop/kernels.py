"""The loop at every transit time with NumPy: several gyros side by side, one sample pair after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from analysis.arrays import Floats, Ints
from analysis.fibre_gyro.loop.design import GUARD_BITS, LoopDesign


class PairSignals(NamedTuple):
    """Signals of one sample pair of all runs; shape (2, runs) each, for a trace. Valid until the next pair."""

    staircase: Ints
    code: Ints
    phase: Floats
    turns: Floats
    level: Floats
    adc: Ints

    def of_run(self, run: int) -> PairSignals:
        """Copy of one run's signals, shape (2,) each."""
        staircase, code, adc = (signal[:, run].copy() for signal in (self.staircase, self.code, self.adc))
        phase, turns, level = (signal[:, run].copy() for signal in (self.phase, self.turns, self.level))
        return PairSignals(staircase, code, phase, turns, level, adc)


Watch = Callable[[PairSignals], None]


def run_pairs(
    constants: LoopConstants,
    converter_phase: Floats,
    words: Ints,
    phases: Floats,
    drive: LoopInput,
    sums: Ints,
    watch: Watch | None = None,
) -> None:
    """Run the loops over all segments."""
    # Shapes: converter_phase (codes * 3/2,), words (runs, 3), phases (runs, 3), sums (runs, segments, 4).
    loops = _Loops(constants, converter_phase, words, phases)
    runs, total = words.shape[0], int(drive.pairs.sum())
    # one row a pair, so that the loop only picks rows
    noise = np.ascontiguousarray(drive.noise.T).reshape(total, 2, runs)
    sagnac = np.ascontiguousarray(drive.sagnac.T)
    injected = np.ascontiguousarray(drive.injected.T)
    log = np.zeros((3, total, runs), dtype=np.int64)
    segment_of = np.repeat(np.arange(drive.pairs.size), drive.pairs)
    for pair, (samples, segment) in enumerate(zip(noise, segment_of.tolist(), strict=True)):
        loops.step_pair(injected[segment], sagnac[pair if drive.by_pair else segment], samples, log[:, pair])
        if watch is not None:
            watch(loops.signals())
    loops.save(words, phases)
    step, error, falls = log
    starts = np.cumsum(drive.pairs) - drive.pairs
    reset = falls != 0
    rows = {STEPS: step, NORMAL: np.where(reset, 0, error), RESET: np.where(reset, error, 0), RESETS: reset}
    for column, row in rows.items():
        sums[:, :, column] = np.add.reduceat(row, starts, axis=0, dtype=np.int64).T


class _Loops:
    """Registers of loops side by side, and the arrays that every pair writes into: making them takes the time."""

    def __init__(self, constants: LoopConstants, converter_phase: Floats, words: Ints, phases: Floats) -> None:
        runs = words.shape[0]
        self.constants, self.converter_phase = constants, converter_phase
        self.register, self.span = words[:, REGISTER].copy(), phases[:, SPAN].copy()
        # rows: one transit time before the pair, even sample, odd sample
        self.ramp, self.second_ramp = (np.tile(words[:, c], (3, 1)) for c in (RAMP, SECOND_RAMP))
        self.phase, self.second_phase = (np.tile(phases[:, c], (3, 1)) for c in (PHASE, SECOND_PHASE))
        self.code, self.adc = (np.zeros((2, runs), dtype=np.int64) for _ in range(2))
        self.turns, self.level, self.u, self.w = (np.zeros((2, runs)) for _ in range(4))
        self.falls, self.second_falls, self.change = (np.zeros(runs, dtype=np.int64) for _ in range(3))

    def save(self, words: Ints, phases: Floats) -> None:
        """Put the state back."""
        words[:, RAMP], words[:, SECOND_RAMP] = self.ramp[2], self.second_ramp[2]
        words[:, REGISTER] = self.register
        phases[:, PHASE], phases[:, SECOND_PHASE] = self.phase[2], self.second_phase[2]
        phases[:, SPAN] = self.span

    def signals(self) -> PairSignals:
        """Signals of the last pair."""
        return PairSignals(self.ramp[1:], self.code, self.phase[1:], self.turns, self.level, self.adc)

    def step_pair(self, injected: Ints, sagnac: Floats, noise: Floats, log: Ints) -> None:
        """Two transit times with one step, then the loop's reaction; `log` gets step, error and falls."""
        step, error, falls = log
        np.right_shift(self.register, self.constants.guard_bits, out=step)
        separate = self.constants.separate
        self._raise(self.ramp, step if separate else step + injected, self.falls)
        self._convert_codes()
        np.add(self.turns, sagnac, out=self.turns)
        falls[:] = self.falls
        if separate:
            self._raise(self.second_ramp, injected, self.second_falls)
            np.bitwise_or(self.falls, self.second_falls, out=falls)
            phase = self.second_phase
            phase[0] = phase[2]
            second_code = self.second_ramp[1:] >> self.constants.fractional_bits
            np.multiply(second_code, self.constants.second_span, out=phase[1:])
            self.turns += phase[1:] - phase[:2]
        self._detect(noise)
        np.subtract(self.adc[0], self.adc[1], out=error)
        self._react(error, falls)

    def _raise(self, ramp: Ints, step: Ints, falls: Ints) -> None:
        """Raise a staircase twice, and count how often it has fallen in the pair."""
        wrap_steps = self.constants.wrap_steps
        ramp[0] = ramp[2]
        np.add(ramp[0], step, out=ramp[1])
        np.add(ramp[1], step, out=ramp[2])
        np.floor_divide(ramp[2], wrap_steps, out=falls)
        np.remainder(ramp[1:], wrap_steps, out=ramp[1:])

    def _convert_codes(self) -> None:
        """Bias, code, modulator phase, and its difference over one transit time."""
        constants, code, phase = self.constants, self.code, self.phase
        np.right_shift(self.ramp[1:], constants.fractional_bits, out=code)
        code[0] += constants.quarter
        if constants.bias_in_wrap:
            code[0] %= constants.wrap
        phase[0] = phase[2]
        np.multiply(self.converter_phase[code], self.span, out=phase[1:])
        np.subtract(phase[1:], phase[:2], out=self.turns)

    def _detect(self, noise: Floats) -> None:
        """Intensity of the samples, and what the detector's converter makes of it."""
        level, u = self.level, self.u
        cosine_of_turns(self.turns, level, u, self.w)
        level *= self.constants.amplitude
        level += self.constants.mean_level
        np.add(level, noise, out=u)
        np.maximum(u, 0.0, out=u)
        np.minimum(u, self.constants.adc_top, out=u)
        self.adc[:] = u

    def _react(self, error: Ints, falls: Ints) -> None:
        """Move the step by the error of the pair, and trim the converter's span after a fall of the staircase."""
        constants, change = self.constants, self.change
        if constants.trim_gain != 0.0:
            self.span -= constants.trim_gain * (self.falls * error)
        if constants.error_gain == 0:
            return
        np.multiply(error, constants.error_gain, out=change)
        if constants.gated:
            change *= falls == 0
        np.add(self.register, change, out=change)
        np.maximum(change, -constants.register_limit, out=change)
        np.minimum(change, constants.register_limit, out=self.register)


def cosine_of_turns(turns: Floats, out: Floats, u: Floats, w: Floats) -> None:
    """cos(2 pi t) to 1e-13 into `out`, by the same operations as the scalar kernel; `u` and `w` are scratch."""
    np.rint(turns, out=w)
    np.subtract(turns, w, out=u)
    np.abs(u, out=u)
    np.subtract(0.25, u, out=u)
    np.multiply(u, u, out=w)
    np.multiply(w, COSINE[-1], out=out)
    for coefficient in COSINE[-2:0:-1]:
        out += coefficient
        out *= w
    out += COSINE[0]
    out *= u


# --------------------
# Numbers that both loop kernels work with: constants of the gates, state of the registers, inputs and sums.
#
# Both kernels do the same operations on the same numbers in the same order, so that they agree to the last bit.
# The cosine is therefore a polynomial here, and not the one of a library, which differs between NumPy and compiled
# code


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
