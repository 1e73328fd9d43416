"""A result on a terminal: tables, values, what they mean, what to watch, the verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from station.terminal.console import stdout_console
from station.terminal.visible import visible

if TYPE_CHECKING:
    from collections.abc import Sequence

    from station.report.report import Shown
    from station.results.limits import Tested
    from station.results.parts import Rows, TextTable
    from station.results.result import Result

_COLOURS = {"stands": "green", "doubtful": "yellow", "fails": "red"}


def text_table(table: TextTable, *, left: int = 0) -> Table:
    """Lay out a table of texts; numbers stand right, the first `left` columns and words left."""
    shown = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for place, name in enumerate(table.header):
        words = place < left or name == "flags"
        shown.add_column(name, justify="left" if words else "right", no_wrap=not words)
    for row in table.rows:
        shown.add_row(*row)
    return shown


def print_result(evaluated: Shown) -> None:
    """Print what a run says."""
    facts = evaluated.run.facts
    rows = [*((name, text) for name, text in facts.labels.items())]
    if facts.resumed_at:
        rows.append(("resumed", ", ".join(facts.resumed_at)))
    if facts.simulated:
        known = (f"{name.replace('_', ' ')} {value:.9g}" for name, value in (facts.truth or {}).items())
        told = evaluated.result.truth or ", ".join(known) or "no truth is saved"
        rows.append(("bench", f"simulated; {told}"))
    print_values(evaluated.result, rows)
    print_tested(evaluated.tested)


def print_tested(tested: Sequence[Tested]) -> None:
    """Print a line for each limit."""
    for one in tested:
        stdout_console().print(one.sentence, style="green" if one.passed else "bold red")


def print_values(result: Result, more: Rows = ()) -> None:
    """Print a result without a run: tables, values, what they mean, what to watch."""
    console = stdout_console()
    for table in result.tables:
        console.print(text_table(table))
    summary = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    summary.add_column(style="dim", no_wrap=True)
    summary.add_column()
    summary.add_row("", "")
    style = f"bold {_COLOURS[result.standing.state]}"
    summary.add_row(result.name, Text(visible(result.value), style=style))
    for name, text in (*result.summary, *more):
        summary.add_row(name, text)
    console.print(summary)
    for sentence in result.sentences:
        console.print(f"• {sentence}")
    shown = {*result.to_watch, result.problem}
    for sentence in (*result.to_watch, *(one for one in result.standing.reasons if one not in shown)):
        console.print(f"• {sentence}", style="red" if sentence in result.failures else "yellow")
