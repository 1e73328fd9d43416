"""The lock-in rate of each record of the beat."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats, Ints
from analysis.flags import FATAL, Flag
from analysis.lockin_equation import Relation, input_rate_from_beat, lock_in_from_rate
from analysis.lockin_rate.beat import Beat, beat_flags, is_weaker
from analysis.lockin_rate.estimate import LockInEstimate
from analysis.lockin_rate.pieces import compare_pieces
from analysis.lockin_rate.rate import backscatter_phase, rate_of_ratio
from analysis.lockin_rate.swing import fewest_levels
from analysis.waveform.quantisation import of_few_levels
from analysis.waveform.records import NanPolicy, as_stack, never_alone
from analysis.waveform.third_harmonic import third_harmonic
from analysis.waveform.waveform_fit import fit_waveform

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
    rate = _given_rate(input_rate, stack.shape)
    mask = None
    if clipped is not None:
        full = np.broadcast_to(np.asarray(clipped, dtype=bool), (*stack.shape, stack.n_samples))
        mask = full.reshape(-1, stack.n_samples)
    if full_amplitude is not None:
        full_amplitude = np.broadcast_to(np.asarray(full_amplitude, dtype=np.float64), stack.shape).ravel()
    if len(stack.volts) == 1:
        rows = never_alone(np.zeros(1, dtype=np.intp))
        return estimate_lock_in(
            stack.volts[rows],
            sample_interval,
            scale_factor=scale_factor,
            input_rate=None if rate is None else rate[rows],
            relation=relation,
            clipped=None if mask is None else mask[rows],
            full_amplitude=None if full_amplitude is None else full_amplitude[rows],
            nan_policy=nan_policy,
        )[0].reshaped(*stack.shape)
    fit = fit_waveform(stack, mask)
    third, third_u = third_harmonic(fit, stack.n_samples)
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
    few = of_few_levels(stack.volts, beat.amplitude, fit.noise_rms, fewest_levels(beat, third, third_u))
    flags[few] |= Flag.FEW_LEVELS
    if full_amplitude is not None:
        flags[is_weaker(beat, fit, full_amplitude, stack.n_samples)] |= Flag.AMPLITUDE_LOST
    # a fit without bounds or without any error, as of a few samples of a slow curve
    flags[((flags & int(FATAL)) == 0) & ~(np.isfinite(value + value_u) & (value_u > 0))] |= Flag.NOT_LOCK_IN_LIKE
    fatal = (flags & int(FATAL)) != 0

    def shaped(values: Floats) -> Floats:
        return np.asarray(np.where(fatal, np.nan, values)).reshape(stack.shape)

    blank = np.where(fatal, np.nan, 1.0)
    sense = np.where(rate < 0, -1.0, 1.0) if rate is not None else np.ones(beat.size.shape)
    own_rate = input_rate_from_beat(beat.ratio, beat.frequency / scale_factor)
    return LockInEstimate(
        lock_in_rate=shaped(value),
        lock_in_rate_u=shaped(value_u),
        lock_in_rate_low_95=shaped(low),
        lock_in_rate_high_95=shaped(high),
        input_rate=shaped(own_rate) if rate is None else rate.reshape(stack.shape),
        beat_frequency=shaped(beat.frequency),
        beat_frequency_u=shaped(beat.frequency_u),
        ratio=shaped(beat.ratio),
        ratio_u=shaped(beat.ratio_u),
        misfit_u=shaped(beat.misfit),
        complex_ratio=(beat.rho * blank).reshape(stack.shape),
        complex_ratio_covariance=(beat.rho_covariance * blank[:, np.newaxis, np.newaxis]).reshape(
            *stack.shape, 2, 2
        ),
        backscatter_phase=shaped(backscatter_phase(beat.rho, sense)),
        amplitude=shaped(beat.amplitude),
        noise_rms=fit.noise_rms.reshape(stack.shape),
        third_harmonic=third.reshape(stack.shape),
        third_harmonic_u=third_u.reshape(stack.shape),
        periods=shaped(beat.periods),
        records=(~fatal).astype(np.int64).reshape(stack.shape),
        records_rejected=fatal.astype(np.int64).reshape(stack.shape),
        flags=flags.reshape(stack.shape),
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
