"""``gyrolock report``: the HTML report of saved runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from station.shell.options import config_option, json_option
from station.terminal.lines import print_failure, print_json, say


@click.command("report")
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="RUN...")
@click.option(
    "--output", "-o", type=click.Path(path_type=Path), metavar="FILE", help="[report.html beside the run]"
)
@config_option
@json_option
def command(paths: tuple[Path, ...], output: Path | None, config: Path | None, as_json: bool) -> int:
    """Write the HTML report of saved runs of any kind: one file each, with its plots inside.

    RUN is the directory of a run or its file. With --config what is known of the bench, and the limits, are
    those of FILE.
    """
    from instrument import InstrumentError
    from station.errors import StationError, describe_failure
    from station.report.report import write_report
    from station.runs.store import open_run
    from station.shell.evaluated import evaluate_run

    if output is not None and len(paths) > 1:
        raise click.UsageError("--output names one file: give one run")
    documents: list[dict[str, Any]] = []
    exit_codes = []
    for path in paths:
        try:
            run = open_run(path)
            written = write_report(evaluate_run(run, config=config), output)
        except (InstrumentError, StationError, OSError) as error:
            failure = describe_failure(error)
            if failure is None or len(paths) == 1:
                raise
            print_failure(failure)
            documents.append({"run": str(path), "error": failure.as_json()})
            exit_codes.append(failure.exit_code)
            continue
        documents.append({"run": str(run.path), "report": str(written)})
        if not as_json:
            say(str(written))
    if as_json:
        print_json(documents[0] if len(documents) == 1 else {"results": documents})
    return min(exit_codes, default=0)
