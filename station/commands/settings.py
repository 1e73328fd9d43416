"""``gyrolock settings``: a commented settings file to copy."""

from __future__ import annotations

from pathlib import Path

import click

from station.shell.options import config_option, json_option
from station.terminal.lines import print_json, say

# file of defaults: the measurement that reads it
_FILES = {"simulated": "measure", "bench": "measure", "dead_band": "deadband"}


@click.command("settings")
@click.argument("name", type=click.Choice(list(_FILES)), default="simulated")
@config_option
@json_option
def command(name: str, config: Path | None, as_json: bool) -> int:
    """Print a commented settings file to copy: `simulated` for the simulated bench, `bench` for a real one.

    `dead_band` is that of `gyrolock deadband`. With --json, or with --config FILE, the values that would be used
    are printed instead of the file.
    """
    from station.measurements import measurement
    from station.settings.load import load, shipped_settings
    from station.settings.toml_files import read_toml

    kind, shipped = measurement(_FILES[name]).kind, shipped_settings(name)
    if config is not None:
        print_json(load(kind, config).model_dump(mode="json"))
    elif as_json:
        print_json(kind.model.model_validate(read_toml(shipped)).model_dump(mode="json"))
    else:
        say(shipped.read_text(encoding="utf-8").rstrip())
    return 0
