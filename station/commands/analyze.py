"""``gyrolock analyze``: evaluate saved runs of any kind, and files of an oscilloscope."""

from __future__ import annotations

from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.display.opening import display_options, shown
from station.shell.options import CHANNELS, config_option, json_option, not_zero, positive
from station.terminal.lines import print_failure, print_json, remark, say

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from station.errors import Failure
    from station.reanalysis.files import AnalyzedFiles
    from station.runs.progress import Progress
    from station.shell.evaluated import Evaluated
    from station.sources.source import Source
    from station.sources.workers import Workers

_METHOD = ("scale_factor", "input_rate", "relation")


@click.command("analyze")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option(
    "--scale-factor",
    type=float,
    callback=positive,
    metavar="K",
    help="Pulses per degree. For files it must be given: here, in the settings, in a gyrolock.toml beside "
    "them, or when it is asked for.",
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
@click.option("--combine", is_flag=True, help="One result of all records, with its budget.")
@click.option(
    "--rates-from",
    type=click.Path(path_type=Path),
    metavar="FILE.csv",
    help="With --combine: the rate of each file, columns file, input_rate_dps and, if known, input_rate_u_dps.",
)
@click.option("--channel", type=CHANNELS, help="With --combine: only records of this input.")
@click.option(
    "--report", type=click.Path(path_type=Path), metavar="FILE.html", help="With --combine: write the report."
)
@click.option(
    "--to",
    "table",
    type=click.Path(path_type=Path),
    metavar="RESULTS",
    help="One row a record into a table, .parquet, .sqlite, .csv or .jsonl; only what it lacks is computed.",
)
@click.option(
    "--processes", type=click.IntRange(1, 256), default=1, show_default=True, help="Processes that share the work."
)
@click.option(
    "--cluster",
    metavar="ADDRESS",
    help="Workers of a Dask scheduler, tcp://host:8786, or `local`, share the work.",
)
@click.option("--jsonl", is_flag=True, help="One JSON object a record, one a line, on stdout.")
@display_options
@config_option
@json_option
def command(paths: tuple[str, ...], config: Path | None, **given: Any) -> int:
    """Evaluate saved runs of any kind again, and files of Tektronix oscilloscopes.

    PATH is a run (its directory or its file), a CSV or ISF file that the scope or its PC software wrote, a data
    set of `gyrolock export`, or a folder: a memory card, or a tree of all of these. Each gives its result; with
    --combine all records give one, with --to each record gives a row of a table. With --json and several sources
    the document holds a list `results`. What cannot be read is named and left out: exit code 2 where that is a
    whole source, 4 if any gives no result, 1 if one is beyond a limit.

    A run is evaluated with the settings that it was taken with. With --config, what FILE states of the bench, and
    its [limits], replace what the run holds of them, for a channel that was measured later; the rest stays.
    """
    _check(given)
    from station.sources.find import find_sources

    choices = {name: given[name] for name in _METHOD}
    with shown(given, command="analyze") as progress, _workers(given) as workers:
        sources = list(find_sources(paths))
        if given["table"] is not None:
            return _to_table(sources, choices, config, workers, progress, given)
        if given["combine"]:
            return _combined(sources, choices, config, workers, progress, given)
        return _each(sources, choices, config, workers, progress, given)


def _check(given: Mapping[str, Any]) -> None:
    if given["jsonl"] and given["as_json"]:
        raise click.UsageError("--json and --jsonl exclude each other")
    if given["table"] is not None and (given["combine"] or given["jsonl"]):
        raise click.UsageError("--to writes one row a record: without --combine and --jsonl")
    if not given["combine"] and (only := [one for one in ("rates_from", "channel", "report") if given[one]]):
        raise click.UsageError(f"--{only[0].replace('_', '-')} needs --combine")
    if given["cluster"] and given["processes"] > 1:
        raise click.UsageError("--cluster and --processes exclude each other")


def _workers(given: Mapping[str, Any]) -> AbstractContextManager[Workers]:
    if given["cluster"]:
        from station.cluster import Cluster

        return Cluster(given["cluster"])
    from station.sources.workers import Processes

    return Processes(given["processes"])


def _to_table(
    sources: Sequence[Path | Source],
    choices: dict[str, Any],
    config: Path | None,
    workers: Workers,
    progress: Progress,
    given: Mapping[str, Any],
) -> int:
    from station.errors import EXIT_USAGE
    from station.reanalysis.fill import fill_table

    chosen = _with_scale_factor(sources, choices, config)
    done = fill_table(sources, given["table"], chosen, workers, progress, lambda one: remark(f"left out: {one}"))
    if given["as_json"]:
        print_json(done.document())
    else:
        say(f"{done.records} records of {done.sources} sources in {done.table}")
        if done.known:
            say(f"{done.known} sources were there already")
        if done.left_out:
            say(f"{len(done.left_out)} left out, named above")
    return EXIT_USAGE if done.left_out else 0


def _combined(
    sources: Sequence[Path | Source],
    choices: dict[str, Any],
    config: Path | None,
    workers: Workers,
    progress: Progress,
    given: Mapping[str, Any],
) -> int:
    from station.errors import EXIT_NO_SIGNAL, EXIT_USAGE, Failure, NoUsableSignal
    from station.reanalysis.combine import combine, said_of
    from station.reanalysis.report import FilesReport
    from station.report.console import print_values
    from station.report.report import write_report

    chosen = _with_scale_factor(sources, choices, config)
    found = combine(
        sources, chosen, workers, progress, config=config, channel=given["channel"], rates=given["rates_from"]
    )
    for line in said_of(found.left_out):
        remark(line)
    document, failure = found.document(), None
    if found.result.problem:
        failure = Failure(NoUsableSignal.kind, found.result.problem, EXIT_NO_SIGNAL)
        document["error"] = failure.as_json()
    if given["report"] is not None:
        document["report"] = str(write_report(FilesReport(found), given["report"]))
    if given["jsonl"]:
        for row in found.rows():
            print_json(row)
    elif given["as_json"]:
        print_json(document)
    else:
        print_values(found.result)
        for line in found.taken_with():
            say(line)
        if given["report"] is not None:
            say(f"report  {document['report']}")
    if failure is not None:
        print_failure(failure)
        return failure.exit_code
    return EXIT_USAGE if found.left_out else 0


def _with_scale_factor(
    sources: Sequence[Path | Source], choices: dict[str, Any], config: Path | None
) -> dict[str, Any]:
    """The choices with the scale factor, where files need one that nobody has given."""
    from station.reanalysis.files import scale_factor_of_files
    from station.sources.find import is_run

    files = []
    for one in sources:
        with suppress(OSError):  # one that is not there is named when it is read
            files += [] if is_run(one) else [one]
    if choices["scale_factor"] is not None or not files:
        return choices
    return choices | {"scale_factor": scale_factor_of_files(config, files)}


def _each(
    sources: Sequence[Path | Source],
    choices: dict[str, Any],
    config: Path | None,
    workers: Workers,
    progress: Progress,
    given: Mapping[str, Any],
) -> int:
    from station.errors import EXIT_FAIL

    jsonl, as_json = given["jsonl"], given["as_json"]
    documents, failures, failed = [], [], False
    for source in sources:
        analyzed, failure = _analyze(source, config, choices, workers, progress)
        document: dict[str, Any] = analyzed.document() if analyzed is not None else {"file": str(source)}
        failed = failed or document.get("verdict") == "FAIL"
        if failure is not None:
            failures.append(failure)
            document["error"] = failure.as_json()
        if as_json:
            documents.append(document)
        if jsonl:
            for line in analyzed.rows() if analyzed is not None else [document]:
                print_json(line)
        elif analyzed is not None and not as_json:
            _print(source, analyzed)
        if failure is not None:
            print_failure(failure)
    if as_json:
        print_json(documents[0] if len(documents) == 1 else {"results": documents})
    # what could not be read at all (2) comes before what holds no result (4)
    return min((failure.exit_code for failure in failures), default=EXIT_FAIL if failed else 0)


def _analyze(
    source: Path | Source, config: Path | None, choices: Mapping[str, Any], workers: Workers, progress: Progress
) -> tuple[Evaluated | AnalyzedFiles | None, Failure | None]:
    """Evaluate one source; one that cannot be read must not keep the others from being evaluated."""
    from instrument import InstrumentError
    from station.errors import EXIT_NO_SIGNAL, Failure, NoUsableSignal, StationError, describe_failure
    from station.reanalysis.files import analyze_file
    from station.shell.evaluated import evaluate_saved
    from station.sources.find import is_run

    analyzed: Evaluated | AnalyzedFiles
    try:
        if is_run(source):
            analyzed = evaluate_saved(source, workers, progress, config=config, choices=choices)
        else:
            analyzed = analyze_file(source, config, choices)
    except (InstrumentError, StationError, OSError) as error:
        return None, describe_failure(error)
    if not analyzed.result.problem:
        return analyzed, None
    return analyzed, Failure(NoUsableSignal.kind, f"{source}: {analyzed.result.problem}", EXIT_NO_SIGNAL)


def _print(source: Path | Source, analyzed: Evaluated | AnalyzedFiles) -> None:
    from station.report.console import print_result, print_values
    from station.shell.evaluated import Evaluated

    say(f"{source}")
    if isinstance(analyzed, Evaluated):
        print_result(analyzed)
    else:
        print_values(analyzed.result)
        for line in analyzed.taken_with():
            say(line)
