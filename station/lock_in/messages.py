"""What the records say, in sentences: rates, table, flags, and what would help."""

import math
from dataclasses import replace

import numpy as np

from analysis import FATAL, Flag, FrequencyFit, QuadratureFlag, RatesFit, RatesFlag, describe_flag, flag_names
from analysis.arrays import NORMAL_95
from analysis.beam_swings import BeamsFlag
from analysis.budget import Budget, BudgetInput
from analysis.frequency_method import FrequencyFlag
from analysis.lock_in_run import ScaleFactorCheck, SeveralRates, TableCheck
from station.lock_in.evaluate import LockInEvaluation
from station.results.numbers import LOCK_IN_RATE
from station.results.result import with_uncertainty

_SECONDS_PER_HOUR = 3600.0

_QUADRATURE_FLAGS = {
    QuadratureFlag.NOT_IN_QUADRATURE: "The two channels are nearly in phase: they hold one signal twice.",
    QuadratureFlag.POOR_QUADRATURE: "The channels are far from a right angle: corrected, but less certain.",
    QuadratureFlag.FREQUENCIES_DIFFER: "The two channels show two different beats.",
    QuadratureFlag.SENSE_DISAGREES: "The channels see another sense of rotation than the table has: are they "
    "exchanged, or is one inverted?",
    QuadratureFlag.LARGE_DISTORTION: "The second harmonic of a receiver is above -34 dBc: a rest of it is left.",
    QuadratureFlag.IMAGE_LEFT: "The third harmonic has an image that neither imbalance nor distortion of second "
    "order makes: look for distortion of third order or stray light.",
}


def lock_in_words(found: LockInEvaluation) -> tuple[str, str]:
    """Return the lock-in rate in deg/s and in deg/h, each with its standard uncertainty, every input counted."""
    rate, u = found.lock_in_rate, found.lock_in_rate_u
    return with_uncertainty(rate, u, "deg/s"), with_uncertainty(
        rate * _SECONDS_PER_HOUR, u * _SECONDS_PER_HOUR, "deg/h"
    )


def interval_words(found: LockInEvaluation) -> str:
    """Return the 95 % interval of the lock-in rate in words; its digits follow the uncertainty."""
    (low, high), u = found.interval_95, found.lock_in_rate_u
    digits = max(0, 1 - math.floor(math.log10(u))) if math.isfinite(u) and u > 0 else 6
    return f"{low:.{digits}f} to {high:.{digits}f} deg/s"


def noise_words(found: LockInEvaluation) -> str:
    """Return what the records' noise alone would make of the uncertainty."""
    relative = f", {100 * found.noise_u / found.lock_in_rate:.2g} %" if found.lock_in_rate > 0 else ""
    return f"u = {found.noise_u:.2g} deg/s{relative} (k = 1)"


def truth_sentence(found: LockInEvaluation) -> str:
    """Compare a simulated truth with the 95 % interval; empty where there is none."""
    if found.truth is None:
        return ""
    true, (low, high) = found.truth[LOCK_IN_RATE.key()], found.interval_95
    distance = (found.lock_in_rate - true) / found.budget.expanded_u_95 if found.budget is not None else math.nan
    where = "inside" if low <= true <= high else "outside"
    return (
        f"The simulation's truth is {true:.6g} deg/s, {where} the 95 % interval: the result lies "
        f"{distance:+.2f} U95 from it."
    )


def truth_is_missed(found: LockInEvaluation) -> bool:
    """Tell whether a simulated truth lies outside the 95 % interval."""
    if found.truth is None or not found.usable:
        return False
    low, high = found.interval_95
    return not low <= found.truth[LOCK_IN_RATE.key()] <= high


def flag_sentence(evaluation: LockInEvaluation, name: str) -> str:
    """Say in words what a flag means, and in how many records it was noticed."""
    sentence = describe_flag(name)
    bit = int(Flag.__members__.get(name.upper(), 0))
    count = int(np.count_nonzero(evaluation.each.flags & bit))
    total = len(evaluation.waveforms)
    if name == "damaged" and evaluation.damaged:
        lost = f"Left out, since they are not what was once saved: record {', '.join(evaluation.damaged)}."
        return f"{lost} {sentence} ({count} of {total} records)" if count else lost
    return f"{sentence} ({count} of {total} records)" if 0 < count < total else sentence


