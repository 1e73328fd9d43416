"""``gyrolock runs``: all runs below a folder, chosen, sorted, drawn over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from station.shell.options import config_option, json_option
from station.terminal.lines import print_json, remark, say

_SHOWN = 100  # on a terminal; nobody reads more


@click.command("runs")
@click.argument("directory", default="runs", type=click.Path(path_type=Path), metavar="[DIR]")
@click.option("--command", metavar="NAME", help="Of this measurement only: measure, deadband, table...")
@click.option("--unit", metavar="TEXT", help="Of this unit; * and ? stand for other letters.")
@click.option("--operator", metavar="TEXT", help="By this operator; * and ? stand for other letters.")
@click.option("--gyro", metavar="TEXT", help="Of this gyro; * and ? stand for other letters.")
@click.option("--verdict", type=click.Choice(["PASS", "FAIL", "none"]), help="With this verdict.")
@click.option("--mark", type=click.Choice(["good", "bad", "none"]), help="With this mark.")
@click.option("--tag", "tags", multiple=True, metavar="TAG", help="With this tag; may be given several times.")
@click.option("--text", metavar="TEXT", help="With these letters in a note.")
@click.option(
    "--since", metavar="DATE", help="From this day on, UTC: 2026, 2026-11, 2026-11-21, 2026-11-21T06:05."
)
@click.option("--until", metavar="DATE", help="Up to this day, which counts too.")
@click.option(
    "--sort",
    multiple=True,
    metavar="KEY",
    help="when, command, unit, operator, result, records, verdict or mark; -KEY turns it round; may be given "
    "several times.  [default: when]",
)
@click.option(
    "--limit", type=click.IntRange(min=0), metavar="N", help=f"The last N only; 0: all.  [{_SHOWN}, in words]"
)
@click.option(
    "--plot", type=click.Path(path_type=Path), metavar="FILE", help="Draw the results over time: .svg .png .pdf."
)
@click.option("--csv", "as_csv", is_flag=True, help="CSV on stdout: one line for each value of a result.")
@config_option
@json_option
def command(
    directory: Path,
    sort: tuple[str, ...],
    limit: int | None,
    plot: Path | None,
    config: Path | None,
    as_csv: bool,
    as_json: bool,
    **wanted: Any,
) -> int:
    """List all runs below a folder: when, what, unit, operator, result, verdict, mark, note.

    DIR is a folder of runs [./runs]. No record is opened, and a run that is written at this moment is not
    disturbed. An index in the folder (.gyrolock-index.sqlite) makes the next list fast; it may be deleted at any
    time. `gyrolock annotate` adds notes, tags and marks. A settings file changes nothing here but the folder.
    """
    from station.catalogue.choose import Wanted, chosen
    from station.catalogue.index import list_runs
    from station.catalogue.listing import SCHEMA, runs_csv, runs_table
    from station.display.opening import shown as displayed

    if as_json and as_csv:
        raise click.UsageError("--json and --csv exclude each other")
    if plot is not None:
        from station.report.figure import check_picture_name

        check_picture_name(plot)
    if config is not None:
        from station.settings.toml_files import read_toml

        read_toml(config)  # a file with a mistake is one here too
    with displayed({"plain": True}, "runs") as progress:
        entries = list_runs(directory, progress=progress)
    asked = Wanted(**{name: value for name, value in wanted.items() if value})
    found = chosen(entries, asked, sort)
    shown = found[-(_SHOWN if limit is None and not (as_json or as_csv) else limit or len(found)) :]
    if plot is not None:
        from station.catalogue.trend import write_trend

        drawn = write_trend(plot, shown)
        remark(f"{drawn} results are drawn in {plot}")
    if as_json:
        print_json({"schema": SCHEMA, "directory": str(directory), "runs": [entry.as_json() for entry in shown]})
    elif as_csv:
        say(runs_csv(shown).rstrip("\n"))
    else:
        _print(runs_table(shown, directory), len(shown), len(found), len(entries), directory)
    return 0


def _print(table: Any, shown: int, found: int, there: int, directory: Path) -> None:
    import shutil
    import sys

    from station.report.console import text_table
    from station.terminal.console import PlainConsole

    if shown:
        # a pipe has no width: nothing is cut off there
        width = None if sys.stdout.isatty() else max(200, shutil.get_terminal_size().columns)
        PlainConsole(width=width).print(text_table(table, left=len(table.header)))
    if not there:
        say(f"{directory}: holds no runs")
    elif not found:
        say(f"none of {there} runs is as asked for")
    elif shown < found:
        say(f"the last {shown} of {found} runs; --limit 0 shows all")
