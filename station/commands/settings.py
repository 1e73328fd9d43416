"""``gyrolock settings``: a commented settings file to copy."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from station.shell.ending import print_json
from station.shell.options import config_option, json_option


@click.command("settings")
@click.argument("name", type=click.Choice(["simulated", "bench"]), default="simulated")
@config_option
@json_option
def command(name: Literal["simulated", "bench"], config: Path | None, as_json: bool) -> int:
    """Print a commented settings file to copy: `simulated` for the simulated bench, `bench` for a real one.

    With --json, or with --config FILE, the values that would be used are printed instead of the file.
    """
    from station.lock_in.settings import default_settings, load_settings
    from station.settings.load import shipped_settings

    if config is not None or as_json:
        settings = load_settings(config) if config is not None else default_settings(name)
        print_json(settings.model_dump(mode="json"))
    else:
        click.echo(shipped_settings(name).read_text(encoding="utf-8"), nl=False)
    return 0
