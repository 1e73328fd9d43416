"""``gyrolock runs``, all runs below a folder, and ``gyrolock history``, tested units over time."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.errors import EXIT_FAIL, EXIT_OK, EXIT_OUTPUT, UsageError, one_line
from station.shell.options import json_option, unused_config_option
from station.terminal import PRINTS_ONE_LINE, print_json, prints, remark, say, say_briefly

if TYPE_CHECKING:
    from station.history import ControlSeries, PastTest

_SHOWN = 100  # on a terminal; nobody reads more


def _day(_: click.Context, __: click.Parameter, value: str | None) -> str | None:
    """A time as runs begin with it: of a date, a part of one, or an age; a `callback` of ``click.option``."""
    if value is None:
        return None
    now = datetime.now(UTC)
    if age := re.fullmatch(r"(\d{1,5})([hdw])", value):
        hours = int(age[1]) * {"h": 1, "d": 24, "w": 168}[age[2]]
        return (now - timedelta(hours=hours)).isoformat(timespec="seconds")[:19]
    if value in ("today", "yesterday"):
        return (now - timedelta(days=value == "yesterday")).isoformat()[:10]
    try:
        datetime.fromisoformat(value + "2026-01-01T00:00:00"[len(value) :])
    except ValueError:
        raise click.BadParameter(
            f"{value!r} is no date: write 2026, 2026-11, 2026-11-21, 2026-11-21T06:05, today, yesterday, or "
            "an age: 12h, 7d, 3w"
        ) from None
    return value


@click.command("runs")
@click.argument("directory", default="runs", type=click.Path(path_type=Path), metavar="[DIR]")
@click.option("--command", metavar="NAME", help="Of this measurement only: measure, deadband, table...")
@click.option("--unit", metavar="TEXT", help="Of this unit; wildcards * and ? allowed.")
@click.option("--operator", metavar="TEXT", help="By this operator; wildcards * and ? allowed.")
@click.option("--gyro", metavar="TEXT", help="Of this gyro; wildcards * and ? allowed.")
@click.option(
    "--verdict", type=click.Choice(["PASS", "MARGINAL", "FAIL", "ERROR", "none"]), help="With this verdict."
)
@click.option("--mark", type=click.Choice(["good", "bad", "none"]), help="With this mark.")
@click.option("--tag", "tags", multiple=True, metavar="TAG", help="With this tag; may be repeated.")
@click.option("--text", metavar="TEXT", help="Note contains TEXT.")
@click.option(
    "--since",
    metavar="DATE",
    callback=_day,
    help="From this day on, UTC: 2026, 2026-11, 2026-11-21, 2026-11-21T06:05, yesterday, 7d.",
)
@click.option("--until", metavar="DATE", callback=_day, help="Up to this day, which counts too.")
@click.option(
    "--sort",
    multiple=True,
    metavar="KEY",
    help="when, command, unit, operator, result, records, verdict or mark; -KEY reverses the order; may be "
    "repeated.  [default: when]",
)
@click.option(
    "--limit", type=click.IntRange(min=0), metavar="N", help=f"Show the last N runs; 0: all.  [{_SHOWN}]"
)
@click.option(
    "--plot", type=click.Path(path_type=Path), metavar="FILE", help="Draw the results over time: .svg .png .pdf."
)
@click.option("--csv", "as_csv", is_flag=True, help="CSV on stdout: one line for each value of a result.")
@click.option("--empty", is_flag=True, help="Only those without a record, which the list leaves out otherwise.")
@click.option("--delete", is_flag=True, help="With --empty: remove them from the disk.")
@unused_config_option
@json_option
def runs_command(
    directory: Path,
    empty: bool,
    delete: bool,
    sort: tuple[str, ...],
    limit: int | None,
    plot: Path | None,
    as_csv: bool,
    as_json: bool,
    **wanted: Any,
) -> int:
    """List runs: when, what, unit, result, quality, verdict.

    DIR is a folder of runs [./runs]. No record is opened, and a run that is written at this moment is not
    disturbed. An index in the folder (.gyrolock-index.sqlite) makes the next list fast; it may be deleted at any
    time. `gyrolock annotate` adds notes, tags and marks.
    """
    from station.catalogue import SCHEMA, RunFilter, chosen, list_runs, runs_csv, runs_table
    from station.shell.options import shown as displayed

    if as_json and as_csv:
        raise click.UsageError("--json and --csv exclude each other")
    if delete and not empty:
        raise click.UsageError("--delete goes with --empty: other runs are not removed")
    if plot is not None:
        from station.report.figure import check_picture_name

        check_picture_name(plot)
    with displayed({"plain": True}, "runs") as progress:
        entries = list_runs(directory, progress=progress)
    asked = RunFilter(**{name: value for name, value in wanted.items() if value})
    found = chosen(entries, asked, sort)
    folded = [entry for entry in found if not (entry.records or entry.problem)]
    if empty or not (as_json or as_csv):
        found = folded if empty else [entry for entry in found if entry not in folded]
    if delete:
        for entry in folded:
            remark(f"{Path(entry.run).parent}: {_removed(Path(entry.run)) or 'removed'}")
        return EXIT_OK
    shown = found[-(_SHOWN if limit is None and not (as_json or as_csv) else limit or len(found)) :]
    if plot is not None:
        from station.catalogue import write_trend

        drawn = write_trend(plot, shown)
        remark(f"{drawn} results are drawn in {plot}")
    if as_json:
        print_json({"schema": SCHEMA, "directory": str(directory), "runs": [entry.as_json() for entry in shown]})
    elif as_csv:
        say(runs_csv(shown).rstrip("\n"), answer=True)
    else:
        _print(runs_table(shown, directory), len(shown), len(found), len(entries), directory)
        if folded and not empty:
            say(f"not shown: {len(folded)} without a record (`gyrolock runs {directory} --empty --delete`)")
    return EXIT_OK


def _removed(run: Path) -> str:
    """Remove a run without a record from the disk; why it stays where it does."""
    import shutil

    from station.campaign.journal import JOURNAL
    from station.live.status import running_programs
    from station.runs.annotations import remarks_file
    from station.runs.store import REPORT_FILE, RUN_FILES

    folder = run.parent
    if any(one.alive and one.run is not None and one.run.resolve() == run.resolve() for one in running_programs()):
        return "a program takes it at the moment"
    if any((above / JOURNAL).exists() for above in folder.absolute().parents):
        return "belongs to the test of a unit"
    known = {run.name, f"{run.name}-wal", f"{run.name}-shm", REPORT_FILE, remarks_file(run).name}
    if run.name not in RUN_FILES or {path.name for path in folder.iterdir()} - known:
        return "holds other files too: remove it by hand"
    shutil.rmtree(folder)
    return ""


def _print(table: Any, shown: int, found: int, there: int, directory: Path) -> None:
    import shutil
    import sys

    from station.live.console import PlainConsole
    from station.report.show import text_table

    say_briefly(f"{found} of {there} runs")
    if shown and not prints(PRINTS_ONE_LINE):
        # a pipe has no width: nothing is cut off there
        width = None if sys.stdout.isatty() else max(200, shutil.get_terminal_size().columns)
        PlainConsole(width=width).print(text_table(table, left=len(table.header)))
    if not there:
        say(f"{directory}: holds no runs")
    elif not found:
        say(f"none of {there} runs is as asked for")
    elif shown < found:
        say(f"the last {shown} of {found} runs; --limit 0 shows all")


# --------------------
# ``gyrolock history``: tested units, and control charts of what was found


_SCHEMA = {"name": "gyrolock history", "version": 1}
_OF_TEST = ("unit", "unit_type", "is_reference", "verdict", "simulated")


@click.command("history")
@click.argument("directory", default="tests", type=click.Path(path_type=Path), metavar="[DIR]")
@click.option("--unit", metavar="TEXT", help="Tests of this unit only.")
@click.option("--type", "unit_type", metavar="TEXT", help="Units of this type only.")
@click.option("--number", metavar="TEXT", help="Numbers with this in their name: lock_in_rate, scale_factor.")
@click.option(
    "--baseline",
    type=click.IntRange(min=8),
    default=25,
    metavar="N",
    help="The first N values give the limits of a chart [25].",
)
@click.option(
    "--to",
    "--out",
    "out",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Where the page goes [DIR/index.html].",
)
@click.option("--page/--no-page", default=True, help="Write the page with the charts [yes].")
@click.option("--csv", "as_csv", is_flag=True, help="CSV on stdout: one line for each number of each test.")
@unused_config_option
@json_option
def history_command(
    directory: Path,
    unit: str | None,
    unit_type: str | None,
    number: str | None,
    baseline: int,
    out: Path | None,
    page: bool,
    as_csv: bool,
    as_json: bool,
) -> int:
    """Show tested units and control charts: of a type of unit, and of the bench by its reference unit.

    DIR is the folder in which `gyrolock station` keeps its tests [./tests]. Charts are of single values and of
    their moving range, with the rules of Western Electric: lock-in rate, scale factor, and what limits are set
    on.
    Exit codes: 0 everything is in control, 1 the last value of a chart is not, 2 there is no test.
    """
    from station.history import courses, history_csv, read_tests, write_index

    if as_json and as_csv:
        raise click.UsageError("--json and --csv exclude each other")
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
    if as_csv:
        say(history_csv(tests, number or "").replace("\r\n", "\n").rstrip("\n"), answer=True)
    elif as_json:
        print_json(_document(directory, tests, charts, unreadable, written))
    else:
        _print_history(tests, charts, written)
    if lost:
        remark(f"the page cannot be written ({lost})")
        return EXIT_OUTPUT
    return EXIT_OK if all(one.chart.last_is_in_control for one in charts) else EXIT_FAIL


def _print_history(tests: list[PastTest], charts: list[ControlSeries], written: Path | None) -> None:
    from station.history import failures
    from station.live.console import stdout_console
    from station.report.show import text_table
    from station.results.result import TextTable

    console = stdout_console()
    verdicts = Counter(one.verdict or "measured" for one in tests)
    say_briefly(f"tests: {', '.join(f'{count} {verdict}' for verdict, count in verdicts.items())}")
    rows = [
        (one.unit, one.unit_type, one.at[:16].replace("T", " "), one.verdict or "measured", one.message)
        for one in tests
    ]
    console.print(text_table(TextTable(("unit", "type", "begun, UTC", "verdict", "why"), tuple(rows)), left=5))
    for name, count in failures(tests):
        console.print(f"FAIL in {count} of {len(tests)} tests: {name}")
    for one in charts:
        console.print(f"\n{one.title}", style="bold")
        for sentence in one.sentences:
            console.print(f"• {sentence}")
    if written is not None:
        say(f"\npage    {written}")


def _document(
    directory: Path,
    tests: list[PastTest],
    charts: list[ControlSeries],
    unreadable: list[Path],
    written: Path | None,
) -> dict[str, Any]:
    return {
        "schema": _SCHEMA,
        "directory": str(directory),
        "tests": [
            {
                **{name: getattr(one, name) for name in _OF_TEST},
                "started_at": one.at,
                "message": one.message or None,
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
                "limits": list(one.numbers[-1].limits),
                "units": [test.unit for test in one.tests],
                "started_at": [test.at for test in one.tests],
                **{name: getattr(one.chart, name) for name in ("centre", "sigma", "moving_range", "baseline")},
                "moving_range_limit": one.chart.range_limit,
                "signals": [{"place": signal.place, "rule": signal.rule} for signal in one.chart.signals],
                "in_control": one.chart.last_is_in_control,
                "trend": None if (of_unit := one.trend) is None else asdict(of_unit),
            }
            for one in charts
        ],
        "unreadable": [str(path) for path in unreadable],
        "page": None if written is None else str(written),
    }
