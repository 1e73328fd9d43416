"""``gyrolock list``: the instruments that VISA can see."""

from __future__ import annotations

from pathlib import Path

import click

from station.shell.options import config_option, json_option, transcript_option
from station.terminal.lines import print_json, say


@click.command("list")
@transcript_option
@config_option
@json_option
def command(config: Path | None, as_json: bool) -> int:
    """List the instruments that VISA can see, and say why one cannot be used.

    A name that is not listed may work all the same: raw TCP sockets cannot be found by looking.
    """
    from instrument import find_resources
    from station.lock_in.settings import load_settings

    load_settings(config)
    found = find_resources()
    if as_json:
        print_json(
            {
                "resources": [
                    {
                        "resource": one.resource_name,
                        "identity": one.identity.text if one.identity else None,
                        "problem": one.problem,
                    }
                    for one in found
                ]
            }
        )
        return 0
    for one in found:
        say(f"{one.resource_name}\t{one.identity.text if one.identity else one.problem}")
    if not found:
        say("VISA sees no instrument. `gyrolock doctor` says which kinds of links can be used here.")
    return 0
