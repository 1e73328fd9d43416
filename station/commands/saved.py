"""Commands on what was saved: ``report``, ``export``, ``compare``, ``annotate``, ``salvage``, ``verify``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.errors import EXIT_FAIL, EXIT_OK
from station.shell.options import (
    CHANNELS,
    RUN,
    RUN_PATH,
    config_option,
    json_option,
    positive,
    unused_config_option,
)
from station.terminal import print_failure, print_json, remark, say

if TYPE_CHECKING:
    from station.live.events import Progress
    from station.report.show import Shown
    from station.sources import ExcludedRecord, Source


@click.command("report")
@click.argument("paths", nargs=-1, required=True, type=RUN, metavar="PATH...")
@click.option(
    "--to",
    "--output",
    "-o",
    "output",
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
def report_command(
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
    from station.errors import CannotWrite, StationError, describe_failure, one_line
    from station.report.show import render_report, write_page

    documents: list[dict[str, Any]] = []
    exit_codes = []
    shown = [item for path in paths for item in _found(path)]
    if output is not None and len(shown) > 1:
        raise click.UsageError("--to names one file: give one run")
    if output is not None and output.suffix.lower() not in (".html", ".htm"):
        raise click.UsageError(f"{output}: a report is HTML: name it .html, and let the browser print a PDF of it")
    for name, sources in shown:
        try:
            evaluated, place = _evaluated(sources, name, config, {"scale_factor": scale_factor}, channel)
            page, to = render_report(evaluated), output or place
            try:
                written = write_page(to, page)
            except OSError as error:
                reason = f"the report cannot be written ({error.strerror or one_line(error)})"
                raise CannotWrite(f"{to}: {reason}: --to FILE writes it elsewhere") from None
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
            say(str(written), answer=True)
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
) -> tuple[Shown, Path]:
    """What a report shows, and where it goes."""
    from station.live.events import Progress
    from station.reanalysis.combine import combine, said_of, scale_factor_of_files
    from station.runs.store import REPORT_FILE
    from station.shell.finish import evaluate_saved
    from station.sources.find import is_run, open_source
    from station.sources.workers import ThisProcess

    first, workers, quiet = sources[0], ThisProcess(), Progress()
    if is_run(first):
        evaluated = evaluate_saved(first, workers, quiet, config=config, choices={})
        return evaluated, evaluated.run.path.parent / REPORT_FILE if isinstance(first, Path) else _beside(first)
    given = sources
    if len(sources) == 1:
        sources = [open_source(first)]  # what cannot be read is told before a scale factor is asked for
    if choices["scale_factor"] is None:
        choices = {"scale_factor": scale_factor_of_files(config, given)}
    found = combine(sources, choices, workers, quiet, config=config, channel=channel)
    for line in said_of(found.left_out):
        remark(line)
    folder = Path(name) if Path(name).is_dir() else Path(name).parent
    return found, folder / REPORT_FILE


def _beside(source: Source) -> Path:
    """Where the report of a run goes that lies in a data set: beside that, called as the run."""
    path = Path(source.name)
    short = path.parent.name if path.name in ("run.sqlite", "fog.sqlite") else path.stem
    return source.path.parent / f"{source.path.stem}.{short}.html"


# --------------------
# ``gyrolock export``: records of runs and files as a data set that other programs read


SCHEMA = {"name": "gyrolock export", "version": 1}


@click.command("export")
@click.argument("paths", nargs=-1, required=True, type=RUN, metavar="PATH...")
@click.option(
    "--to",
    metavar="FILE",
    help="Write this data set: .parquet, .h5, .npz or .csv by its ending; a name that ends with / is a folder of "
    "Parquet parts of about 100 MB, for a cluster. A URL such as s3://bucket/records.parquet is an object store.",
)
@click.option(
    "--tek-csv",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Write a CSV file for each record of an oscilloscope into this folder, as the scope writes them.",
)
@click.option(
    "--part-records", type=click.IntRange(min=1), metavar="N", help="Records in a part, about.  [default: 40000]"
)
@click.option("--replace", is_flag=True, help="Overwrite existing files.")
@unused_config_option
@json_option
def export_command(
    paths: tuple[str, ...],
    to: str | None,
    tek_csv: Path | None,
    part_records: int | None,
    replace: bool,
    as_json: bool,
) -> int:
    """Write records to a data set: Parquet, HDF5, NumPy or CSV.

    PATH is a run of any kind, a file of an oscilloscope, a data set, or a folder of them. One row is one record:
    codes as they were sent, and what is known of them; `gyrolock.read` and `gyrolock analyze` read it back and
    give the same result. Exit code 2 if something could not be read: the
    rest is written.
    """
    from station.datasets.data_set import RECORDS_OF_PART, check_target, export, write_tek_files
    from station.errors import EXIT_OK, EXIT_USAGE
    from station.shell.options import shown
    from station.sources.batches import NO_RECORD

    if (to is None) == (tek_csv is None):
        raise click.UsageError("give --to FILE or --tek-csv DIR")
    if part_records is not None and not (to or "").endswith("/"):
        raise click.UsageError("--part-records belongs to a folder of parts: a name that ends with /")
    left_out: list[ExcludedRecord] = []
    if to is not None:
        check_target(to, replace=replace)
    with shown({"plain": True, "quiet": as_json}, "export") as progress:
        sources = _opened(paths, left_out, progress)
        if to is not None:
            done = export(sources, to, records_of_part=part_records or RECORDS_OF_PART, left_out=left_out)
        else:
            done = write_tek_files(sources, Path(str(tek_csv)), replace=replace, left_out=left_out)
    _tell_left_out(left_out)
    if as_json:
        print_json(
            {
                "schema": SCHEMA,
                "files": done.files if len(done.files) <= 1000 else [done.files[0], done.files[-1]],
                "records": done.records,
                "sources": done.sources,
                "left_out": [str(one) for one in left_out],
            }
        )
    else:
        where = (
            done.files[0] if len(done.files) == 1 else f"{len(done.files)} files, {done.files[0]} and following"
        )
        say(f"saved   {done.records} records of {done.sources} sources in {where}", answer=True)
    return EXIT_USAGE if any(one.reason != NO_RECORD for one in left_out) else EXIT_OK


def _tell_left_out(left_out: list[ExcludedRecord]) -> None:
    """Name what could not be read, and count what holds nothing."""
    from station.sources.batches import NO_RECORD

    empty = [one for one in left_out if one.reason == NO_RECORD]
    for one in left_out:
        if one.reason != NO_RECORD:
            remark(f"left out: {one}")
    if empty:
        more = f", as {len(empty) - 1} more" if len(empty) > 1 else ""
        remark(f"left out: {empty[0]}{more}")


def _opened(paths: tuple[str, ...], left_out: list[ExcludedRecord], progress: Progress) -> Iterator[Source]:
    """Open one source after the other; one that cannot be read must not keep the others from being written."""
    from instrument import InstrumentError
    from station.errors import StationError, one_line
    from station.sources import ExcludedRecord, find_sources, open_source

    given = list(find_sources(paths))
    progress.start("exporting", len(given))
    for one in given:
        try:
            yield open_source(one)
        except (StationError, InstrumentError, OSError) as error:
            left_out.append(ExcludedRecord(str(one), None, one_line(error).removeprefix(f"{one}: ")))
        progress.advance()


# --------------------
# ``gyrolock compare``: two analyses, or two gyros


@click.command("compare")
@click.argument("first", type=RUN, metavar="A")
@click.argument("second", type=RUN, metavar="B")
@click.option("--a", "part_a", default="", metavar="TEXT", help="Which analysis of a table with several.")
@click.option("--b", "part_b", default="", metavar="TEXT", help="The same for B.")
@click.option("--relation-a", type=click.Choice(["exact", "paper-13", "paper-10"]), help="For records of A.")
@click.option("--relation-b", type=click.Choice(["exact", "paper-13", "paper-10"]), help="For records of B.")
@click.option(
    "--scale-factor", type=float, callback=positive, metavar="K", help="Pulses per degree; a run knows its own."
)
@click.option(
    "--plot", type=click.Path(path_type=Path), metavar="FILE", help="Draw the differences: .svg, .png or .pdf."
)
@click.option(
    "--processes", type=click.IntRange(1, 256), default=1, show_default=True, help="Processes that share the work."
)
@config_option
@json_option
def compare_command(first: str, second: str, config: Path | None, as_json: bool, **given: Any) -> int:
    """Compare two analyses of the same records, or records of two gyros.

    A and B are results tables of `gyrolock analyze --to`, or runs, files and folders, which are then analysed.
    Where records are in both, they are compared one by one, in the uncertainties of their noise, which is all that
    two methods can differ by. Otherwise the results of runs and of files at one rate are, with all uncertainties.
    Results tables know the noise of records only, and are compared by their means. With --config the channel is
    the one that FILE states, and the scale factor of files is that of FILE.
    """
    from station.live.console import stdout_console
    from station.reanalysis.compare import compare, read_records, with_headlines
    from station.report.show import text_table
    from station.sources.workers import Processes

    factor = given["scale_factor"]
    with Processes(given["processes"]) as workers:
        a, b = (
            read_records(place, {"scale_factor": factor, "relation": given[relation]}, workers, of, config)
            for place, relation, of in (
                (first, "relation_a", given["part_a"]),
                (second, "relation_b", given["part_b"]),
            )
        )
        a, b = with_headlines(a, b, workers, config)
    _tell_left_out([*a.left_out, *b.left_out])
    found = compare(a, b)
    if given["plot"] is not None:
        from station.reanalysis.compare import write_comparison_plot

        write_comparison_plot(given["plot"], found)
    if as_json:
        print_json(found.document())
        return 0
    for name, side in (("A", a), ("B", b)):
        say(f"{name}   {side.name}: {len(side.keys)} records; {'; '.join(side.analyses)}")
    stdout_console().print(text_table(found.table(), left=1))
    *before, last = found.sentences()
    for sentence in before:
        say(sentence)
    say(last, answer=True)
    return 0


# --------------------
# ``gyrolock annotate``: say something of a run afterwards


@click.command("annotate")
@click.argument("paths", nargs=-1, required=True, type=RUN_PATH, metavar="RUN...")
@click.option("--note", default="", metavar="TEXT", help="What should be remembered.")
@click.option("--tag", "tags", multiple=True, metavar="TAG", help="Add this word; may be given several times.")
@click.option("--untag", "untagged", multiple=True, metavar="TAG", help="Take this word away.")
@click.option("--good", "mark", flag_value="good", help="Mark the run as good.")
@click.option("--bad", "mark", flag_value="bad", help="Mark the run as bad.")
@click.option("--unmark", "mark", flag_value="none", help="Take the mark away.")
@click.option("--by", default="", metavar="NAME", help="Author of the remark.  [the user's name]")
@unused_config_option
@json_option
def annotate_command(
    paths: tuple[Path, ...],
    note: str,
    tags: tuple[str, ...],
    untagged: tuple[str, ...],
    mark: str | None,
    by: str,
    as_json: bool,
) -> int:
    """Add notes, tags or a good or bad mark to saved runs; without any, show what was said.

    RUN is the directory of a run or its file. What is said is added to a text file beside the run, with name and
    time; the measurement itself stays as it is. `gyrolock runs` shows it and chooses by it.
    """
    from station.runs.annotations import SCHEMA, add_remark, read_remarks
    from station.runs.database import reading
    from station.runs.store import run_file

    files = [run_file(path) for path in paths]
    for file in files:
        with reading(file, fold=False):  # is it a run at all?
            pass
    if note or tags or untagged or mark:
        chosen = "" if mark is None else {"none": None}.get(mark, mark)
        for file in files:
            add_remark(file, note=note, tags=tags, untagged=untagged, mark=chosen, by=by)
    shown = []
    for file in files:
        remarks = read_remarks(file)
        if remarks.unreadable:
            remark(f"{file}: {remarks.unreadable} lines of its remarks cannot be read")
        said = [one.as_json() for one in remarks.said]
        shown.append({"run": str(file), "mark": remarks.mark, "tags": list(remarks.tags), "remarks": said})
        if not as_json:
            say(" ".join([str(file), *filter(None, [remarks.mark]), *remarks.tags]), answer=True)
            for one in remarks.notes:
                say(f"  {one.at[:16].replace('T', ' ')}  {one.by}: {one.note}")
    if as_json:
        schema = {**SCHEMA, "name": f"{SCHEMA['name']}s"}
        print_json({"schema": schema, **shown[0]} if len(shown) == 1 else {"schema": schema, "results": shown})
    return 0


# --------------------
# ``gyrolock salvage``: what can still be read of a damaged run, as a new run


@click.command("salvage")
@click.argument("path", type=RUN_PATH, metavar="RUN")
@click.option(
    "--runs",
    "--out",
    "out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Directory of runs [that of RUN].",
)
@unused_config_option
@json_option
def salvage_command(path: Path, out: Path | None, as_json: bool) -> int:
    """Copy what can still be read of a damaged run into a new one.

    RUN stays as it is. A record is taken over if it is byte for byte what was once saved; those that are lost are
    named. `gyrolock analyze` reads the new run, --resume goes on with it.
    """
    from station.runs.salvage import salvage

    found = salvage(path, out)
    if as_json:
        schema = {"name": "gyrolock salvage", "version": 1}
        print_json(
            {"schema": schema, "from": path, "run": found.path, "records": found.records, "lost": found.lost}
        )
        return 0
    for name in found.lost:
        remark(f"lost: {name}")
    say(f"saved   {found.records} records in {found.path}", answer=True)
    return 0


# --------------------
# ``gyrolock verify``: whether the record of a test holds


_SCHEMA = {"name": "gyrolock verify", "version": 1}


@click.command("verify")
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="RECORD...")
@unused_config_option
@json_option
def verify_command(paths: tuple[Path, ...], as_json: bool) -> int:
    """Check that the record of a test matches its raw runs, and compute the result again.

    RECORD is a record.json, or the folder that it lies in. Looked at are the record itself, the raw records of
    every run by their SHA-256, the numbers that they give now, and the verdicts. Exit codes: 0 everything holds, 1
    something does not, 2 there is no record.
    """
    from station.campaign.record import verify

    told: list[dict[str, Any]] = []
    for path in paths:
        checks = verify(path)
        holds = all(one.holds for one in checks)
        told.append({"record": str(path), "holds": holds, "checks": [vars(one) for one in checks]})
        if not as_json:
            say(f"{path}: {'holds' if holds else 'DOES NOT HOLD'}", answer=True)
            for one in checks:
                say(f"  {'ok  ' if one.holds else 'NOT '} {one.about}: {one.sentence}")
    if as_json:
        print_json({"schema": _SCHEMA, "holds": all(one["holds"] for one in told), "records": told})
    return EXIT_OK if all(one["holds"] for one in told) else EXIT_FAIL
