"""A digital closed-loop fibre gyro, simulated at every transit time tau of its coil.

Each tau the staircase rises by the feedback step S and by the injected step, and falls back by the full range of
the converter when it runs over. The two beams see the difference of the modulator's phase now and one tau ago:

    difference = phi_s + [phi_m(t) - phi_m(t - tau)] + square-wave bias of +-pi/2                           (16)
    intensity  = A [1 + V cos(difference)] + noise, cut to whole steps of the detector's converter          (17)

Every second tau the difference of the last two samples, -2 A V sin(phi_s + step), moves S; the output is the mean
of S over the output period with its sign reversed. Everything after the converters is integer arithmetic, as in
the gate array of a real instrument.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats, Indices, Ints
from analysis.fibre_gyro.loop import kernels
from analysis.fibre_gyro.loop.design import FibreCoil, LoopDesign, LoopTrace, OutputBlock, OutputClock
from analysis.fibre_gyro.loop.kernels import (
    NORMAL,
    PHASE,
    REGISTER,
    RESET,
    RESETS,
    SPAN,
    STEPS,
    LoopConstants,
    LoopInput,
    loop_constants,
)

Rate = ArrayLike | Callable[[Floats], ArrayLike]
Kernel = Literal["auto", "numba", "numpy"]
RunPairs = Callable[[LoopConstants, Floats, Ints, Floats, LoopInput, Ints], None]

_CHUNK_SAMPLES = 1 << 19
_MANY_RUNS = 12  # from here on NumPy is faster than plain Python


class ClosedLoop:
    """One gyro, or several of the same build side by side, with the state of its registers.

    Parameters
    ----------
    seed : int, optional
        Of the noise. Every run has a stream of its own, the same whatever the kernel and however the time is cut.
    runs : int, optional
        Gyros side by side; they differ in noise, rate and injected step.
    kernel : {"auto", "numba", "numpy"}, optional
        "auto" takes Numba where it is installed, else plain Python for a few runs and NumPy for many. All of them
        give the same numbers.

    Raises
    ------
    ValueError
        No run, or Numba asked for and not installed.

    Examples
    --------
    >>> gyro = ClosedLoop(FibreCoil(), LoopDesign(), kernel="numpy")
    >>> block = gyro.run(2, output_period_s=2e-3, rate_dps=1.0)
    >>> bool(abs(block.counts[1] / 246.153 - 1.0) < 0.002)
    True
    """

    def __init__(
        self, coil: FibreCoil, design: LoopDesign, seed: int = 0, *, runs: int = 1, kernel: Kernel = "auto"
    ) -> None:
        if runs < 1:
            raise ValueError(f"the number of runs must be at least 1, not {runs}")
        self.coil, self.design, self.runs = coil, design, runs
        self._run_pairs = _kernel(kernel, runs)
        self._phase = design.converter_phase()
        self._noise = design.detector_noise(coil)
        self._streams = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(runs)]
        self._words = np.zeros((runs, 3), dtype=np.int64)
        self._phases = np.zeros((runs, 3))
        self._phases[:, SPAN] = 1.0 + design.two_pi_error
        self._phases[:, PHASE] = self._phase[0] * self._phases[:, SPAN]
        self._clock = OutputClock(coil)

    @property
    def time_s(self) -> float:
        """End of the last output period since the start."""
        return self._clock.time

    @property
    def largest_step(self) -> float:
        """Largest injected step, codes."""
        return self.design.largest_step

    @property
    def two_pi_error(self) -> Floats:
        """Present 2 pi error of every run, shape (runs,): the second loop trims it."""
        return np.asarray(self._phases[:, SPAN] - 1.0)

    def clear_feedback(self) -> None:
        """Set the feedback step to zero; an open loop stays there."""
        self._words[:, REGISTER] = 0

    def run(
        self,
        n_outputs: int,
        *,
        output_period_s: float = 0.01,
        rate_dps: Rate = 0.0,
        injected_step: ArrayLike = 0.0,
        closed: bool | None = None,
    ) -> OutputBlock:
        """Next output words; the gyro goes on from where it is.

        An output period holds the sample pairs that end in it, so that outputs come at exact times on average.

        Parameters
        ----------
        rate_dps : float, array_like of shape (n_outputs,) or (runs, n_outputs) or (runs, 1), or callable
            A callable gets the times of the sample pairs since the start and returns the rate at each.
        injected_step : array_like, optional
            Codes each transit time, rounded to the resolution; shapes as those of the rate.
        closed : bool, optional
            False: the feedback step stays as it is. Default: as in the design.

        Raises
        ------
        ValueError
            No output, a period shorter than one sample pair, an injected step beyond half of the converter's
            range, or shapes that do not fit.
        """
        rate = rate_dps if callable(rate_dps) else self._by_output(rate_dps, n_outputs)
        steps = self.design.injected_units(self._by_output(injected_step, n_outputs))
        pair = self._clock.pairs
        ends, in_output = self._clock.next_outputs(n_outputs, output_period_s)
        constants = loop_constants(self.design, closed=self.design.closed if closed is None else closed)
        total = np.zeros((self.runs, n_outputs, 4), dtype=np.int64)
        for chunk in _chunks(in_output, max(1, _CHUNK_SAMPLES // (2 * self.runs))):
            drive = self._drive(chunk, rate, steps, pair)
            sums = np.zeros((self.runs, chunk.output.size, 4), dtype=np.int64)
            self._run_pairs(constants, self._phase, self._words, self._phases, drive, sums)
            for place, output in enumerate(chunk.output.tolist()):
                total[:, output] += sums[:, place]
            pair += int(chunk.pairs.sum())
        return self._block(ends, output_period_s, in_output, total)

    def trace(
        self, n_samples: int, *, rate_dps: float = 0.0, injected_step: float = 0.0, closed: bool | None = None
    ) -> LoopTrace:
        """Signals of the first gyro at every transit time, for a plot; the gyro goes on as in :meth:`run`."""
        chunk = _Chunk(np.zeros(1, dtype=np.intp), np.array([(n_samples + 1) // 2]))
        steps = self.design.injected_units(np.full((self.runs, 1), float(injected_step)))
        first = self._clock.pairs
        drive = self._drive(chunk, np.full((self.runs, 1), float(rate_dps)), steps, first)
        constants = loop_constants(self.design, closed=self.design.closed if closed is None else closed)
        seen: list[kernels.PairSignals] = []
        sums = np.zeros((self.runs, 1, 4), dtype=np.int64)

        def watch(pair: kernels.PairSignals) -> None:
            seen.append(pair.of_run(0))

        kernels.run_pairs(constants, self._phase, self._words, self._phases, drive, sums, watch)
        self._clock.pairs += int(chunk.pairs[0])
        self._clock.time = self._clock.pairs * self._clock.pair_time
        return _trace(seen, 2 * first + 1, self.coil, self.design)

    def _by_output(self, value: ArrayLike, n_outputs: int) -> Floats:
        return np.broadcast_to(np.asarray(value, dtype=np.float64), (self.runs, n_outputs))

    def _drive(
        self, chunk: _Chunk, rate: Floats | Callable[[Floats], ArrayLike], steps: Ints, first: int
    ) -> LoopInput:
        """Noise, Sagnac phase and injected steps of one chunk."""
        n_pairs = int(chunk.pairs.sum())
        if callable(rate):
            times = (first + 0.5 + np.arange(n_pairs, dtype=np.float64)) * self._clock.pair_time
            rates = np.broadcast_to(np.asarray(rate(times), dtype=np.float64), (self.runs, n_pairs))
        else:
            rates = rate[:, chunk.output]
        noise = np.empty((self.runs, 2 * n_pairs))
        for row, stream in zip(noise, self._streams, strict=True):
            stream.standard_normal(out=row)
        noise *= self._noise
        turns = (rates + self.design.bias_dph / 3600.0) * self.coil.turns_per_dps
        injected = np.ascontiguousarray(steps[:, chunk.output])
        return LoopInput(chunk.pairs, injected, np.ascontiguousarray(turns), callable(rate), noise)

    def _block(self, ends: Floats, period: float, pairs: Ints, total: Ints) -> OutputBlock:
        unit = 2.0**self.design.fractional_bits
        resets = total[..., RESETS]
        with np.errstate(invalid="ignore"):
            normal, at_reset = total[..., NORMAL] / (pairs - resets), total[..., RESET] / resets
        counts = -total[..., STEPS] / (pairs * unit)
        if self.runs == 1:
            return OutputBlock(ends, period, counts[0], normal[0], at_reset[0], resets[0])
        return OutputBlock(ends, period, counts, normal, at_reset, resets)


class _Chunk(NamedTuple):
    """Some segments of time: the output that each belongs to, and its sample pairs."""

    output: Indices
    pairs: Ints


def _chunks(in_output: Ints, most: int) -> Iterator[_Chunk]:
    """Cut outputs of so many pairs into chunks of at most `most` pairs; a long output is cut into segments."""
    outputs: list[int] = []
    pairs: list[int] = []
    room = most
    for output, left in enumerate(in_output.tolist()):
        while left:
            taken = min(left, room)
            outputs.append(output)
            pairs.append(taken)
            left, room = left - taken, room - taken
            if not room:
                yield _Chunk(np.array(outputs, dtype=np.intp), np.array(pairs, dtype=np.int64))
                outputs, pairs, room = [], [], most
    if outputs:
        yield _Chunk(np.array(outputs, dtype=np.intp), np.array(pairs, dtype=np.int64))


def _kernel(name: Kernel, runs: int) -> RunPairs:
    """Kernel by name; Numba is loaded only here."""
    if name not in ("auto", "numba", "numpy"):
        raise ValueError(f"the kernel must be 'auto', 'numba' or 'numpy', not {name!r}")
    if name == "numpy":
        return kernels.run_pairs
    scalar = import_module("analysis.fibre_gyro.loop.compiled_kernel")
    if name == "numba" and not scalar.COMPILED:
        raise ValueError("the compiled loop needs Numba: install gyrolock[fast], or take the kernel 'auto'")
    many = runs >= _MANY_RUNS and not scalar.COMPILED
    run_pairs: RunPairs = kernels.run_pairs if many else scalar.run_pairs
    return run_pairs


def _trace(seen: list[kernels.PairSignals], first: int, coil: FibreCoil, design: LoopDesign) -> LoopTrace:
    """Signals of the first run, pair after pair, as one series."""
    staircase, code, adc = (np.concatenate([pair[field] for pair in seen]) for field in (0, 1, 5))
    phase, turns, level = (np.concatenate([pair[field] for pair in seen]) for field in (2, 3, 4))
    half_range = (design.wrap << design.fractional_bits) // 2
    fallen = np.abs(np.diff(staircase, prepend=staircase[:1])) > half_range
    return LoopTrace(
        times_s=(first + np.arange(code.size, dtype=np.float64)) * coil.transit_time,
        staircase=staircase >> design.fractional_bits,
        code=code,
        modulator_rad=2.0 * np.pi * phase,
        difference_rad=2.0 * np.pi * turns,
        intensity=level / (2.0 * design.adc_half_range * design.light_level),
        adc=adc,
        reset=fallen,
    )
