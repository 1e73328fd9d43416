"""Fits over several rates in plain sentences: what the data tell, and what they cannot."""

from __future__ import annotations

import numpy as np

from analysis import FrequencyFit, RatesFit, RatesFlag
from analysis.frequency_method import FrequencyFlag
from station.results.numbers import with_uncertainty

SEEN = 3.3
"""Standard uncertainties from zero beyond which something is called seen."""

_DECIBELS = 20 / np.log(10)

COUPLING_DEG = 60
COUPLING = 0.27
"""The gain corner comes out too high by this times (WL/slowest rate)^2 where the backscatter of the beams is
`COUPLING_DEG` apart and cross over self saturation 0.5 (integrated equations; docs/several_rates.md)."""

CAVEAT = (
    "The beat frequency shows the lock-in rate only where the coupling of the beams is dissipative: a "
    "conservative part pushes the frequency up when the beat is fast against the gain, and WL comes out too "
    "small, zero or imaginary. Compare with the harmonics first."
)


def describe_rates(fit: RatesFit) -> tuple[str, ...]:
    """Sentences for the person who reads the result, the main one first."""
    sentences = [_value(fit), _distortion(fit), _gain(fit), _alternatives(fit), _third_order(fit), _bandwidth(fit)]
    sentences += [_test(fit), _left_out(fit), _phase(fit), _records(fit)]
    sentences += [_locked(fit), _unused(fit), _mismatch(fit), _reference(fit)]
    return tuple(s for s in sentences if s)


def separated_words(fit: RatesFit) -> str:
    """Name what the fit has told from lock-in, with its size: it no longer spoils the value; empty if nothing."""
    found = []
    if abs(fit.distortion) > SEEN * fit.distortion_u:
        level, u = 20 * np.log10(abs(fit.distortion)), _DECIBELS * fit.distortion_u / abs(fit.distortion)
        found.append(f"distortion {with_uncertainty(float(level), float(u), 'dBc')}")
    if fit.gain_time > SEEN * fit.gain_time_u:
        corner_u = fit.gain_corner_hz * fit.gain_time_u / fit.gain_time
        found.append(f"gain corner {with_uncertainty(fit.gain_corner_hz, corner_u, 'Hz')}")
    return f"{', '.join(found)}: found and removed" if found else ""


def _has(fit: RatesFit, flag: RatesFlag) -> bool:
    return bool(fit.flags & flag)


def _value(fit: RatesFit) -> str:
    senses = "one sense" if _has(fit, RatesFlag.ONE_SENSE) else "both senses"
    n_rates = max(fit.left_out.rate.size, 1)
    rates = f"{n_rates} rate{'s' if n_rates > 1 else ''}"
    origin = f"from {int(fit.used.sum())} records at {rates} in {senses}"
    if _has(fit, RatesFlag.NOT_SIGNIFICANT):
        text = (
            f"No lock-in stands out of the noise: below {fit.lock_in_rate_high_95:.3g} deg/s with 95 %, {origin}."
        )
    else:
        value = f"{fit.lock_in_rate:.6g} ± {fit.lock_in_rate_u:.2g} deg/s"
        text = f"The fit gives a lock-in rate of {value} (k = 1, as the records show it) {origin}."
    if _has(fit, RatesFlag.RATES_TOO_CLOSE):
        text += (
            f" The rates lie too close together: not knowing the distortion multiplies the uncertainty by"
            f" {fit.cost:.3g}. Take the other sense as well, or rates that differ by a factor of two and more."
        )
    elif _has(fit, RatesFlag.NOT_DETERMINED) and not _has(fit, RatesFlag.NOT_SIGNIFICANT):
        text += " These records do not determine it."
    return text


def _distortion(fit: RatesFit) -> str:
    if np.isnan(fit.distortion):
        return "Second-order distortion of the receiver was taken to be zero; it would go into the lock-in rate."
    if abs(fit.distortion) > SEEN * fit.distortion_u:
        level = 20 * np.log10(abs(fit.distortion))
        return f"The receiver makes a second harmonic of {level:.1f} dBc; it is taken out."
    limit = 20 * np.log10(abs(fit.distortion) + 1.96 * fit.distortion_u)
    return f"No second-order distortion is seen; it is below {limit:.0f} dBc with 95 %."


