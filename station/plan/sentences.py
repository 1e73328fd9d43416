"""A plan in words: what to set, what will come of it, and why not 20 times the lock-in rate."""

from __future__ import annotations

import math
from dataclasses import replace

from analysis import harmonic_ratio, lock_in_from_rate
from analysis.plan import FEW_RATES, Plan, PlannedRate, PlanRequest, plan_measurement, predicted_budget
from analysis.rotation import EARTH_RATE_DPS
from station.plan.plan import PAPER_OVER_LOCK_IN, PlannedMeasurement
from station.results.numbers import with_prefix

_LARGE_SWING = 0.05


def plan_sentences(planned: PlannedMeasurement) -> list[str]:
    """Say what the plan comes to and what to mind."""
    plan = planned.plan
    return [_outcome(plan), *_why_not_faster(plan), *_senses(plan), *_elsewhere(planned), *_warnings(plan)]


def rate_words(rate: PlannedRate) -> tuple[str, ...]:
    """Return one rate of a plan as text: rate, beat, time base, vertical scale, record, records."""
    table = f", table {rate.table_rate:+.4g} deg/s" if math.isfinite(rate.table_rate) else ""
    return (
        f"{rate.over_lock_in:.3g} WL = {rate.input_rate:+.4g} deg/s{table}",
        with_prefix(rate.beat_frequency, "Hz"),
        with_prefix(rate.seconds_per_division, "s/div"),
        f"{with_prefix(rate.volts_per_division, 'V/div')} ({rate.levels:.0f} levels)",
        f"{rate.periods:.0f} periods of {rate.samples_per_period:.0f} samples",
        f"{rate.shape.records}",
    )


