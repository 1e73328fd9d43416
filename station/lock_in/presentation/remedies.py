"""The one measurement that would make an uncertainty smaller: what to measure, how, and what comes of it."""

from __future__ import annotations

from analysis.budget import Budget, BudgetInput

_SINE = "put a clean sine of the beat's frequency and size in the place of the photodiode, measure its"
_LED = "measure the response of photodiode and amplifier at the beat and at its double, with an LED on a generator"
_REMEDIES = {
    "distortion": "take several rates in both senses (measurement.rates_over_lock_in, measurement.both_senses), "
    f"which separates it; or {_SINE} second harmonic and state budget.distortion_limit_dbc",
    "third_order": f"{_SINE} third harmonic and state budget.third_order_limit_dbc",
    "bandwidth": f"{_LED}, and state it in [front_end] (or budget.bandwidth_hz, where it is far above)",
    "high_pass": f"couple the oscilloscope DC; or {_LED}, and state it in [front_end]",
    "gain_corner": "take several rates in both senses up to 30 lock-in rates, which show the gain corner of the "
    "laser; or state budget.gain_corner_hz",
    "scale_factor": "count the beats over whole turns of the table, K = beats/(360 deg times turns), and state "
    "gyro.scale_factor_pulses_per_deg and budget.scale_factor_u_ppm",
    "time_base": "compare the time base with a frequency counter, and state budget.time_base_limit_ppm",
    "response": "measure the response in [front_end] again, more finely, and state budget.front_end_u_percent",
    "input_rate": "leave the rate out, so that each record is its own reference",
    "relation": "use the exact relation",
    "scatter": "find what makes the records differ (temperature, table, alignment), or take four times as many",
    "noise": "take four times as many records",
    "quantization": "take four times as many records, or let the beat fill more of the screen",
    "beat_frequency": "take four times as many records",
    "separation": "take four times as many records, or more rates, farther apart and in both senses",
}
_TABLE = "measure the rate on the gyro's axis, or let each record be its own reference"

_HALVED = ("noise", "quantization", "beat_frequency", "scatter", "separation")
"""What more records make smaller, but do not take away."""


def remedy_sentence(budget: Budget) -> str:
    """Name the measurement that would remove the largest part, and the U95 that would be left; or nothing."""
    first = budget.inputs[0] if budget.inputs else None
    if first is None or first.contribution == 0:
        return ""
    after = budget.with_line(first, _left_of(first)).expanded_u_95
    now = budget.expanded_u_95
    return (
        f"The largest part is {first.quantity} ({100 * budget.share(first):.0f} % of the variance"
        f"{'' if first.stated else '; nobody stated it'}): {_REMEDIES.get(first.name, _TABLE)}. "
        f"U95 would fall from {_percent(now, budget)} to {_percent(after, budget)}."
    )


def _left_of(line: BudgetInput) -> float:
    return 0.5 if line.name in _HALVED else 0.0


def _percent(u_95: float, budget: Budget) -> str:
    if budget.lock_in_rate > 0:
        return f"{100 * u_95 / budget.lock_in_rate:.2g} %"
    return f"{u_95:.2g} deg/s"
