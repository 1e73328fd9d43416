"""A campaign in words: what it will do, how it has ended, its verdict in large letters."""

from __future__ import annotations

from collections.abc import Sequence

from station.campaign.outcome import CampaignOutcome, StepOutcome
from station.results.parts import TextTable
from station.results.verdict import LimitOutcome, limit_words, number_words

_LETTERS = {
    "A": (" ### ", "#   #", "#####", "#   #", "#   #"),
    "B": ("#### ", "#   #", "#### ", "#   #", "#### "),
    "D": ("#### ", "#   #", "#   #", "#   #", "#### "),
    "E": ("#####", "#    ", "#### ", "#    ", "#####"),
    "F": ("#####", "#    ", "#### ", "#    ", "#    "),
    "G": (" ####", "#    ", "#  ##", "#   #", " ####"),
    "I": ("###", " # ", " # ", " # ", "###"),
    "L": ("#    ", "#    ", "#    ", "#    ", "#####"),
    "M": ("#   #", "## ##", "# # #", "#   #", "#   #"),
    "N": ("#   #", "##  #", "# # #", "#  ##", "#   #"),
    "O": (" ### ", "#   #", "#   #", "#   #", " ### "),
    "P": ("#### ", "#   #", "#### ", "#    ", "#    "),
    "R": ("#### ", "#   #", "#### ", "#  # ", "#   #"),
    "S": (" ####", "#    ", " ### ", "    #", "#### "),
    "T": ("#####", "  #  ", "  #  ", "  #  ", "  #  "),
}

COLOURS = {"PASS": "green", "FAIL": "red", "MARGINAL": "yellow", "ERROR": "magenta", "ABORTED": "magenta"}

MEANING = {
    "PASS": "The unit keeps to every limit.",
    "FAIL": "The unit is beyond a limit, by more than the measurement can be wrong.",
    "MARGINAL": "A limit lies within what the measurement can tell: neither PASS nor FAIL is proven.",
    "ERROR": "The bench has failed, not the unit: nothing is said of the unit.",
    "ABORTED": "The test was ended before its time: nothing is said of the unit.",
}


def large(word: str) -> list[str]:
    r"""Return a word in letters five lines high; lines of one length.

    Examples
    --------
    >>> print("\n".join(line.rstrip() for line in large("FAIL")))
    #####   ###   ###  #
    #      #   #   #   #
    ####   #####   #   #
    #      #   #   #   #
    #      #   #  ###  #####
    """
    return ["  ".join(_LETTERS[letter][row] for letter in word) for row in range(5)]


def limits_table(steps: Sequence[StepOutcome]) -> TextTable:
    """Return every number against its limit."""
    header = ("verdict", "step", "number", "value", "95 % interval", "limit", "margin", "risk")
    rows = [_limit_row(step, one) for step in steps for one in step.limits]
    return TextTable(header, tuple(rows))


def _limit_row(step: StepOutcome, one: LimitOutcome) -> tuple[str, ...]:
    measured, unit = one.measured, one.measured.unit
    interval = f"{measured.low_95:.6g} to {measured.high_95:.6g}" if measured.uncertain else ""
    return (
        one.verdict,
        step.step.key,
        number_words(one.limit.number, measured),
        f"{measured.value:.6g} {unit}".rstrip() if measured.value == measured.value else "none",
        interval,
        limit_words(one.limit, unit),
        f"{one.margin:+.3g}" if one.margin == one.margin else "",
        "" if one.risk is None else risk_words(one.risk),
    )


def risk_words(risk: float) -> str:
    """Say a risk in percent: of a wrong decision.

    Examples
    --------
    >>> risk_words(0.12), risk_words(3e-9)
    ('12 %', '< 0.01 %')
    """
    return f"{100 * risk:.2g} %" if risk >= 1e-4 else "< 0.01 %"


def sentences(outcome: CampaignOutcome) -> list[str]:
    """Say what has to be known beside the limits: what failed, what was tried again, what to do next."""
    said = [] if outcome.failure is None else [outcome.failure.message]
    for step in outcome.steps:
        if step.failure is not None and step.failure != outcome.failure:
            said.append(f"{step.step.key}: {step.failure.message}")
        said += [f"{step.step.key}: {remark}" for remark in step.remarks]
    undone = len(outcome.plan.steps) - len(outcome.steps)
    if undone:
        said.append(f"{undone} of {len(outcome.plan.steps)} steps were not begun")
    if outcome.verdict in ("ERROR", "ABORTED"):
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