def flag_sentences(evaluation: LockInEvaluation) -> list[str]:
    """Say in words what was noticed, of the combined result and of single records."""
    return [flag_sentence(evaluation, name) for name in evaluation.flags]


def rates_sentences(evaluation: LockInEvaluation) -> list[str]:
    """Say what records at several rates can tell and what they cannot; empty for one rate."""
    several = evaluation.several
    if several is None:
        return []
    fitted = [several.problem]
    if several.by_beat is not None:
        fitted = list(describe_rates(several.by_beat, beams=several.beams is not None))
    return [*fitted, *(f"No record at {text}" for text in evaluation.without_beat)]


def quadrature_sentences(evaluation: LockInEvaluation) -> list[str]:
    """Say what sine and cosine channel show of each other; empty for one channel."""
    found = evaluation.quadratures
    if found is None:
        return []
    sense = {1: "positive sense", -1: "negative sense"}.get(found.sense, "unknown sense")
    if found.sense == 0 and evaluation.several is not None:
        sense = "both senses" if len({g.table_rate > 0 for g in evaluation.several.groups}) > 1 else sense
    error = with_uncertainty(math.degrees(found.phase_error), math.degrees(found.phase_error_u))
    first = (
        f"Sine and cosine channel: amplitudes {with_uncertainty(found.gain_ratio, found.gain_ratio_u)} to 1, "
        f"{error}° beyond a right angle, {sense} of rotation."
    )
    levels = [
        f"{20 * math.log10(d):.1f} dBc" if d > 3 * u else f"below {20 * math.log10(d + 2 * u):.0f} dBc"
        for d, u in zip(map(abs, found.distortion), found.distortion_u, strict=True)
    ]
    second = (
        f"Second harmonic made by the receivers: sine {levels[0]}, cosine {levels[1]}; taken out. Alone "
        f"the sine would give {found.sine_alone:.6g} deg/s and the cosine {found.cosine_alone:.6g} deg/s."
    )
    third = f"Image of the third harmonic that is left: {found.images[2]:.2g} of the first."
    return [first, second, third, *(_QUADRATURE_FLAGS[QuadratureFlag[name.upper()]] for name in found.flags)]


_BEAMS_FLAGS = {
    BeamsFlag.CLIPPED: "A beam leaves the screen in most records and is not used: take a coarser scale for it.",
    BeamsFlag.DARK: "A beam's channel shows no swing at the beat and is not used: look at photodiode and scale.",
    BeamsFlag.SHOWS_THE_BEAT: "A beam's channel swings like the beat and is not used: are the cables exchanged?",
    BeamsFlag.NO_LEVEL: "The DC level of the beams is not known, and only the phase of their swing counts: "
    "state beams.level_v.",
    BeamsFlag.RECORDS_LEFT_OUT: "In some records the rate moves too much for the swing of the beams: they count "
    "by their beat alone.",
    BeamsFlag.MISFIT: "Beat and beams do not fit one laser within their noise, and the uncertainty is enlarged: "
    "look for a slow or AC-coupled channel, and state [beams].",
    BeamsFlag.ROUTES_DIFFER: "The routes differ: harmonics alone take the backscatter of both beams to be in "
    "phase, the frequencies take the rates to be right, and a dead band is of its own day. The fit of all "
    "together needs none of that.",
    BeamsFlag.SEVERAL_SOLUTIONS: "Another lock-in rate explains beat and beams as well, and the interval holds "
    "all: take one more rate.",
}


