"""``gyrolock analyze``: evaluate saved runs of any kind, and files of an oscilloscope."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.shell.options import config_option, json_option, not_zero, positive
from station.terminal.lines import print_failure, print_json, say

if TYPE_CHECKING:
    from collections.abc import Mapping

    from station.errors import Failure
    from station.lock_in.files import AnalyzedFiles
    from station.shell.evaluated import Evaluated


@click.command("analyze")
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="PATH...")
@click.option(
    "--scale-factor",
    type=float,
    callback=positive,
    metavar="K",
    help="Pulses per degree. For files it must be given, here or in the settings.",
)
@click.option(
    "--input-rate",
    type=float,
    callback=not_zero,
    metavar="W",
    help="Rate on the gyro's axis, deg/s. Without it the beat frequency is the reference.",
)
@click.option(
    "--relation", type=click.Choice(["exact", "paper-13", "paper-10"]), help="Of ratio and rate.  [default: exact]"
)
@click.option("--jsonl", is_flag=True, help="One JSON object a record, one a line, on stdout.")
@config_option
@json_option
def command(paths: tuple[Path, ...], jsonl: bool, config: Path | None, as_json: bool, **choices: Any) -> int:
    """Evaluate saved runs of any kind again, and Tektronix files.

    PATH is a run (its directory or its file), or a CSV or ISF file that the scope or its PC software wrote. With
    --json and several paths the document holds a list `results`. Exit code 4 if any of them gives no result, 1 if
    one is beyond a limit.

    A run is evaluated with the settings that it was taken with. With --config, what FILE states of the bench, and
    its [limits], replace what the run holds of them, for a channel that was measured later; the rest stays.
    """
    from station.errors import EXIT_FAIL

    if jsonl and as_json:
        raise click.UsageError("--json and --jsonl exclude each other")
    documents, failures, failed = [], [], False
    for path in paths:
        analyzed, failure = _analyze(path, config, choices)
        document: dict[str, Any] = analyzed.document() if analyzed is not None else {"file": str(path)}
        failed = failed or document.get("verdict") == "FAIL"
        if failure is not None:
            failures.append(failure)
            document["error"] = failure.as_json()
        documents.append(document)
        if jsonl:
            for line in analyzed.rows() if analyzed is not None else [document]:
                print_json(line)
        elif analyzed is not None and not as_json:
            _print(path, analyzed)
        if failure is not None:
            print_failure(failure)
    if as_json:
        print_json(documents[0] if len(documents) == 1 else {"results": documents})
    # what could not be read at all (2) comes before what holds no result (4)
    return min((failure.exit_code for failure in failures), default=EXIT_FAIL if failed else 0)


def _analyze(
    path: Path, config: Path | None, choices: Mapping[str, Any]
) -> tuple[Evaluated | AnalyzedFiles | None, Failure | None]:
    """Evaluate one path; one that cannot be read must not keep the others from being evaluated."""
    from instrument import InstrumentError
    from station.errors import EXIT_NO_SIGNAL, Failure, NoUsableSignal, StationError, describe_failure
    from station.lock_in.files import analyze_file
    from station.runs.database import is_database
    from station.runs.progress import Progress
    from station.shell.evaluated import evaluate_saved
    from station.sources.workers import Processes

    analyzed: Evaluated | AnalyzedFiles
    try:
        if is_database(path):
            analyzed = evaluate_saved(path, Processes(1), Progress(quiet=True), config=config, choices=choices)
        else:
            analyzed = analyze_file(path, config, choices)
    except (InstrumentError, StationError, OSError) as error:
        return None, describe_failure(error)
    if not analyzed.result.problem:
        return analyzed, None
    return analyzed, Failure(NoUsableSignal.kind, f"{path}: {analyzed.result.problem}", EXIT_NO_SIGNAL)


def _print(path: Path, analyzed: Evaluated | AnalyzedFiles) -> None:
    from station.report.console import print_result, print_values
    from station.shell.evaluated import Evaluated

    say(f"{path}")
    if isinstance(analyzed, Evaluated):
        print_result(analyzed)
    else:
        print_values(analyzed.result)
