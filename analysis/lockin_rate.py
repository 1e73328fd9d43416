"""The lock-in rate of each record of the beat."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from html import escape
from typing import Any

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import Bools, Complexes, Floats, Indices, Ints, Stacked
from analysis.flags import FATAL, Flag, flag_names
from analysis.lockin_equation import Relation, input_rate_from_beat, lock_in_from_beat, lock_in_from_rate
from analysis.waveform.converter import of_few_levels
from analysis.waveform.fit import WaveformFit, fit_waveform
from analysis.waveform.frequency import NanPolicy, Stack, as_stack, never_alone

WHITE = "white noise of the size that the fit leaves, in each record"
COLOURED = "noise of the strength that the fit leaves near the fundamental and the second harmonic"


def estimate_lock_in(
    volts: ArrayLike,
    sample_interval: float,
    *,
    scale_factor: float,
    input_rate: ArrayLike | None = None,
    relation: Relation = "exact",
    clipped: ArrayLike | None = None,
    full_amplitude: ArrayLike | None = None,
    nan_policy: NanPolicy = "raise",
    mains_hz: float | None = None,
) -> LockInEstimate:
    """Lock-in rate from each record of the beat.

    The whole waveform is fitted by maximum likelihood (`geometric_series`), which gives r = A2/A1 and f; then
    WL = |W| 2r/(1 + r^2) with the rate given, or WL = (f/K) 2r/(1 - r^2) without, where neither table rate nor
    tilt nor earth rate enters.

    Parameters
    ----------
    volts : (..., n_samples)
        Or raw codes, in which -128 marks a missing sample. Clipped samples are found by themselves where they are
        many.
    sample_interval : float
        Seconds.
    scale_factor : float
        K, pulses per degree.
    input_rate : (...), optional
        W, deg/s, signed. Without it the record is its own reference.
    relation : {"exact", "paper-13", "paper-10"}
        The paper's approximations serve for comparison. Without a given rate they use W = f/K for (10) and
        the exact W of the record for (13).
    clipped : (..., n_samples) of bool, optional
        Samples known to stand at the end of the converter's range.
    full_amplitude : (...), optional
        Volts: A as a single acquisition shows it. A record that the scope has averaged over a phase that was not
        triggered is weaker, and its second harmonic is weaker still (three times as much, at first): it is
        flagged.
    nan_policy : {"raise", "omit"}
        Whether nan in `volts` is an error, or a missing sample that is left out.
    mains_hz : float, optional
        Frequency of the mains; without it both 50 and 60 Hz are thought of.

    Returns
    -------
    LockInEstimate
        nan with a fatal flag where a lock-in rate would mean nothing. What is said of a record does not depend on
        the others, to the last bit.

    Raises
    ------
    ValueError
        Fewer than 8 samples, wrong shapes, nan or infinite values, interval or scale factor not positive, unknown
        relation.
    """
    if not np.isfinite(scale_factor) or scale_factor <= 0:
        raise ValueError(f"scale_factor must be positive (pulses per degree), not {scale_factor!r}")
    lock_in_from_rate(0.0, 1.0, relation)  # an unknown relation is an error before any work is done
    stack = as_stack(volts, sample_interval, nan_policy)
    shape, n_records, rate, mask = stack.shape, len(stack.volts), _given_rate(input_rate, stack.shape), None
    if clipped is not None:
        mask = np.broadcast_to(np.asarray(clipped, bool), (*shape, stack.n_samples)).reshape(stack.volts.shape)
    if full_amplitude is not None:
        full_amplitude = np.broadcast_to(np.asarray(full_amplitude, dtype=np.float64), shape).ravel()
    if n_records == 1:
        stack = replace(stack, volts=stack.volts[[0, 0]])  # see `never_alone`
        rate, mask = (None if one is None else one[[0, 0]] for one in (rate, mask))
    fit = fit_waveform(stack, mask)
    third, third_u = _third_harmonic(fit, stack.n_samples)
    with np.errstate(all="ignore"):  # records without a beat divide by zero; their flags are fatal
        beat = Beat.of(fit, stack.n_samples, sample_interval)
        beat, flags = compare_pieces(beat, fit, stack, mask, sample_interval)
        per_degree = np.array([scale_factor, 1.0])
        value, value_u, low, high = rate_of_ratio(
            beat.size,
            beat.ratio,
            beat.frequency / scale_factor,
            beat.covariance[:, :2, :2] / np.outer(per_degree, per_degree),
            beat.misfit,
            rate,
            relation,
        )
    flags = flags | beat_flags(beat, flags, stack.n_samples)
    flags |= mains_flags(beat, flags, mains_hz)
    few = of_few_levels(stack.volts, beat.amplitude, fit.noise_rms, fewest_levels(beat, third, third_u))
    flags[few] |= Flag.FEW_LEVELS
    if full_amplitude is not None:
        # the amplitude falls short by more than noise and the stability of a laser explain
        amplitude_u = fit.noise_rms * np.sqrt(2 / stack.n_samples)
        short = full_amplitude - beat.amplitude > np.maximum(LOSS * full_amplitude, 5 * amplitude_u)
        flags[short] |= Flag.AMPLITUDE_LOST
    # a fit without bounds or without any error, as of a few samples of a slow curve
    flags[((flags & int(FATAL)) == 0) & ~(np.isfinite(value + value_u) & (value_u > 0))] |= Flag.NOT_LOCK_IN_LIKE
    fatal = (flags & int(FATAL)) != 0

    def shaped(values: Floats) -> Floats:
        lost = fatal.reshape(-1, *(1,) * (values.ndim - 1))
        return np.where(lost, np.nan, values)[:n_records].reshape((*shape, *values.shape[1:]))

    sense = np.where(rate < 0, -1.0, 1.0) if rate is not None else np.ones(beat.size.shape)
    own_rate = input_rate_from_beat(beat.ratio, beat.frequency / scale_factor)
    if rate is not None:
        r = beat.ratio
        relative_u = np.hypot(beat.frequency_u / beat.frequency, 4 * r * beat.ratio_u / (1 - r**4))
        differs = np.abs(np.abs(rate) / own_rate - 1) > np.maximum(5 * relative_u, RATE_ERROR)
        flags[~fatal & differs] |= Flag.RATE_MISMATCH
    return LockInEstimate(
        lock_in_rate=shaped(value),
        lock_in_rate_u=shaped(value_u),
        lock_in_rate_low_95=shaped(low),
        lock_in_rate_high_95=shaped(high),
        input_rate=shaped(own_rate) if rate is None else rate[:n_records].reshape(shape),
        beat_frequency=shaped(beat.frequency),
        beat_frequency_u=shaped(beat.frequency_u),
        ratio=shaped(beat.ratio),
        ratio_u=shaped(beat.ratio_u),
        misfit_u=shaped(beat.misfit),
        complex_ratio=np.where(fatal, complex(np.nan, np.nan), beat.rho)[:n_records].reshape(shape),
        complex_ratio_covariance=shaped(beat.rho_covariance),
        backscatter_phase=shaped(backscatter_phase(beat.rho, sense)),
        amplitude=shaped(beat.amplitude),
        noise_rms=fit.noise_rms[:n_records].reshape(shape),
        third_harmonic=third[:n_records].reshape(shape),
        third_harmonic_u=third_u[:n_records].reshape(shape),
        periods=shaped(beat.periods),
        records=(~fatal[:n_records]).astype(np.int64).reshape(shape),
        records_rejected=fatal[:n_records].astype(np.int64).reshape(shape),
        flags=flags[:n_records].reshape(shape),
        scale_factor=float(scale_factor),
        relation=relation,
        rate_given=rate is not None,
        noise_model=noise_model(flags),
    )


def noise_model(flags: Ints) -> str:
    """What the uncertainties of records with these flags rest on, in words."""
    return COLOURED if np.any(flags & int(Flag.COLOURED_NOISE)) else WHITE


def _given_rate(input_rate: ArrayLike | None, shape: tuple[int, ...]) -> Floats | None:
    if input_rate is None:
        return None
    rate = np.broadcast_to(np.asarray(input_rate, dtype=np.float64), shape).ravel()
    if not np.all(np.isfinite(rate)):
        raise ValueError("input_rate must be finite (deg/s)")
    return rate


# --------------------
# What is known of the lock-in rate from one or many records


@dataclass(frozen=True, repr=False)
class LockInEstimate:
    """Estimates of one or many records; every array has the leading shape of the records.

    lock_in_rate, lock_in_rate_u : deg/s, and its standard uncertainty
    lock_in_rate_low_95, lock_in_rate_high_95 : deg/s, 95 % interval; not symmetric, and it begins at 0 where the
        second harmonic does not stand out of the noise
    input_rate : deg/s, as given (signed), or from the record itself: W = (f/K)(1 + r^2)/(1 - r^2)
    beat_frequency, beat_frequency_u : Hz
    ratio, ratio_u : r = A2/A1, freed of the bias that noise gives to the size of a small complex number
    misfit_u : what the u of the ratio holds that is no noise: what the residual, and the parts of the record, show
    complex_ratio : rho = c2 |c1| / c1^2, independent of the time origin
    complex_ratio_covariance : (..., 2, 2) of its real and imaginary part, from noise alone
    backscatter_phase : rad, beta less the readout phase
    amplitude, noise_rms : volts, A of A sin(phi), and the standard deviation of what the fit leaves
    third_harmonic, third_harmonic_u : third harmonic beyond that of the lock-in waveform, over the amplitude, its
        phase referred to three times the fundamental's: third-order distortion; u of either part, inf: not known
    periods : beat periods in the record
    records, records_rejected : how many records the value rests on, and how many could not be used
    flags : bits of `Flag`
    noise_model : what the uncertainties rest on, in words
    """

    lock_in_rate: Floats
    lock_in_rate_u: Floats
    lock_in_rate_low_95: Floats
    lock_in_rate_high_95: Floats
    input_rate: Floats
    beat_frequency: Floats
    beat_frequency_u: Floats
    ratio: Floats
    ratio_u: Floats
    misfit_u: Floats
    complex_ratio: Complexes
    complex_ratio_covariance: Floats
    backscatter_phase: Floats
    amplitude: Floats
    noise_rms: Floats
    third_harmonic: Complexes
    third_harmonic_u: Floats
    periods: Floats
    records: Ints
    records_rejected: Ints
    flags: Ints
    scale_factor: float
    relation: Relation
    rate_given: bool
    noise_model: str

    def __getitem__(self, key: int | slice | Bools | Indices) -> LockInEstimate:
        """Some of the records; indexes the leading axes of every field."""
        picked = {f.name: getattr(self, f.name) for f in fields(self)}
        for name, value in picked.items():
            if isinstance(value, np.ndarray):
                picked[name] = np.asarray(value[key])
        return LockInEstimate(**picked)

    def reshaped(self, *shape: int) -> LockInEstimate:
        """The same records in another leading shape."""
        changed = {f.name: getattr(self, f.name) for f in fields(self)}
        inner = self.flags.ndim
        for name, value in changed.items():
            if isinstance(value, np.ndarray):
                changed[name] = value.reshape((*shape, *value.shape[inner:]))
        return LockInEstimate(**changed)

    def changed(self, change: Callable[[LockInEstimate, slice], LockInEstimate]) -> LockInEstimate:
        """The records (n,) as a function makes others of them, which is told which ones it is given."""
        return change(self, slice(0, len(self)))

    def described(self, noise_model: str) -> LockInEstimate:
        """The same records, with other words on what their uncertainties rest on."""
        return replace(self, noise_model=noise_model)

    @property
    def usable(self) -> Bools:
        """Where a lock-in rate could be given at all."""
        return np.asarray((self.flags & int(FATAL)) == 0)

    def plot(self, axes: Any = None) -> Any:
        """Draw the lock-in rate of every record with Matplotlib, into `axes` or a new figure; returns the axes."""
        if axes is None:
            import matplotlib.pyplot as plt

            _, axes = plt.subplots()
        values, u = self.lock_in_rate.ravel(), self.lock_in_rate_u.ravel()
        axes.errorbar(np.arange(values.size) + 1, values, u, fmt="o", capsize=2.5)
        axes.set(xlabel="record", ylabel="lock-in rate / deg/s")
        return axes

    def __len__(self) -> int:
        return len(self.flags)

    def __repr__(self) -> str:
        of = f" of {' x '.join(map(str, self.flags.shape))} records" if self.flags.ndim else ""
        known = np.isfinite(self.lock_in_rate)
        ends = np.sort(self.lock_in_rate[known])[:: max(1, int(known.sum()) - 1)]
        u = f" deg/s, u {np.median(self.lock_in_rate_u[known]):.2g}" if ends.size else "no lock-in rate"
        flags = ", ".join(flag_names(int(np.bitwise_or.reduce(self.flags, axis=None)))) or "no flags"
        return f"<LockInEstimate{of}: {' to '.join(f'{end:.6g}' for end in ends)}{u}; {flags}>"

    def _repr_html_(self) -> str:
        first = self.reshaped(-1)[:20]
        rows = [["lock-in rate, deg/s", "u, deg/s", "beat, Hz", "flags"]]
        columns = (first.lock_in_rate, first.lock_in_rate_u, first.beat_frequency, first.flags)
        for *values, flags in zip(*columns, strict=True):
            rows.append([*(f"{value:.6g}" for value in values), ", ".join(flag_names(flags))])
        cells = "".join(f"<tr><td>{'</td><td>'.join(row)}</td></tr>" for row in rows)
        return f"<table><caption>{escape(repr(self))}</caption>{cells}</table>"


# --------------------
# Frequency and harmonic ratio of the fitted waveforms, and what speaks against them


FEWEST_PERIODS = 3.0

FEW_FOR_A_MOTION = 10.0
"""Periods below which a fitted motion can make a beat of any slow curve; the second harmonic must speak for it."""

RATE_ERROR = 0.002
"""Share by which a given rate may differ from the beat's: what scale factor and tilt are known to."""

