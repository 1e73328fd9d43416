"""From the arrays of all records of a run to one result."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from analysis.channel import ChannelResponse
from analysis.combine import combine_estimates
from analysis.lock_in_run.budget import known_of_bench, record_uncertainties, run_budget
from analysis.lock_in_run.estimates import Method, estimate_records, only_beats, without_channel
from analysis.lock_in_run.groups import at_several_rates, combined_estimate, evaluate_rates, rates_table_check
from analysis.lock_in_run.pairs import QuadratureResult, estimate_pairs, mean_of_pairs
from analysis.lock_in_run.records import RecordArrays, RunArrays, RunKnowledge
from analysis.lock_in_run.result import LockInRun
from analysis.lock_in_run.table_rate import axis_rate_is_known, axis_rates, find_tilt, table_check
from analysis.lockin_rate import LockInEstimate


def evaluate(run: RunArrays, knowledge: RunKnowledge | None, method: Method) -> LockInRun:
    """Evaluate the records that a run took at its slow rate, or at its slow rates.

    Parameters
    ----------
    run : RunArrays
        With one slow record at least.
    knowledge : RunKnowledge or None
        ``None``: nothing is known of the bench. Then there is no correction and no table, and the budget counts
        what everything may be at worst.
    method : Method

    Returns
    -------
    LockInRun

    Raises
    ------
    NoTilt
        If beat and table rate of the fast run do not fit together.
    OutsideResponse
        If a beat or its second harmonic lies outside the measured response of the channel.
    OneRateOnly
        If the method is one for a single rate, and the run has several.
    """
    # 1. every record by itself, as before the channel
    each, quadratures = _each_record(run.slow, method, None if knowledge is None else knowledge.response)
    # 2. all of them as if at one rate
    found = LockInRun(method, each, combine_estimates(each), quadratures=quadratures)
    if knowledge is None:
        knowledge = RunKnowledge(method.scale_factor, latitude_deg=math.nan)
    elif axis_rate_is_known(run, knowledge):
        # 3. the table: tilt, and the rate on the axis
        tilt = find_tilt(run.fast, knowledge, _best_shown(each))
        axis = axis_rates(run.slow, tilt, knowledge)
        found = replace(found, tilt=tilt)
        if at_several_rates(run.slow):
            # 4. each rate alone, then one fit
            several = evaluate_rates(run.slow, each, axis)
            check = rates_table_check(several, axis)
            found = replace(found, several=several, combined=combined_estimate(several), table_check=check)
        elif method.input_rate is None:
            # 5. the same by the table
            found = replace(found, table_check=table_check(each, found.combined, axis))
    # 6. what all inputs make of the uncertainty
    if not found.usable:
        return found
    bench = known_of_bench(found, run.slow, knowledge)
    budget = run_budget(found, run.slow, bench)
    return replace(found, budget=budget, record_u=record_uncertainties(found, run.slow, bench))


def _each_record(
    slow: RecordArrays, method: Method, response: ChannelResponse | None
) -> tuple[LockInEstimate, QuadratureResult | None]:
    """Estimate the records, with the help of the second photodiode where there is one."""
    if slow.n_channels == 2:
        pairs = estimate_pairs(slow, method, response)
        return only_beats(pairs.estimate), mean_of_pairs(pairs)
    each = only_beats(estimate_records(slow, method))
    return (each if response is None else without_channel(each, response)), None


def _best_shown(each: LockInEstimate) -> float:
    """Lock-in rate, deg/s, of the record that shows it best (at several rates a slow one); nan if none does."""
    relative = np.where(each.usable, each.lock_in_rate_u / each.lock_in_rate, np.nan)
    return float(each.lock_in_rate[np.nanargmin(relative)]) if np.isfinite(relative).any() else math.nan
