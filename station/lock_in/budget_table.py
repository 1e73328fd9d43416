"""An uncertainty budget as a table on a terminal."""

from __future__ import annotations

from rich.table import Table

from analysis.budget import Budget
from station.lock_in.sentences import budget_rows

_SHOWN = ("quantity", "u (k = 1)", "sensitivity", "contribution, deg/s", "share")
_PLACES = (0, 2, 4, 5, 6)


def budget_table(budget: Budget) -> Table:
    """Lay out the lines of a budget that contribute, the largest first, and the combined uncertainty.

    Parameters
    ----------
    budget : Budget

    Returns
    -------
    rich.table.Table
    """
    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for name in _SHOWN:
        table.add_column(name, justify="left" if name == "quantity" else "right")
    rows = budget_rows(budget)
    for line, row in zip(budget.inputs, rows, strict=False):
        if line.contribution > 0:
            table.add_row(*(row[place] for place in _PLACES))
    table.add_row(*(rows[-1][place] for place in _PLACES), style="bold")
    return table