def beams_sentences(several: SeveralRates) -> list[str]:
    """Say what the single beams show; empty where none were recorded."""
    fit = several.beams
    if fit is None:
        seen = [text for flag, text in _BEAMS_FLAGS.items() if flag & several.beams_flags]
        return (
            [f"The single beams were not used: {several.beams_problem}.", *seen] if several.beams_problem else []
        )
    turn = 2 * math.pi
    first = with_uncertainty(fit.backscatter_1 / turn, fit.backscatter_1_u / turn, "Hz")
    second = with_uncertainty(fit.backscatter_2 / turn, fit.backscatter_2_u / turn, "Hz")
    turned = with_uncertainty(math.degrees(fit.phase_sum), math.degrees(fit.phase_sum_u))
    low, high = (f"{end / turn:.4g}" for end in (fit.gain_rate_low_95, fit.gain_rate_high_95))
    said = [
        f"Beat and single beams together: backscatter {first} and {second}, the sum of its phases {turned}°; the "
        f"gain corner of the laser lies between {low} and {high} Hz.",
        f"The difference of the beams makes beats faster by up to {100 * float(np.max(fit.push)):.2g} %.",
    ]
    return [*said, *(text for flag, text in _BEAMS_FLAGS.items() if flag & fit.flags)]


def no_result_words(evaluation: LockInEvaluation) -> str:
    """Say in one sentence why no lock-in rate is given."""
    if evaluation.several is not None and evaluation.several.problem:
        return f"no lock-in rate: {evaluation.several.problem}"
    fatal = [describe_flag(name) for name in flag_names(int(evaluation.combined.flags) & int(FATAL))]
    reasons = fatal or flag_sentences(evaluation) or ["The records show no beat."]
    return f"no lock-in rate: {' '.join(reasons)}"


# --------------------
# Fits over several rates in plain sentences: what the data tell, and what they cannot


SEEN = 3.3  # standard uncertainties from zero beyond which something is called seen

LEAST_DRIFT, LEAST_TURN = 0.001, 0.01
"""Drift of the lock-in rate (relative) and change of the phase (rad) below which nobody needs to hear of them."""

_DECIBELS = 20 / np.log(10)

COUPLING_DEG = 60
COUPLING = 0.18
"""The gain corner comes out too high by this times (WL/slowest rate)^2 where the backscatter of the beams is
`COUPLING_DEG` apart and cross over self saturation 0.5 (integrated equations; docs/several_rates.md)."""

CAVEAT = (
    "The beat frequency shows the lock-in rate only where the coupling of the beams is dissipative: a "
    "conservative part pushes the frequency up when the beat is fast against the gain, and WL comes out too "
    "small, zero or imaginary. Compare with the harmonics first."
)


def describe_rates(fit: RatesFit, *, beams: bool = False) -> tuple[str, ...]:
    """Sentences for the person who reads the result, the main one first; `beams`: these say more than the beat."""
    if beams:
        said = _value(fit), _distortion(fit), _third_order(fit), _bandwidth(fit), _locked(fit), _unused(fit)
        return tuple(filter(None, said))
    sentences = [_value(fit), _distortion(fit), _gain(fit), _alternatives(fit), _third_order(fit), _bandwidth(fit)]
    sentences += [_test(fit), _left_out(fit), _phase(fit), _records(fit)]
    sentences += [_locked(fit), _unused(fit), _mismatch(fit)]
    by_beat = "The rate was taken from the beat itself: an error of the scale factor"
    by_rate = "The rates given were used: an error common to all of them"
    sentences.append(f"{by_beat if fit.reference == 'beat' else by_rate} goes 1:1 into the lock-in rate.")
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
    if abs(fit.lock_in_drift) > max(SEEN * fit.lock_in_drift_u, LEAST_DRIFT):
        drift = with_uncertainty(100 * fit.lock_in_drift, 100 * fit.lock_in_drift_u, "%")
        found.append(f"lock-in rate drifting by {drift} over the run")
    turns = (fit.phase_between_senses, fit.phase_between_senses_u), (fit.phase_drift, fit.phase_drift_u)
    for (turn, turn_u), where in zip(turns, ("between the senses", "over the run"), strict=True):
        if abs(turn) > max(SEEN * turn_u, LEAST_TURN):
            found.append(f"backscatter phase turning by {with_uncertainty(turn, turn_u, 'rad')} {where}")
    return f"{', '.join(found)}: found and removed" if found else ""


