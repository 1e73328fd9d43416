"""Numbers and findings as a person reads them."""

from __future__ import annotations

import math

from analysis import FATAL, QuadratureFlag, describe_flag, flag_names
from analysis.budget import Budget
from analysis.lock_in_run import SeveralRates
from station.lock_in.evaluation import Evaluation
from station.lock_in.rates_sentences import describe_rates

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


def with_uncertainty(value: float, u: float, unit: str = "") -> str:
    """Write a value with its standard uncertainty in the last digits.

    Examples
    --------
    >>> with_uncertainty(0.0100023, 0.0000121, "deg/s")
    '0.010002(12) deg/s'
    >>> with_uncertainty(159.9912, 0.25, "Hz")
    '159.99(25) Hz'
    >>> with_uncertainty(36.1, 12.0)
    '36(12)'
    """
    tail = f" {unit}" if unit else ""
    if not math.isfinite(value):
        return "none"
    if not math.isfinite(u) or u <= 0:
        return f"{value:.6g}{tail}"
    digits = 1 - math.floor(math.log10(u))
    if round(u * 10.0**digits) >= 100:  # 0.0996 is written with the digits of 0.10
        digits -= 1
    if digits <= 0:
        return f"{value:.0f}({u:.0f}){tail}"
    return f"{value:.{digits}f}({round(u * 10.0**digits)}){tail}"


def with_prefix(value: float, unit: str) -> str:
    """Write a value with the unit prefix that fits.

    Examples
    --------
    >>> with_prefix(0.025, "s/div")
    '25 ms/div'
    >>> with_prefix(0.000004, "s")
    '4 µs'
    """
    if value == 0 or not math.isfinite(value):
        return f"{value:g} {unit}"
    for factor, prefix in (
        (1e9, "G"),
        (1e6, "M"),
        (1e3, "k"),
        (1.0, ""),
        (1e-3, "m"),
        (1e-6, "µ"),
        (1e-9, "n"),
    ):
        if abs(value) >= factor * 0.9999995:
            return f"{value / factor:.4g} {prefix}{unit}"
    return f"{value:.4g} {unit}"


def lock_in_words(evaluation: Evaluation) -> tuple[str, str]:
    """Return the lock-in rate in deg/s and in deg/h, each with its standard uncertainty."""
    rate, u = float(evaluation.combined.lock_in_rate), float(evaluation.combined.lock_in_rate_u)
    return with_uncertainty(rate, u, "deg/s"), with_uncertainty(
        rate * _SECONDS_PER_HOUR, u * _SECONDS_PER_HOUR, "deg/h"
    )


def interval_words(evaluation: Evaluation) -> str:
    """Return the 95 % interval of the lock-in rate in words."""
    combined = evaluation.combined
    low, high = float(combined.lock_in_rate_low_95), float(combined.lock_in_rate_high_95)
    u = float(combined.lock_in_rate_u)
    digits = max(0, 1 - math.floor(math.log10(u))) if math.isfinite(u) and u > 0 else 6
    return f"{low:.{digits}f} to {high:.{digits}f} deg/s"


def flag_sentences(evaluation: Evaluation) -> list[str]:
    """Say in words what was noticed, of the combined result and of single records."""
    said = []
    for name in evaluation.flags:
        sentence = describe_flag(name)
        count = sum(name in names for names in record_flags(evaluation))
        total = len(evaluation.waveforms)
        said.append(f"{sentence} ({count} of {total} records)" if 0 < count < total else sentence)
    if evaluation.damaged:
        said.append(f"Left out, since they are not what was once saved: record {', '.join(evaluation.damaged)}.")
    return said


def rates_sentences(evaluation: Evaluation) -> list[str]:
    """Say what records at several rates can tell and what they cannot; empty for one rate."""
    several = evaluation.several
    if several is None:
        return []
    fitted = [several.problem] if several.by_beat is None else list(describe_rates(several.by_beat))
    return [*fitted, *(f"No record at {text}" for text in evaluation.without_beat)]


def quadrature_sentences(evaluation: Evaluation) -> list[str]:
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


GROUP_COLUMNS = ("rate/WL", "table, deg/s", "axis, deg/s", "beat, Hz", "r = A2/A1", "WL alone, deg/s", "records")


