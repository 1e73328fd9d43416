"""``gyrolock annotate``: say something of a run afterwards."""

from __future__ import annotations

from pathlib import Path

import click

from station.shell.options import config_option, json_option
from station.terminal.lines import print_json, remark, say


@click.command("annotate")
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="RUN...")
@click.option("--note", default="", metavar="TEXT", help="What should be remembered.")
@click.option("--tag", "tags", multiple=True, metavar="TAG", help="Add this word; may be given several times.")
@click.option("--untag", "untagged", multiple=True, metavar="TAG", help="Take this word away.")
@click.option("--good", "mark", flag_value="good", help="Mark the run as good.")
@click.option("--bad", "mark", flag_value="bad", help="Mark the run as bad.")
@click.option("--unmark", "mark", flag_value="none", help="Take the mark away.")
@click.option("--by", default="", metavar="NAME", help="Who says it.  [the user's name]")
@config_option
@json_option
def command(
    paths: tuple[Path, ...],
    note: str,
    tags: tuple[str, ...],
    untagged: tuple[str, ...],
    mark: str | None,
    by: str,
    config: Path | None,
    as_json: bool,
) -> int:
    """Say something of saved runs afterwards: a note, tags, a good or bad mark; without any, show what was said.

    RUN is the directory of a run or its file. What is said is added to a text file beside the run, with name and
    time; the measurement itself stays as it is. `gyrolock runs` shows it and chooses by it.
    """
    from station.runs.database import reading
    from station.runs.remarks import SCHEMA, add_remark, read_remarks
    from station.runs.store import run_file
    from station.settings.toml_files import read_toml

    if config is not None:
        read_toml(config)  # a file with a mistake is one here too
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
            say(" ".join([str(file), *filter(None, [remarks.mark]), *remarks.tags]))
            for one in remarks.notes:
                say(f"  {one.at[:16].replace('T', ' ')}  {one.by}: {one.note}")
    if as_json:
        schema = {**SCHEMA, "name": f"{SCHEMA['name']}s"}
        print_json({"schema": schema, **shown[0]} if len(shown) == 1 else {"schema": schema, "results": shown})
    return 0