LOSS = 0.01
"""Share of the amplitude that may be missing; an averaged moving phase that costs it costs the ratio 3 %."""


@dataclass(frozen=True)
class Beat(Stacked):
    """Frequency and harmonic ratio of (R,) records, with their covariance."""

    # size is |q| as fitted, ratio the same freed of its bias; covariance (R, 3, 3) is that of frequency, size of
    # the ratio, and its part across (phase times size), from noise; misfit is the standard uncertainty of both
    # parts of the ratio by what is no noise.

    frequency: Floats
    size: Floats
    ratio: Floats
    covariance: Floats
    misfit: Floats
    rho: Complexes
    rho_covariance: Floats
    amplitude: Floats
    omega: Floats
    periods: Floats

    @property
    def frequency_u(self) -> Floats:
        """Standard uncertainty of the frequency, Hz."""
        return np.sqrt(self.covariance[:, 0, 0])

    @property
    def ratio_u(self) -> Floats:
        """Standard uncertainty of the size of the ratio."""
        return np.hypot(np.sqrt(self.covariance[:, 1, 1]), self.misfit)

    def widened(self, rows: Indices, ratio_u: Floats) -> Beat:
        """With one more uncertainty (r,) by what is no noise in the ratio of some records."""
        misfit = self.misfit.copy()
        misfit[rows] = np.hypot(misfit[rows], ratio_u)
        return replace(self, misfit=misfit)

    @staticmethod
    def of(fit: WaveformFit, n_samples: int, sample_interval: float) -> Beat:
        """From fitted waveforms."""
        first, q, omega = fit.series.first, fit.series.ratio, fit.series.omega
        size = np.abs(q)
        jacobian = _jacobian(first, q, 1 / (np.pi * n_samples * sample_interval))
        covariance = jacobian @ fit.covariance @ jacobian.swapaxes(-1, -2)
        strength = np.sqrt(fit.excess)
        covariance = covariance * strength[:, :, np.newaxis] * strength[:, np.newaxis, :]
        rho = q * np.conj(first) / np.abs(first)
        turn = np.exp(1j * np.angle(rho))
        rotation = np.stack([np.stack([turn.real, -turn.imag], -1), np.stack([turn.imag, turn.real], -1)], -2)
        return Beat(
            frequency=omega / (2 * np.pi * sample_interval),
            size=size,
            # |q|^2 is too large by the variance of its two parts; that along q is in the mean already.
            ratio=np.sqrt(np.maximum(size**2 - covariance[:, 2, 2], 0.0)),
            covariance=covariance,
            misfit=fit.misfit,
            rho=rho,
            rho_covariance=rotation @ covariance[:, 1:, 1:] @ rotation.swapaxes(-1, -2),
            amplitude=np.abs(first) / (1 - size**2),
            omega=omega,
            periods=omega * n_samples / (2 * np.pi),
        )


