"""The staircase on a gyro's phase modulator, as an oscilloscope shows it: step, step time, reset, 2-pi voltage.

Level k of a modulo counter that grows by h each step, with a square wave b in step with it (the bias), is

    v_k = c + h k + b p_k - R w_k

with p_k = 0, 1, 0, 1, ..., and w_k the number of resets so far. R, all codes of the converter, is the voltage that
should be two pi of phase. A reset is seen as a fall by R - h, because a step comes with it. The w_k are whole
numbers and follow from differences between levels of the same p; the rest is a linear fit.

Voltages are as good as the oscilloscope's gain, which no record can tell; ratios of them are free of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats, Ints
from analysis.fibre_gyro.staircase.cut import MINIMUM_STEPS, Cut, check_period, find_cut
from analysis.fibre_gyro.staircase.levels import Levels, read_levels
from analysis.fibre_gyro.staircase.rounded_fit import (
    RoundedFit,
    converter_spacing,
    dither_of,
    fit_rounded,
    rounding_left,
)

FEW_RESETS = 3
FEW_SAMPLES_PER_STEP = 6
MISFIT = 4.0
"""Variance of the levels, over that of noise and rounding, beyond which they are no even staircase."""

_WHITE = 0.5  # noise in levels before the converter from which on rounding is white to two per cent
_EDGE_TO_POLE = 2.2  # width of the edge of a single pole from 10 % to 90 %, over its time constant
_CLEAR = 20.0  # times the noise: jumps that show which samples lie on an edge

_TOO_FEW_STEPS = (
    "fewer than five steps lie between two resets, so steps and resets cannot be told apart: inject a smaller step"
)
_SENTENCES = {
    "no_reset": "No reset is in the record: the 2-pi voltage is unknown. Use a slower time base or a larger step.",
    "few_resets": "Fewer than 3 resets are in the record: the 2-pi voltage rests on few levels.",
    "not_settled": "The levels have not settled when the next step comes: heights are those of the last samples.",
    "misfit": "The levels depart from an even staircase by more than their noise: converter nonlinearity, a "
    "clipped record or a changing step.",
    "few_samples_per_step": "Fewer than 6 samples a step: use a faster time base.",
}


@dataclass(frozen=True, eq=False)
class StaircaseWitness:
    """What a record of the modulator staircase says; in V and s, `_u` are standard uncertainties (k = 1).

    Attributes
    ----------
    step_height, step_height_u : float
        Change from level to level, bias taken off; negative for a falling staircase.
    reset_height, reset_height_u : float
        The fall that is seen at a reset, positive; nan without one.
    two_pi_voltage, two_pi_voltage_u : float
        Fall and step together: what all codes of the converter span.
    bias_height, bias_height_u : float
        Of the square wave on top; 0 if there is none.
    steps, resets : int
        That the record holds.
    noise_rms : float
        Of one sample about its level.
    level_spacing : float
        Of the converter where rounding is not white, else 0.
    settling_samples : int
        After each edge that were not used.
    times, levels, model : (K,)
        Middle of each level from the first sample on, its height as read, and as fitted.
    flags : tuple of str
        `describe_witness_flag` says what they mean.
    """

    step_height: float
    step_height_u: float
    step_time: float
    step_time_u: float
    reset_height: float
    reset_height_u: float
    two_pi_voltage: float
    two_pi_voltage_u: float
    bias_height: float
    bias_height_u: float
    steps: int
    resets: int
    noise_rms: float
    level_spacing: float
    settling_samples: int
    times: Floats
    levels: Floats
    model: Floats
    flags: tuple[str, ...]


def describe_witness_flag(name: str) -> str:
    """One sentence for the person who reads the result."""
    return _SENTENCES[name]


def two_pi_error_of_drive(
    two_pi_voltage: float,
    two_pi_voltage_u: float,
    half_wave_voltage: float,
    half_wave_voltage_u: float = 0.0,
) -> tuple[float, float]:
    """Relative 2-pi error of a modulator drive, ``V_2pi / (2 V_pi) - 1``, and its standard uncertainty.

    Parameters
    ----------
    two_pi_voltage, two_pi_voltage_u : float
        Of a `StaircaseWitness`.
    half_wave_voltage, half_wave_voltage_u : float
        V_pi of the modulator.

    Raises
    ------
    ValueError
        If V_pi is not positive.

    Examples
    --------
    >>> two_pi_error_of_drive(8.08, 0.08, 4.0)
    (0.01, 0.01)
    """
    if not half_wave_voltage > 0:
        raise ValueError(f"the half-wave voltage must be positive, not {half_wave_voltage:g} V")
    ratio = two_pi_voltage / (2 * half_wave_voltage)
    relative = np.hypot(two_pi_voltage_u / two_pi_voltage, half_wave_voltage_u / half_wave_voltage)
    return round(ratio - 1, 15), round(float(ratio * relative), 15)


def witness_staircase(
    volts: ArrayLike,
    sample_interval: float,
    *,
    step_time: float | None = None,
    gain_u: float = 0.0,
    time_base_u: float = 0.0,
) -> StaircaseWitness:
    """Measure the staircase in a record.

    Parameters
    ----------
    volts : (n,)
        nan marks a missing sample.
    sample_interval : float
        Seconds.
    step_time : float, optional
        In seconds, right to 2 %, if it is known: the transit time of the coil. Needed only where single steps
        hardly stand out of the noise.
    gain_u, time_base_u : float
        Relative standard uncertainties of the oscilloscope's volts and seconds; they enter every result.

    Raises
    ------
    ValueError
        If there is no staircase in the record, or not one that can be told; says why and what to change.
    """
    record = _checked(volts, sample_interval)
    cut = find_cut(record, None if step_time is None else step_time / sample_interval)
    check_period(cut.period, len(record))
    levels = read_levels(record, cut)
    _check_steps(levels)
    wraps, sign = _count_wraps(levels)
    fit, spacing = _fit_heights(record, levels, wraps, sign)
    period, period_u, start = _fit_times(record, cut, levels)
    height, resets, nan = fit.values["h"], int(np.ptp(wraps)), float("nan")
    two_pi, bias = fit.values.get("R", nan), fit.values.get("b", 0.0)
    fall, fall_u = two_pi - abs(height), fit.u_of(R=1.0, h=-sign) if resets else nan
    return StaircaseWitness(
        step_height=height,
        step_height_u=float(np.hypot(fit.u_of(h=1.0), gain_u * height)),
        step_time=period * sample_interval,
        step_time_u=float(np.hypot(period_u, time_base_u * period)) * sample_interval,
        reset_height=fall,
        reset_height_u=float(np.hypot(fall_u, gain_u * fall)),
        two_pi_voltage=two_pi,
        two_pi_voltage_u=float(np.hypot(fit.u_of(R=1.0) if resets else nan, gain_u * two_pi)),
        bias_height=abs(bias),
        bias_height_u=float(np.hypot(fit.u_of(b=1.0), gain_u * bias)),
        steps=int(np.ptp(levels.numbers)),
        resets=resets,
        noise_rms=levels.noise,
        level_spacing=spacing,
        settling_samples=levels.settling,
        times=np.asarray((start + (levels.numbers + 0.5) * period) * sample_interval),
        levels=levels.heights,
        model=fit.model,
        flags=_flags(levels, fit.scatter, resets, period),
    )


def _checked(volts: ArrayLike, sample_interval: float) -> Floats:
    record = np.asarray(volts, dtype=np.float64)
    if record.ndim != 1 or np.isfinite(record).sum() < 4 * MINIMUM_STEPS:
        raise ValueError(f"a record of one dimension with at least {4 * MINIMUM_STEPS} valid samples is needed")
    if np.isinf(record).any():
        raise ValueError("volts holds infinite values")
    if not (np.isfinite(sample_interval) and sample_interval > 0):
        raise ValueError(f"sample_interval must be a positive number of seconds, not {sample_interval!r}")
    if np.nanmax(record) - np.nanmin(record) <= 1e-9 * np.nanmax(np.abs(record)):
        raise ValueError("all samples are equal: no staircase is in the record")
    return record


def _check_steps(levels: Levels) -> None:
    """Levels must differ by more than their noise, and be level themselves."""
    if len(levels.numbers) < MINIMUM_STEPS:
        raise ValueError(f"only {len(levels.numbers)} levels can be read; {MINIMUM_STEPS} are the least")
    jump = float(np.median(np.abs(np.diff(levels.heights))))
    noise = levels.noise * float(np.sqrt(2 / np.median(levels.counts)))
    if jump < 3 * noise:
        raise ValueError(
            f"no steps stand out of the noise, or fewer than {MINIMUM_STEPS} are in the record: inject a larger "
            "step, use fewer volts per division or a slower time base, or give the step time"
        )
    if abs(levels.slope) > 0.5 * jump:
        raise ValueError(
            "the signal moves on between the edges, like a ramp, a sine or steps that never settle: inject a "
            "larger step or use a faster time base"
        )


# ---------------------------------------------------------------------- resets


def _count_wraps(levels: Levels) -> tuple[Ints, float]:
    """Resets before each level, (K,), and the sign of the staircase.

    Levels with and without the bias are followed separately; how far the two are apart is told only up to whole
    resets, and the smallest distance is taken.
    """
    numbers, heights = levels.numbers, levels.heights
    pairs = [np.flatnonzero(numbers % 2 == parity) for parity in (0, 1)]
    rises = [np.diff(heights[p]) / np.diff(numbers[p]) for p in pairs]
    step = float(np.median(np.concatenate(rises)))
    # What a step of the same parity departs from the usual by is a reset or next to nothing.
    off = [np.diff(heights[p]) - step * np.diff(numbers[p]) for p in pairs]
    largest = float(np.abs(np.concatenate(off)).max())
    wraps = np.zeros(len(numbers), np.int64)
    noise = levels.noise / np.sqrt(np.median(levels.counts))
    if largest < max(4 * abs(step), 12 * noise):
        return wraps, float(np.sign(step)) or 1.0
    away = np.concatenate(off)[np.abs(np.concatenate(off)) > 0.5 * largest]
    if len(away) > 0.45 * len(numbers):
        raise ValueError(_TOO_FEW_STEPS)
    span, sign = float(np.median(np.abs(away))), -float(np.sign(np.median(away)))
    for p, departures in zip(pairs, off, strict=True):
        wraps[p[1:]] = np.cumsum(np.rint(-sign * departures / span)).astype(np.int64)
    odd = pairs[1]
    unwrapped = heights + sign * span * wraps - step * numbers
    apart = float(np.median(unwrapped[odd]) - np.median(unwrapped[pairs[0]]))
    wraps[odd] -= round(sign * apart / span)
    return wraps - wraps.min(), sign


# ---------------------------------------------------------------------- heights and times


def _fit_heights(record: Floats, levels: Levels, wraps: Ints, sign: float) -> tuple[RoundedFit, float]:
    """Fit "c", "h", "b" and "R", the last two where there is a bias and a reset; and the converter's spacing."""
    valid = record[np.isfinite(record)]
    spacing = converter_spacing(valid)
    dither = 0.0
    if spacing:
        dither = dither_of(levels.noise / spacing, (levels.heights - valid[0]) / spacing, levels.counts)
    spacing = spacing if dither < _WHITE else 0.0
    smallest = 1e-9 * float(np.ptp(valid))
    variance = levels.noise**2 / levels.counts + (rounding_left(dither) * spacing) ** 2 + smallest**2
    columns: dict[str, Floats] = {
        "c": np.ones(len(wraps)),
        "h": levels.numbers - levels.numbers.mean(),
        "b": (levels.numbers % 2).astype(np.float64),
    }
    if wraps.any():
        columns["R"] = -sign * wraps.astype(np.float64)

    def fit() -> RoundedFit:
        return fit_rounded(
            columns, levels.heights, variance, spacing=spacing, origin=float(valid[0]), dither=dither
        )

    found = fit()
    if abs(found.values["b"]) < 4 * found.u_of(b=1.0):
        del columns["b"]
        found = fit()
    _check_heights(found, levels.heights)
    return found, spacing


