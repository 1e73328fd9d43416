"""``gyrolock history``: tested units, and control charts of what was found."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.errors import EXIT_FAIL, EXIT_OK, EXIT_OUTPUT, UsageError, one_line
from station.shell.options import config_option, json_option
from station.terminal.lines import print_json, remark, say

if TYPE_CHECKING:
    from station.history.charts import Course
    from station.history.past_tests import PastTest

_SCHEMA = {"name": "gyrolock history", "version": 1}


@click.command("history")
@click.argument("directory", default="tests", type=click.Path(path_type=Path), metavar="[DIR]")
@click.option("--unit", metavar="TEXT", help="Tests of this unit only.")
@click.option("--type", "unit_type", metavar="TEXT", help="Units of this type only.")
@click.option(
    "--number", metavar="TEXT", help="Charts of numbers with this in their name: lock_in_rate, scale_factor."
)
@click.option(
    "--baseline",
    type=click.IntRange(min=8),
    default=25,
    metavar="N",
    help="The first N values give the limits of a chart [25].",
)
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="FILE", help="Where the page goes [DIR/index.html]."
)
@click.option("--page/--no-page", default=True, help="Write the page with the charts [yes].")
@config_option
@json_option
def command(
    directory: Path,
    unit: str | None,
    unit_type: str | None,
    number: str | None,
    baseline: int,
    out: Path | None,
    page: bool,
    config: Path | None,
    as_json: bool,
) -> int:
    """Show tested units and control charts: of a type of unit, and of the bench by its reference unit.

    DIR is the folder in which `gyrolock station` keeps its tests [./tests]. Charts are of single values and of
    their moving range, with the rules of Western Electric: lock-in rate, scale factor, and what limits are set
    on.
    Exit codes: 0 everything is in control, 1 the last value of a chart is not, 2 there is no test.
    """
    from station.history.charts import courses
    from station.history.page import write_index
    from station.history.past_tests import read_tests
    from station.settings.toml_files import read_toml

    if config is not None:
        read_toml(config)  # a file with a mistake is one here too
    if not directory.is_dir():
        raise UsageError(f"{directory}: there is no such folder of tests")
    tests, unreadable = read_tests(directory)
    tests = [one for one in tests if unit in (None, one.unit) and unit_type in (None, one.unit_type)]
    if not tests and not unreadable:
        raise UsageError(
            f"{directory}: holds no record of a test" + (" of these units" if unit or unit_type else "")
        )
    charts = [one for one in courses(tests, baseline=baseline) if number is None or number in one.name]
    for path in unreadable:
        remark(f"{path}: cannot be read and is left out")
    written, lost = None, ""
    if page:
        try:
            written = write_index(directory, tests, charts, out)
        except OSError as error:
            lost = one_line(error)
    if as_json:
        print_json(_document(directory, tests, charts, unreadable, written))
    else:
        _print(tests, charts, written)
    if lost:
        remark(f"the page cannot be written ({lost})")
        return EXIT_OUTPUT
    return EXIT_OK if all(one.chart.last_is_in_control for one in charts) else EXIT_FAIL


def _print(tests: list[PastTest], charts: list[Course], written: Path | None) -> None:
    from station.report.console import text_table
    from station.results.parts import TextTable
    from station.terminal.console import stdout_console

    console = stdout_console()
    rows = [
        (one.unit, one.unit_type, one.at[:16].replace("T", " "), one.verdict or "measured", one.message)
        for one in tests
    ]
    console.print(text_table(TextTable(("unit", "type", "begun, UTC", "verdict", "why"), tuple(rows)), left=5))
    for one in charts:
        console.print(f"\n{one.of}: {one.name}", style="bold")
        for sentence in one.sentences:
            console.print(f"• {sentence}")
    if written is not None:
        say(f"\npage    {written}")


def _document(
    directory: Path, tests: list[PastTest], charts: list[Course], unreadable: list[Path], written: Path | None
) -> dict[str, Any]:
    return {
        "schema": _SCHEMA,
        "directory": str(directory),
        "tests": [
            {
                "unit": one.unit,
                "unit_type": one.unit_type,
                "is_reference": one.is_reference,
                "started_at": one.at,
                "verdict": one.verdict,
                "message": one.message or None,
                "simulated": one.simulated,
                "record": str(one.path),
            }
            for one in tests
        ],
        "charts": [
            {
                "of": one.of,
                "number": one.name,
                "values": one.chart.values,
                "u": list(one.us),
                "units": [test.unit for test in one.tests],
                "started_at": [test.at for test in one.tests],
                "centre": one.chart.centre,
                "sigma": one.chart.sigma,
                "moving_range": one.chart.moving_range,
                "moving_range_limit": one.chart.range_limit,
                "baseline": one.chart.baseline,
                "signals": [{"place": signal.place, "rule": signal.rule} for signal in one.chart.signals],
                "in_control": one.chart.last_is_in_control,
            }
            for one in charts
        ],
        "unreadable": [str(path) for path in unreadable],
        "page": None if written is None else str(written),
    }
