"""Several records at one rate, combined into one value."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.special

from analysis.arrays import Complexes, Floats
from analysis.flags import Flag
from analysis.lockin_rate import LockInEstimate, rate_and_slopes, size_interval

_AT_ONCE = 1 << 14  # records whose numbers are worked out together: those of a million would take much memory
UNLIKELY = 0.001  # a scatter that the records' own noise would produce less often than this is taken as real


AMPLITUDE_SCATTER = 0.1
"""Range of the amplitudes, over the largest, that a steady laser never has; averages over a phase that was not
triggered differ by more."""

BY_CHANCE = (Flag.COLOURED_NOISE, Flag.MISFIT, Flag.PARTS_DIFFER, Flag.RATE_WANDER)
BY_CHANCE_SHARE = 0.05  # tests of the residual raise these flags in well under this share of faultless records


UNLIKE = 5.0  # times what noise explains: such a scatter is that of records that do not belong together
RATES_DIFFER = 0.002  # range of the beat frequencies, over their mean, beyond which one setting was not one rate

SHOWN_PHASE = 5.0
"""Standard uncertainties of its noise that the size of every record must have for its own phase to be believed."""


def combine_estimates(estimates: LockInEstimate, input_rate: Floats | None = None) -> LockInEstimate:
    """Combine records at one rate, coherently: the complex values are averaged, not their sizes.

    The size of a small complex number is biased upwards by its noise, and averaging sizes keeps that bias; the
    mean of the complex values does not have it. Each record's value is the complex lock-in rate
    WL exp(i beta'), with beta' the backscatter phase less the readout phase, which is the same for both senses
    and for slightly different rates.

    Parameters
    ----------
    estimates : LockInEstimate
        Any leading shape; all records are taken together. Records with a fatal flag are left out and counted, and
        so are copies of another record.
    input_rate : (n_records,), optional
        deg/s, where it is known that the rates differ a little: the beats then may, too.

    Returns
    -------
    LockInEstimate
        Fields of shape (). The uncertainty follows from the records' own, with less weight for those that did not
        fit; what did not fit may be the same in all, so that part does not average out. Where their scatter is
        larger than their uncertainty explains, from the scatter, and `noise_model` says so. `flags` holds the bits
        of the records
        used, those that chance can raise only if more records have them than chance explains; `phase_turns`, or
        `misfit` where single records do not show their phases, if the phases disagree; `beat_wanders`;
        `records_differ`.

    Raises
    ------
    ValueError
        No record at all.
    """
    flat = without_copies(estimates.reshaped(-1))
    if flat.flags.size == 0:
        raise ValueError("no record to combine")
    usable = flat.usable
    used = flat[np.asarray(usable)]
    rejected = int((~usable).sum())
    if not usable.any():
        bits = int(np.bitwise_or.reduce(flat.flags))
        return replace(
            flat[0], flags=np.asarray(bits), records=np.asarray(0), records_rejected=np.asarray(rejected)
        )

    together = _coherent_mean(used)
    mean, rate_u, weights = together.mean, together.rate_u, together.weights

    flags = int(np.bitwise_or.reduce(used.flags)) & ~int(Flag.RATIO_NOT_SIGNIFICANT)
    for bit in BY_CHANCE:
        if np.count_nonzero(used.flags & int(bit)) <= max(2, BY_CHANCE_SHARE * len(used)) and len(used) > 2:
            flags &= ~int(bit)
    value = float(np.sqrt(max(abs(mean) ** 2 - together.across_u**2, 0.0)))
    if not abs(mean) > 3.3 * rate_u:
        flags |= Flag.RATIO_NOT_SIGNIFICANT
    if together.phases_differ:
        flags |= Flag.PHASE_TURNS if together.by_sizes else Flag.MISFIT
    beats, beats_u = _mean_frequency(used)
    alike = used.beat_frequency
    if input_rate is not None:
        alike = as_at_one_rate(alike, np.asarray(input_rate).ravel()[usable], value)
    by_noise = 10 * used.beat_frequency_u.max() / used.beat_frequency.mean()
    if np.ptp(alike) > max(RATES_DIFFER, by_noise) * alike.mean():
        flags |= Flag.BEAT_WANDERS
    if together.inflation > UNLIKE:
        flags |= Flag.RECORDS_DIFFER
    if np.ptp(used.amplitude) > AMPLITUDE_SCATTER * used.amplitude.max():
        flags |= Flag.AMPLITUDE_LOST
    low = high = abs(mean)
    if (wide := rate_u * together.stretch) > 0:
        low, high = (float(end) * wide for end in size_interval(abs(mean) / wide))
    ratio, ratio_u, rho, rho_covariance = _mean_ratio(used, weights)
    third, third_u = _mean_third_harmonic(used)
    model = used.noise_model
    if together.unequal:
        model += "; enlarged to the scatter between records, which is more than that noise explains"
    return replace(
        used[0],
        lock_in_rate=np.asarray(value),
        lock_in_rate_u=np.asarray(rate_u),
        lock_in_rate_low_95=np.asarray(low),
        lock_in_rate_high_95=np.asarray(high),
        input_rate=np.asarray(used.input_rate.mean()),
        beat_frequency=np.asarray(beats),
        beat_frequency_u=np.asarray(beats_u),
        ratio=ratio,
        ratio_u=ratio_u,
        misfit_u=np.asarray(np.sum(weights * used.misfit_u)),
        complex_ratio=rho,
        complex_ratio_covariance=rho_covariance,
        backscatter_phase=np.asarray(np.angle(mean)),
        amplitude=np.asarray(used.amplitude.mean()),
        noise_rms=np.asarray(np.sqrt((used.noise_rms**2).mean())),
        third_harmonic=third,
        third_harmonic_u=third_u,
        periods=np.asarray(used.periods.sum()),
        flags=np.asarray(flags),
        noise_model=model,
        records=np.asarray(int(usable.sum())),
        records_rejected=np.asarray(rejected),
    )


def without_copies(estimates: LockInEstimate) -> LockInEstimate:
    """The records (n,), every copy of an earlier one flagged: noise never gives the same numbers twice."""
    rows = np.flatnonzero(estimates.usable)
    _, first = np.unique(estimates.complex_ratio[rows], return_index=True)
    if first.size == rows.size:
        return estimates
    flags = estimates.flags.copy()
    flags[np.delete(rows, first)] |= int(Flag.COPY)
    return replace(estimates, flags=flags)


def _mean_frequency(used: LockInEstimate) -> tuple[float, float]:
    """Mean of the beat frequencies and its u; that of their scatter where noise does not explain it."""
    frequency, weights = used.beat_frequency, 1 / np.maximum(used.beat_frequency_u**2, 1e-300)
    mean, degrees = float(np.average(frequency, weights=weights)), frequency.size - 1
    by_noise = float(1 / np.sqrt(weights.sum()))
    if degrees < 1 or scipy.special.chdtrc(degrees, float(np.sum(weights * (frequency - mean) ** 2))) > UNLIKELY:
        return mean, by_noise
    return float(frequency.mean()), float(max(frequency.std(ddof=1) / np.sqrt(frequency.size), by_noise))


def as_at_one_rate(beats: Floats, rate: Floats, lock_in_rate: float) -> Floats:
    """Beats as they would be if all known rates, deg/s, were the mean of their sizes."""
    above = np.sqrt(np.maximum(rate**2 - lock_in_rate**2, (0.01 * rate) ** 2))
    return np.asarray(beats * (above.mean() / above))


@dataclass(frozen=True)
class _CoherentMean:
    """Weighted mean of the complex lock-in rates, and what their scatter says."""

    mean: complex
    weights: Floats
    rate_u: float  # standard uncertainty along its own direction, and across it from noise alone
    across_u: float
    inflation: float  # the part of rate_u that their scatter asks for
    stretch: float  # factor for the 95 % interval
    unequal: bool  # whether they scatter by more than their uncertainty explains, along and across
    phases_differ: bool
    # whether each record shows its phase by itself, so that the mean is that of their sizes
    by_sizes: bool = False


def _coherent_mean(used: LockInEstimate) -> _CoherentMean:
    each = _ComplexRates(np.empty(len(used), np.complex128), *(np.empty(len(used)) for _ in range(3)))
    for some in _blocks(used):
        parts = _complex_rates_of_some(used[some])
        each.values[some], each.radial[some], each.tangential[some], each.misfit[some] = parts
    found = _mean_of(used, each)
    size = np.abs(each.values)
    if not found.phases_differ or np.any(size**2 < SHOWN_PHASE**2 * each.tangential):
        return found
    # every record along one direction, with its size freed of what noise across it adds
    unbiased = np.sqrt(size**2 - each.tangential) * np.exp(1j * np.angle(found.mean))
    by_size = _mean_of(used, replace(each, values=unbiased.astype(np.complex128)))
    return replace(by_size, phases_differ=True, by_sizes=True, across_u=0.0)


def _mean_of(used: LockInEstimate, each: _ComplexRates) -> _CoherentMean:
    weights = 1 / np.maximum((each.radial + each.tangential) / 2, 1e-300)
    weights /= weights.sum()
    mean = complex(sum(np.sum(weights[some] * each.values[some]) for some in _blocks(used)))
    along = np.conj(mean / abs(mean)) if mean != 0 else 1.0
    by_noise = by_misfit = across = 0.0
    radial, tangential = _Scatter(), _Scatter()
    for some in _blocks(used):
        w, misfit, turned = weights[some], each.misfit[some], each.values[some] * along
        by_noise += float(np.sum(w**2 * (each.radial[some] - misfit**2)))
        by_misfit += float(np.sum(w * misfit))
        across += float(np.sum(w**2 * (each.tangential[some] - misfit**2)))
        radial.add(turned.real - abs(mean), each.radial[some], w)
        tangential.add(turned.imag, each.tangential[some], w)
    inflation, stretch, unequal = radial.said()
    rate_u = float(np.hypot(np.sqrt(by_noise), by_misfit)) * inflation
    across_u, phases_differ = float(np.sqrt(across)), tangential.said()[2]
    return _CoherentMean(mean, weights, rate_u, across_u, inflation, stretch, unequal, phases_differ)


@dataclass(frozen=True)
class _ComplexRates:
    """WL exp(i beta') of each record."""

    values: Complexes
    radial: Floats  # variances along and across its own direction
    tangential: Floats
    misfit: Floats  # standard uncertainty in both by what is no noise


def _blocks(used: LockInEstimate) -> Iterator[slice]:
    return (slice(first, first + _AT_ONCE) for first in range(0, len(used), _AT_ONCE))


def _complex_rates_of_some(used: LockInEstimate) -> tuple[Complexes, Floats, Floats, Floats]:
    size = np.abs(used.complex_ratio)
    rate = used.input_rate if used.rate_given else None
    value, slope, _ = rate_and_slopes(size, used.beat_frequency / used.scale_factor, rate, used.relation)
    unit = used.complex_ratio / np.where(size > 0, size, 1.0)
    turned = np.stack([-unit.imag, unit.real], axis=-1)
    across = np.einsum("ri,rij,rj->r", turned, used.complex_ratio_covariance, turned)
    scale = np.divide(value, size, out=np.asarray(slope, dtype=float).copy(), where=size > 0)
    vector = np.asarray(value * np.exp(1j * used.backscatter_phase), dtype=np.complex128)
    # At a small ratio the slope is that of the size, and the two scales are one.
    misfit = np.minimum(used.misfit_u * scale, used.lock_in_rate_u)
    return vector, used.lock_in_rate_u**2, np.asarray(across * scale**2 + misfit**2), np.asarray(misfit)


@dataclass
class _Scatter:
    """Deviations of records from their mean against their variances, as they come."""

    count: int = 0
    known: bool = True
    chi_square: float = 0.0
    seen: float = 0.0
    expected: float = 0.0

    def add(self, deviation: Floats, variance: Floats, weights: Floats) -> None:
        """Take some records."""
        self.count += deviation.size
        self.known = self.known and bool(np.all(variance > 0))
        if self.known:
            self.chi_square += float(np.sum(deviation**2 / variance))
            self.seen += float(np.sum(weights**2 * deviation**2))
            self.expected += float(np.sum(weights**2 * variance))

    def said(self) -> tuple[float, float, bool]:
        """Factor for the uncertainty, factor for the 95 % interval beyond it, and whether the scatter is real."""
        degrees = self.count - 1
        if degrees < 1 or not self.known:
            return 1.0, 1.0, False
        if scipy.special.chdtrc(degrees, self.chi_square) > UNLIKELY:
            return 1.0, 1.0, False
        # Uncertainty of the weighted mean from the scatter itself, with Student's factor for the interval.
        seen = self.seen * (degrees + 1) / degrees
        student = float(scipy.special.stdtrit(degrees, 0.975)) / -float(scipy.special.ndtri(0.025))
        return max(float(np.sqrt(seen / self.expected)), 1.0), student, True


def _mean_ratio(used: LockInEstimate, weights: Floats) -> tuple[Floats, Floats, Complexes, Floats]:
    """Coherent mean of rho: its size freed of bias, uncertainty of the size, the mean and its covariance."""
    # Where both senses are there, records of the negative one count with the value that the positive would give.
    rate = used.input_rate
    mixed = used.rate_given and bool((rate < 0).any() and not (rate < 0).all())
    mean, covariance = 0j, np.zeros((2, 2))
    for some in _blocks(used):
        part, weight = used[some], weights[some]
        rho, turned = part.complex_ratio, part.complex_ratio_covariance
        if mixed:
            negative = part.input_rate < 0
            rho = np.where(negative, -np.conj(rho), rho)
            mirror = np.where(negative, -1.0, 1.0)[:, np.newaxis] * np.array([1.0, 0.0]) + np.array([0.0, 1.0])
            turned = turned * mirror[:, :, np.newaxis] * mirror[:, np.newaxis, :]
        mean += complex(np.sum(weight * rho))
        covariance += np.einsum("r,rij->ij", weight**2, turned)
    size = abs(mean)
    along = np.array([mean.real, mean.imag]) / size if size > 0 else np.array([1.0, 0.0])
    across = np.array([-along[1], along[0]])
    ratio = np.sqrt(max(size**2 - float(across @ covariance @ across), 0.0))
    ratio_u = np.hypot(np.sqrt(along @ covariance @ along), np.sum(weights * used.misfit_u))
    return np.asarray(ratio), np.asarray(ratio_u), np.asarray(mean), covariance


def _mean_third_harmonic(used: LockInEstimate) -> tuple[Complexes, Floats]:
    """Weighted mean of the third harmonics, those of unknown size left out, and its uncertainty."""
    weights = used.third_harmonic_u**-2.0
    total = weights.sum()
    if total == 0:
        return np.asarray(0j), np.asarray(np.inf)
    return np.asarray(np.sum(weights * used.third_harmonic) / total), np.asarray(1 / np.sqrt(total))