def _check_heights(fit: RoundedFit, heights: Floats) -> None:
    """Refuse what the model fits but does not mean. Raises ValueError."""
    height, span, bias = fit.values["h"], fit.values.get("R", np.inf), fit.values.get("b", 0.0)
    if abs(height) < 4 * fit.u_of(h=1.0):
        raise ValueError("the levels neither rise nor fall from step to step: no staircase is injected")
    # With so few steps a larger step the other way and half a span of bias would look the same.
    if abs(height) > span / 5 or abs(bias) > 0.4 * span:
        raise ValueError(_TOO_FEW_STEPS)
    left = float(np.sqrt(np.mean((heights - fit.model) ** 2)))
    if left > 0.3 * max(abs(height), abs(bias)):
        raise ValueError(
            "the levels do not follow a staircase with resets: look at the signal and at the range of the scope"
        )


def _fit_times(record: Floats, cut: Cut, levels: Levels) -> tuple[float, float, float]:
    """Samples per step, its standard uncertainty, and position of edge 0.

    An edge stands where the area under the signal says, so that its shape shifts all edges by the same time.
    """
    period, start, period_u = cut.period, cut.start, 0.5 / max(float(np.ptp(levels.numbers)), 1.0)
    for _ in range(3):
        edges = _edges(record, Cut(period, start), levels)
        if len(edges.numbers) < MINIMUM_STEPS // 2:
            break
        columns = {"start": np.ones(len(edges.numbers)), "period": edges.numbers}
        fit = fit_rounded(columns, edges.places, edges.variances, spacing=1.0, origin=0.5, dither=edges.dither)
        period, start, period_u = fit.values["period"], fit.values["start"], fit.u_of(period=1.0)
    return period, period_u, start