def _gain(fit: RatesFit) -> str:
    if not np.isnan(fit.gain_time):
        low, high = fit.gain_corner_low_95_hz, fit.gain_corner_high_95_hz
        if fit.gain_time > SEEN * fit.gain_time_u:
            span = f"{low:.4g} to {high:.4g} Hz"
            return f"The gain corner of the laser is seen at {fit.gain_corner_hz:.4g} Hz ({span}).{_coupling(fit)}"
        if fit.gain_time < -SEEN * fit.gain_time_u:
            return (
                "The second harmonic runs ahead with the rate, which no gain corner does: look for a slow or "
                "AC-coupled channel."
            )
        above = f"above {low:.3g} Hz" if np.isfinite(low) else "anywhere"
        return f"The rates do not reach the gain corner of the laser: it lies {above} with 95 %."
    if np.isnan(fit.gain_time_limit):
        return "The gain corner of the laser was taken to be far above the beat; these records cannot show it."
    corner = 1 / (2 * np.pi * fit.gain_time_limit)
    fuller = next(m for m in fit.models if m.model == ("both" if fit.model == "distortion" else "gain"))
    return (
        f"The gain corner of the laser was taken to be far above the beat; these records only say that it lies "
        f"above {corner:.3g} Hz. With a free corner the lock-in rate would be {fuller.lock_in_rate:.5g} ± "
        f"{fuller.lock_in_rate_u:.2g} deg/s; faster rates, or both senses, settle it."
    )


def _alternatives(fit: RatesFit) -> str:
    """Every other solution with its numbers: the records do not say which of them is true."""
    if not fit.alternatives:
        return ""
    others = "; ".join(
        f"{one.lock_in_rate:.5g} ± {one.lock_in_rate_u:.2g} deg/s (chi-square {one.chi_square:+.1f})"
        for one in fit.alternatives
    )
    return (
        f"These records have more than one solution. Beside the value above: {others}. The interval, "
        f"{fit.lock_in_rate_low_95:.5g} to {fit.lock_in_rate_high_95:.5g} deg/s, holds all of them; the other "
        "sense of rotation, or one more rate, decides."
    )


def _third_order(fit: RatesFit) -> str:
    if not abs(fit.third_order) > 3.3 * fit.third_order_u:
        return ""
    level = 20 * np.log10(abs(fit.third_order))
    return f"The receiver makes a third harmonic of {level:.1f} dBc; what it does to the second is taken out."


def _bandwidth(fit: RatesFit) -> str:
    if fit.lag_square > 3.3 * fit.lag_square_u:
        return f"The receiver has a corner at about {fit.bandwidth_hz:.3g} Hz; its effect is taken out."
    if fit.lag_square < -3.3 * fit.lag_square_u:
        return (
            "The second harmonic grows with the rate, which no low pass does: look for a channel that is "
            "AC-coupled or rises with frequency."
        )
    return ""


def _records(fit: RatesFit) -> str:
    if _has(fit, RatesFlag.STATED_LIMITS_EXCEEDED):
        return (
            "The records show more distortion, or a lower corner of receiver or laser, than was stated; the "
            "statement was not used."
        )
    if not _has(fit, RatesFlag.RECORDS_MISFIT):
        return ""
    return (
        "Records depart from the lock-in waveform by more than their noise, and third-order distortion does not "
        "explain it: the lock-in rate may be wrong by more than its uncertainty. See the records' own flags."
    )


def _coupling(fit: RatesFit) -> str:
    """What coupling without loss would do to the gain corner, where that is more than its uncertainty."""
    slowest = float(np.min(np.abs(fit.rate[fit.used])))
    share = COUPLING * (fit.lock_in_rate / slowest) ** 2
    if share * fit.gain_time < fit.gain_time_u:
        return ""
    return (
        f" It holds for backscatter of the two beams in phase; {COUPLING_DEG} deg between them would make it "
        f"about {100 * share:.1g} % too high, through the slowest rate. Without that rate it would show less."
    )


def _test(fit: RatesFit) -> str:
    if fit.degrees_of_freedom == 0:
        return "Nothing is left over to test the model with: one more rate would do that."
    numbers = f"chi-square {fit.chi_square:.3g} for {fit.degrees_of_freedom} degrees of freedom"
    if _has(fit, RatesFlag.MISFIT):
        return (
            f"The records do not agree with the model within their noise ({numbers}); the uncertainty is enlarged "
            "to their scatter. A rate that moves, a slow channel or a wrong rate does that."
        )
    return f"The records agree with the model within their noise ({numbers})."


def _left_out(fit: RatesFit) -> str:
    known = np.isfinite(fit.left_out.deviation)
    if not known.any():
        return "No rate can be left out as a check: the others would not determine the lock-in rate."
    size = np.where(known, np.abs(fit.left_out.deviation), 0.0)
    worst = int(np.argmax(size))
    rate, change = fit.left_out.rate[worst], fit.left_out.lock_in_rate[worst] - fit.lock_in_rate
    if _has(fit, RatesFlag.ONE_RATE_DISAGREES):
        return (
            f"Without the records at {rate:.4g} deg/s the lock-in rate changes by {change:+.2g} deg/s, "
            f"{size[worst]:.1f} of its standard uncertainties: look at that rate."
        )
    return (
        f"Leaving out any one rate changes the lock-in rate by at most {size[worst]:.1f} standard uncertainties."
    )


