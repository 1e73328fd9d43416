"""Records of one run at several rates: each rate by itself, and one fit to all of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.arrays import Floats, Indices
from analysis.combine import combine_estimates
from analysis.errors import NoFit, OneRateOnly
from analysis.flags import FATAL, Flag
from analysis.frequency_method import FrequencyFit, fit_frequencies
from analysis.lock_in_run.records import RecordArrays
from analysis.lock_in_run.table_check import ByTable
from analysis.lock_in_run.table_rate import AxisRates
from analysis.lockin_rate import LockInEstimate
from analysis.several_rates import RatesFit, RatesFlag, ReceiverKnowledge, Reference, fit_rates


@dataclass(frozen=True, eq=False)
class RateGroup:
    """The records at one rate of the table."""

    table_rate: float  # deg/s, signed
    input_rate: float  # mean rate on the gyro's axis by the table, deg/s, signed
    over_lock_in: float | None  # what was asked for, in expected lock-in rates
    rows: Indices  # which of the records they are
    combined: LockInEstimate  # fields of shape (): what this rate says alone


@dataclass(frozen=True)
class SeveralRates:
    """What records at several rates, or in both senses, say together."""

    groups: tuple[RateGroup, ...]  # from the fastest in the positive sense to the fastest in the negative one
    # fit with the beat frequency, and with the table, as reference; ``None`` where it is not possible
    by_beat: RatesFit | None
    by_table: RatesFit | None
    # the other route: beat frequency against rate, without harmonics, scale factor free
    by_frequency: FrequencyFit | None = None
    problem: str = ""  # why there is no fit by the beat

    @property
    def reference_group(self) -> RateGroup:
        """The rate that determines the lock-in rate best; it stands for all where one value is asked for."""

        def relative_u(group: RateGroup) -> float:
            one = group.combined
            relative = float(one.lock_in_rate_u) / max(float(one.lock_in_rate), 1e-300)
            return relative if math.isfinite(relative) else math.inf

        return min(self.groups, key=relative_u)


def at_several_rates(slow: RecordArrays) -> bool:
    """Tell whether a run went through several rates of the table, or through both senses of one."""
    return np.unique(slow.table_rate).size > 1


def evaluate_rates(
    slow: RecordArrays, each: LockInEstimate, axis: AxisRates, receiver: ReceiverKnowledge
) -> SeveralRates:
    """Combine the records at each rate, and fit all of them."""
    if each.rate_given or each.relation != "exact":
        raise OneRateOnly(
            "this run has several rates: they are fitted with the exact relation and their own rates"
        )
    rates, counts = np.unique(slow.table_rate, return_counts=True)
    place = np.searchsorted(rates, slow.table_rate)
    groups = []
    for index in range(rates.size)[::-1]:
        rows = np.flatnonzero(place == index)
        asked = float(slow.over_lock_in[rows[0]])
        group = RateGroup(
            table_rate=float(rates[index]),
            input_rate=float(np.mean(axis.rates[rows])),
            over_lock_in=asked if math.isfinite(asked) else None,
            rows=rows,
            combined=combine_estimates(each[rows]),
        )
        groups.append(group)
    # shared by the records at one rate: their mean is no better than one of them
    rates_u = axis.azimuth_u * np.sqrt(counts[place])
    by_beat, problem = _fit(each, axis, rates_u, "beat", receiver)
    by_table, _ = _fit(each, axis, rates_u, "rate", receiver)
    return SeveralRates(tuple(groups), by_beat, by_table, _frequencies(each, axis, rates_u), problem)


def _fit(
    each: LockInEstimate, axis: AxisRates, rates_u: Floats, reference: Reference, receiver: ReceiverKnowledge
) -> tuple[RatesFit | None, str]:
    try:
        fit = fit_rates(each, input_rate=axis.rates, input_rate_u=rates_u, reference=reference, receiver=receiver)
        return fit, ""
    except NoFit as reason:
        return None, str(reason)


def _frequencies(each: LockInEstimate, axis: AxisRates, rates_u: Floats) -> FrequencyFit | None:
    """Fit the beat frequencies; with one sense alone a bias rate cannot be told from the rest."""
    usable = each.usable
    both = np.unique(np.sign(axis.rates[usable])).size == 2
    frequency = np.where(usable, each.beat_frequency, np.nan)
    try:
        return fit_frequencies(axis.rates, frequency, each.beat_frequency_u, input_rate_u=rates_u, bias=both)
    except NoFit:
        return None


def combined_estimate(several: SeveralRates) -> LockInEstimate:
    """The result of the fit in the form that a result at one rate has."""
    one, fit = several.reference_group.combined, several.by_beat
    rejected = sum(int(group.combined.records_rejected) for group in several.groups)
    total = sum(len(group.rows) for group in several.groups)
    counts: dict[str, Any] = {"records": np.asarray(total - rejected), "records_rejected": np.asarray(rejected)}
    if fit is None:
        nothing: dict[str, Any] = dict.fromkeys(
            ("lock_in_rate", "lock_in_rate_u", "lock_in_rate_low_95", "lock_in_rate_high_95"), np.asarray(np.nan)
        )
        return replace(one, **nothing, **counts)
    return replace(
        one,
        lock_in_rate=np.asarray(fit.lock_in_rate),
        lock_in_rate_u=np.asarray(fit.lock_in_rate_u),
        lock_in_rate_low_95=np.asarray(fit.lock_in_rate_low_95),
        lock_in_rate_high_95=np.asarray(fit.lock_in_rate_high_95),
        backscatter_phase=np.asarray(fit.backscatter_phase),
        flags=np.asarray(_flags(several, fit)),
        noise_model=fit.noise_model,
        **counts,
    )


def _flags(several: SeveralRates, fit: RatesFit) -> int:
    """Flags of the records, except those that the fit answers better than a record can."""
    answered = int(Flag.MISFIT | Flag.RATIO_NOT_SIGNIFICANT | FATAL)
    flags = 0
    for group in several.groups:
        flags |= int(group.combined.flags) & ~answered
    if fit.flags & (RatesFlag.MISFIT | RatesFlag.ONE_RATE_DISAGREES):
        flags |= Flag.MISFIT
    if fit.flags & (RatesFlag.NOT_SIGNIFICANT | RatesFlag.NOT_DETERMINED | RatesFlag.RATES_TOO_CLOSE):
        flags |= Flag.RATIO_NOT_SIGNIFICANT
    return int(flags)


def rates_by_table(several: SeveralRates) -> ByTable | None:
    """What the fit with the table's rate as reference says; ``None`` if there is none by the table or the beat."""
    fit, group = several.by_table, several.reference_group
    if fit is None or several.by_beat is None:
        return None
    return ByTable(fit.lock_in_rate, fit.lock_in_rate_u, group.input_rate, float(group.combined.beat_frequency))
