"""Which rates a campaign goes through, and in which order."""

from __future__ import annotations

from dataclasses import dataclass

from station.lock_in.settings import Settings


@dataclass(frozen=True)
class RateStep:
    """One rate of a campaign.

    Attributes
    ----------
    over_lock_in : float
        Rate on the gyro's axis over the expected lock-in rate.
    sense : {1, -1}
        Of the rotation.
    rate_dps : float
        Rate on the gyro's axis, deg/s, signed.
    """

    over_lock_in: float
    sense: int
    rate_dps: float


def rate_plan(settings: Settings) -> tuple[RateStep, ...]:
    """Return the steps of a campaign: one sense after the other, each from the fastest rate to the slowest.

    Parameters
    ----------
    settings : Settings
        Without ``measurement.rates_over_lock_in`` there is one rate, ``table.slow_rate_over_lock_in``.
    """
    ratios = settings.measurement.rates_over_lock_in or (settings.table.slow_rate_over_lock_in,)
    senses = (1, -1) if settings.measurement.both_senses else (1,)
    expected = settings.gyro.expected_lock_in_rate_dps
    return tuple(
        RateStep(ratio, sense, sense * ratio * expected)
        for sense in senses
        for ratio in sorted(set(ratios), reverse=True)
    )