def _phase(fit: RatesFit) -> str:
    if fit.model not in ("both", "all") or _has(fit, RatesFlag.NOT_SIGNIFICANT):
        return ""
    if abs(np.cos(fit.backscatter_phase)) < 0.15:
        return (
            "The backscatter phase is near a right angle to the readout phase, where the first effect of a gain "
            "corner looks like distortion: these two are told apart poorly, the lock-in rate suffers less."
        )
    return ""


def _locked(fit: RatesFit) -> str:
    text = ""
    if _has(fit, RatesFlag.LOCKED_RECORDS):
        text = (
            f"No beat at {fit.at_least:.4g} deg/s: the lock-in rate is at least that; the interval begins there."
        )
    if _has(fit, RatesFlag.NO_BEAT_ABOVE_LOCK_IN):
        above = np.abs(fit.rate[fit.locked & (np.abs(fit.rate) > fit.lock_in_rate_high_95)])
        text += (
            f" Records without a beat where the gyro should turn freely: {above.size}, at {above.min():.4g} deg/s"
            " and above; look at cable, laser and table."
        )
    return text.strip()


def _unused(fit: RatesFit) -> str:
    n = int(np.sum(~fit.used & ~fit.locked))
    if n == 0:
        return ""
    return (
        f"{n} of {fit.used.size} records could not be used: no ratio, or a beat faster than the given rate allows."
    )


def _mismatch(fit: RatesFit) -> str:
    if not _has(fit, RatesFlag.RATE_AND_BEAT_DISAGREE):
        return ""
    known = fit.rate_mismatch[np.isfinite(fit.rate_mismatch)]
    if not known.size:
        return "The records show a beat at rates that lock the gyro: rates or scale factor are wrong."
    worst = known[np.argmax(np.abs(known))]
    return (
        f"Beat frequencies and given rates differ by up to {100 * worst:+.2g} %: table rate, tilt, earth rate or "
        "scale factor is wrong. With the beat as reference only the scale factor matters. If the rates are right, "
        f"the scale factor is {fit.scale_factor:.6g} ± {max(fit.scale_factor_u, 0.0):.2g} pulses per degree."
    )


def _reference(fit: RatesFit) -> str:
    if fit.reference == "beat":
        return (
            "The rate was taken from the beat itself: an error of the scale factor goes 1:1 into the lock-in rate."
        )
    return "The rates given were used: an error common to all of them goes 1:1 into the lock-in rate."


def describe_frequencies(fit: FrequencyFit) -> tuple[str, ...]:
    """Say what beat frequencies against rate tell: the main sentence first, the caveat of the method last."""
    known = "given" if fit.scale_factor_given else "fitted"
    origin = f"from {int(fit.used.sum())} beat frequencies, scale factor {known}"
    high = fit.lock_in_rate_high_95
    if np.isnan(high):
        value = (
            f"WL^2 is {fit.lock_in_square:.3g} ± {fit.lock_in_square_u:.2g} (deg/s)^2, below zero beyond its "
            f"uncertainty, {origin}: the frequency is pushed up, not pulled down. There is no lock-in rate in it."
        )
    elif fit.flags & FrequencyFlag.NOT_SIGNIFICANT:
        value = (
            f"WL^2 is {fit.lock_in_square:.3g} ± {fit.lock_in_square_u:.2g} (deg/s)^2 and does not stand out, "
            f"{origin}; the frequencies alone would say WL below {high:.3g} deg/s with 95 %."
        )
    else:
        value = f"Lock-in rate {fit.lock_in_rate:.5g} ± {fit.lock_in_rate_u:.2g} deg/s (k = 1) {origin}."
    others = (
        f"Scale factor {fit.scale_factor:.8g} ± {fit.scale_factor_u:.2g} pulses per degree, bias rate "
        f"{fit.bias_rate:.3g} ± {fit.bias_rate_u:.2g} deg/s."
    )
    if not fit.scale_factor_given:
        others += " The rates rest on a tilt that was found with the scale factor used: this one repeats it."
    sentences = [value, others]
    if fit.flags & FrequencyFlag.MISFIT:
        sentences.append(
            f"The frequencies scatter more than their uncertainties say (chi-square {fit.chi_square:.3g} for "
            f"{fit.degrees_of_freedom} degrees of freedom); the result's are enlarged to that."
        )
    if fit.flags & FrequencyFlag.NO_BEAT_ABOVE_LOCK_IN:
        sentences.append("There are records without a beat at rates where the gyro should turn freely.")
    if fit.flags & FrequencyFlag.LOCKED_RECORDS:
        sentences.append("Records without a beat bound the lock-in rate from below; the interval begins there.")
    return (*sentences, CAVEAT)
