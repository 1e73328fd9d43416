"""``gyrolock status``: how the measurements stand that run on this machine, from any other shell."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.errors import EXIT_FAIL, EXIT_OK
from station.shell.options import config_option, json_option
from station.terminal.lines import print_json, say

if TYPE_CHECKING:
    from station.events.running import Running

_SCHEMA = {"name": "gyrolock status", "version": 1}


@click.command("status")
@click.option("--watch", "watched", is_flag=True, help="Show it again every second, until Ctrl-C or the end.")
@config_option
@json_option
def command(watched: bool, config: Path | None, as_json: bool) -> int:
    """Show how the measurements stand that run on this machine, and those that were killed.

    It acts from any shell of the same user; `gyrolock stop` ends one. Exit codes: 0 something runs, 1 nothing
    does.
    """
    from station.events.running import running_programs
    from station.settings.toml_files import read_toml

    if config is not None:
        read_toml(config)  # a file with a mistake is one here too
    programs = [one for one in running_programs() if one.alive or _was_cut_short(one)]
    if as_json:
        print_json({"schema": _SCHEMA, "programs": [one.as_json() for one in programs]})
    elif watched and sys.stdout.isatty() and any(one.alive for one in programs):
        _watch()
    elif programs:
        for place, one in enumerate(programs):
            say("") if place else None
            _print(one)
    else:
        say("no measurement runs on this machine")
    return EXIT_OK if any(one.alive for one in programs) else EXIT_FAIL


def _was_cut_short(program: Running) -> bool:
    """Whether a program that was killed has left a run that nobody has gone on with; if not it is forgotten."""
    from station.errors import RunError
    from station.runs.store import open_run

    try:
        if program.run is not None and open_run(program.run).facts.get("outcome") is None:
            return True
    except (RunError, OSError):
        pass
    program.forget()
    return False


def _print(program: Running) -> None:
    from station.display.picture import picture
    from station.terminal.console import stdout_console

    console, situation = stdout_console(), program.situation
    if program.alive:
        since = str(situation.program.get("at", ""))[:19].replace("T", " ")
        say(f"process {program.pid}, since {since} UTC")
    else:
        say(f"process {program.pid} was killed; the records are kept: go on with --resume {_parent(program)}")
    console.print(picture(situation, console.width, max(console.height, 40)))


def _parent(program: Running) -> Any:
    return program.run.parent if program.run is not None else ""


def _watch() -> None:
    from rich.live import Live

    from station.display.picture import picture
    from station.events.running import running_programs
    from station.terminal.console import stdout_console

    console = stdout_console()
    with Live(console=console, auto_refresh=False) as live:
        while alive := [one for one in running_programs() if one.alive]:
            live.update(picture(alive[-1].situation, console.width, console.height), refresh=True)
            time.sleep(1.0)
