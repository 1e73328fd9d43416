"""A curve of dots on a terminal: the samples of a record, and the fit through them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

from rich.text import Text

_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))  # of a Braille cell: four rows of two


def plot(
    samples: Sequence[float | None],
    fit: Sequence[float | None],
    width: int,
    height: int,
    *,
    unit: str,
    seconds: float,
) -> list[Text]:
    """Draw samples as dots and a fit as a line, with the ends of both axes."""
    known = [value for value in (*samples, *fit) if value is not None and math.isfinite(value)]
    if not known or width < 16 or height < 3:
        return [Text("no record to show", style="dim")]
    low, high = min(known), max(known)
    if low == high:
        low, high = low - 0.5, high + 0.5
    labels = [f"{high:.3g} {unit}", f"{low:.3g} {unit}"]
    margin = max(map(len, labels)) + 1
    columns, rows = width - margin, height - 1
    dots = dict(_cells(_spread(samples, low, high, columns, rows)))
    line = dict(_cells(_joined(_spread(fit, low, high, columns, rows))))
    lines = []
    for row in range(rows):
        label = labels[0] if row == 0 else labels[1] if row == rows - 1 else ""
        text = Text(f"{label:>{margin - 1}} ", style="dim")
        for column in range(columns):
            cell = (column, row)
            bits = dots.get(cell, 0) | line.get(cell, 0)
            style = "cyan" if cell in line else "yellow"
            text.append(chr(0x2800 + bits) if bits else " ", style=style)
        lines.append(text)
    scale, name = next(
        (s, n) for limit, s, n in ((2.0, 1.0, "s"), (2e-3, 1e3, "ms"), (0.0, 1e6, "µs")) if seconds >= limit
    )
    end = f"{seconds * scale:.4g} {name}"
    lines.append(Text(f"{'':{margin}}0{end:>{columns - 1}}", style="dim"))
    return lines


def _spread(
    values: Sequence[float | None], low: float, high: float, columns: int, rows: int
) -> list[tuple[int, int]]:
    """Dots of a picture of so many characters: two across and four down in each."""
    across, down = 2 * columns - 1, 4 * rows - 1
    last = max(len(values) - 1, 1)
    return [
        (round(place / last * across), round((high - value) / (high - low) * down))
        for place, value in enumerate(values)
        if value is not None and math.isfinite(value)
    ]


def _joined(dots: Sequence[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """The dots, and those between neighbours: a line."""
    for (x, y), (to_x, to_y) in itertools.pairwise(dots):
        steps = max(abs(to_x - x), abs(to_y - y), 1)
        for step in range(steps + 1):
            yield round(x + (to_x - x) * step / steps), round(y + (to_y - y) * step / steps)


def _cells(dots: Iterator[tuple[int, int]] | Sequence[tuple[int, int]]) -> Iterator[tuple[tuple[int, int], int]]:
    """Characters with the dots that are set in each, every character once."""
    cells: dict[tuple[int, int], int] = {}
    for x, y in dots:
        cell = (x // 2, y // 4)
        cells[cell] = cells.get(cell, 0) | _DOTS[y % 4][x % 2]
    yield from cells.items()
