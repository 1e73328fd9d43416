"""``gyrolock verify``: whether the record of a test holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from station.errors import EXIT_FAIL, EXIT_OK
from station.shell.options import config_option, json_option
from station.terminal.lines import print_json, say

_SCHEMA = {"name": "gyrolock verify", "version": 1}


@click.command("verify")
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="RECORD...")
@config_option
@json_option
def command(paths: tuple[Path, ...], config: Path | None, as_json: bool) -> int:
    """Prove that the record of a test and its raw runs belong together, and compute the result again.

    RECORD is a record.json, or the folder that it lies in. Looked at are the record itself, the raw records of
    every run by their SHA-256, the numbers that they give now, and the verdicts. Exit codes: 0 everything holds, 1
    something does not, 2 there is no record.
    """
    from station.record.verify import verify
    from station.settings.toml_files import read_toml

    if config is not None:
        read_toml(config)  # a file with a mistake is one here too
    told: list[dict[str, Any]] = []
    for path in paths:
        checks = verify(path)
        holds = all(one.holds for one in checks)
        told.append({"record": str(path), "holds": holds, "checks": [vars(one) for one in checks]})
        if not as_json:
            say(f"{path}: {'holds' if holds else 'DOES NOT HOLD'}")
            for one in checks:
                say(f"  {'ok  ' if one.holds else 'NOT '} {one.about}: {one.sentence}")
    if as_json:
        print_json({"schema": _SCHEMA, "holds": all(one["holds"] for one in told), "records": told})
    return EXIT_OK if all(one["holds"] for one in told) else EXIT_FAIL