def duration_words(seconds: float) -> str:
    """Write a duration.

    Examples
    --------
    >>> duration_words(3.44), duration_words(200.0), duration_words(9000.0)
    ('3 s', '3 min 20 s', '2 h 30 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s" if whole else "less than 1 s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def _outcome(plan: Plan) -> str:
    wanted, got = 100 * plan.request.wanted_u, 100 * plan.budget.relative_u
    total = plan.records * len(plan.rates)
    taken = f"{total} record{'s' if total > 1 else ''}, about {duration_words(plan.duration_s)}"
    if plan.reached:
        return f"{taken}: the lock-in rate to {got:.2g} % (k = 1), where {wanted:.3g} % is wanted."
    line = next(iter(plan.budget.inputs))
    return (
        f"{wanted:.3g} % cannot be reached: no number of records goes below {100 * plan.floor_u:.2g} %, "
        f"most of it from this: {line.quantity}. {taken}: {got:.2g} %."
    )


def _why_not_faster(plan: Plan) -> list[str]:
    """Compare the plan's slowest rate with the paper's advice, in numbers."""
    request, chosen = plan.request, plan.rates[0].over_lock_in
    if chosen >= 0.9 * PAPER_OVER_LOCK_IN:
        return []
    here, there = (float(harmonic_ratio(1 / over)) for over in (chosen, PAPER_OVER_LOCK_IN))
    noise_here, noise_there = (_noise(request, over) for over in (chosen, PAPER_OVER_LOCK_IN))
    more = (noise_there / noise_here) ** 2
    limit = request.knowledge.distortion_limit
    said = [
        f"Why not 20 times the lock-in rate: there the second harmonic is {100 * there:.2g} % of the fundamental, "
        f"at {chosen:.3g} times it is {100 * here:.2g} %. The same noise weighs {noise_there / noise_here:.1f} "
        f"times as much at 20, so that it takes {more:.0f} times as many records"
        + (
            f"; distortion of {20 * math.log10(limit):.0f} dBc can falsify records of one sense by "
            f"±{100 * _largest(limit, there):.2g} % there and by ±{100 * _largest(limit, here):.2g} % here."
            if limit > 0 and math.isfinite(limit)
            else "; distortion of detector and oscilloscope weighs as much more."
        )
    ]
    low = float(lock_in_from_rate(here, 1.0, "paper-13")) * chosen - 1
    said.append(
        "The advice to stay far away belongs to the approximate formula, equation (13) of Zhan et al. (2009), "
        f"which would be wrong by {100 * low:+.2g} % here; the exact relation holds at every rate above lock-in. "
        "What limits the slow side is that the lock-in rate is only guessed and that no table turns perfectly "
        "steadily."
    )
    return said


def _noise(request: PlanRequest, over: float) -> float:
    """What noise makes of the lock-in rate from one record."""
    budget = predicted_budget(replace(request, both_senses=False), over, 1)
    return math.hypot(*(line.contribution for line in budget.inputs if line.name in ("noise", "quantization")))


def _largest(limit: float, ratio: float) -> float:
    """Largest relative error of one record with distortion `limit`, its own reference."""
    return limit / ratio * (1 + ratio**2)


def _senses(plan: Plan) -> list[str]:
    request = plan.request
    if request.reference == "rate":
        own = plan_measurement(replace(request, reference="beat"))
        said = (
            "The table's rate is the reference, so tilt and earth rate weigh more the slower it turns. With each "
            f"record as its own reference {own.records * len(own.rates)} records from "
            f"{own.rates[0].over_lock_in:.3g} times lock-in on give {100 * own.budget.relative_u:.2g} %."
        )
        return [said, *_separation(plan)]
    return _separation(plan)


def _separation(plan: Plan) -> list[str]:
    request = plan.request
    rates = len({rate.over_lock_in for rate in plan.rates})
    if request.both_senses:
        said = (
            "Both senses of rotation separate distortion from lock-in at no cost: it adds to the complex ratio of "
            "both alike, while lock-in turns round with the sense."
        )
        more = " Several rates show the bandwidth of the channel and the gain corner of the laser too."
        return [said + more * (rates > 1)]
    if request.distortion_separated:
        both = plan_measurement(replace(request, both_senses=True))
        few = "may have two solutions, and" if rates < FEW_RATES else "tell distortion from lock-in, but"
        return [
            f"{rates} rates in one sense {few} what separates them costs most of the uncertainty. In both senses "
            f"(--both-senses) {both.records * len(both.rates)} records give {100 * both.budget.relative_u:.2g} %."
        ]
    line = next(iter(plan.budget.inputs))
    if line.name == "distortion" and plan.budget.share(line) > 0.3:
        return [
            f"Distortion makes {100 * plan.budget.share(line):.0f} % of the variance. Taken in both senses of "
            "rotation (--both-senses), the same records are free of it."
        ]
    return []


def _elsewhere(planned: PlannedMeasurement) -> list[str]:
    parts = [f"{100 * u:.2g} % if it is {rate:.3g} deg/s" for rate, u in planned.elsewhere if math.isfinite(u)]
    locked = [f"{rate:.3g}" for rate, u in planned.elsewhere if not math.isfinite(u)]
    said = [f"The lock-in rate is only expected; the same settings give {' and '.join(parts)}."] if parts else []
    if locked:
        said.append(
            f"At a lock-in rate of {locked[0]} deg/s the gyro would be locked at this rate: choose a faster one."
        )
    return said


def _warnings(plan: Plan) -> list[str]:
    said = []
    table, slowest = plan.request.table, plan.rates[0]
    if table is not None:
        latitude, tilt = math.radians(table.latitude_deg), math.radians(table.tilt_deg)
        swing = EARTH_RATE_DPS * math.cos(latitude) * abs(math.sin(tilt)) / abs(slowest.input_rate)
        if swing > _LARGE_SWING:
            said.append(
                f"The earth's rotation changes the rate on the axis by ±{100 * swing:.0f} % in a table turn: "
                "take the records at one azimuth, and let each be its own reference."
            )
        if abs(slowest.input_rate) * (1 - swing) < 1.05 * plan.request.lock_in_rate:
            said.append("At some azimuths the rate would come too close to lock-in: less tilt or a faster rate.")
    for rate in plan.rates:
        if rate.samples_per_period < plan.request.samples_per_period_min * 0.999 or rate.periods < 3:
            said.append(
                f"No time base of the oscilloscope suits a beat of {with_prefix(rate.beat_frequency, 'Hz')}: "
                f"{rate.periods:.1f} periods of {rate.samples_per_period:.1f} samples."
            )
    return said
