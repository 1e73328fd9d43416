"""The results as tables of Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.hostile.measure import Outcome, common_flags

_HEAD = ("class", "kind", "unwarned", "wrong", "refused", "covered", "u/WL", "flags")


def records_table(outcomes: Sequence[Outcome], n_records: int, seeds: Sequence[int]) -> str:
    """One line for each class of records."""
    rows = [_HEAD, tuple("---" for _ in _HEAD)]
    for one in outcomes:
        finite = one.count("finite")
        share = f"{100 * one.covered / finite:.0f} %" if finite else ""
        stopped = one.count("error")
        refused = f"{len(one.answers) - finite}" + (f" ({stopped} stopped the batch)" if stopped else "")
        rows.append(
            (
                one.name,
                one.kind,
                str(one.unwarned),
                str(one.unwarned_wrong),
                refused,
                share,
                f"{one.relative_u:.2g}",
                common_flags(one),
            )
        )
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    drawn = f"seed {seeds[0]}" if len(seeds) == 1 else f"each of the seeds {seeds[0]} to {seeds[-1]}"
    return f"{n_records} records of each class, {drawn}.\n\n{table}"