def _has(fit: RatesFit, flag: RatesFlag) -> bool:
    return bool(fit.flags & flag)


def _value(fit: RatesFit) -> str:
    senses = "one sense" if _has(fit, RatesFlag.ONE_SENSE) else "both senses"
    rates = f"{fit.n_rates} rate{'s' if fit.n_rates > 1 else ''}"
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
    limit = 20 * np.log10(abs(fit.distortion) + NORMAL_95 * fit.distortion_u)
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
    if fit.lasers or share * fit.gain_time < fit.gain_time_u:
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


# --------------------
# The check by the rate table in plain sentences: what it shows, and what it cannot


_WAYS = {
    "known tilt": "the tilt that is known without the gyro",
    "earth rate": "the earth rate, which swings with the azimuth",
}


ALIAS = (
    "Nothing here tells the beat from an alias of one above half the sampling rate: give the rate, or compare "
    "with a record at a faster time base."
)


def table_sentences(found: LockInEvaluation) -> list[str]:
    """Say whether beat, harmonics and table fit together, and whether anything tests the scale factor."""
    check = found.table_check
    if check is None:
        return []
    used = found.method.scale_factor
    return [
        _beat_over_table(check, found.lock_in_rate),
        *(_scale_factor(one, used) for one in check.scale_factors),
        _unseen(check),
    ]


def beat_over_table_words(check: TableCheck) -> str:
    """Return beat over table with its uncertainty."""
    return with_uncertainty(check.beat_over_table, check.beat_over_table_u)


def by_table_words(check: TableCheck) -> str:
    """Return the lock-in rate by the table; its u leaves out detector and channel."""
    return f"{with_uncertainty(check.lock_in_rate, check.lock_in_rate_u, 'deg/s')} (u by noise and table)"


def _beat_over_table(check: TableCheck, lock_in_rate: float) -> str:
    over = (check.beat_over_table - 1) / check.beat_over_table_u
    verdict = "beat and table agree"
    if check.unexplained:
        verdict = "beat and table disagree, by more than chance and the whole budget explain"
    elif check.mismatch:
        verdict = (
            "more than chance explains, but not more than the budget counts for what is not known of detector and "
            "channel"
        )
    text = (
        f"Beat over table is {beat_over_table_words(check)}, {over:+.1f} u from 1: {verdict}. This check detects "
        + ("no error" if check.least_error_seen > 1 else f"errors above {100 * check.least_error_seen:.2g} %")
        + " of the lock-in rate by the harmonics (a slow channel, distortion)."
    )
    if not check.mismatch or not check.by_frequencies > 0:
        return text
    alone = with_uncertainty(check.by_frequencies, check.by_frequencies_u, "deg/s")
    off = 100 * (lock_in_rate / check.by_frequencies - 1)
    return (
        f"{text} By the beat frequencies alone, without the harmonics, the lock-in rate is {alone}; that by the "
        f"harmonics is {off:+.2g} % from it."
    )


def _scale_factor(one: ScaleFactorCheck, used: float) -> str:
    found = with_uncertainty(one.scale_factor, one.scale_factor_u, "pulses/deg")
    text = f"By {_WAYS[one.by]}, the scale factor is {found}; {used:g} was used"
    if one.p_value < 0.001:
        wrong = 100 * (one.scale_factor / used - 1)
        return (
            f"{text}. They differ by {wrong:+.2g} %, more than chance explains, and by so much the lock-in rate "
            "is then wrong: measure the scale factor, or look for a wrong angle, latitude or table rate, or a "
            "bias of the gyro."
        )
    return f"{text}, which agrees."


def _unseen(check: TableCheck) -> str:
    text = (
        "The tilt was found with the same scale factor, and an error of it is absorbed there: scale factor, tilt "
        "and lock-in rate change together, so this check cannot test K."
    )
    if check.scale_factors:
        return f"{text} Only what is said above of the scale factor tests it."
    return (
        f"{text} Nothing in these records tests the scale factor; a tilt known without the gyro "
        "(table.known_tilt_deg), or records with the table's azimuth in both senses, would."
    )


