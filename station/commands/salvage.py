"""``gyrolock salvage``: what can still be read of a damaged run, as a new run."""

from __future__ import annotations

from pathlib import Path

import click

from station.shell.options import config_option, json_option
from station.terminal.lines import print_json, remark, say


@click.command("salvage")
@click.argument("path", type=click.Path(path_type=Path), metavar="RUN")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Directory of runs [that of RUN].")
@config_option
@json_option
def command(path: Path, out: Path | None, config: Path | None, as_json: bool) -> int:
    """Get everything that can still be read out of a damaged run, into a new one.

    RUN stays as it is. A record is taken over if it is byte for byte what was once saved; those that are lost are
    named. `gyrolock analyze` reads the new run, --resume goes on with it. A settings file changes nothing here.
    """
    from station.runs.salvage import salvage
    from station.settings.toml_files import read_toml

    if config is not None:
        read_toml(config)  # a file with a mistake is one here too
    found = salvage(path, out)
    if as_json:
        schema = {"name": "gyrolock salvage", "version": 1}
        print_json(
            {"schema": schema, "from": path, "run": found.path, "records": found.records, "lost": found.lost}
        )
        return 0
    for name in found.lost:
        remark(f"lost: {name}")
    say(f"saved   {found.records} records in {found.path}")
    return 0
