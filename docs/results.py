"""Write docs/results.md, every number of every result, from the declarations themselves: ``make docs``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from station.measurements import MEASUREMENTS, measurement
from station.results.quantity import UNITS, Quantity, QuantityGroup

PAGE = Path(__file__).with_suffix(".md")

HEAD = """# Numbers of results

Written by `make docs` from the declarations of the measurements. A number stands in the JSON under its key; beside
it stand `u`, its standard uncertainty (k = 1), and its 95 % interval: `lock_in_rate_dps`, `lock_in_rate_u_dps`,
`lock_in_rate_low_95_dps`, `lock_in_rate_high_95_dps`. *limit*: `[limits]` and campaigns may name it. A campaign
can limit any other number too, as `result.` and its place."""


def page() -> str:
    """The whole page; the same declarations always give the same text."""
    return (
        "\n\n".join(
            [HEAD, *(part for name in MEASUREMENTS if measurement(name).quantities for part in _parts(name))]
        )
        + "\n"
    )


def _parts(name: str) -> Iterator[str]:
    kind = measurement(name)
    yield f"## {kind.title}\n\n`{kind.command}`"
    told: set[tuple[Quantity, ...]] = set()
    for group in kind.quantities:
        if group.quantities not in told:
            told.add(group.quantities)
            yield f"{_place(group)}\n\n| key | unit | known by | |\n|---|---|---|---|\n" + "\n".join(
                _row(one) for one in group.quantities if one.unit or one.u or one.doc
            )


def _place(group: QuantityGroup) -> str:
    each = f", one for each `{group.each}`" if group.each else ""
    return f"In `{group.place}`{each}:" if group.place else "At the top:"


def _row(one: Quantity) -> str:
    known = ", ".join(filter(None, ("u" if one.u else "", "interval" if one.interval else "")))
    limit = f"*limit* `{one.limit_name}`" if isinstance(one.limit, str) else "*limit*" if one.limit else ""
    return f"| `{one.key()}` | {UNITS.get(one.unit, '')} | {known} | {'; '.join(filter(None, (one.doc, limit)))} |"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