@dataclass(frozen=True, eq=False)
class _Edges:
    """Edges that stand out: numbers, places and variances of these, all (E,).

    `dither` is the noise in samples that would take as much from the rounding of a place to whole samples as the
    shape of the edge does: its Fourier transform at the sampling rate, that of a single pole of its width.
    """

    numbers: Floats
    places: Floats
    variances: Floats
    dither: float


def _edges(record: Floats, cut: Cut, levels: Levels) -> _Edges:
    half = cut.period / 2
    span = float(np.ptp(levels.heights))
    found = []
    for k in np.flatnonzero(np.diff(levels.numbers) == 1) + 1:
        low, jump = levels.heights[k - 1], levels.heights[k] - levels.heights[k - 1]
        edge = cut.start + levels.numbers[k] * cut.period
        first, last = int(np.ceil(edge - min(2.5, half))), int(np.floor(edge + min(levels.settling + 2.0, half)))
        if first < 0 or last >= len(record) or abs(jump) <= max(3 * levels.noise, 1e-9 * span):
            continue
        part = (record[first : last + 1] - low) / jump
        if np.isfinite(part).all():
            size = len(part)
            # The levels themselves are known only so well, and stand in for every sample.
            noise = size + size**2 * (1 / levels.counts[k] + 1 / levels.counts[k - 1]) / 4
            variance, place = noise * (levels.noise / jump) ** 2, last + 0.5 - float(part.sum())
            between = float(np.sum((part > 0.1) & (part < 0.9)))
            found.append((float(levels.numbers[k]), place, variance, between, abs(jump)))
    if not found:
        return _Edges(np.zeros(0), np.zeros(0), np.zeros(0), 0.0)
    numbers, places, variances, between, jumps = np.array(found).T
    # On a small step noise looks like a sample on the edge.
    clear = jumps > _CLEAR * levels.noise
    pole = float(between[clear].mean()) / _EDGE_TO_POLE if clear.any() else 0.0
    dither = float(np.sqrt(np.log1p((2 * np.pi * pole) ** 2)) / (2 * np.pi))
    variances = variances + rounding_left(dither) ** 2 + 1e-12
    # An amplifier may slew at resets, which makes those edges late.
    away = np.abs(places - cut.start - numbers * cut.period)
    keep = away < 5 * np.median(away) + 1.0
    return _Edges(numbers[keep], places[keep], variances[keep], dither)


def _flags(levels: Levels, scatter: float, resets: int, period: float) -> tuple[str, ...]:
    raised = {
        "no_reset": resets == 0,
        "few_resets": 0 < resets < FEW_RESETS,
        "not_settled": not levels.settled,
        "misfit": scatter > MISFIT,
        "few_samples_per_step": period < FEW_SAMPLES_PER_STEP,
    }
    return tuple(name for name, is_so in raised.items() if is_so)