def _jacobian(first: Complexes, q: Complexes, hertz: float) -> Floats:
    """Derivatives (R, 3, 6) of frequency, and of the ratio along and across its direction, by the parameters."""
    # The part across is that of rho = q exp(-i arg H), so the phase of H enters it; the size of the ratio does not
    # know H.
    size = np.abs(q)
    unit = np.where(size > 0, q / np.where(size > 0, size, 1.0), 1.0)
    jacobian = np.zeros((q.size, 3, 6))
    jacobian[:, 0, 5] = hertz
    jacobian[:, 1, 3], jacobian[:, 1, 4] = unit.real, unit.imag
    jacobian[:, 2, 3], jacobian[:, 2, 4] = -unit.imag, unit.real
    squared = np.abs(first) ** 2
    jacobian[:, 2, 1], jacobian[:, 2, 2] = size * first.imag / squared, -size * first.real / squared
    return jacobian


def beat_flags(beat: Beat, fit_flags: Ints, n_samples: int) -> Ints:
    """What frequency and ratio say against a record, (R,), with the flags of its fit (R,)."""
    flags = np.zeros(beat.size.shape, dtype=np.int64)
    flags[beat.periods < FEWEST_PERIODS] |= Flag.FEW_PERIODS
    flags[2 * beat.omega >= np.pi] |= Flag.SECOND_HARMONIC_ABOVE_NYQUIST
    orders = np.arange(2, 13)
    folded = np.abs((orders * beat.omega[:, np.newaxis] + np.pi) % (2 * np.pi) - np.pi)
    bin_width = 2 * np.pi / n_samples
    strong = beat.size[:, np.newaxis] ** (orders - 1) > 0.02 * beat.size[:, np.newaxis]
    on_first = np.abs(folded - beat.omega[:, np.newaxis]) < bin_width
    second = np.abs((2 * beat.omega[:, np.newaxis] + np.pi) % (2 * np.pi) - np.pi)
    on_second = (np.abs(folded - second) < bin_width) & (orders > 2)
    at_edge = (np.abs(folded - np.pi) < bin_width) & (orders == 2)
    at_zero = (folded < bin_width) & (orders == 2)
    flags[np.asarray((strong & (on_first | on_second | at_edge | at_zero)).any(axis=-1))] |= Flag.HARMONICS_ALIASED
    flags[~(beat.size > SIGNIFICANT * beat.ratio_u)] |= Flag.RATIO_NOT_SIGNIFICANT
    moved = (fit_flags & int(Flag.RATE_WANDER)) != 0
    silent = (flags & int(Flag.RATIO_NOT_SIGNIFICANT)) != 0
    # A gyro that swings inside lock-in leaves such a curve.
    flags[moved & silent & (beat.periods < FEW_FOR_A_MOTION)] |= Flag.MISFIT
    return flags


