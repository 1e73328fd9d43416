"""``gyrolock list``: the instruments that VISA can see."""

from __future__ import annotations

from pathlib import Path

import click

from station.shell.options import config_option, json_option, transcript_option
from station.terminal.lines import print_json, remark, say


@click.command("list")
@click.option("--lan/--no-lan", default=True, help="Look on the network too, for two seconds.  [default: --lan]")
@transcript_option
@config_option
@json_option
def command(lan: bool, config: Path | None, as_json: bool) -> int:
    """List the instruments that VISA can see, and say why one cannot be used.

    A name that is not listed may work all the same: raw TCP sockets cannot be found by looking, and on a slow
    network an instrument may need longer than it is waited for.
    """
    from instrument import find_resources
    from station.lock_in.settings import load_settings

    load_settings(config)
    if lan:
        remark("looking for instruments, on the network too...")
    found = find_resources(lan=lan)
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
