"""A campaign in words: what it will do, how it has ended, its verdict in large letters."""

from collections.abc import Iterable, Sequence
from typing import Any

from rich.text import Text

from station.campaign.journal import CampaignOutcome, CampaignPlan, StepOutcome, to_repeat
from station.live.console import stdout_console
from station.measurements import measurement
from station.report.show import text_table
from station.results.numbers import LOCK_IN_RATE
from station.results.result import TextTable
from station.results.verdict import LimitOutcome, interval_words, limit_words, margin_words, number_words
from station.terminal import visible

_ALPHABET = "ABDEFGILMNOPRST"
_ROWS = (
    " ###  ####  ####  ##### #####  ####  ###  #     #   # #   #  ###  ####  ####   #### #####",
    "#   # #   # #   # #     #     #       #   #     ## ## ##  # #   # #   # #   # #       #  ",
    "##### ####  #   # ####  ####  #  ##   #   #     # # # # # # #   # ####  ####   ###    #  ",
    "#   # #   # #   # #     #     #   #   #   #     #   # #  ## #   # #     #  #      #   #  ",
    "#   # ####  ####  ##### #      ####  ###  ##### #   # #   #  ###  #     #   # ####    #  ",
)
"""Each letter five wide, a blank between two."""

COLOURS = {"PASS": "green", "FAIL": "red", "MARGINAL": "yellow", "ERROR": "magenta", "ABORTED": "magenta"}

MEANING = {
    "PASS": "The unit keeps to every limit.",
    "FAIL": "The unit is beyond a limit, by more than the measurement can be wrong.",
    "MARGINAL": "A limit lies within what the measurement can tell: neither PASS nor FAIL is proven.",
    "ERROR": "The bench has failed, not the unit: nothing is said of the unit.",
    "ABORTED": "The test was ended before its time: nothing is said of the unit.",
}


def large(word: str) -> list[str]:
    """Return a word in letters five lines high; lines of one length."""
    places = [6 * _ALPHABET.index(letter) for letter in word]
    return ["  ".join(row[place : place + 5] for place in places) for row in _ROWS]


LIMIT_COLUMNS = ("verdict", "step", "number", "value", "95 % interval", "limit", "margin", "risk")


def limits_table(steps: Sequence[StepOutcome]) -> TextTable:
    """Return every number against its limit."""
    rows = [_limit_row(step, one) for step in steps for one in step.limits]
    return TextTable(LIMIT_COLUMNS, tuple(rows))


def _limit_row(step: StepOutcome, one: LimitOutcome) -> tuple[str, ...]:
    measured, unit = one.measured, one.measured.unit
    interval = interval_words(measured) if measured.uncertain else ""
    return (
        one.verdict,
        step.step.key,
        number_words(one.limit, measured),
        f"{measured.digits(measured.value)} {unit}".rstrip() if measured.value == measured.value else "none",
        interval,
        limit_words(one.limit, unit),
        margin_words(measured, one.margin) if one.margin == one.margin else "",
        "" if one.risk is None else risk_words(one.risk),
    )


def risk_words(risk: float) -> str:
    """Say a risk in percent: of a wrong decision."""
    return f"{100 * risk:.2g} %" if risk >= 1e-4 else "< 0.01 %"


def sentences(outcome: CampaignOutcome) -> list[str]:
    """Say what has to be known beside the limits: what failed, what was tried again, what to do next."""
    said = [] if outcome.failure is None else [outcome.failure.message]
    for step in outcome.steps:
        if step.failure is not None and step.failure != outcome.failure:
            said.append(f"{step.step.key}: {step.failure.message}")
        said += [f"{step.step.key}: {remark}" for remark in step.remarks]
    begun = {one.step.key for one in outcome.steps}
    undone = [step.is_due(outcome.steps) for step in outcome.plan.steps if step.key not in begun]
    if any(undone):
        said.append(f"{sum(undone)} of {len(outcome.plan.steps)} steps were not begun")
    if not all(undone):
        said.append(f"{undone.count(False)} steps were not due, by how those before them ended")
    if outcome.verdict == "ABORTED" or any(map(to_repeat, outcome.steps)):
        said.append(f"go on with --resume {outcome.directory}: what is there is not taken again")
    return said


