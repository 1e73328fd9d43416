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

from analysis.arrays import Bools, Floats, Ints
from analysis.waveform.converter import mean_rounding

FEW_RESETS = 3
FEW_SAMPLES_PER_STEP = 6
MISFIT = 4.0  # variance of the levels, over that of noise and rounding, beyond which they are no even staircase
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
    """What a record of the modulator staircase says; in V and s, `_u` are standard uncertainties (k = 1)."""

    # change from level to level, bias taken off; negative for a falling staircase; with its uncertainty
    step_height: float
    step_height_u: float
    step_time: float
    step_time_u: float
    reset_height: float  # the fall that is seen at a reset, positive; nan without one; with its uncertainty
    reset_height_u: float
    two_pi_voltage: float  # fall and step together: what all codes of the converter span; with its uncertainty
    two_pi_voltage_u: float
    bias_height: float  # of the square wave on top; 0 if there is none; with its uncertainty
    bias_height_u: float
    steps: int  # that the record holds
    resets: int
    noise_rms: float  # of one sample about its level
    level_spacing: float  # of the converter where rounding is not white, else 0
    settling_samples: int  # after each edge that were not used
    times: Floats  # middle of each level from the first sample on, its height as read, and as fitted
    levels: Floats
    model: Floats
    flags: tuple[str, ...]  # `describe_witness_flag` says what they mean


def describe_witness_flag(name: str) -> str:
    """One sentence for the person who reads the result."""
    return _SENTENCES[name]