def mains_flags(beat: Beat, others: Ints, mains_hz: float | None) -> Ints:
    """Where a beat (R,) may be hum, and where hum may stand on its second harmonic; with its other flags (R,)."""
    # Where nobody stated the mains the second is told of records only that show something beside the beat.
    flags = np.zeros(beat.size.shape, dtype=np.int64)
    spoiled = (others & int(Flag.MISFIT)) != 0
    for mains in MAINS_HZ if mains_hz is None else (mains_hz,):
        order = np.rint(beat.frequency / mains)
        hums = np.abs(beat.frequency - order * mains) < MAINS_WANDERS * beat.frequency
        hums &= (order >= 1) & (order <= 2) & (beat.ratio < SMALL_RATIO) & (beat.periods > FEWEST_PERIODS)
        flags[hums] |= Flag.MAINS
        flags[hums & ~(beat.size > SIGNIFICANT * beat.ratio_u)] |= Flag.NO_BEAT
        order = np.clip(np.rint(2 * beat.frequency / mains), 1, MAINS_ORDERS)
        width = beat.frequency / beat.periods  # 1/T
        beside = np.abs(2 * beat.frequency - order * mains) < width + MAINS_WANDERS * order * mains
        flags[beside & ~hums & (spoiled | (mains_hz is not None))] |= Flag.MAINS_BESIDE
    return flags


