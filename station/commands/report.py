"""``gyrolock report``: the HTML report of saved runs and of files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.shell.options import config_option, json_option, positive
from station.terminal.lines import print_failure, print_json, say

if TYPE_CHECKING:
    from station.report.report import Shown
    from station.sources.source import Source


@click.command("report")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option(
    "--output", "-o", type=click.Path(path_type=Path), metavar="FILE", help="[report.html beside the run]"
)
@click.option(
    "--scale-factor",
    type=float,
    callback=positive,
    metavar="K",
    help="Pulses per degree, for files.",
)
@config_option
@json_option
def command(
    paths: tuple[str, ...], output: Path | None, scale_factor: float | None, config: Path | None, as_json: bool
) -> int:
    """Write the HTML report of saved runs of any kind, and of files: one page each, with its plots inside.

    PATH is the directory of a run or its file, a file of an oscilloscope, whose report is named after it, a data
    set, or a folder of them. With --config what is known of the bench, and the limits, are those of FILE. One
    report of many files: `gyrolock analyze --combine --report`.
    """
    from instrument import InstrumentError
    from station.errors import StationError, describe_failure
    from station.report.report import write_report
    from station.sources.find import find_sources

    sources = list(find_sources(paths))
    if output is not None and len(sources) > 1:
        raise click.UsageError("--output names one file: give one run")
    documents: list[dict[str, Any]] = []
    exit_codes = []
    for source in sources:
        try:
            shown, place = _shown(source, config, scale_factor)
            written = write_report(shown, output or place)
        except (InstrumentError, StationError, OSError) as error:
            failure = describe_failure(error)
            if failure is None or len(sources) == 1:
                raise
            print_failure(failure)
            documents.append({"run": str(source), "error": failure.as_json()})
            exit_codes.append(failure.exit_code)
            continue
        documents.append({"run": str(shown.run.path), "report": str(written)})
        if not as_json:
            say(str(written))
    if as_json:
        print_json(documents[0] if len(documents) == 1 else {"results": documents})
    return min(exit_codes, default=0)


def _shown(source: Path | Source, config: Path | None, scale_factor: float | None) -> tuple[Shown, Path | None]:
    """What a source says, and where its report goes; None: beside the run."""
    from station.reanalysis.files import analyze_file
    from station.reanalysis.report import FilesReport
    from station.runs.progress import Progress
    from station.runs.store import run_file
    from station.shell.evaluated import evaluate_saved
    from station.sources.find import is_run
    from station.sources.workers import ThisProcess

    if isinstance(source, Path) and source.is_dir():
        run_file(source)
    if is_run(source):
        return evaluate_saved(source, ThisProcess(), Progress(quiet=True), config=config, choices={}), None
    found = analyze_file(source, config, {"scale_factor": scale_factor})
    return FilesReport(found), found.paths[0].with_suffix(".html")
