"""What a campaign would do with a unit, without doing it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.text import Text

from station.campaign.plan import CampaignPlan
from station.measurements import measurement
from station.report.console import text_table
from station.results.parts import TextTable
from station.results.verdict import limit_words
from station.terminal.console import stdout_console

Uncertainty = tuple[float | None, float | None, str]
"""Standard uncertainty and half of the 95 % interval of a lock-in rate, deg/s; or why they are not known."""


def dry_run_document(
    plan: CampaignPlan, seconds: Sequence[float | None], uncertainties: Sequence[Uncertainty]
) -> dict[str, Any]:
    """Return the plan as one JSON document."""
    steps = [
        {
            "step": step.key,
            "measurement": step.measurement,
            "conditions": dict(step.conditions),
            "warm_up_s": step.warm_up_s,
            "settle_s": step.settle_s,
            "seconds": time,
            "lock_in_rate_u_dps": u,
            "lock_in_rate_expanded_u_95_dps": u95,
            "limits": [f"{one.number} {limit_words(one, '')}".strip() for one in step.limits],
        }
        for step, time, (u, u95, _) in zip(plan.steps, seconds, uncertainties, strict=True)
    ]
    return {
        "campaign": plan.name,
        "unit": plan.unit,
        "simulated": plan.simulated,
        "seconds": total_seconds(plan, seconds),
        "steps": steps,
    }


def total_seconds(plan: CampaignPlan, seconds: Sequence[float | None]) -> float | None:
    """Return the time of all steps with their warm-up and settling; ``None`` where one is not known."""
    known = [one for one in seconds if one is not None]
    if len(known) < len(seconds):
        return None
    return sum(known) + sum(step.warm_up_s + step.settle_s for step in plan.steps)


def print_dry_run(
    plan: CampaignPlan, seconds: Sequence[float | None], uncertainties: Sequence[Uncertainty]
) -> None:
    """Print the plan, its time and the predicted uncertainty."""
    console = stdout_console()
    console.print(Text(f"{plan.name}: unit {plan.unit} ({plan.unit_type}) on {plan.station}"), soft_wrap=True)
    console.print()
    rows = []
    for step, time, (_, u95, _) in zip(plan.steps, seconds, uncertainties, strict=True):
        waits = step.warm_up_s + step.settle_s
        rows.append(
            (
                step.key,
                measurement(step.measurement).command,
                ", ".join(f"{name} {value:g}" for name, value in step.conditions.items()),
                time_words(waits) if waits else "",
                "not known" if time is None else time_words(time),
                "" if u95 is None else f"±{u95:.2g} deg/s",
            )
        )
    header = ("step", "command", "conditions", "waits", "takes", "U95 of the lock-in rate")
    console.print(text_table(TextTable(header, tuple(rows)), left=3))
    console.print()
    for step, (_, u95, _) in zip(plan.steps, uncertainties, strict=True):
        for one in step.limits:
            said = f"{step.key}: {one.number} {limit_words(one, '')}, guard band {one.rule}"
            if u95 is not None and one.number == "lock_in_rate_dps" and one.rule == "U95":
                said += f"; MARGINAL within about {u95:.2g} of it"
            console.print(f"• {said}", soft_wrap=True)
    total = total_seconds(plan, seconds)
    console.print()
    said = "not known" if total is None else f"{time_words(total)} on a real bench"
    simulated = ", which this is not: a simulated one does not wait" if plan.simulated else ""
    console.print(f"total   {said}{simulated}")


def time_words(seconds: float) -> str:
    """Say a time.

    Examples
    --------
    >>> time_words(42.0), time_words(600.0), time_words(8000.0)
    ('42 s', '10 min', '2 h 13 min')
    """
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    return f"{int(seconds // 3600)} h {int(seconds % 3600 // 60)} min"