def outcome_document(outcome: CampaignOutcome) -> dict[str, object]:
    """Return how a test has ended as one JSON document."""
    return {
        "schema": {"name": "gyrolock station", "version": 1},
        "campaign": outcome.plan.name,
        "station": outcome.plan.station,
        "unit": outcome.plan.unit,
        "unit_type": outcome.plan.unit_type,
        "operator": outcome.operator or None,
        "note": outcome.note or None,
        "simulated": outcome.plan.simulated,
        "verdict": outcome.verdict,
        "exit_code": outcome.exit_code,
        "message": outcome.message,
        "started_at": outcome.started_at,
        "ended_at": outcome.ended_at or None,
        "resumed_at": list(outcome.resumed_at),
        "directory": str(outcome.directory),
        "steps": [_step_document(step) for step in outcome.steps],
        **({} if outcome.failure is None else {"error": outcome.failure.as_json()}),
    }


def _step_document(step: StepOutcome) -> dict[str, object]:
    return {
        "step": step.step.key,
        "measurement": step.step.measurement,
        "verdict": step.verdict,
        "limits": [_limit_document(one) for one in step.limits],
        "run": None if step.run is None else str(step.run),
        "attempts": step.attempts,
        "elapsed_s": step.elapsed_s,
        "conditions": dict(step.conditions),
        "remarks": list(step.remarks),
        "error": None if step.failure is None else step.failure.as_json(),
    }


def _limit_document(one: LimitOutcome) -> dict[str, object]:
    return {
        "name": one.name,
        "value": one.measured.value,
        "low_95": one.measured.low_95,
        "high_95": one.measured.high_95,
        "unit": one.measured.unit,
        "at_least": one.limit.at_least,
        "at_most": one.limit.at_most,
        "guard_band": one.limit.rule,
        "margin": one.margin,
        "risk": one.risk,
        "verdict": one.verdict,
        "sentence": one.sentence,
    }


# --------------------
# How a test has ended, on the terminal: the verdict in large letters, every limit, what to do next


def print_outcome(outcome: CampaignOutcome) -> None:
    """Print how a test has ended."""
    console = stdout_console()
    plan, verdict = outcome.plan, outcome.verdict
    console.print(Text(visible(f"{plan.unit}   {plan.name}, {plan.station}")), soft_wrap=True)
    console.print()
    if verdict is None:
        console.print("no limits are set: nothing is decided")
    else:
        for line in large(verdict) if console.is_terminal else [f"VERDICT {verdict}"]:
            console.print(Text(line, style=f"bold {COLOURS[verdict]}"), soft_wrap=True)
        console.print()
        console.print(MEANING[verdict])
    table = limits_table(outcome.steps)
    if table.rows:
        console.print()
        if console.is_terminal and console.width >= _WIDE:
            console.print(text_table(table, left=3))
        else:
            limits = ((step.step.key, one) for step in outcome.steps for one in step.limits)
            _print_lines(f"{key}: {one.sentence.partition('; ')[0]}" for key, one in limits)
    if said := sentences(outcome):
        console.print()
        _print_lines(f"• {sentence}" for sentence in said)
    console.print()
    console.print(Text(f"saved   {outcome.directory}"), soft_wrap=True)


def _print_lines(lines: Iterable[str]) -> None:
    """Print lines, folded on a terminal and whole elsewhere."""
    console = stdout_console()
    for line in lines:
        console.print(Text(visible(line)), soft_wrap=not console.is_terminal)


_WIDE = 140  # columns from which on the limits are shown as a table


# --------------------
# What a campaign would do with a unit, without doing it


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
            LOCK_IN_RATE.key("u"): u,
            "lock_in_rate_expanded_u_95_dps": u95,
            "limits": [f"{one.number}{one.relation} {limit_words(one, '')}".strip() for one in step.limits],
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
            said = f"{step.key}: {one.number}{one.relation} {limit_words(one, '')}, guard band {one.rule}"
            if u95 is not None and (one.number, one.relation, one.rule) == (LOCK_IN_RATE.key(), "", "U95"):
                said += f"; MARGINAL within about {u95:.2g} of it"
            console.print(f"• {said}", soft_wrap=True)
    total = total_seconds(plan, seconds)
    console.print()
    said = "not known" if total is None else f"{time_words(total)} on a real bench"
    simulated = ", which this is not: a simulated one does not wait" if plan.simulated else ""
    console.print(f"total   {said}{simulated}")


def time_words(seconds: float) -> str:
    """Say a time."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    return f"{int(seconds // 3600)} h {int(seconds % 3600 // 60)} min"