def two_pi_error_of_drive(
    two_pi_voltage: float, two_pi_voltage_u: float, half_wave_voltage: float, half_wave_voltage_u: float = 0.0
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
    """Measure the staircase in a record."""
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
    raised = {
        "no_reset": resets == 0,
        "few_resets": 0 < resets < FEW_RESETS,
        "not_settled": not levels.settled,
        "misfit": fit.scatter > MISFIT,
        "few_samples_per_step": period < FEW_SAMPLES_PER_STEP,
    }
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
        flags=tuple(name for name, is_so in raised.items() if is_so),
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
    """Resets before each level, (K,), and the sign of the staircase."""
    # Levels with and without the bias are followed separately; how far the two are apart is told only up to whole
    # resets, and the smallest distance is taken.
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
    height, span, bias = found.values["h"], found.values.get("R", np.inf), found.values.get("b", 0.0)
    if abs(height) < 4 * found.u_of(h=1.0):
        raise ValueError("the levels neither rise nor fall from step to step: no staircase is injected")
    # With so few steps a larger step the other way and half a span of bias would look the same.
    if abs(height) > span / 5 or abs(bias) > 0.4 * span:
        raise ValueError(_TOO_FEW_STEPS)
    left = float(np.sqrt(np.mean((levels.heights - found.model) ** 2)))
    if left > 0.3 * max(abs(height), abs(bias)):
        raise ValueError(
            "the levels do not follow a staircase with resets: look at the signal and at the range of the scope"
        )
    return found, spacing


def _fit_times(record: Floats, cut: Cut, levels: Levels) -> tuple[float, float, float]:
    """Samples per step, its standard uncertainty, and position of edge 0."""
    # An edge stands where the area under the signal says, so that its shape shifts all edges by the same time.
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
    """Edges that stand out: numbers, places and variances of these, all (E,)."""

    numbers: Floats
    places: Floats
    variances: Floats
    dither: float  # noise in samples that takes as much from the rounding of a place as the edge's one pole does


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


# --------------------
# Where the steps of a staircase stand in a record.
#
# Nothing is assumed here about the heights: a record is cut into equal times, and the cut that leaves the least
# scatter within the pieces is the right one. So resets, and a bias square wave on top, do not disturb it.
#
# Positions are in samples; sample i stands for the time from i - 1/2 to i + 1/2


MINIMUM_PERIOD = 3.0  # samples per step; with fewer no sample is surely free of an edge

MINIMUM_STEPS = 8
CANDIDATES = 4
_FINALISTS = 3
HARMONICS = 6
_PADDING = 8
_WIDTH = 0.02  # relative half width of the search around a step time that the caller knows


@dataclass(frozen=True)
class Cut:
    """Edges at ``start + k period``, in samples, for all whole k."""

    period: float
    start: float

    def index(self, positions: Floats) -> Ints:
        """Number of the level on which each position lies."""
        return np.floor((positions - self.start) / self.period).astype(np.int64)


def find_cut(volts: Floats, period: float | None) -> Cut:
    """The cut of a record that fits its edges."""
    filled = _filled(volts)
    n = len(filled)
    if period is not None:
        check_period(period, n)
        return _fine_cut(filled, _coarse_cut(filled, period, _WIDTH * period))
    floor = rounding_variance(filled)

    def criterion(cut: Cut) -> float:
        """Schwarz's: more pieces must pay for themselves."""
        # A tenth may be samples on the wrong side of an edge, each of which would outweigh all others.
        number = cut.index(np.arange(len(filled), dtype=np.float64))
        numbers, _, heights = piece_means(filled, number, np.ones(len(filled), bool))
        squares = (filled - heights[np.searchsorted(numbers, number)]) ** 2
        return float(
            n * np.log(float(np.mean(np.sort(squares)[: int(0.9 * len(squares))])) + floor)
            + n / cut.period * np.log(n)
        )

    cuts = sorted((_coarse_cut(filled, one, one**2 / n) for one in _candidates(filled)), key=criterion)
    return _without_false_edges(filled, min((_fine_cut(filled, cut) for cut in cuts[:_FINALISTS]), key=criterion))


def check_period(period: float, n: int) -> None:
    """Refuse a step time that a record of `n` samples cannot show. Raises ValueError."""
    if period < MINIMUM_PERIOD:
        raise ValueError(
            f"a step lasts only {period:.3g} samples, {MINIMUM_PERIOD:g} are the least: use a faster time base"
        )
    if n / period < MINIMUM_STEPS:
        raise ValueError(
            f"the record holds only {n / period:.3g} steps, {MINIMUM_STEPS} are the least: use a slower time base"
        )


def piece_means(volts: Floats, number: Ints, usable: Bools) -> tuple[Ints, Floats, Floats]:
    """Numbers, sample counts and mean heights of the pieces, from the samples that may be used."""
    numbers, place = np.unique(number[usable], return_inverse=True)
    counts = np.bincount(place).astype(np.float64)
    return numbers, counts, np.bincount(place, weights=volts[usable]) / counts


# ---------------------------------------------------------------------- period


def _filled(volts: Floats) -> Floats:
    """Missing samples replaced by the one before."""
    good = np.isfinite(volts)
    if good.all():
        return volts
    last = np.maximum.accumulate(np.where(good, np.arange(len(volts)), 0))
    return np.asarray(np.where(np.isfinite(volts[last]), volts[last], np.nanmedian(volts)))


def rounding_variance(volts: Floats) -> float:
    """Variance below which no fit can be better: that of rounding, else next to nothing."""
    spacing = converter_spacing(volts)
    return max(spacing, 1e-6 * float(np.nanmax(volts) - np.nanmin(volts)), 1e-150) ** 2 / 12


def _candidates(volts: Floats) -> list[float]:
    """Periods at which changes of the signal repeat, the most likely first."""
    change = np.abs(np.diff(volts))
    # Logarithm: a reset is a hundred times a step, and there are few of them.
    scale = max(float(np.mean(np.minimum(change, np.quantile(change, 0.9)))), 1e-12 * float(change.max()), 1e-300)
    activity = np.log1p(change / scale)
    activity -= activity.mean()
    size = _PADDING * len(volts)
    spectrum = np.abs(np.fft.rfft(activity, size))
    bins = np.arange(int(MINIMUM_STEPS * _PADDING * 0.8), int(size / MINIMUM_PERIOD * 1.02))
    score = np.zeros(len(bins))
    for m in range(1, HARMONICS + 1):
        inside = m * bins < len(spectrum)
        # Harmonics above half the sampling rate do not count against a fast staircase.
        score[inside] += spectrum[m * bins[inside]]
    score /= np.sqrt(np.minimum(HARMONICS, (len(spectrum) - 1) // bins))
    found: list[float] = []
    for best in np.argsort(score)[::-1]:
        period = size / bins[best]
        if all(abs(period / other - 1) > 1.5 * period / len(volts) for other in found):
            found.append(float(period))
        if len(found) == CANDIDATES:
            break
    longest = len(volts) / MINIMUM_STEPS
    related = [period * m for period in found for m in (2, 3)] + [period / 2 for period in found]
    for period in related:
        is_new = all(abs(period / other - 1) > 0.5 * period / len(volts) for other in found)
        if is_new and MINIMUM_PERIOD <= period <= longest:
            found.append(period)
    return found


def _coarse_cut(volts: Floats, period: float, half_width: float) -> Cut:
    """The cut with the least scatter within its pieces, on a coarse grid of periods and starts."""
    n, sums = len(volts), _sums(volts)
    pitch = _pitch(period)
    step = pitch / 2 * period / n  # so that the last edge moves by half a pitch
    periods = np.arange(max(period - half_width, 0.98 * MINIMUM_PERIOD), period + half_width, step)
    tried = [_best_start(sums, n, trial, np.arange(0.0, trial, pitch)) for trial in periods]
    return Cut(*max(tried)[1:])


def _fine_cut(volts: Floats, cut: Cut) -> Cut:
    """The best cut near another: one sample on the wrong side of a reset outweighs all noise."""
    n, sums = len(volts), _sums(volts)
    pitch = _pitch(cut.period)
    step = pitch / 2 * cut.period / n
    best = (-np.inf, cut.period, cut.start)
    for _ in range(3):
        _, period, start = best
        middle = n // (2 * period)
        for trial in period + np.linspace(-1, 1, 17) * step:
            # Turn about the middle of the record, so that period and start hardly depend on each other.
            starts = start + middle * (period - trial) + np.linspace(-1, 1, 17) * pitch
            best = max(best, _best_start(sums, n, trial, starts))
        step, pitch = step / 4, pitch / 4
    return Cut(*best[1:])


def _pitch(period: float) -> float:
    """Distance of the starts on the coarse grid."""
    return max(0.5, period / 64)


def _sums(volts: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum(volts - volts.mean())])


def _best_start(sums: Floats, n: int, period: float, starts: Floats) -> tuple[float, float, float]:
    """Sum of squares that the best of some starts explains; period; that start."""
    numbers = np.arange(-1, int(n / period) + 3)
    edges = np.clip(np.ceil(starts[:, np.newaxis] + period * numbers), 0, n).astype(np.int64)
    pieces = np.diff(sums[edges], axis=-1)
    lengths = np.diff(edges, axis=-1)
    explained = np.asarray(np.sum(pieces**2 / np.maximum(lengths, 1), axis=-1))
    # Many starts between two samples are equally good; the middle of them is the best guess.
    equal = np.flatnonzero(explained >= explained.max() * (1 - 1e-12))
    return float(explained.max()), float(period), float(starts[equal[len(equal) // 2]])


def _without_false_edges(volts: Floats, cut: Cut) -> Cut:
    """A slow settling looks like further edges: take out those whose jumps only follow the jumps before them."""
    number = cut.index(np.arange(len(volts), dtype=np.float64))
    numbers, counts, heights = piece_means(volts, number, np.ones(len(volts), bool))
    residual = volts - heights[np.searchsorted(numbers, number)]
    noise = 1.5 * float(np.median(np.abs(residual))) * np.sqrt(2 / float(np.median(counts)))
    noise = max(noise, float(np.sqrt(rounding_variance(volts))))
    for parts in (6, 5, 4, 3, 2):
        if len(volts) / (parts * cut.period) >= MINIMUM_STEPS:
            true = _true_edges(numbers[1:], np.diff(heights), noise, parts)
            if true is not None:
                return Cut(cut.period * parts, cut.start + true * cut.period)
    return cut


def _true_edges(edges: Ints, jumps: Floats, noise: float, parts: int) -> int | None:
    """Which of `parts` interleaved sets of edges holds all real ones, None if none does."""
    size = [float(np.median(np.abs(jumps[edges % parts == part]))) for part in range(parts)]
    true = int(np.argmax(size))
    rest = max(size[:true] + size[true + 1 :])
    largest = float(np.abs(jumps[edges % parts == true]).max())
    others = edges % parts != true
    if size[true] < 4 * rest or np.abs(jumps[others]).max() > 0.3 * largest:
        return None
    # A false jump is the same part of the real one before it each time, and of the one behind it if a sample of
    # that lies on the wrong side; a step with a bias on top is not.
    for later in range(1, parts):
        here = np.flatnonzero(edges % parts == (true + later) % parts)
        here = here[(here >= later) & (here + parts - later < len(jumps))]
        false = jumps[here]
        real = np.stack([jumps[here - later], jumps[here + parts - later]], axis=-1)
        shares = np.linalg.lstsq(real, false, rcond=None)[0]
        if shares[1] < 0:  # no sample on the wrong side does that, but resets at even intervals can
            shares = np.array([np.sum(real[:, 0] * false) / np.sum(real[:, 0] ** 2), 0.0])
        left = false - real @ shares
        if np.mean(left**2) > 0.25 * np.mean(false**2) + (3 * noise) ** 2:
            return None
    return true


# --------------------
# How high each level of a staircase is, and which samples belong to it


_SETTLED = 1e-3  # part of a jump that may be left where a level counts as settled
_SHY = 0.75  # samples before an edge that are never used: so uncertain is its position
_ENOUGH = 0.3  # of the usual number of samples that a level must have
_SPIKE = 6.0  # times the noise; a sample farther away does not belong to its level


@dataclass(frozen=True)
class Levels:
    """The levels between the edges."""

    numbers: Ints  # (K,)
    heights: Floats  # (K,)
    counts: Floats
    noise: float
    settling: int
    settled: bool
    slope: float


def read_levels(volts: Floats, cut: Cut) -> Levels:
    """Mean height of every level, without the samples at its edges that have not settled."""
    positions = np.arange(len(volts), dtype=np.float64)
    number = cut.index(positions)
    phase = positions - cut.start - number * cut.period
    after, before, settled = _disturbed(volts, cut.period, number, phase)
    usable = np.isfinite(volts) & (phase >= after) & (cut.period - phase > before)
    kept = usable.copy()
    places = np.flatnonzero(usable)
    groups = np.split(places, np.flatnonzero(np.diff(number[places])) + 1)
    centre = np.zeros(len(volts))
    for group in groups:
        centre[group] = np.median(volts[group])
    away = np.abs(volts - centre)
    # A converter that rounds leaves most samples without any scatter; one level off is no spike.
    rms = max(1.5 * float(np.median(away[usable])), 0.5 * float(np.sqrt(12 * rounding_variance(volts))))
    kept[usable & (away > _SPIKE * rms)] = False
    usable = kept
    numbers, counts, heights = piece_means(volts, number, usable)
    # A piece of a level at the ends of the record, or between missing samples, says little and may be all edge.
    usable &= np.isin(number, numbers[counts >= _ENOUGH * np.median(counts)])
    numbers, counts, heights = piece_means(volts, number, usable)
    noise, slope = _within(volts, number, phase, usable, cut.period)
    return Levels(numbers, heights, counts, noise, int(after), settled, slope)


def _disturbed(volts: Floats, period: float, number: Ints, phase: Floats) -> tuple[float, float, bool]:
    """Samples after and before an edge that do not belong to its levels, and whether a level settles at all."""
    # The mean response to a jump, as a part of the jump, follows from all edges together; the resets weigh most.
    valid = np.isfinite(volts)
    late = valid & (phase > period / 2) & (period - phase > max(_SHY, 0.15 * period))
    numbers, _, heights = piece_means(volts, number, late)
    last = np.interp(number, numbers, heights)
    left = volts - last
    scatter = max(1.5 * float(np.median(np.abs(left[late]))), float(np.sqrt(rounding_variance(volts))))
    jump = last - np.interp(number - 1, numbers, heights)
    response, doubt = _response(left, jump, phase, valid & (period - phase > _SHY), scatter)
    half = max(1, int(np.ceil(period / 2)))
    moving = np.flatnonzero(np.abs(response[:half]) > _SETTLED + doubt[:half])
    after = float(moving[-1] + 1) if moving.size else 0.0
    if moving.size:
        # What is too small to be seen still shifts the level: go on until an exponential has fallen 20 times more.
        seen = min(float(doubt[moving[-1]]) + _SETTLED, 0.3)
        after = min(float(np.ceil(after * (1 + 3 / -np.log(seen)))), max(after, np.floor(0.6 * period)))
    tail, tail_doubt = response[half : int(period)], doubt[half : int(period)]
    change = 0.0
    quarter = tail.size // 2
    if quarter >= 2:
        change = abs(float(tail[:quarter].mean() - tail[quarter:].mean())) - float(tail_doubt.mean())
    next_jump = np.interp(number + 1, numbers, heights) - last
    early, doubt = _response(left, next_jump, period - phase, valid & (phase > period / 2), scatter)
    still = np.flatnonzero(np.abs(early[: half // 2]) <= _SETTLED + doubt[: half // 2])
    before = float(still[0]) if still.size else half / 2
    return after, max(before, _SHY), (not moving.size or moving[-1] + 1 < half) and change <= 2 * _SETTLED


def _response(
    left: Floats, jump: Floats, distance: Floats, usable: Bools, scatter: float
) -> tuple[Floats, Floats]:
    """What is left of a jump at each whole distance from its edge, as a part of it, and four times its noise."""
    at = np.floor(distance[usable]).astype(np.int64)
    weight = np.maximum(np.bincount(at, weights=jump[usable] ** 2), 1e-300)
    response = np.bincount(at, weights=(jump * left)[usable]) / weight
    return np.asarray(response, np.float64), np.asarray(4 * scatter / np.sqrt(weight))


def _within(volts: Floats, number: Ints, phase: Floats, usable: Bools, period: float) -> tuple[float, float]:
    """Rms of the samples about their levels, and the common slope of the levels from edge to edge."""
    numbers, _, heights = piece_means(volts, number, usable)
    _, _, middles = piece_means(phase, number, usable)
    place = np.searchsorted(numbers, number[usable])
    left, along = volts[usable] - heights[place], phase[usable] - middles[place]
    free = max(1, int(usable.sum()) - len(numbers))
    moment = float(np.sum(along**2))
    slope = float(np.sum(along * left)) / moment * period if moment > 0 else 0.0
    return float(np.sqrt(np.sum(left**2) / free)), slope


# --------------------
# A straight fit to a few numbers that a converter rounded.
#
# Rounding is no noise where the true noise is less than about a third of a level: the same value is then rounded
# the same way every time, and values that lie evenly are rounded in a pattern that can imitate a slope. What it
# does to each result is computed for data of the kind at hand, instead of being taken as white


_DRAWS = 200
_SEED = 20150513
_SAME = 1e-6  # of the span: two values closer than this are the same
_ON_LEVEL = 0.02  # of the spacing
_EUCLID = 8
_BEYOND = 0.01  # squared levels of scatter over more than two of them: 0.3 of noise
_MOST_LEVELS = 600  # twice as many as an eight-bit converter has: what stands on more was not rounded by one


@dataclass(frozen=True, eq=False)
class RoundedFit:
    """Result of `fit_rounded`."""

    values: dict[str, float]  # parameters by name
    model: Floats  # (K,)
    scatter: float  # variance of the data about the model, over the variance that was expected
    _columns: Floats
    _estimator: Floats
    _covariance: Floats
    _places: Floats  # of the model, in levels from a level
    _spacing: float
    _dither: float

    def u_of(self, **factors: float) -> float:
        """Standard uncertainty of a sum of parameters, each times its factor."""
        weights = np.array([factors.get(name, 0.0) for name in self.values])
        noise = float(weights @ self._covariance @ weights) * max(1.0, self.scatter)
        return float(np.hypot(np.sqrt(noise), self._rounding_u(weights @ self._estimator)))

    def _rounding_u(self, weights: Floats) -> float:
        """Rms effect of rounding on a sum of data, over data that could have been rounded to these."""
        if self._spacing == 0:
            return 0.0
        # By how far each parameter is wrong at most, if every number was rounded the worst way.
        reach = 0.5 * np.abs(self._estimator).sum(axis=-1)
        shifts = np.random.default_rng(_SEED).uniform(-1, 1, (_DRAWS, len(reach))) * reach
        places = self._places + shifts @ self._columns.T
        rms = np.full(_DRAWS, np.sqrt(self._dither**2 + 1 / 12))
        rounding = mean_rounding(places, np.zeros((_DRAWS, 1)), np.ones(_DRAWS), rms)
        return float(np.sqrt(np.mean((rounding @ weights) ** 2))) * self._spacing


def converter_spacing(values: Floats) -> float:
    """Spacing of the levels on which all values stand, 0 if they stand on none; nan is left out."""
    levels = np.unique(values[np.isfinite(values)])
    span = float(levels[-1] - levels[0])
    gaps = np.diff(levels)
    gaps = gaps[gaps > _SAME * span]
    if gaps.size < 2:
        return 0.0
    spacing = float(gaps.min())
    for _ in range(_EUCLID):
        places = (levels - levels[0]) / spacing
        rest = float(np.abs(places - np.rint(places)).max())
        if rest < _ON_LEVEL:
            steps = round(span / spacing)
            return span / steps if steps < _MOST_LEVELS else 0.0
        # No two levels were neighbours yet: as in Euclid's algorithm, the spacing divides what is left over.
        spacing *= rest
    return 0.0


def rounding_left(dither: float) -> float:
    """Part of a level that rounding is still wrong by, rms, with so much Gaussian noise; both in levels."""
    return float(np.exp(-2 * (np.pi * dither) ** 2) / np.sqrt(12))


def dither_of(noise: float, means: Floats, counts: Floats) -> float:
    """Noise before a converter, 0 where it is so small that only two neighbouring levels ever alternate."""
    part = means - np.floor(means)
    # Two levels scatter by p (1 - p), however small the noise is that flips between them near their threshold; a
    # mean of n samples takes its share of that.
    alternating = part * (1 - part) * counts / np.maximum(counts - 1, 1)
    beyond = noise**2 - float(np.average(alternating, weights=counts))
    return float(np.sqrt(beyond + 1 / 12)) if beyond > _BEYOND else 0.0


def fit_rounded(
    columns: dict[str, Floats], data: Floats, variance: Floats, *, spacing: float, origin: float, dither: float
) -> RoundedFit:
    """Weighted linear least squares."""
    matrix = np.stack(list(columns.values()), axis=-1)
    root = 1 / np.sqrt(variance)
    weighted = matrix * root[:, np.newaxis]
    scale = np.sqrt(np.sum(weighted**2, axis=0))
    if len(data) <= matrix.shape[1] or np.linalg.matrix_rank(weighted / scale) < matrix.shape[1]:
        raise ValueError("too few levels for a fit: use a slower time base")
    inverse = np.linalg.pinv(weighted)
    estimator = inverse * root
    parameters = estimator @ data
    model = matrix @ parameters
    degrees = len(data) - matrix.shape[1]
    return RoundedFit(
        values=dict(zip(columns, map(float, parameters), strict=True)),
        model=model,
        scatter=float(np.sum(((data - model) * root) ** 2) / degrees),
        _columns=matrix,
        _estimator=estimator,
        _covariance=inverse @ inverse.T,
        _places=(model - origin) / (spacing or 1.0),
        _spacing=spacing,
        _dither=dither,
    )
