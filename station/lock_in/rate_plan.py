"""Which rates a campaign goes through, in which order, and which others when the gyro is not as expected."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from analysis import plan as planning
from analysis.lock_in_run import PreliminaryLockIn
from analysis.rotation import EARTH_RATE_DPS
from station.errors import NoUsableSignal
from station.lock_in.settings import Settings

RECORDS_IN_ALL = 40
"""At several rates together, where nobody says how many: twice those of one rate, for twice the time."""

RECORDS_AT_ONE_RATE = 20

FAR_OFF = 1.4
"""An expected lock-in rate that is surely wrong by more than this factor is replaced by the one that was found."""

MOST_CHANGES = 4

LIKELY_FACTOR = 2.0  # by which the lock-in rate may differ from the expected one
_SAME = 0.2  # rates that differ by less tell nothing new
_WITHIN = 0.95  # share of the table's range that is made use of: rates are rounded to two digits

_CHANNEL_OVER_BEAT = 5.0
"""No rate is chosen at which the beat comes closer to the bandwidth of the channel, where that is known."""


@dataclass(frozen=True)
class RateStep:
    """One rate of a campaign."""

    over_lock_in: float  # rate on the gyro's axis over the expected lock-in rate
    sense: int  # {1, -1}: Of the rotation
    rate_dps: float  # rate on the gyro's axis, deg/s, signed
    again: bool = False  # whether the run was there before: two visits share the records

    @property
    def setting(self) -> tuple[float, int]:
        """Rate and sense: what two visits have in common."""
        return self.over_lock_in, self.sense


@dataclass(frozen=True)
class RatePlan:
    """The steps of a campaign: from the fastest rate to the slowest, and back in the other sense or the same."""

    steps: tuple[RateStep, ...]
    planned_for_dps: float  # lock-in rate for which the rates were chosen
    changes: int = 0  # how often they were chosen anew

    @property
    def settings(self) -> int:
        """Different rates and senses."""
        return len({step.setting for step in self.steps})

    def as_json(self) -> dict[str, object]:
        """Return it as a fact of the run; :func:`saved_plan` reads it."""
        steps = [
            {"over_lock_in": step.over_lock_in, "sense": step.sense} | ({"again": True} if step.again else {})
            for step in self.steps
        ]
        return {"steps": steps, "planned_for_dps": self.planned_for_dps, "changes": self.changes}


def rate_plan(settings: Settings, tilt_deg: float = 0.0, likely_factor: float = LIKELY_FACTOR) -> RatePlan:
    """The plan of a campaign: rates that the user has named, or those chosen for the expected lock-in rate."""
    expected = settings.gyro.expected_lock_in_rate_dps
    if settings.rates_are_chosen:
        sizes = _chosen_rates(settings, expected, tilt_deg, likely_factor)
    else:
        sizes = tuple(ratio * expected for ratio in settings.named_rates or (settings.slow_over_lock_in,))
    return RatePlan(_steps(settings, sizes, _senses(settings, len(sizes))), expected)


def saved_plan(settings: Settings, values: Mapping[str, Any]) -> RatePlan:
    """Return the plan that a run was begun with, from its facts."""
    expected = settings.gyro.expected_lock_in_rate_dps
    steps = tuple(
        RateStep(
            step["over_lock_in"],
            step["sense"],
            step["sense"] * step["over_lock_in"] * expected,
            step.get("again", False),
        )
        for step in values["steps"]
    )
    return RatePlan(steps, float(values["planned_for_dps"]), int(values["changes"]))


def records_at_each(settings: Settings, plan: RatePlan) -> int:
    """Records at each rate and sense of a plan: as many as the user says, or enough in all."""
    if settings.measurement.records != "auto":
        return settings.measurement.records
    if plan.settings == 1:
        return RECORDS_AT_ONE_RATE
    return max(planning.DEFAULT_RECORDS, round(RECORDS_IN_ALL / plan.settings))


def records_after(plan: RatePlan, step: RateStep, count: int) -> int:
    """Records that a setting has when a step is done, of so many: half of them where the run comes back to it."""
    comes_back = any(later.again and later.setting == step.setting for later in plan.steps)
    return math.ceil(count / 2) if comes_back and not step.again else count


def changed_plan(
    settings: Settings,
    plan: RatePlan,
    tilt_deg: float,
    *,
    seen: PreliminaryLockIn | None,
    tried: Iterable[RateStep],
    without_beat: Iterable[RateStep],
) -> RatePlan | None:
    """Choose the rates anew where the lock-in rate is surely far from the one that they were chosen for."""
    silent = {step.over_lock_in for step in without_beat}
    taken = [abs(step.rate_dps) for step in tried if step.over_lock_in not in silent]
    locked = max((abs(step.rate_dps) for step in without_beat), default=0.0)
    if plan.changes >= MOST_CHANGES or (seen is None and not locked):
        return None
    if seen is None:
        wanted = locked  # not even the fastest rate is above lock-in
    else:
        wanted = seen.lock_in_rate
        if seen.least <= FAR_OFF * plan.planned_for_dps and seen.most >= plan.planned_for_dps / FAR_OFF:
            return None
    try:
        sizes = _chosen_rates(settings, wanted, tilt_deg)
    except NoUsableSignal:
        return None  # the table goes no further: what there is must do
    sizes = tuple(_nearest(size, taken) for size in sizes if size > locked * (1 + _SAME))
    if not sizes:
        return None
    senses = _senses(settings, len(sizes))
    done = tuple(step for step in tried if step.sense == 1)
    known = {(step.setting, step.again) for step in done}
    steps = [step for step in _steps(settings, sizes, senses) if (step.setting, step.again) not in known]
    return replace(plan, steps=(*done, *steps), planned_for_dps=wanted, changes=plan.changes + 1)


def _chosen_rates(
    settings: Settings, lock_in_rate: float, tilt_deg: float, likely_factor: float = LIKELY_FACTOR
) -> tuple[float, ...]:
    """Sizes of the rates on the axis, deg/s, for a lock-in rate that may be wrong by some factor."""
    # The axis of a tilted gyro meets the horizontal earth rate at an azimuth that nobody knows: no rate is so slow
    # that it could stop or turn the gyro round.
    tilt = math.radians(tilt_deg)
    earth = EARTH_RATE_DPS * math.cos(math.radians(settings.site.latitude_deg)) * math.sin(tilt)
    clear = earth / lock_in_rate + likely_factor
    stated = settings.budget.bandwidth_hz if settings.budget is not None else 0.0
    bandwidth = settings.front_end.low_pass_hz or stated or math.inf
    scale_factor = settings.gyro.scale_factor_pulses_per_deg
    factor = max(likely_factor, clear / planning.SAFE_ABOVE_LOCK_IN)
    slowest_beat = scale_factor * planning.SAFE_ABOVE_LOCK_IN * factor * lock_in_rate
    try:
        ratios = planning.default_rates(
            lock_in_rate,
            scale_factor,
            lock_in_factor=factor,
            fastest_rate=_WITHIN * settings.table.highest_rate_dps * math.cos(tilt),
            # a channel that is slow even for the slowest rate spoils all of them; the budget says how much
            fastest_beat_hz=max(bandwidth / _CHANNEL_OVER_BEAT, 2 * slowest_beat),
        )
    except ValueError as error:
        raise NoUsableSignal(f"no rate can be chosen: {error}") from None
    return tuple(ratio * lock_in_rate for ratio in ratios)


def _nearest(size: float, taken: list[float]) -> float:
    """A rate that was gone to already, if there is one so near that another tells nothing new."""
    nearest = min(taken, key=lambda one: abs(one - size), default=math.inf)
    return nearest if abs(nearest - size) < _SAME * size else size


def _senses(settings: Settings, rates: int) -> tuple[int, ...]:
    both = settings.measurement.both_senses
    return (1, -1) if (rates > 1 if both == "auto" else both) else (1,)


def _steps(settings: Settings, sizes: Iterable[float], senses: tuple[int, ...]) -> tuple[RateStep, ...]:
    expected = settings.gyro.expected_lock_in_rate_dps
    signed = [sense * float(f"{size / expected:.4g}") for size in sizes for sense in senses]
    return tuple(
        RateStep(abs(ratio), 1 if ratio > 0 else -1, ratio * expected, again)
        for ratio, again in planning.run_order(signed)
    )
