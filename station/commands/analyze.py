"""``gyrolock analyze``: evaluate saved runs of any kind, and files of an oscilloscope."""

from __future__ import annotations

import re
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.shell.options import (
    CHANNELS,
    RUN,
    config_option,
    display_options,
    json_option,
    not_zero,
    positive,
    shown,
)
from station.terminal import (
    PRINTS_ALL,
    PRINTS_ONE_LINE,
    JsonResults,
    print_failure,
    print_json,
    prints,
    remark,
    say,
    visible,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from contextlib import AbstractContextManager

    from station.errors import Failure
    from station.live.events import Progress
    from station.reanalysis.combine import AnalyzedFiles
    from station.shell.finish import Evaluated
    from station.sources.batches import Source
    from station.sources.workers import Workers

_METHOD = ("scale_factor", "input_rate", "relation")


def _numbers(context: click.Context, option: click.Parameter, value: str | None) -> tuple[range, ...]:
    """The records that are meant: ``23-30,41``."""
    found = []
    for part in [] if value is None else value.split(","):
        if (meant := re.fullmatch(r"\s*(\d+)(?:-(\d+))?\s*", part)) is None:
            raise click.BadParameter(f"{value!r} is no list of records such as 23-30,41")
        found.append(range(int(meant[1]), int(meant[2] or meant[1]) + 1))
    return tuple(found)


@click.command("analyze")
@click.argument("paths", nargs=-1, required=True, type=RUN, metavar="PATH...")
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
@click.option(
    "--exclude", callback=_numbers, metavar="N-M,...", help="Leave these records of a run out, by their numbers."
)
@click.option("--jsonl", is_flag=True, help="One JSON object a record, one a line, on stdout.")
@display_options
@config_option
@json_option
def command(paths: tuple[str, ...], config: Path | None, **given: Any) -> int:
    """Evaluate saved runs again, and files of Tektronix oscilloscopes.

    PATH is a run (its directory or its file), a CSV or ISF file that the scope or its PC software wrote, a data
    set of `gyrolock export`, or a folder: a memory card, or a tree of all of these. Each gives its result; with
    --combine all records give one, with --to each record gives a row of a table. With --json and several sources
    the document holds a list `results`. What cannot be read is named and left out: exit code 2 where that is a
    whole source, 4 if any gives no result, 1 if one is beyond a limit.

    A run is evaluated with the settings that it was taken with. With --config, what FILE states of the bench, and
    its [limits], replace what the run holds of them, for a channel that was measured later; the rest stays. Of the
    bench that files come from nothing is known but what FILE states.
    """
    if given["jsonl"] and given["as_json"]:
        raise click.UsageError("--json and --jsonl exclude each other")
    if given["table"] is not None and (given["combine"] or given["jsonl"]):
        raise click.UsageError("--to writes one row a record: without --combine and --jsonl")
    if not given["combine"] and (only := [one for one in ("rates_from", "channel", "report") if given[one]]):
        raise click.UsageError(f"--{only[0].replace('_', '-')} needs --combine")
    if given["cluster"] and given["processes"] > 1:
        raise click.UsageError("--cluster and --processes exclude each other")
    from station.sources.find import find_sources, is_run

    with shown(given, command="analyze") as progress, _workers(given) as workers:
        sources = list(find_sources(paths))
        if given["exclude"] and (given["combine"] or given["table"] or len(sources) > 1 or not is_run(sources[0])):
            raise click.UsageError("--exclude is for one run: name it alone, without --combine and --to")
        analysis = Analysis(
            sources, {name: given[name] for name in _METHOD}, config, workers, progress, given["exclude"]
        )
        answer = AnalyzeAnswer(given["as_json"], given["jsonl"])
        if given["table"] is not None:
            return analysis.to_table(given["table"], answer)
        if given["combine"]:
            return analysis.combined(given["channel"], given["rates_from"], given["report"], answer)
        return analysis.each(answer)


def _workers(given: Mapping[str, Any]) -> AbstractContextManager[Workers]:
    if given["cluster"]:
        from station.sources.workers import Cluster

        return Cluster(given["cluster"])
    from station.sources.workers import Processes

    return Processes(given["processes"])


@dataclass(frozen=True)
class AnalyzeAnswer:
    """How a result is told: in words, as one JSON document, or as one JSON object a record."""

    as_json: bool
    jsonl: bool

    @property
    def in_words(self) -> bool:
        """Whether a person reads it."""
        return not (self.as_json or self.jsonl)


@dataclass(frozen=True)
class Analysis:
    """Sources, how they are evaluated, and by whom; each method returns the exit code."""

    sources: Sequence[Path | Source]  # of :func:`station.sources.find_sources`
    choices: dict[str, Any]  # of :class:`analysis.lock_in_run.Method`; ``None`` where nothing was asked for
    config: Path | None  # settings file: what is known of the bench now
    workers: Workers
    progress: Progress
    exclude: tuple[range, ...] = ()  # numbers of records

    def to_table(self, table: Path, answer: AnalyzeAnswer) -> int:
        """Put one row for each record into a table."""
        from station.errors import EXIT_OK, EXIT_USAGE
        from station.reanalysis.analyze_table import fill_table
        from station.reanalysis.combine import front_end_of_files

        done = fill_table(
            self.sources,
            table,
            self._with_scale_factor() | {"front_end": front_end_of_files(self.config)},
            self.workers,
            self.progress,
            lambda one: remark(f"left out: {one}"),
        )
        if answer.as_json:
            print_json(done.document())
        else:
            say(f"{done.records} records of {done.sources} sources in {done.table}", answer=True)
            if done.known:
                say(f"{done.known} sources were there already")
            if done.left_out:
                say(f"{len(done.left_out)} left out, named above")
        return EXIT_USAGE if done.left_out else EXIT_OK

    def combined(self, channel: str | None, rates: Path | None, report: Path | None, answer: AnalyzeAnswer) -> int:
        """Make one result of all records."""
        from station.errors import EXIT_OUTPUT, EXIT_USAGE, CannotWrite, Failure
        from station.reanalysis.combine import combine, said_of
        from station.report.show import write_report
        from station.results.verdict import exit_code_of

        found = combine(
            self.sources,
            self._with_scale_factor(),
            self.workers,
            self.progress,
            config=self.config,
            channel=channel,
            rates=rates,
        )
        for line in said_of(found.left_out):
            remark(line)
        document, failure = found.document(), _no_result(found.result.problem)
        if report is not None:
            try:
                document["report"] = str(write_report(found, report))
            except OSError as error:  # the result is there all the same
                problem = f"{report}: the report cannot be written ({error.strerror or error})"
                failure = failure or Failure(CannotWrite.kind, problem, EXIT_OUTPUT)
        if failure is not None:
            document["error"] = failure.as_json()
        if answer.jsonl:
            for row in found.rows():
                print_json(row)
        elif answer.as_json:
            print_json(document)
        else:
            _print(found)
            if "report" in document:
                say(f"report  {document['report']}")
        if failure is not None:
            print_failure(failure)
            return failure.exit_code
        if found.left_out:
            return EXIT_USAGE
        return exit_code_of(found.verdict)

    def each(self, answer: AnalyzeAnswer) -> int:
        """Evaluate every source by itself; one that cannot be read must not keep the others from it."""
        from station.results.verdict import exit_code_of, worst

        exit_codes, verdicts = list[int](), list[Any]()
        listed = answer.in_words and len(self.sources) > 1 and not prints(PRINTS_ALL)
        tally = Counter[str]()
        if listed:
            say(f"{'source':32}  {'records':>9}  {'result (95 %)':36}  quality")
        with JsonResults(alone=len(self.sources) == 1) as results:
            for source in self.sources:
                analyzed, failure = self._analyzed(source)
                document: dict[str, Any] = {"file": str(source)} if analyzed is None else analyzed.document()
                verdicts += filter(None, [document.get("verdict")])
                if failure is not None:
                    exit_codes.append(failure.exit_code)
                    document["error"] = failure.as_json()
                if answer.as_json:
                    results.add(document)
                elif answer.jsonl:
                    for row in analyzed.rows() if analyzed is not None else [document]:
                        print_json(row)
                elif listed:
                    say(_line(source, analyzed))
                    word = "not read" if analyzed is None else analyzed.result.quality.partition(":")[0]
                    tally[word] += 1
                elif analyzed is not None:
                    say(f"{source}")
                    _print(analyzed)
                if failure is not None:
                    print_failure(failure)
            if answer.as_json:
                results.print()
        if listed:
            said = ", ".join(f"{count} {word}" for word, count in tally.items())
            more = (
                "" if prints(PRINTS_ONE_LINE) else ". Details: --full; one result: --combine; a table: --to FILE"
            )
            say(f"{len(self.sources)} sources: {said}{more}", answer=True)
        # what could not be read at all (2) comes before what holds no result (4)
        return min(exit_codes, default=exit_code_of(worst(verdicts)))

    def _analyzed(self, source: Path | Source) -> tuple[Evaluated | AnalyzedFiles | None, Failure | None]:
        from instrument import InstrumentError
        from station.errors import StationError, describe_failure
        from station.reanalysis.combine import analyze_file
        from station.shell.finish import evaluate_saved
        from station.sources.find import is_run

        analyzed: Evaluated | AnalyzedFiles
        try:
            if is_run(source):
                analyzed = evaluate_saved(
                    source,
                    self.workers,
                    self.progress,
                    config=self.config,
                    choices=self.choices,
                    exclude=self.exclude,
                )
            else:
                analyzed = analyze_file(source, self.config, self.choices)
        except (InstrumentError, StationError, OSError) as error:
            return None, describe_failure(error)
        problem = analyzed.result.problem
        return analyzed, _no_result(f"{source}: {problem}" if problem else "")

    def _with_scale_factor(self) -> dict[str, Any]:
        """The choices with the scale factor, where files need one that nobody has given."""
        from station.reanalysis.combine import scale_factor_of_files
        from station.sources.find import is_run

        files: list[Path | Source] = []
        for one in self.sources:
            with suppress(OSError):  # one that is not there is named when it is read
                files += [] if is_run(one) else [one]
        if self.choices["scale_factor"] is not None or not any(map(_is_waveform, files)):
            return self.choices
        return self.choices | {"scale_factor": scale_factor_of_files(self.config, files)}


def _is_waveform(file: Path | Source) -> bool:
    """Whether a file can be read as one of an oscilloscope: a table of results beside runs needs no K."""
    from instrument import InstrumentError
    from station.errors import StationError
    from station.sources.find import open_source

    try:
        return len(open_source(file)) > 0
    except (InstrumentError, StationError, OSError):
        return False


def _no_result(problem: str) -> Failure | None:
    """The failure of records that can be read and give no result."""
    from station.errors import EXIT_NO_SIGNAL, Failure, NoUsableSignal

    return Failure(NoUsableSignal.kind, problem, EXIT_NO_SIGNAL) if problem else None


_NAME, _VALUE, _WORDS = 32, 36, 32
"""Letters that a line of the list has for a source, its value, and what rules it: 120 in all."""


def _line(source: Path | Source, analyzed: Evaluated | AnalyzedFiles | None) -> str:
    """One source in one line: records, value, quality."""
    from station.results.quantity import headline_values

    name = str(source) if len(str(source)) <= _NAME else f"…{str(source)[1 - _NAME :]}"
    if analyzed is None:
        return visible(f"{name:{_NAME}}  {'':9}  {'-':{_VALUE}}  not read")
    result = analyzed.result
    total, out = (result.document.get(key) for key in ("records", "records_rejected"))
    used = "" if not isinstance(total, int) else f"{total - out}/{total}" if isinstance(out, int) else f"{total}"
    values = headline_values(result.document, result.quantities)
    value = ", ".join(one.text for one in values)[:_VALUE] if not result.problem else "-"
    verdict = f" {analyzed.verdict}" if analyzed.verdict else ""
    return visible(f"{name:{_NAME}}  {used:>9}  {value:{_VALUE}}  {result.quality[:_WORDS]}{verdict}")


def _print(analyzed: Evaluated | AnalyzedFiles) -> None:
    from station.report.show import print_result, print_values
    from station.shell.finish import Evaluated

    if isinstance(analyzed, Evaluated):
        print_result(analyzed)
        return
    print_values(analyzed.result, analyzed.tested)
    for line in analyzed.taken_with():
        say(line)
