"""The loop at every transit time, one gyro after the other: compiled where Numba is installed, else plain Python.

Imported only when it is used: Numba takes a second to load. The machine code is cached beside this file or, where
that cannot be written, in the user's cache folder.
"""

from collections.abc import Callable
from typing import Any

from analysis.arrays import Floats, Ints
from analysis.fibre_gyro.loop.kernels import (
    COSINE,
    NORMAL,
    PHASE,
    RAMP,
    REGISTER,
    RESET,
    RESETS,
    SECOND_PHASE,
    SECOND_RAMP,
    SPAN,
    STEPS,
    LoopConstants,
    LoopInput,
)

try:
    import numba
except ImportError:
    COMPILED = False
else:
    COMPILED = True


_C0, _C1, _C2, _C3, _C4, _C5, _C6 = COSINE


def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile, and keep the machine code where some folder for it can be written."""
    if not COMPILED:
        return function
    try:
        return numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:
        return numba.njit(nogil=True)(function)


@_compiled
def _converted(constants: LoopConstants, turns: float, noise: float) -> int:
    """Counts of the detector's converter: the cosine as in the NumPy kernel, noise, rounding, clipping."""
    u = 0.25 - abs(turns - round(turns))
    w = u * u
    cosine = ((((((w * _C6 + _C5) * w + _C4) * w + _C3) * w + _C2) * w + _C1) * w + _C0) * u
    level = constants.amplitude * cosine + constants.mean_level
    return int(min(max(level + noise, 0.0), constants.adc_top))


@_compiled
def _raised(ramp: int, step: int, wrap_steps: int) -> tuple[int, int]:
    """Staircase one step on, and whether it has fallen: 1 from the top, -1 from the bottom."""
    ramp += step
    if ramp >= wrap_steps:
        return ramp - wrap_steps, 1
    if ramp < 0:
        return ramp + wrap_steps, -1
    return ramp, 0


@_compiled
def _run_one(
    constants: LoopConstants,
    converter_phase: Floats,
    words: Ints,
    phases: Floats,
    pairs: Ints,
    injected: Ints,
    sagnac: Floats,
    by_pair: bool,
    noise: Floats,
    sums: Ints,
) -> None:
    """All segments of one gyro; the arguments are one row of those of the NumPy kernel."""
    # plain numbers: those of NumPy would make plain Python slow
    ramp, register, second_ramp = int(words[RAMP]), int(words[REGISTER]), int(words[SECOND_RAMP])
    before, second_before, span = float(phases[PHASE]), float(phases[SECOND_PHASE]), float(phases[SPAN])
    bits, wrap_steps, limit = constants.fractional_bits, constants.wrap_steps, constants.register_limit
    pair = 0
    for segment in range(pairs.size):
        number = int(injected[segment])
        steps = normal = at_reset = resets = 0
        for _ in range(pairs[segment]):
            rate_phase = sagnac[pair if by_pair else segment]
            step = register >> constants.guard_bits
            total = step if constants.separate else step + number
            ramp, falls = _raised(ramp, total, wrap_steps)
            code = (ramp >> bits) + constants.quarter
            if constants.bias_in_wrap and code >= constants.wrap:
                code -= constants.wrap
            even_phase = converter_phase[code] * span
            ramp, fall = _raised(ramp, total, wrap_steps)
            falls += fall
            odd_phase = converter_phase[ramp >> bits] * span
            even, odd = (even_phase - before) + rate_phase, (odd_phase - even_phase) + rate_phase
            before, passed = odd_phase, falls != 0
            if constants.separate:
                second_ramp, first_fall = _raised(second_ramp, number, wrap_steps)
                even_phase = (second_ramp >> bits) * constants.second_span
                second_ramp, fall = _raised(second_ramp, number, wrap_steps)
                odd_phase = (second_ramp >> bits) * constants.second_span
                even, odd = even + (even_phase - second_before), odd + (odd_phase - even_phase)
                second_before, passed = odd_phase, passed or first_fall + fall != 0
            error = _converted(constants, even, noise[2 * pair]) - _converted(constants, odd, noise[2 * pair + 1])
            if constants.trim_gain != 0.0:
                span -= constants.trim_gain * (falls * error)
            if not (constants.gated and passed):
                register = min(max(register + constants.error_gain * error, -limit), limit)
            steps += step
            if passed:
                at_reset += error
                resets += 1
            else:
                normal += error
            pair += 1
        sums[segment, STEPS], sums[segment, NORMAL] = steps, normal
        sums[segment, RESET], sums[segment, RESETS] = at_reset, resets
    words[RAMP], words[REGISTER], words[SECOND_RAMP] = ramp, register, second_ramp
    phases[PHASE], phases[SECOND_PHASE], phases[SPAN] = before, second_before, span


def run_pairs(
    constants: LoopConstants, converter_phase: Floats, words: Ints, phases: Floats, drive: LoopInput, sums: Ints
) -> None:
    """Run the loops over all segments; parameters as those of the NumPy kernel."""
    table: Any = converter_phase if COMPILED else converter_phase.data
    for run in range(words.shape[0]):
        sagnac, noise = (v[run] if COMPILED else v[run].tolist() for v in (drive.sagnac, drive.noise))
        by_run = (drive.pairs, drive.injected[run], sagnac, drive.by_pair, noise, sums[run])
        _run_one(constants, table, words[run], phases[run], *by_run)