def group_rows(several: SeveralRates) -> list[tuple[str, ...]]:
    """Return what each rate of a run says alone, under `GROUP_COLUMNS`."""
    rows: list[tuple[str, ...]] = []
    for group in several.groups:
        one, sense = group.combined, "-" if group.input_rate < 0 else "+"
        asked = "" if group.over_lock_in is None else f"{sense}{group.over_lock_in:g}"
        left_out = int(one.records_rejected)
        rows.append(
            (
                asked,
                f"{group.table_rate:+.4f}",
                f"{group.input_rate:+.5f}",
                with_uncertainty(float(one.beat_frequency), float(one.beat_frequency_u)),
                with_uncertainty(float(one.ratio), float(one.ratio_u)),
                with_uncertainty(float(one.lock_in_rate), float(one.lock_in_rate_u)),
                f"{len(group.rows)}, left out {left_out}" if left_out else f"{len(group.rows)}",
            )
        )
    return rows


def record_flags(evaluation: Evaluation) -> list[list[str]]:
    """Return the names of the flags of each record."""
    return [flag_names(int(flags)) for flags in evaluation.each.flags]


def no_result_words(evaluation: Evaluation) -> str:
    """Say in one sentence why no lock-in rate is given."""
    if evaluation.several is not None and evaluation.several.problem:
        return f"no lock-in rate: {evaluation.several.problem}"
    fatal = [describe_flag(name) for name in flag_names(int(evaluation.combined.flags) & int(FATAL))]
    reasons = fatal or flag_sentences(evaluation) or ["The records show no beat."]
    return f"no lock-in rate: {' '.join(reasons)}"


BUDGET_COLUMNS = (
    "quantity",
    "value",
    "u (k = 1)",
    "distribution",
    "sensitivity, deg/s per unit",
    "contribution, deg/s",
    "share",
    "d.o.f.",
)


def budget_rows(budget: Budget) -> list[tuple[str, ...]]:
    """Return the lines of a budget as text under `BUDGET_COLUMNS`, the largest contribution first.

    Parameters
    ----------
    budget : Budget

    Returns
    -------
    list of tuple of str
        The last one is the combined uncertainty.
    """
    rows: list[tuple[str, ...]] = []
    for line in budget.inputs:
        unit = "" if line.unit == "1" else f" {line.unit}"
        rows.append(
            (
                line.quantity,
                f"{line.value:.6g}{unit}",
                f"{line.u:.2g}{unit}",
                line.distribution,
                f"{line.sensitivity:.3g}" if line.sensitivity else "0",
                f"{line.contribution:.2g}" if line.contribution else "0",
                _percent(budget.share(line)),
                _freedom(line.degrees_of_freedom),
            )
        )
    rows.append(
        (
            "lock-in rate, combined",
            f"{budget.lock_in_rate:.6g} deg/s",
            f"{budget.combined_u:.2g} deg/s",
            "",
            "",
            f"{budget.combined_u:.2g}",
            "100 %",
            _freedom(budget.effective_degrees_of_freedom),
        )
    )
    return rows


def budget_sentences(budget: Budget) -> list[str]:
    """Say in words what the budget comes to, and what it does not hold.

    Parameters
    ----------
    budget : Budget

    Returns
    -------
    list of str
    """
    value = with_uncertainty(budget.lock_in_rate, budget.combined_u, "deg/s")
    said = [
        f"Lock-in rate {value}, all inputs counted; U95 = {budget.expanded_u_95:.2g} deg/s "
        f"({100 * budget.coverage_factor * budget.relative_u:.2g} %) with k = {budget.coverage_factor:.2f}."
    ]
    if budget.inputs and budget.inputs[0].contribution > 0:
        first = budget.inputs[0]
        said.append(f"The largest part is: {first.quantity} ({_percent(budget.share(first))} of the variance).")
    if budget.unstated:
        said.append(
            f"Not counted, since nobody stated it: {'; '.join(budget.unstated)}. "
            "The [budget] section of the settings is the place."
        )
    return said


def _percent(share: float) -> str:
    return "0" if share == 0 else "< 0.1 %" if share < 0.001 else f"{100 * share:.1f} %"


def _freedom(value: float) -> str:
    return "∞" if value > 1e6 else f"{value:.0f}"
