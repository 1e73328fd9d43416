"""``gyrolock export``: records of runs and files as a data set that other programs read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from station.shell.options import config_option, json_option
from station.terminal.lines import print_json, remark, say

if TYPE_CHECKING:
    from station.runs.progress import Progress
    from station.sources import LeftOut, Source

SCHEMA = {"name": "gyrolock export", "version": 1}


@click.command("export")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
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
@click.option("--replace", is_flag=True, help="Write over what is there.")
@config_option
@json_option
def command(
    paths: tuple[str, ...],
    to: str | None,
    tek_csv: Path | None,
    part_records: int | None,
    replace: bool,
    config: Path | None,
    as_json: bool,
) -> int:
    """Write the records of runs and files to a data set: Parquet, HDF5, NumPy or CSV.

    PATH is a run of any kind, a file of an oscilloscope, a data set, or a folder of them. One row is one record:
    codes as they were sent, and what is known of them; `gyrolock.read` and `gyrolock analyze` read it back and
    give the same result. A settings file changes nothing here. Exit code 2 if something could not be read: the
    rest is written.
    """
    from station.datasets.tek_csv import write_tek_files
    from station.datasets.writing import RECORDS_OF_PART, check_target, export
    from station.display.opening import shown
    from station.errors import EXIT_OK, EXIT_USAGE
    from station.settings.toml_files import read_toml

    if (to is None) == (tek_csv is None):
        raise click.UsageError("give --to FILE or --tek-csv DIR")
    if part_records is not None and not (to or "").endswith("/"):
        raise click.UsageError("--part-records belongs to a folder of parts: a name that ends with /")
    if config is not None:
        read_toml(config)  # a file with a mistake is one here too
    left_out: list[LeftOut] = []
    if to is not None:
        check_target(to, replace=replace)
    with shown({"plain": True, "quiet": as_json}, "export") as progress:
        sources = _opened(paths, left_out, progress)
        if to is not None:
            done = export(sources, to, records_of_part=part_records or RECORDS_OF_PART, left_out=left_out)
        else:
            done = write_tek_files(sources, Path(str(tek_csv)), replace=replace, left_out=left_out)
    for one in left_out:
        remark(f"left out: {one}")
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
        say(f"saved   {done.records} records of {done.sources} sources in {where}")
    return EXIT_USAGE if left_out else EXIT_OK


def _opened(paths: tuple[str, ...], left_out: list[LeftOut], progress: Progress) -> Iterator[Source]:
    """Open one source after the other; one that cannot be read must not keep the others from being written."""
    from instrument import InstrumentError
    from station.errors import StationError, one_line
    from station.sources import LeftOut, find_sources, open_source

    given = list(find_sources(paths))
    progress.start("exporting", len(given))
    for one in given:
        try:
            yield open_source(one)
        except (StationError, InstrumentError, OSError) as error:
            left_out.append(LeftOut(str(one), None, one_line(error).removeprefix(f"{one}: ")))
        progress.advance()
