"""What the records say, in sentences."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from analysis import FATAL, Flag, QuadratureFlag, describe_flag, flag_names
from station.lock_in.found import LockInFound
from station.lock_in.presentation.rates_sentences import describe_rates
from station.results.numbers import with_uncertainty

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


def lock_in_words(found: LockInFound) -> tuple[str, str]:
    """Return the lock-in rate in deg/s and in deg/h, each with its standard uncertainty, every input counted."""
    rate, u = found.lock_in_rate, found.lock_in_rate_u
    return with_uncertainty(rate, u, "deg/s"), with_uncertainty(
        rate * _SECONDS_PER_HOUR, u * _SECONDS_PER_HOUR, "deg/h"
    )


def interval_words(found: LockInFound) -> str:
    """Return the 95 % interval of the lock-in rate in words; its digits follow the uncertainty."""
    (low, high), u = found.interval_95, found.lock_in_rate_u
    digits = max(0, 1 - math.floor(math.log10(u))) if math.isfinite(u) and u > 0 else 6
    return f"{low:.{digits}f} to {high:.{digits}f} deg/s"


def noise_words(found: LockInFound) -> str:
    """Return what the records' noise alone would make of the uncertainty."""
    relative = f", {100 * found.noise_u / found.lock_in_rate:.2g} %" if found.lock_in_rate > 0 else ""
    return f"u = {found.noise_u:.2g} deg/s{relative} (k = 1)"


def truth_sentence(found: LockInFound) -> str:
    """Compare a simulated truth with the 95 % interval; empty where there is none."""
    if found.truth is None:
        return ""
    true, (low, high) = found.truth["lock_in_rate_dps"], found.interval_95
    distance = (found.lock_in_rate - true) / found.budget.expanded_u_95 if found.budget is not None else math.nan
    where = "inside" if low <= true <= high else "outside"
    return (
        f"The simulation's truth is {true:.6g} deg/s, {where} the 95 % interval: the result lies "
        f"{distance:+.2f} U95 from it."
    )


def truth_is_missed(found: LockInFound) -> bool:
    """Tell whether a simulated truth lies outside the 95 % interval."""
    if found.truth is None or not found.usable:
        return False
    low, high = found.interval_95
    return not low <= found.truth["lock_in_rate_dps"] <= high


def span_words(values: Iterable[float], unit: str = "") -> str:
    """Return the sizes of what several rates have each for itself.

    Examples
    --------
    >>> span_words([0.03, -0.3, float("nan")], "deg/s"), span_words([0.5])
    ('0.03 to 0.3 deg/s', '0.5')
    """
    sizes = [abs(value) for value in values if math.isfinite(value)]
    if not sizes:
        return "none"
    ends = dict.fromkeys(f"{size:.4g}" for size in (min(sizes), max(sizes)))
    return f"{' to '.join(ends)} {unit}".rstrip()


def flag_sentence(evaluation: LockInFound, name: str) -> str:
    """Say in words what a flag means, and in how many records it was noticed."""
    sentence = describe_flag(name)
    bit = int(Flag.__members__.get(name.upper(), 0))
    count = int(np.count_nonzero(evaluation.each.flags & bit))
    total = len(evaluation.waveforms)
    if name == "damaged" and evaluation.damaged:
        lost = f"Left out, since they are not what was once saved: record {', '.join(evaluation.damaged)}."
        return f"{lost} {sentence} ({count} of {total} records)" if count else lost
    return f"{sentence} ({count} of {total} records)" if 0 < count < total else sentence


def flag_sentences(evaluation: LockInFound) -> list[str]:
    """Say in words what was noticed, of the combined result and of single records."""
    return [flag_sentence(evaluation, name) for name in evaluation.flags]


def rates_sentences(evaluation: LockInFound) -> list[str]:
    """Say what records at several rates can tell and what they cannot; empty for one rate."""
    several = evaluation.several
    if several is None:
        return []
    fitted = [several.problem] if several.by_beat is None else list(describe_rates(several.by_beat))
    return [*fitted, *(f"No record at {text}" for text in evaluation.without_beat)]


def quadrature_sentences(evaluation: LockInFound) -> list[str]:
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
    levels = [_level_words(d, u) for d, u in zip(found.distortion, found.distortion_u, strict=True)]
    second = (
        f"Second harmonic made by the receivers: sine {levels[0]}, cosine {levels[1]}; taken out. Alone "
        f"the sine would give {found.sine_alone:.6g} deg/s and the cosine {found.cosine_alone:.6g} deg/s."
    )
    third = f"Image of the third harmonic that is left: {found.images[2]:.2g} of the first."
    return [first, second, third, *(_QUADRATURE_FLAGS[QuadratureFlag[name.upper()]] for name in found.flags)]


def _level_words(distortion: float, u: float) -> str:
    """Level of a second harmonic in dBc, or the limit below which it is."""
    if abs(distortion) > 3 * u:
        return f"{20 * math.log10(abs(distortion)):.1f} dBc"
    return f"below {20 * math.log10(abs(distortion) + 2 * u):.0f} dBc"


def no_result_words(evaluation: LockInFound) -> str:
    """Say in one sentence why no lock-in rate is given."""
    if evaluation.several is not None and evaluation.several.problem:
        return f"no lock-in rate: {evaluation.several.problem}"
    fatal = [describe_flag(name) for name in flag_names(int(evaluation.combined.flags) & int(FATAL))]
    reasons = fatal or flag_sentences(evaluation) or ["The records show no beat."]
    return f"no lock-in rate: {' '.join(reasons)}"
