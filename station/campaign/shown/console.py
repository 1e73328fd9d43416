"""How a test has ended, on the terminal: the verdict in large letters, every limit, what to do next."""

from __future__ import annotations

from collections.abc import Iterable

from rich.text import Text

from station.campaign.outcome import CampaignOutcome
from station.campaign.shown.words import COLOURS, MEANING, large, limits_table, sentences
from station.report.console import text_table
from station.terminal.console import stdout_console
from station.terminal.visible import visible


def print_outcome(outcome: CampaignOutcome) -> None:
    """Print how a test has ended."""
    console = stdout_console()
    plan, verdict = outcome.plan, outcome.verdict
    console.print()
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
            _print_lines(f"{step.step.key}: {one.sentence}" for step in outcome.steps for one in step.limits)
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


_WIDE = 140
"""Columns from which on the limits are shown as a table."""