MAINS_HZ = (50.0, 60.0)
MAINS_WANDERS = 0.005  # share by which the frequency of the mains is off at most
MAINS_ORDERS = 6  # harmonics of the mains that are strong enough to matter on a bench
SMALL_RATIO = 0.02  # second harmonic over the fundamental up to which a beat at the mains may be hum


# --------------------
# From the ratio of the harmonics to the lock-in rate, with its uncertainty and its interval


SIGNIFICANT = 3.3
"""Noise alone makes a ratio of more than this many of its standard uncertainties in 0.4 % of records."""


def rate_of_ratio(
    size: Floats,
    ratio: Floats,
    beat_rate: Floats,
    covariance: Floats,
    misfit: Floats,
    rate: Floats | None,
    relation: Relation,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Lock-in rate, its standard uncertainty and the ends of its 95 % interval, deg/s."""
    value, by_ratio, by_beat_rate = rate_and_slopes(ratio, beat_rate, rate, relation)
    variance = _variance_along(by_beat_rate, by_ratio, covariance)
    value_u = np.sqrt(np.maximum(variance, 0.0) + (by_ratio * misfit) ** 2)
    observed = rate_and_slopes(size, beat_rate, rate, relation)[0]
    low, high = size_interval(observed / value_u)
    return value, value_u, low * value_u, high * value_u


def _variance_along(x: Floats, y: Floats, covariance: Floats) -> Floats:
    """Variance (...) of x a + y b, from the covariance (..., 2, 2) of a and b."""
    # Written out: the order in which `einsum` adds depends on how many records there are.
    both = covariance[..., 0, 1] + covariance[..., 1, 0]
    return np.asarray(x * x * covariance[..., 0, 0] + x * y * both + y * y * covariance[..., 1, 1])


def rate_and_slopes(
    ratio: Floats, beat_rate: Floats, rate: Floats | None, relation: Relation
) -> tuple[Floats, Floats, Floats]:
    """Lock-in rate, and its derivatives by the ratio and by f/K; `rate` None: the record is its own reference."""
    r = ratio
    if rate is None and relation == "exact":
        value = lock_in_from_beat(r, beat_rate)
        return value, beat_rate * 2 * (1 + r * r) / (1 - r * r) ** 2, 2 * r / (1 - r * r)
    if rate is None:
        w = beat_rate if relation == "paper-10" else input_rate_from_beat(r, beat_rate)
        by_beat_rate = lock_in_from_rate(r, w / beat_rate, relation)
    else:
        w, by_beat_rate = np.abs(rate), np.zeros_like(r)
    half = 1e-6
    rise = lock_in_from_rate(r + half, w, relation) - lock_in_from_rate(r - half, w, relation)
    return lock_in_from_rate(r, w, relation), rise / (2 * half), by_beat_rate


def backscatter_phase(ratio: Complexes, sense: Floats) -> Floats:
    """Beta less the readout phase, rad, from rho and the sign of the rate."""
    return np.angle(-ratio * sense) * sense


def with_ratio(
    estimate: LockInEstimate,
    ratio: Complexes,
    covariance: Floats,
    sense: Floats | None = None,
    misfit_u: Floats | None = None,
) -> LockInEstimate:
    """The estimate with a corrected rho: lock-in rate, interval and phase from it; frequency and noise stay."""
    misfit_u = estimate.misfit_u if misfit_u is None else misfit_u
    size = np.abs(ratio)
    unit = ratio / np.where(size > 0, size, 1.0)
    radial = _variance_along(unit.real, unit.imag, covariance)
    tangential = _variance_along(-unit.imag, unit.real, covariance)
    unbiased = np.sqrt(np.maximum(size**2 - tangential, 0.0))
    beat_rate = estimate.beat_frequency / estimate.scale_factor
    given = estimate.input_rate if estimate.rate_given else None
    beat_rate_u = estimate.beat_frequency_u / estimate.scale_factor
    both = np.stack([beat_rate_u**2, radial], axis=-1)[..., np.newaxis] * np.eye(2)
    value, value_u, low, high = rate_of_ratio(size, unbiased, beat_rate, both, misfit_u, given, estimate.relation)
    if given is not None:
        turning = np.where(given < 0, -1.0, 1.0)
    else:
        turning = np.ones_like(size) if sense is None else sense
    ratio_u = np.hypot(np.sqrt(radial), misfit_u)
    lost = np.where(size > SIGNIFICANT * ratio_u, 0, int(Flag.RATIO_NOT_SIGNIFICANT))
    # Records without a beat stay nan, whatever the correction was.
    blank = np.where(estimate.usable, 1.0, np.nan)
    return replace(
        estimate,
        lock_in_rate=value * blank,
        lock_in_rate_u=value_u * blank,
        lock_in_rate_low_95=low * blank,
        lock_in_rate_high_95=high * blank,
        input_rate=turning * input_rate_from_beat(unbiased, beat_rate) * blank if given is None else given,
        ratio=unbiased * blank,
        ratio_u=ratio_u * blank,
        misfit_u=misfit_u * blank,
        complex_ratio=ratio * blank,
        complex_ratio_covariance=covariance * blank[..., np.newaxis, np.newaxis],
        backscatter_phase=backscatter_phase(ratio, turning) * blank,
        flags=(estimate.flags & ~int(Flag.RATIO_NOT_SIGNIFICANT)) | lost,
    )


# --------------------
# Do the parts of a record agree? Asked where the residual of the whole is not white noise.
#
# The lock-in rate does not change while a record is taken. A part that was blocked, jumped, was taken with another
# time base or inside lock-in shows another one than the rest, or no beat at all. What the parts differ by beyond
# their noise enters the uncertainty of the whole


PERIODS, SAMPLES = 4.0, 100  # that a part has at least
MOST_PIECES = 4  # parts of a record at most

UNLIKELY, RARE = 1e-4, 1e-2
"""Shares of records in which noise makes parts differ so much that a flag says so, or the difference counts."""


def compare_pieces(
    beat: Beat, fit: WaveformFit, stack: Stack, clipped: Bools | None, sample_interval: float
) -> tuple[Beat, Ints]:
    """Beats, their uncertainty enlarged by what their parts say, and the flags plus that of parts that differ."""
    # noise that is not white is worth a look where it is stronger at the beat than elsewhere: what happens in one
    # part never leaves less there; of a rate that moves the fit has asked
    flags = fit.flags
    louder = ((flags & int(Flag.COLOURED_NOISE)) != 0) & (fit.excess.max(axis=-1) > 1)
    suspect = (((flags & int(Flag.MISFIT)) != 0) | louder) & ((flags & int(FATAL)) == 0)
    suspect &= ~fit.moves
    pieces = np.minimum(np.minimum(beat.periods / PERIODS, stack.n_samples / SAMPLES), MOST_PIECES)
    number = np.where(suspect & np.isfinite(pieces), pieces, 0).astype(int)
    for n_pieces in range(2, MOST_PIECES + 1):
        rows = never_alone(np.flatnonzero(number == n_pieces))
        if rows.size:
            parts = _beats_of_parts(stack, clipped, rows, n_pieces, sample_interval)
            ratio_u, differ = _disagreement(beat, rows, *parts)
            beat = beat.widened(rows, ratio_u)
            flags[rows[differ]] |= Flag.PARTS_DIFFER
    return beat, flags


def _beats_of_parts(
    stack: Stack, clipped: Bools | None, rows: Indices, n_pieces: int, sample_interval: float
) -> tuple[Beat, Ints]:
    length = stack.n_samples // n_pieces

    def cut(samples: np.ndarray) -> np.ndarray:
        return samples[rows, : length * n_pieces].reshape(-1, length)

    # What no motion has explained as a whole is not looked for in the parts with the slowest of means.
    parts = Stack(cut(stack.volts), (rows.size * n_pieces,), stack.nan_policy, exact=False)
    fit = fit_waveform(parts, None if clipped is None else cut(clipped))
    return Beat.of(fit, length, sample_interval), fit.flags


def _disagreement(whole: Beat, rows: Indices, parts: Beat, part_flags: Ints) -> tuple[Floats, Bools]:
    """Standard uncertainty of the ratio by what parts differ by beyond noise, (r,), and where it is no chance."""
    value, radial, tangential = _lock_in(parts)
    values, variances = value.reshape(rows.size, -1), ((radial + tangential) / 2).reshape(rows.size, -1)
    lost = ((part_flags & int(FATAL)) != 0).reshape(values.shape) | ~np.isfinite(values) | ~(variances > 0)
    weights = np.where(lost, 0.0, 1 / np.where(lost, 1.0, variances))
    values = np.where(lost, 0.0, values)
    mean = np.sum(weights * values, axis=-1) / np.maximum(weights.sum(axis=-1), 1e-300)
    chi_square = np.sum(weights * np.abs(values - mean[:, np.newaxis]) ** 2, axis=-1)
    kept = values.shape[1] - lost.sum(axis=-1)
    chance = np.where(kept > 1, scipy.special.chdtrc(2 * np.maximum(kept - 1, 1), chi_square), 1.0)
    chance[lost.any(axis=-1)] = 0.0
    own = whole.take(rows)
    away = np.where(lost, 0.0, np.abs(values - _lock_in(own)[0][:, np.newaxis])) ** 2
    surplus = np.sum(away / 2 - np.where(lost, 0.0, variances), axis=-1) / np.maximum(kept, 1)
    slope = rate_and_slopes(own.size, own.frequency, None, "exact")[1]
    return np.where(chance < RARE, np.sqrt(np.maximum(surplus, 0.0)) / slope, 0.0), chance < UNLIKELY


def _lock_in(beat: Beat) -> tuple[Complexes, Floats, Floats]:
    """The lock-in rate, in units of 1/K, along the phase of rho, and its variances along and across."""
    value, by_ratio, by_frequency = rate_and_slopes(beat.size, beat.frequency, None, "exact")
    radial = by_ratio**2 * beat.ratio_u**2 + by_frequency**2 * beat.frequency_u**2
    across = np.where(beat.size > 0, value / np.where(beat.size > 0, beat.size, 1.0), by_ratio)
    direction = np.exp(1j * np.angle(beat.rho))
    return (
        np.asarray(value * direction),
        radial,
        np.asarray(across**2 * (beat.covariance[:, 2, 2] + beat.misfit**2)),
    )


# --------------------
# Whether a beat may be no beat: a gyro that is shaken inside lock-in swings, and its swing is nearly a sine too.
#
# Its phase follows the rate that shakes it, arc sine of W/WL. So the signal is a curve f of that rate: of its
# harmonics the second stands in phase with the fundamental or against it, but for a small lag, and the third is
# 2/3 f' f'''/f''^2 of that of a beat with the same second harmonic: hardly ever as much. The smaller the swing,
# the less of this can be seen; then its height has to tell, since whoever set the scale saw something larger


FEW_LEVELS = 16.0
"""Levels of amplitude below which a beat fills so little of the converter (127 levels) that whoever set it saw
something larger, or nothing like a beat."""

FEW_LEVELS_OF_A_SWING = 40.0
"""The same for a waveform that a gyro which swings inside lock-in may show. Vertical scales in steps of 1, 2, 5
leave more than that of a beat that was to fill the screen."""

FEW_LEVELS_WITHOUT_A_THIRD = 64.0  # the same for one whose third harmonic is probably not that of a beat

LAGS, LAG_SCATTERS = 0.2, 2.0
"""rad by which the second harmonic of a swing may lag behind the fundamental, and standard uncertainties of its
phase beside them."""

QUICK_LAGS = 0.8  # the same where the third harmonic speaks against a beat: a quick swing lags by more

SHOWS, CLOSE = 6.0, 5.0
"""Uncertainties that the third harmonic of a beat must have to show that it is one, and times by which it must
exceed what is amiss with it."""

PROBABLY = 3.0  # uncertainties beyond which it is probably not that of a beat: noise is so in one of 90 records


def fewest_levels(beat: Beat, third: Complexes, third_u: Floats) -> Floats:
    """Levels of the converter below which the amplitude of each record speaks against a beat, (R,)."""
    size, across = np.abs(beat.rho), np.abs(beat.rho.imag)
    scatter = LAG_SCATTERS * np.sqrt(np.maximum(beat.rho_covariance[:, 1, 1], 0.0))
    amiss = np.abs(third) > PROBABLY * third_u
    # the third harmonic of a beat is r times its second
    turns = size**2 > np.maximum(SHOWS * third_u, CLOSE * np.abs(third))
    in_phase, nearly = across < LAGS * size + scatter, across < np.sin(QUICK_LAGS) * size + scatter
    few = np.where(in_phase & ~turns, FEW_LEVELS_OF_A_SWING, FEW_LEVELS)
    return np.asarray(np.where(nearly & amiss, FEW_LEVELS_WITHOUT_A_THIRD, few))


# --------------------
# The 95 % interval of a size whose estimate is that of a complex number.
#
# The size t of a complex estimate follows the Rice distribution: it is never negative, it is biased upwards, and
# a symmetric error bar about it is wrong when it is comparable with its noise. The interval used here orders by
# likelihood ratio (Feldman and Cousins, Phys. Rev. D 57, 3873 (1998)): it covers 95 % for every true size and
# passes from an upper limit to the usual two-sided interval by itself


TABLE_END = 9.0
"""Beyond this many standard uncertainties the Rice distribution is Gaussian to the accuracy of the table."""


def size_interval(size: ArrayLike) -> tuple[Floats, Floats]:
    """Lower and upper 95 % limit of a true size, given the observed one, both in standard uncertainties."""
    observed = np.asarray(size, dtype=np.float64)
    true, accepted_from, accepted_to = _acceptance()
    low = np.interp(observed, accepted_to, true)
    high = np.interp(observed, accepted_from, true)
    centre = observed - 0.5 / np.maximum(observed, 1.0)
    far = observed > TABLE_END - 2.5
    width = -float(scipy.special.ndtri(0.025))
    return np.where(far, centre - width, low), np.where(far, centre + width, high)


@cache
def _acceptance() -> tuple[Floats, Floats, Floats]:
    """For true sizes 0..TABLE_END: the range of observed sizes that is accepted with 95 %."""
    step = 0.005
    observed: Floats = np.arange(step / 2, TABLE_END + 5, step, dtype=np.float64)
    true: Floats = np.linspace(0.0, TABLE_END, 181)
    most_likely = np.sqrt(np.maximum(observed**2 - 1, 0))
    for _ in range(40):
        # Maximum-likelihood size of a Rice variable: its fixed point mu = t I1(t mu)/I0(t mu).
        argument = observed * most_likely
        most_likely = observed * scipy.special.i1e(argument) / scipy.special.i0e(argument)
    density = _rice(observed, true[:, np.newaxis])
    order = density / np.maximum(_rice(observed, most_likely), 1e-300)
    first, last = np.empty_like(true), np.empty_like(true)
    for row, (weights, ranks) in enumerate(zip(density, order, strict=True)):
        chosen = np.argsort(-ranks, kind="stable")
        total = np.cumsum(weights[chosen]) * step
        kept = chosen[: int(np.searchsorted(total, 0.95)) + 1]
        first[row], last[row] = observed[kept.min()] - step / 2, observed[kept.max()] + step / 2
    # Strictly rising, so that the inverse by interpolation is single-valued.
    rise = np.arange(true.size) * 1e-9
    return true, np.maximum.accumulate(first) + rise, np.maximum.accumulate(last) + rise


def _rice(observed: Floats, true: Floats) -> Floats:
    return np.asarray(
        observed * np.exp(-((observed - true) ** 2) / 2) * scipy.special.i0e(observed * true), dtype=np.float64
    )


# --------------------
# What the lock-in waveform leaves at three times the beat: third-order distortion shows itself there.
#
# s + k s^3 of the signal s = A sin(psi) is (1 + 3h) s - h A sin(3 psi), h = k A^2/4. The geometric series that
# fits it best has another ratio than the beat, which no ratio shows; what no geometric series can take up is, at
# the third harmonic, h A times a number that follows from r alone (`analysis.several_rates.ratio_model`)


ORDER = 3

NOT_KNOWN = int(FATAL | Flag.CLIPPED | Flag.DAMAGED | Flag.RATE_WANDER | Flag.ROUNDING_REPEATS)
"""Records in which other things leave something at the third harmonic."""

SMALLEST = 1e-4  # least uncertainty, -80 dBc: rounding to levels leaves that much in quiet records


def _third_harmonic(fit: WaveformFit, n_samples: int) -> tuple[Complexes, Floats]:
    """Third harmonic beyond the waveform that was fitted, over the amplitude of the beat, of (R,) records."""
    # Its phase is referred to three times that of the fundamental, so that the time origin does not enter.
    series = fit.series
    with np.errstate(all="ignore"):  # records without a beat; they are blanked
        unit = series.first / np.abs(series.first)
        amplitude = np.abs(series.first) / (1 - np.abs(series.ratio) ** 2)
        excess = fit.third * np.conj(unit) ** ORDER / amplitude
        noise = fit.noise_rms * np.sqrt(2 / n_samples * fit.excess[:, 1]) / amplitude
    known = ((fit.flags & NOT_KNOWN) == 0) & np.isfinite(excess) & np.isfinite(noise)
    known &= ORDER * series.omega < np.pi
    return np.where(known, excess, 0.0), np.where(known, np.hypot(noise, SMALLEST), np.inf)
