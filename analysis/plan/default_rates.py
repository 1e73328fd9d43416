"""Rates for a gyro of which only the expected lock-in rate is known."""

from __future__ import annotations

import math

from analysis.plan.request import SAFE_ABOVE_LOCK_IN

SPAN = 10.0
"""The fastest rate over the slowest. The slow rates carry the lock-in rate; distortion shows itself where the
second harmonic of lock-in has become small, bandwidth and gain corner where the beat is fast."""

STEPS = 5
"""So many rates determine lock-in rate, phase, distortion, gain corner and bandwidth, and leave a test of them."""

LEAST_STEP = 1.25
"""One rate over the next: where they cannot go far, more of them still tell whether the beats follow the rates."""

DEFAULT_RECORDS = 3
"""At each rate and sense: fewer would not show whether they scatter by more than their noise."""


def default_rates(
    expected_lock_in_rate: float,
    scale_factor: float,
    *,
    lock_in_factor: float = 2.0,
    fastest_rate: float = math.inf,
    fastest_beat_hz: float = math.inf,
) -> tuple[float, ...]:
    """Rates to measure at, in expected lock-in rates, each in both senses.

    Five rates from 1.5 times the largest lock-in rate that is possible to ten times that, evenly on a logarithmic
    scale; closer together where table or receiver do not go so far, and fewer where less than a quarter would lie
    between two.

    Examples
    --------
    >>> default_rates(0.01, 2000.0)
    (3.0, 5.3, 9.5, 17.0, 30.0)
    """
    for name, value in (("expected_lock_in_rate", expected_lock_in_rate), ("scale_factor", scale_factor)):
        if not (value > 0 and math.isfinite(value)):
            raise ValueError(f"{name} must be a positive number, not {value!r}")
    if not lock_in_factor >= 1:
        raise ValueError(f"the lock-in rate can be wrong by a factor of 1 or more, not {lock_in_factor!r}")
    slowest = SAFE_ABOVE_LOCK_IN * lock_in_factor
    highest = min(fastest_rate, fastest_beat_hz / scale_factor) / expected_lock_in_rate
    if not highest >= slowest:
        raise ValueError(
            f"the gyro may be locked up to {slowest * expected_lock_in_rate:.3g} deg/s, and the bench goes to "
            f"{highest * expected_lock_in_rate:.3g} deg/s only: no rate is safe"
        )
    span = min(SPAN, highest / slowest)
    count = min(STEPS, max(2, 1 + math.floor(math.log(span) / math.log(LEAST_STEP)))) if span > 1 else 1
    steps = [slowest * span ** (step / max(count - 1, 1)) for step in range(count)]
    return tuple(float(f"{ratio:.2g}") for ratio in steps)
