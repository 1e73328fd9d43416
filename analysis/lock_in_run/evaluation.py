"""From the arrays of all records of a run to one result."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from analysis.channel import ChannelResponse
from analysis.combine import combine_estimates
from analysis.flags import Flag
from analysis.lock_in_run.budget import known_of_bench, record_uncertainties, run_budget
from analysis.lock_in_run.estimates import (
    Method,
    at_known_rates,
    by_themselves,
    estimate_records,
    only_beats,
    without_channel_model,
)
from analysis.lock_in_run.groups import at_several_rates, combined_estimate, evaluate_rates, rates_by_table
from analysis.lock_in_run.pairs import QuadratureResult, estimate_pairs, mean_of_pairs
from analysis.lock_in_run.records import RecordArrays, RunArrays, RunKnowledge
from analysis.lock_in_run.result import LockInRun
from analysis.lock_in_run.table_check import ByTable, TableCheck, check_by_table
from analysis.lock_in_run.table_rate import AxisRates, axis_rate_is_known, axis_rates, fast_estimates, find_tilt
from analysis.lockin_rate import LockInEstimate
from analysis.several_rates import ReceiverKnowledge

CANCEL_IN_THE_CHECK = ("noise", "scale_factor", "time_base")
"""Inputs of the budget that the check by the table has counted already, or that the tilt absorbs in it."""


def evaluate(
    run: RunArrays,
    knowledge: RunKnowledge | None,
    method: Method,
    estimated: LockInEstimate | None = None,
    axis: AxisRates | None = None,
) -> LockInRun:
    """Evaluate the records that a run took at its slow rate, or at its slow rates."""
    # 1. every record by itself, as before the channel
    each, quadratures = _each_record(
        run.slow, method, None if knowledge is None else knowledge.response, estimated
    )
    if knowledge is None:
        knowledge = RunKnowledge(method.scale_factor, latitude_deg=math.nan)
    # 2. the table: tilt, and the rate on the axis
    tilt = None
    if axis is None and axis_rate_is_known(run, knowledge):
        tilt = find_tilt(run.fast, knowledge, _best_shown(each))
        axis = axis_rates(run.slow, tilt, knowledge)
    # 3. the mean of all records, or each rate alone and then one fit
    several = None
    if axis is not None and at_several_rates(run.slow):
        several = evaluate_rates(run.slow, each, axis, ReceiverKnowledge.of(knowledge.bench))
    combined = combine_estimates(each) if several is None else combined_estimate(several)
    unknown = np.broadcast_to(math.nan, each.flags.shape)
    found = LockInRun(method, each, combined, unknown, tilt, several=several, quadratures=quadratures)
    # 4. the same by the table
    if axis is not None and tilt is not None:
        found = _checked_by_table(found, run, axis, knowledge)
    # 5. what all inputs make of the uncertainty
    if not found.usable:
        return found
    bench = known_of_bench(found, run.slow, knowledge)
    budget = run_budget(found, run.slow, bench)
    check = found.table_check
    if check is not None:
        others = [line.contribution for line in budget.inputs if line.name not in CANCEL_IN_THE_CHECK]
        check = check.beside_budget(found.lock_in_rate, math.hypot(*others))
    us = record_uncertainties(found, run.slow, bench)
    return replace(found, budget=budget, record_u=us, table_check=check)


def _each_record(
    slow: RecordArrays, method: Method, response: ChannelResponse | None, estimated: LockInEstimate | None
) -> tuple[LockInEstimate, QuadratureResult | None]:
    """Estimate the records, with the help of the second photodiode where there is one."""
    if slow.n_channels == 2:
        pairs = estimate_pairs(slow, method, response)
        return only_beats(pairs.estimate), mean_of_pairs(pairs)
    if estimated is None:
        return by_themselves(estimate_records(slow, method), response), None
    return (estimated if response is None else estimated.described(without_channel_model(estimated))), None


def _checked_by_table(found: LockInRun, run: RunArrays, axis: AxisRates, knowledge: RunKnowledge) -> LockInRun:
    """The same with the check by the table, and its flags on the result; as it is where nothing can be checked."""
    by_table = _one_rate_by_table(found, axis) if found.several is None else rates_by_table(found.several)
    if by_table is None or found.tilt is None or not found.usable:
        return found
    each = found.each, fast_estimates(run.fast, knowledge)
    check = check_by_table(run, each, found.combined, by_table, axis, found.tilt, knowledge)
    return replace(found, table_check=check, combined=_flagged(found.combined, check))


def _one_rate_by_table(found: LockInRun, axis: AxisRates) -> ByTable | None:
    if found.method.input_rate is not None:
        return None
    by_table = combine_estimates(at_known_rates(found.each, axis.rates))
    if not np.isfinite(by_table.lock_in_rate):
        return None
    return ByTable(
        float(by_table.lock_in_rate),
        float(by_table.lock_in_rate_u),
        float(np.mean(axis.rates)),
        float(found.combined.beat_frequency),
    )


def _flagged(result: LockInEstimate, check: TableCheck) -> LockInEstimate:
    flags = int(result.flags)
    flags |= int(Flag.TABLE_MISMATCH) if check.mismatch else 0
    flags |= int(Flag.SCALE_FACTOR_MISMATCH) if check.scale_factor_mismatch else 0
    return replace(result, flags=np.asarray(flags))


def _best_shown(each: LockInEstimate) -> float:
    """Lock-in rate, deg/s, of the record that shows it best (at several rates a slow one); nan if none does."""
    with np.errstate(divide="ignore", invalid="ignore"):  # noise may leave a lock-in rate of zero
        relative = np.where(each.usable, each.lock_in_rate_u / each.lock_in_rate, np.nan)
    return float(each.lock_in_rate[np.nanargmin(relative)]) if np.isfinite(relative).any() else math.nan