# --------------------
# The one measurement that would make an uncertainty smaller: what to measure, how, and what comes of it


_SINE = "put a clean sine of the beat's frequency and size in the place of the photodiode, measure its"
_LED = "measure the response of photodiode and amplifier at the beat and at its double, with an LED on a generator"
_REMEDIES = {
    "distortion": "take several rates in both senses (measurement.rates_over_lock_in, measurement.both_senses), "
    f"which separates it; or {_SINE} second harmonic and state budget.distortion_limit_dbc",
    "third_order": f"{_SINE} third harmonic and state budget.third_order_limit_dbc",
    "bandwidth": f"{_LED}, and state it in [front_end] (or budget.bandwidth_hz, where it is far above)",
    "high_pass": f"couple the oscilloscope DC; or {_LED}, and state it in [front_end]",
    "gain_corner": "take several rates in both senses up to 30 lock-in rates, which show the gain corner of the "
    "laser; or state budget.gain_corner_hz",
    "scale_factor": "count the beats over whole turns of the table, K = beats/(360 deg times turns), and state "
    "gyro.scale_factor_pulses_per_deg and budget.scale_factor_u_ppm",
    "time_base": "compare the time base with a frequency counter, and state budget.time_base_limit_ppm",
    "response": "measure the response in [front_end] again, more finely, and state budget.front_end_u_percent",
    "tail": f"{_LED}, and state it in [front_end] instead of the tail",
    "input_rate": "leave the rate out, so that each record is its own reference",
    "relation": "use the exact relation",
    "scatter": "find what makes the records differ (temperature, table, alignment), or take four times as many",
    "noise": "take four times as many records",
    "quantization": "take four times as many records, or let the beat fill more of the screen",
    "beat_frequency": "take four times as many records",
    "separation": "take four times as many records, or more rates, farther apart and in both senses",
}
_UNSEEN = "take several rates in both senses, up to 30 lock-in rates, which show them; or state them in [budget]"
_TABLE = "measure the rate on the gyro's axis, or let each record be its own reference"

_HALVED = ("noise", "quantization", "beat_frequency", "scatter", "separation")
"""What more records make smaller, but do not take away."""


def remedy_sentence(budget: Budget) -> str:
    """Name the measurement that would remove the largest part, and the U95 that would be left; or nothing."""
    first = budget.inputs[0] if budget.inputs else None
    if first is None or first.contribution == 0:
        return ""
    # more records show nothing of what these rates do not show
    better = replace(first, u=(0.5 if first.stated and first.name in _HALVED else 0.0) * first.u)
    after = replace(budget, inputs=tuple(better if one is first else one for one in budget.inputs)).expanded_u_95
    now = budget.expanded_u_95
    return (
        f"The largest part is {first.quantity} ({100 * budget.share(first):.0f} % of the variance"
        f"{'' if first.stated else '; nobody stated it'}): {_remedy(first)}. "
        f"U95 would fall from {_percent(now, budget)} to {_percent(after, budget)}."
    )


def short_remedy(budget: Budget) -> str:
    """The same without what would be left."""
    first = budget.inputs[0] if budget.inputs else None
    if first is None or first.contribution == 0:
        return ""
    share = f"{100 * budget.share(first):.0f} % of the variance"
    remedy = _remedy(first).partition("; or ")[0]
    if first.name == "distortion":
        remedy = "take several rates in both senses (--table manual, or the table's name), which separates it"
    return f"{first.quantity} is {share}: {remedy}"


def _remedy(line: BudgetInput) -> str:
    return _UNSEEN if line.name == "separation" and not line.stated else _REMEDIES.get(line.name, _TABLE)


def _percent(u_95: float, budget: Budget) -> str:
    if budget.lock_in_rate > 0:
        return f"{100 * u_95 / budget.lock_in_rate:.2g} %"
    return f"{u_95:.2g} deg/s"
