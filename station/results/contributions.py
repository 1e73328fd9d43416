"""A budget in parts per million of the result: what each input contributes to its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from station.results.parts import TextTable


@dataclass(frozen=True)
class Contribution:
    """One line of a budget."""

    name: str  # for programs
    quantity: str  # in words
    # standard uncertainty that it makes of the result, ppm of it; 0 where it is taken out or not counted
    ppm: float
    stated: bool  # whether it is known: stated, measured, or taken out; else `note` says what counts instead
    note: str  # where it comes from


def budget_document(reference: str, lines: Sequence[Contribution], combined_ppm: float) -> dict[str, Any]:
    """Return a budget for the JSON document, the largest contribution first."""
    ordered = sorted(lines, key=lambda line: -line.ppm)
    total = sum(line.ppm**2 for line in lines) or 1.0
    return {
        "reference": reference,
        "combined_u_ppm": combined_ppm,
        "inputs": [
            {
                "name": line.name,
                "quantity": line.quantity,
                "contribution_ppm": line.ppm,
                "share_of_variance": line.ppm**2 / total,
                "stated": line.stated,
                "note": line.note,
            }
            for line in ordered
        ],
        "not_stated": [line.name for line in ordered if not line.stated],
        "largest_part": ordered[0].name if ordered and ordered[0].ppm > 0 else None,
    }


def budget_table(of: str, document: Mapping[str, Any]) -> TextTable:
    """Return a budget as a table; `of` names the result."""
    rows = [
        (
            line["quantity"] if line["stated"] else f"{line['quantity']} (not stated)",
            f"{line['contribution_ppm']:.2g}" if line["contribution_ppm"] else "0",
            f"{100 * line['share_of_variance']:.0f} %",
            line["note"],
        )
        for line in document["inputs"]
    ]
    combined = (f"{of}, combined", f"{document['combined_u_ppm']:.2g}", "100 %", "")
    return TextTable(("input", "u, ppm", "share", "from"), (*rows, combined))
