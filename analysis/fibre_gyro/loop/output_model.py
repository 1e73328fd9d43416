"""The closed-loop gyro at the level of its output words, for runs of minutes; the same laws without the loop.

Per transit time, with every quantity in codes, the mean of what the beams see is driven to zero:

    (1 + eps) S + K0 Omega + (1 + eps_inj) S_inj' - P F = 0                                                (20)

S the step of the staircase, S_inj' an injected step on a second electrode. F are the falls of the staircase per
transit time: where all sample pairs enter the loop, each fall is seen as the pulse P = 2^N sin(2 pi d)/(2 pi), d
the excess of the fall over one whole turn. The pulses make the mean scale that of the optical 2 pi, and a ripple.
Where the pairs with a fall are left out P is 0, and 1 + eps stays in the scale. White noise, rounding of the step
and the settling of a first-order loop are added. Not in the model: bow of the converter, dead zone, lost fringes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats, Ints
from analysis.fibre_gyro.loop.design import FibreCoil, LoopDesign, OutputBlock, OutputClock

Rate = ArrayLike | Callable[[Floats], ArrayLike]

_ROUNDING_VARIANCE = 1.0 / 12.0


class OutputModel:
    """One gyro, or several side by side, by the output word.

    Parameters
    ----------
    seed : int, optional
        Every run has a noise of its own, the same however the time is cut.

    Raises
    ------
    ValueError
        No run.

    Examples
    --------
    >>> gyro = OutputModel(FibreCoil(), LoopDesign(two_pi_error=0.001))
    >>> block = gyro.run(2000, rate_dps=1.0)
    >>> bool(abs(block.counts[1:].mean() / (FibreCoil().nominal_scale(16) / 1.001) - 1) < 1e-4)
    True
    """

    def __init__(self, coil: FibreCoil, design: LoopDesign, seed: int = 0, *, runs: int = 1) -> None:
        if runs < 1:
            raise ValueError(f"the number of runs must be at least 1, not {runs}")
        self.coil, self.design, self.runs = coil, design, runs
        self._streams = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(runs)]
        self._clock = OutputClock(coil)
        self._laws = _laws(coil, design)
        self._feedback = np.zeros(runs)
        self._rounded_off = np.zeros(runs)
        self._ramp, self._second_ramp = _Ramp(runs), _Ramp(runs)

    @property
    def time_s(self) -> float:
        """End of the last output period since the start."""
        return self._clock.time

    @property
    def largest_step(self) -> float:
        """Largest injected step, codes."""
        return self.design.largest_step

    def clear_feedback(self) -> None:
        """Set the feedback step to zero; an open loop stays there."""
        self._feedback[:] = 0.0

    def run(
        self,
        n_outputs: int,
        *,
        output_period_s: float = 0.01,
        rate_dps: Rate = 0.0,
        injected_step: ArrayLike = 0.0,
        closed: bool | None = None,
    ) -> OutputBlock:
        """Next output words; parameters as those of :meth:`ClosedLoop.run`.

        A callable rate is called with the start, middle and end of the output periods.

        Raises
        ------
        ValueError
            As there, and for a rate with a Sagnac phase beyond pi: there the loop settles on another fringe.
        """
        steps = self.design.injected_units(np.broadcast_to(np.asarray(injected_step), (self.runs, n_outputs)))
        injected = np.asarray(steps * self.design.step_resolution, dtype=np.float64)
        start = self._clock.time
        ends, pairs = self._clock.next_outputs(n_outputs, output_period_s)
        codes_per_dps = self.coil.nominal_scale(self.design.dac_bits)
        optical = np.asarray(codes_per_dps * self._mean_rate(rate_dps, start, ends), dtype=np.float64)
        noise = np.stack([stream.standard_normal((n_outputs, 3)) for stream in self._streams])
        drive = _Drive(optical, injected, pairs, noise)
        is_closed = self.design.closed if closed is None else closed
        fields = self._closed(drive) if is_closed else self._open(drive)
        if self.runs == 1:
            fields = _Fields(*(field[0] for field in fields))
        return OutputBlock(ends, output_period_s, fields.counts, fields.normal, fields.reset, fields.resets)

    def _mean_rate(self, rate_dps: Rate, start: float, ends: Floats) -> Floats:
        """Mean rate of every output with the bias, shape (runs, n)."""
        if callable(rate_dps):
            starts = np.concatenate(([start], ends[:-1]))
            first, middle, last = (
                np.asarray(rate_dps(t), dtype=np.float64) for t in (starts, (starts + ends) / 2, ends)
            )
            given = (first + 4.0 * middle + last) / 6.0
        else:
            given = np.asarray(rate_dps, dtype=np.float64)
        rate = np.broadcast_to(given, (self.runs, ends.size)) + self.design.bias_dph / 3600.0
        limit = self.coil.fringe_limit_dps
        if not np.all(np.abs(rate) < limit):
            raise ValueError(
                f"the rate must be within {limit:.5g} deg/s, a Sagnac phase of pi: beyond it the gyro reads "
                f"another fringe"
            )
        return rate

    def _closed(self, drive: _Drive) -> _Fields:
        laws = self._laws
        injected_on_main = 0.0 if laws.separate else drive.injected
        needed = drive.optical.copy()
        resets = np.zeros(needed.shape, dtype=np.int64)
        if laws.separate:
            falls, seen = self._falls(self._second_ramp, drive.injected, drive.pairs, laws.wrap)
            needed += laws.second_span * drive.injected - laws.second_pulse * seen / (2 * drive.pairs)
            resets += np.abs(falls)
        # without the pulses first: they make the staircase fall a little early
        staircase = -needed / laws.span
        jump = laws.pulse / laws.span
        falls, seen = self._falls(self._ramp, staircase, drive.pairs, laws.wrap - jump)
        resets += np.abs(falls)
        left = 1.0 - np.minimum(resets / drive.pairs, 0.9) if laws.gated else np.ones_like(needed)
        target = staircase + jump * seen / (2 * drive.pairs) - injected_on_main
        end = staircase - injected_on_main
        # The step at the end is a low pass of the noise, of variance sigma^2 g/(2 - g), and holds part of its
        # own noise; the rest is independent.
        pairs, gain = drive.pairs * left, laws.gain
        last = laws.step_noise * np.sqrt(gain / (2.0 - gain)) * drive.noise[..., 0]
        regression = (2.0 - gain) / gain
        rest = laws.step_noise * np.sqrt(np.maximum(pairs - regression, 0.0)) * drive.noise[..., 1]
        noisy, state = target + (regression * last + rest) / pairs, end + last
        # the loop comes from the state at the end of the output before
        before = np.concatenate((self._feedback[:, None], state[:, :-1]), axis=1)
        self._feedback = state[:, -1].copy()
        counts = -self._rounded(noisy - (state - before) / (gain * pairs), drive.pairs)
        nan = np.full(counts.shape, np.nan)
        return _Fields(counts, nan, nan, np.minimum(resets, drive.pairs))

    def _open(self, drive: _Drive) -> _Fields:
        """Feedback held: the errors of pairs without and with a fall, by equations (18) and (19)."""
        laws = self._laws
        feedback = np.broadcast_to(self._feedback[:, None], drive.optical.shape)
        staircase = feedback + (0.0 if laws.separate else drive.injected)
        second = laws.second_span * drive.injected if laws.separate else 0.0
        phase = laws.span * staircase + drive.optical + second
        falls, _seen = self._falls(self._ramp, staircase, drive.pairs, laws.wrap)
        turn = 2.0 * np.pi / laws.codes
        fallen = phase - np.sign(falls) * laws.excess * laws.codes
        resets = np.minimum(np.abs(falls), drive.pairs)
        normal = -2.0 * laws.amplitude * np.sin(turn * phase)
        at_reset = -laws.amplitude * (np.sin(turn * phase) + np.sin(turn * fallen))
        with np.errstate(divide="ignore", invalid="ignore"):
            normal = normal + laws.error_noise * drive.noise[..., 0] / np.sqrt(drive.pairs - resets)
            at_reset = at_reset + laws.error_noise * drive.noise[..., 1] / np.sqrt(resets)
        at_reset[resets == 0] = np.nan
        return _Fields(np.asarray(-feedback), normal, at_reset, resets)

    def _falls(self, ramp: _Ramp, step: Floats, pairs: Ints, wrap: float) -> tuple[Ints, Floats]:
        """Signed falls of a staircase in each output, and how many of their pulses the loop has followed."""
        # Each pulse is followed with the time constant of the loop. On a steady staircase the parts still to come
        # are a geometric series, whose sum is known from the time since the last fall.
        rate = step / wrap
        place = ramp.place[:, None] + np.cumsum(rate * (2 * pairs), axis=1)
        turns = np.floor(place)
        falls = np.diff(turns, axis=1, prepend=0.0).astype(np.int64)
        since = np.where(rate < 0, 1.0 - (place - turns), place - turns)
        decay = self._laws.decay / np.maximum(np.abs(rate), 1e-12)
        to_come = np.sign(rate) * np.exp(-decay * since) / -np.expm1(-decay)
        seen = falls - np.diff(to_come, axis=1, prepend=ramp.to_come[:, None])
        ramp.place, ramp.to_come = place[:, -1] - turns[:, -1], to_come[:, -1].copy()
        return falls, seen

    def _rounded(self, mean: Floats, pairs: Ints) -> Floats:
        """Steps in whole units; what is rounded off stays in the accumulator and comes in the next output."""
        unit = self.design.step_resolution
        total = self._rounded_off[:, None] + np.cumsum(mean * pairs, axis=1)
        whole = unit * np.floor(total / unit)
        self._rounded_off = total[:, -1] - whole[:, -1]
        return np.diff(whole, axis=1, prepend=0.0) / pairs


class _Ramp:
    """Place of a staircase in turns of its wrap, and pulses of its falls that the loop has still to follow."""

    def __init__(self, runs: int) -> None:
        self.place, self.to_come = np.zeros(runs), np.zeros(runs)


class _Drive(NamedTuple):
    """Inputs by output, shape (runs, n): K0 Omega and injected step in codes; pairs (n,); noise (runs, n, 3)."""

    optical: Floats
    injected: Floats
    pairs: Ints
    noise: Floats


class _Fields(NamedTuple):
    counts: Floats
    normal: Floats
    reset: Floats
    resets: Ints


class _Laws(NamedTuple):
    """Numbers of equation (20) in codes; noises of one sample pair; decay of the loop in one transit time."""

    codes: int
    span: float
    second_span: float
    wrap: float
    excess: float
    pulse: float
    second_pulse: float
    gated: bool
    separate: bool
    gain: float
    decay: float
    step_noise: float
    amplitude: float
    error_noise: float


def _laws(coil: FibreCoil, design: LoopDesign) -> _Laws:
    codes, wrap = design.codes, design.wrap
    # the second loop, once it has settled, makes the fall one whole turn
    span = 1.0 + design.two_pi_error if design.two_pi_loop_gain == 0 else codes / wrap
    excess, second_excess = span * wrap / codes - 1.0, (1 + design.injection_two_pi_error) * wrap / codes - 1.0
    pulse, second_pulse = (codes * np.sin(2 * np.pi * d) / (2 * np.pi) for d in (excess, second_excess))
    bias = np.sin(np.pi / 2 * span)
    amplitude = design.adc_half_range * design.light_level * design.contrast * bias
    error_noise = np.sqrt(2.0 * (design.detector_noise(coil) ** 2 + _ROUNDING_VARIANCE))
    gain = design.loop_gain * design.light_level * design.contrast * bias * span
    return _Laws(
        codes=codes,
        span=span,
        second_span=1.0 + design.injection_two_pi_error,
        wrap=float(wrap),
        excess=excess,
        pulse=0.0 if design.gated else float(pulse),
        second_pulse=0.0 if design.gated else float(second_pulse),
        gated=design.gated,
        separate=design.injection_path == "separate",
        gain=float(gain),
        decay=float(-np.log(abs(1.0 - gain)) / 2.0) if gain != 1.0 else 1e3,
        step_noise=float(error_noise / (2 * amplitude) * codes / (2 * np.pi) / span),
        amplitude=float(amplitude),
        error_noise=float(error_noise),
    )
