"""An uncertainty budget as JSON, as a table and in sentences."""

from __future__ import annotations

from typing import Any

from analysis.budget import Budget
from station.lock_in.presentation.remedies import remedy_sentence
from station.results.as_json import picked
from station.results.numbers import with_uncertainty
from station.results.parts import TextTable

_LINE = {
    "name": "name",
    "quantity": "quantity",
    "unit": "unit",
    "value": "value",
    "u": "u",
    "distribution": "distribution",
    "sensitivity_dps_per_unit": "sensitivity",
    "contribution_dps": "contribution",
    "degrees_of_freedom": "degrees_of_freedom",
    "note": "note",
    "stated": "stated",
}
BUDGET_COLUMNS = (
    "quantity",
    "value",
    "u (k = 1)",
    "distribution",
    "sensitivity, deg/s per unit",
    "contribution, deg/s",
    "share",
    "d.o.f.",
)
_SHORT = (0, 2, 4, 5, 6)
"""Columns that a terminal has room for."""


def budget_document(budget: Budget) -> dict[str, Any]:
    """Return a budget for the JSON document."""
    return {
        "reference": budget.reference,
        "lock_in_rate_dps": budget.lock_in_rate,
        "combined_u_dps": budget.combined_u,
        "combined_u_percent": 100 * budget.relative_u,
        "effective_degrees_of_freedom": budget.effective_degrees_of_freedom,
        "coverage_factor": budget.coverage_factor,
        "expanded_u_95_dps": budget.expanded_u_95,
        "inputs": [{**picked(line, _LINE), "share_of_variance": budget.share(line)} for line in budget.inputs],
        "not_stated": [line.name for line in budget.not_stated],
        "largest_part": budget.inputs[0].name if budget.inputs else None,
        "remedy": remedy_sentence(budget) or None,
    }


def budget_rows(budget: Budget) -> list[tuple[str, ...]]:
    """Return the lines of a budget as text under `BUDGET_COLUMNS`, the largest contribution first.

    The last one is the combined uncertainty.
    """
    rows: list[tuple[str, ...]] = []
    for line in budget.inputs:
        unit = "" if line.unit == "1" else f" {line.unit}"
        rows.append(
            (
                line.quantity if line.stated else f"{line.quantity} (not stated)",
                f"{line.value:.6g}{unit}",
                f"{line.u:.2g}{unit}",
                line.distribution,
                f"{line.sensitivity:.3g}" if line.sensitivity else "0",
                f"{line.contribution:.2g}" if line.contribution else "0",
                _percent(budget.share(line)),
                _freedom(line.degrees_of_freedom),
            )
        )
    rows.append(
        (
            "lock-in rate, combined",
            f"{budget.lock_in_rate:.6g} deg/s",
            f"{budget.combined_u:.2g} deg/s",
            "",
            "",
            f"{budget.combined_u:.2g}",
            "100 %",
            _freedom(budget.effective_degrees_of_freedom),
        )
    )
    return rows


def short_budget_table(budget: Budget) -> TextTable:
    """Return the lines that contribute, the largest first, and the combined uncertainty: for a terminal."""
    *rows, combined = budget_rows(budget)
    shown = [row for line, row in zip(budget.inputs, rows, strict=True) if line.contribution > 0]
    header = [BUDGET_COLUMNS[place].replace(", deg/s per unit", "") for place in _SHORT]
    return TextTable(tuple(header), tuple(tuple(row[place] for place in _SHORT) for row in (*shown, combined)))


def budget_sentences(budget: Budget) -> list[str]:
    """Say in words what the budget comes to, what would make it smaller, and what it had to assume."""
    value = with_uncertainty(budget.lock_in_rate, budget.combined_u, "deg/s")
    percent = f" ({100 * budget.coverage_factor * budget.relative_u:.2g} %)" if budget.lock_in_rate > 0 else ""
    said = [
        f"Lock-in rate {value}, every input counted; U95 = {budget.expanded_u_95:.2g} deg/s{percent} with "
        f"k = {budget.coverage_factor:.2f}."
    ]
    if remedy := remedy_sentence(budget):
        said.append(remedy)
    if assumed := assumed_sentence(budget):
        said.append(assumed)
    return said


def assumed_sentence(budget: Budget) -> str:
    """Name what counts with a bound because nobody stated it; empty where everything was stated."""
    parts = [f"{line.quantity} ({line.note.removeprefix('not stated: bound of ')})" for line in budget.not_stated]
    if not parts:
        return ""
    return f"Nobody stated, so it counts with what it may be at worst: {'; '.join(parts)}."


def doubt_sentence(budget: Budget) -> str:
    """Say that something unknown rules the uncertainty; empty where the largest part is known."""
    first = budget.inputs[0] if budget.inputs else None
    if first is None or first.stated or first.contribution == 0:
        return ""
    return f"What rules the uncertainty is not known: {first.quantity}, {first.note}."


def _percent(share: float) -> str:
    return "0" if share == 0 else "< 0.1 %" if share < 0.001 else f"{100 * share:.1f} %"


def _freedom(value: float) -> str:
    return "∞" if value > 1e6 else f"{value:.0f}"
