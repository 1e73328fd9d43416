"""``gyrolock report``: the HTML report of saved runs, of data sets and of files of an oscilloscope."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.shell.options import CHANNELS, config_option, json_option, positive
from station.terminal.lines import print_failure, print_json, remark, say

if TYPE_CHECKING:
    from collections.abc import Iterator

    from station.report.report import Shown
    from station.sources import Source


@click.command("report")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="[report.html beside the run, or in the folder of the files]",
)
@click.option(
    "--scale-factor",
    type=float,
    callback=positive,
    metavar="K",
    help="Of files: pulses per degree, where no settings say it.",
)
@click.option("--channel", type=CHANNELS, help="Of files: only those of this input.")
@config_option
@json_option
def command(
    paths: tuple[str, ...],
    output: Path | None,
    scale_factor: float | None,
    channel: str | None,
    config: Path | None,
    as_json: bool,
) -> int:
    """Write the HTML report of saved runs of any kind: one file each, with its plots inside.

    PATH is the directory of a run or its file, a data set of `gyrolock export`, a file of an oscilloscope, or a
    folder: the files in it, such as those of a memory card, give one report. With --config what is known of the
    bench, and the limits, are those of FILE.
    """
    from instrument import InstrumentError
    from station.errors import StationError, describe_failure
    from station.report.report import write_report

    documents: list[dict[str, Any]] = []
    exit_codes = []
    shown = [item for path in paths for item in _found(path)]
    if output is not None and len(shown) > 1:
        raise click.UsageError("--output names one file: give one run")
    for name, sources in shown:
        try:
            evaluated, place = _evaluated(sources, name, config, {"scale_factor": scale_factor}, channel)
            written = write_report(evaluated, output or place)
        except (InstrumentError, StationError, OSError) as error:
            failure = describe_failure(error)
            if failure is None or len(shown) == 1:
                raise
            print_failure(failure)
            documents.append({"run": name, "error": failure.as_json()})
            exit_codes.append(failure.exit_code)
            continue
        documents.append({"run": str(evaluated.run.path), "report": str(written)})
        if not as_json:
            say(str(written))
    if as_json:
        print_json(documents[0] if len(documents) == 1 else {"results": documents})
    return min(exit_codes, default=0)


def _found(path: str) -> Iterator[tuple[str, list[Path | Source]]]:
    """What gives a report each: every run by itself, the files of one path together."""
    from station.sources.find import find_sources, is_run

    files: list[Path | Source] = []
    for one in find_sources([path]):
        if is_run(one):
            yield str(one), [one]
        else:
            files.append(one)
    if files:
        yield path, files


def _evaluated(
    sources: list[Path | Source], name: str, config: Path | None, choices: dict[str, Any], channel: str | None
) -> tuple[Shown, Path | None]:
    """What a report shows, and where it goes; ``None``: beside the run."""
    from station.reanalysis.combine import combine, said_of
    from station.reanalysis.files import scale_factor_of_files
    from station.reanalysis.report import FilesReport
    from station.runs.progress import Progress
    from station.runs.store import REPORT_FILE
    from station.shell.evaluated import evaluate_saved
    from station.sources.find import is_run, open_source
    from station.sources.workers import ThisProcess

    first, workers, quiet = sources[0], ThisProcess(), Progress(quiet=True)
    if is_run(first):
        evaluated = evaluate_saved(first, workers, quiet, config=config, choices={})
        return evaluated, None if isinstance(first, Path) else _beside(first)
    given = sources
    if len(sources) == 1:
        sources = [open_source(first)]  # what cannot be read is told before a scale factor is asked for
    if choices["scale_factor"] is None:
        choices = {"scale_factor": scale_factor_of_files(config, given)}
    found = combine(sources, choices, workers, quiet, config=config, channel=channel)
    for line in said_of(found.left_out):
        remark(line)
    folder = Path(name) if Path(name).is_dir() else Path(name).parent
    return FilesReport(found), folder / REPORT_FILE


def _beside(source: Source) -> Path:
    """Where the report of a run goes that lies in a data set: beside that, called as the run."""
    path = Path(source.name)
    short = path.parent.name if path.name in ("run.sqlite", "fog.sqlite") else path.stem
    return source.path.parent / f"{source.path.stem}.{short}.html"
