"""`python -m benchmarks.hostile`: records and benches that are not as they should be, and what is said of them."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.hostile import benches
from benchmarks.hostile.classes import CLASSES
from benchmarks.hostile.measure import measure
from benchmarks.hostile.tables import records_table

DEFAULT_RECORDS = 200
PAGE_MARKS = ("<!-- tables of python -m benchmarks.hostile -->", "<!-- end of tables -->")


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    options = _options(arguments)
    chosen = [one for one in CLASSES if options.only.lower() in f"{one.kind}: {one.name}".lower()]
    seeds = range(options.seed, options.seed + options.seeds)
    outcomes = measure(chosen, options.records, seeds)
    report = records_table(outcomes, options.records, seeds) + "\n"
    sys.stdout.write(report)
    if options.page:
        before, rest = options.page.read_text().split(PAGE_MARKS[0], 1)
        after = rest.split(PAGE_MARKS[1], 1)[1]
        options.page.write_text(f"{before}{PAGE_MARKS[0]}\n\n{report}\n{PAGE_MARKS[1]}{after}")
    if options.benches and not options.only:
        sys.stdout.write("\n" + benches.run(options.seed, options.benches) + "\n")
    if options.grid and not options.only:
        sys.stdout.write("\n" + benches.grid(options.seed, options.grid) + "\n")
    return 0


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.hostile",
        description="What estimate_lock_in says of records, and `gyrolock measure` of benches, that are not as "
        "they should be.",
    )
    parser.add_argument(
        "--records",
        type=int,
        default=DEFAULT_RECORDS,
        metavar="N",
        help="of each class and seed (default %(default)s)",
    )
    parser.add_argument(
        "--benches",
        type=int,
        default=benches.DEFAULT_BENCHES,
        metavar="N",
        help="whole measurements in each of three tables, seconds each; none with --only (default %(default)s)",
    )
    parser.add_argument(
        "--grid",
        type=int,
        default=0,
        metavar="N",
        help="seeds of whole measurements with each of 21 gyros, some seconds each (default none)",
    )
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of every random number (default 1)")
    parser.add_argument(
        "--seeds",
        type=int,
        default=1,
        metavar="N",
        help="so many seeds, from S on, each with as many records, added up (default %(default)s)",
    )
    parser.add_argument("--only", default="", metavar="TEXT", help='classes with this in "kind: name"')
    parser.add_argument("--page", type=Path, metavar="FILE", help="put the tables between the marks of this page")
    options = parser.parse_args(arguments)
    if min(options.records, options.seeds) < 1:
        parser.error("--records and --seeds must be 1 or more")
    if options.page and not (options.page.is_file() and all(m in options.page.read_text() for m in PAGE_MARKS)):
        parser.error(f"{options.page} is no file with the marks {PAGE_MARKS[0]} and {PAGE_MARKS[1]}")
    return options


if __name__ == "__main__":
    sys.exit(main())
