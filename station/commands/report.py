"""``gyrolock report``: the HTML report of a saved run."""

from __future__ import annotations

from pathlib import Path

import click

from station.shell.options import config_option, json_option, print_json


@click.command("report")
@click.argument("run", type=click.Path(path_type=Path), metavar="RUN")
@click.option(
    "--output", "-o", type=click.Path(path_type=Path), metavar="FILE", help="[report.html beside the run]"
)
@config_option
@json_option
def command(run: Path, output: Path | None, config: Path | None, as_json: bool) -> int:
    """Write the HTML report of a saved run: one file, with its plots inside.

    RUN is the directory of the run or its file.
    """
    from station.lock_in.read import evaluate_run
    from station.lock_in.report import write_report
    from station.runs.store import open_run
    from station.settings.load import load_settings

    load_settings(config)  # a mistake in it is told, though a saved run carries its own settings
    saved = open_run(run)
    written = write_report(evaluate_run(saved), saved, output)
    if as_json:
        print_json({"run": str(saved.path), "report": str(written)})
    else:
        click.echo(str(written))
    return 0
