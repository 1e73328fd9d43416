"""Rate, time base, vertical scale and number of records for a wanted uncertainty of the lock-in rate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.budget import Budget, BudgetInput, lock_in_budget
from analysis.budget.expected_noise import RecordShape, expected_point
from analysis.lockin_equation import beat_frequency
from analysis.plan.request import FASTEST_OVER_LOCK_IN, PlanRequest
from analysis.plan.several_rates import expected_joint_u
from analysis.several_rates import COUNTED, ReceiverKnowledge

MOST_RECORDS = 100_000

FEWEST_RECORDS = 3
"""In all: fewer would not show whether they scatter by more than their noise."""

_FLOOR_SHARE = 3.0
"""Where the wanted uncertainty is out of reach, noise is brought to this fraction of what remains."""

_CLOSE_TO_FLOOR = 1.05

_CANDIDATES = 60


@dataclass(frozen=True)
class PlannedRate:
    """One rate of a plan, and how its records are taken."""

    over_lock_in: float  # |W|/WL
    input_rate: float  # deg/s, signed; the second is nan where no table is described
    table_rate: float
    beat_frequency: float  # Hz
    seconds_per_division: float
    volts_per_division: float
    periods: float
    samples_per_period: float
    levels: float  # amplitude of the beat in levels of the converter
    shape: RecordShape  # with the number of records at this rate


@dataclass(frozen=True)
class Plan:
    """What to do, and what will come of it."""

    request: PlanRequest
    rates: tuple[PlannedRate, ...]
    budget: Budget  # predicted, of all records together
    reached: bool  # whether the wanted uncertainty is reached
    floor_u: float  # relative uncertainty that no number of records goes below
    duration_s: float  # of all records with their transfer

    @property
    def records(self) -> int:
        """At each rate."""
        return self.rates[0].shape.records


def plan_measurement(request: PlanRequest) -> Plan:
    """Plan a measurement.

    Without rates in the request the rate is the one that needs the fewest records, or, where no number of them
    is enough, the one with the smallest uncertainty that remains.
    """
    chosen = request.rates_over_lock_in or (_best_rate(request),)
    return _planned(request, chosen)


def plan_of_records(request: PlanRequest, records: int) -> Plan:
    """Say what so many records at each rate of the request give, and how long they take."""
    if not request.rates_over_lock_in:
        raise ValueError("without rates nobody knows what the records give")
    ratios = request.rates_over_lock_in
    rates = _rates(request, ratios, records)
    budget, most = _budget(request, rates), _budget(request, _rates(request, ratios, MOST_RECORDS))
    seconds = sum(rate.shape.records * (rate.shape.duration + request.seconds_between_records) for rate in rates)
    wanted = request.wanted_u * request.lock_in_rate
    return Plan(request, rates, budget, budget.combined_u <= wanted, most.relative_u, seconds)


def predicted_budget(request: PlanRequest, over_lock_in: float, records: int) -> Budget:
    """Budget of so many records at one rate, or at it in both senses."""
    rates = _rates(request, (over_lock_in,), records)
    return _budget(request, rates)


def budget_elsewhere(plan: Plan, lock_in_rate: float) -> Budget:
    """Budget of the same rates and records if the lock-in rate is another than expected, deg/s."""
    ratios = tuple(abs(rate.input_rate) / lock_in_rate for rate in plan.rates)
    request = replace(plan.request, lock_in_rate=lock_in_rate, rates_over_lock_in=ratios)
    return _budget(request, _rates(request, ratios, plan.records))


def _best_rate(request: PlanRequest) -> float:
    slowest = request.slowest_over_lock_in
    candidates = np.geomspace(slowest, max(FASTEST_OVER_LOCK_IN, 2 * slowest), _CANDIDATES)
    plans = [_planned(request, (float(ratio),)) for ratio in candidates]
    reached = [plan for plan in plans if plan.reached]
    if reached:
        best = min(reached, key=lambda plan: (plan.records, plan.budget.relative_u))
    else:
        best = min(plans, key=lambda plan: (float(f"{plan.floor_u:.3g}"), plan.budget.relative_u))
    return best.rates[0].over_lock_in


def _planned(request: PlanRequest, ratios: tuple[float, ...]) -> Plan:
    one = _budget(request, _rates(request, ratios, 1))
    most = _budget(request, _rates(request, ratios, MOST_RECORDS))
    averaging = math.sqrt(max(one.combined_u**2 - most.combined_u**2, 0.0) / (1 - 1 / MOST_RECORDS))
    fixed = math.sqrt(max(most.combined_u**2 - averaging**2 / MOST_RECORDS, 0.0))
    wanted = request.wanted_u * request.lock_in_rate
    room = wanted**2 - fixed**2
    if room <= 0:
        room = (fixed / _FLOOR_SHARE) ** 2
    least = math.ceil(FEWEST_RECORDS / len(_rates(request, ratios, 1)))
    records = min(max(math.ceil(averaging**2 / room * (1 - 1e-9)), least), MOST_RECORDS)
    rates = _rates(request, ratios, records)
    budget = _budget(request, rates)
    # where what is known beforehand bounds the rest, the variance does not go with the number of records
    while budget.combined_u > wanted >= fixed * _CLOSE_TO_FLOOR and records < MOST_RECORDS:
        records = min(math.ceil(1.2 * records), MOST_RECORDS)
        rates = _rates(request, ratios, records)
        budget = _budget(request, rates)
    seconds = sum(rate.shape.records * (rate.shape.duration + request.seconds_between_records) for rate in rates)
    reached = budget.combined_u <= wanted * (1 + 1e-6)
    return Plan(request, rates, budget, reached, fixed / request.lock_in_rate, seconds)


def _rates(request: PlanRequest, ratios: tuple[float, ...], records: int) -> tuple[PlannedRate, ...]:
    senses = (1, -1) if request.both_senses else (1,)
    return tuple(_rate(request, ratio, sense, records) for ratio in sorted(set(ratios)) for sense in senses)


def _rate(request: PlanRequest, ratio: float, sense: int, records: int) -> PlannedRate:
    scope, rate = request.oscilloscope, sense * ratio * request.lock_in_rate
    frequency = float(beat_frequency(request.scale_factor, rate, request.lock_in_rate))
    base = scope.time_base(frequency, request.periods_min, request.samples_per_period_min)
    scale = scope.vertical_scale(request.amplitude, request.fill_levels)
    spacing = scale / scope.levels_per_division
    shape = RecordShape(
        samples=scope.samples,
        sample_interval=scope.divisions * base / scope.samples,
        amplitude=request.amplitude,
        noise_rms=math.hypot(request.noise_rms, request.noise_levels * spacing),
        level_spacing=spacing,
        records=records,
    )
    return PlannedRate(
        over_lock_in=ratio,
        input_rate=rate,
        table_rate=request.table.at(rate).table_rate if request.table is not None else math.nan,
        beat_frequency=frequency,
        seconds_per_division=base,
        volts_per_division=scale,
        periods=frequency * shape.duration,
        samples_per_period=1 / (frequency * shape.sample_interval),
        levels=request.amplitude / spacing,
        shape=shape,
    )


def _separated(rates: tuple[PlannedRate, ...]) -> frozenset[str]:
    """What the records will show: a third harmonic always; the fit to several rates counts all of it."""
    return frozenset(COUNTED) if len(rates) > 1 else frozenset({"third_order"})


def _budget(request: PlanRequest, rates: tuple[PlannedRate, ...]) -> Budget:
    """Budget at the slowest rate, where most of what is known comes from, with the noise of all rates."""
    slowest = rates[0]
    point = expected_point(
        slowest.shape,
        scale_factor=request.scale_factor,
        input_rate=slowest.input_rate,
        lock_in_rate=request.lock_in_rate,
        scatter=request.scatter * request.lock_in_rate,
        phase=request.phase,
    )
    knowledge = replace(
        request.knowledge,
        separated=_separated(rates),
        table=request.table.at(slowest.input_rate) if request.table is not None else None,
    )
    if len(rates) == 1:
        return lock_in_budget(point, knowledge, request.reference)
    alone = lock_in_budget(point, knowledge, request.reference)
    own = math.hypot(*(line.contribution for line in alone.inputs if line.name in ("noise", "quantization")))
    noise, joint = _joint_u(request, rates, all_else_known=True), _joint_u(request, rates)
    point = replace(
        point,
        ratio_u=point.ratio_u * noise / own,
        noise_degrees_of_freedom=point.noise_degrees_of_freedom * len(rates),
        scatter_u=point.scatter_u / math.sqrt(len(rates)),
    )
    budget = lock_in_budget(point, knowledge, request.reference)
    rest = math.sqrt(max(joint**2 - noise**2, 0.0))
    quantity = "noise, by way of distortion, gain corner and bandwidth"
    separation = BudgetInput("separation", quantity, "deg/s", 0.0, rest, "normal", 1.0, note=_SEPARATION_NOTE)
    return Budget(budget.lock_in_rate, budget.reference, (*budget.inputs, separation))


_SEPARATION_NOTE = "they are fitted to the same records, within what is known of them"


def _joint_u(request: PlanRequest, rates: tuple[PlannedRate, ...], *, all_else_known: bool = False) -> float:
    return expected_joint_u(
        [rate.shape for rate in rates],
        [rate.input_rate for rate in rates],
        request.lock_in_rate,
        request.scale_factor,
        reference=request.reference,
        phase=request.phase,
        receiver=ReceiverKnowledge.of(request.knowledge),
        all_else_known=all_else_known,
    )
