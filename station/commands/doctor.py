"""``gyrolock doctor``: check this installation."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from station.shell.options import config_option, json_option, print_json


@click.command("doctor")
@click.option("--resource", metavar="NAME", help="Look at this instrument too.")
@config_option
@json_option
def command(resource: str | None, config: Path | None, as_json: bool) -> int:
    """Check this installation, and say what to do about what is missing.

    Exit code 3 if something must be mended.
    """
    from station.doctor import examine
    from station.errors import EXIT_INSTRUMENT, EXIT_OK
    from station.settings.load import load_settings

    settings = load_settings(config, resource=resource)
    checks = examine(settings, resource or settings.scope.resource or None)
    bad = [check for check in checks if check.state == "bad"]
    if as_json:
        print_json({"ok": not bad, "checks": [asdict(check) for check in checks]})
    else:
        for check in checks:
            click.echo(f"{check.state:<5}{check.name:<14}{check.text}")
    return EXIT_INSTRUMENT if bad else EXIT_OK
