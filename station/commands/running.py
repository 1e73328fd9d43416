"""``gyrolock status``, ``stop`` and ``panel``: measurements on this machine, from another shell or a browser."""

from __future__ import annotations

import socket
import sys
import time
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from station.errors import EXIT_FAIL, EXIT_OK, CannotWrite, UsageError
from station.shell.options import json_option, unused_config_option
from station.terminal import print_json, remark, say

if TYPE_CHECKING:
    from station.live.status import Running

_SCHEMA = {"name": "gyrolock status", "version": 1}
_ASK_EVERY_S = 0.1


@click.command("status")
@click.option("--watch", "watched", is_flag=True, help="Show it again every second, until Ctrl-C or the end.")
@unused_config_option
@json_option
def status(watched: bool, as_json: bool) -> int:
    """Show running measurements, and those that were killed.

    It acts from any shell of the same user; `gyrolock stop` ends one. Exit codes: 0 something runs, 1 nothing
    does.
    """
    from station.live.status import running_programs

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
        say("no measurement runs on this machine", answer=True)
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
    from station.live.console import stdout_console
    from station.live.display import picture

    console, situation = stdout_console(), program.situation
    if program.alive:
        since = str(situation.program.get("at", ""))[:19].replace("T", " ")
        say(f"process {program.pid}, since {since} UTC", answer=True)
    else:
        resumed = program.run.parent if program.run else ""
        say(f"process {program.pid} was killed; the records are kept: go on with --resume {resumed}", answer=True)
    console.print(picture(situation, console.width, max(console.height, 40)))


def _watch() -> None:
    from rich.live import Live

    from station.live.console import stdout_console
    from station.live.display import picture
    from station.live.status import running_programs

    console = stdout_console()
    with Live(console=console, auto_refresh=False) as live:
        while alive := [one for one in running_programs() if one.alive]:
            live.update(picture(alive[-1].situation, console.width, console.height), refresh=True)
            time.sleep(1.0)


@click.command("stop")
@click.argument("which", required=False, metavar="[PID|RUN]")
@click.option("--all", "everything", is_flag=True, help="Stop all of them.")
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(min=0),
    default=60.0,
    metavar="S",
    help="Seconds to wait for the end [60].",
)
@unused_config_option
@json_option
def stop(which: str | None, everything: bool, wait_s: float, as_json: bool) -> int:
    """Stop a running measurement or station; its records are kept.

    It is what Ctrl-C does in its own terminal: the front panel is put back, the table stopped, the outcome saved;
    --resume goes on. Without PID or RUN the only one that runs is meant. Exit codes: 0 it has ended, 1 it has not
    ended within --wait, 2 nothing runs or it is not clear which is meant.
    """
    from station.live.status import running_programs

    alive = [one for one in running_programs() if one.alive]
    chosen = alive if everything else _chosen(alive, which)
    if not chosen:
        raise UsageError("no measurement runs on this machine")
    for one in chosen:
        one.stop()
    left = _still_there(chosen, wait_s)
    if as_json:
        print_json(
            {"stopped": [one.pid for one in chosen if one not in left], "running": [one.pid for one in left]}
        )
    else:
        for one in chosen:
            if one in left:
                say(f"process {one.pid} was told to stop and has not ended after {wait_s:g} s", answer=True)
            else:
                where = f"; go on with --resume {one.run.parent}" if one.run is not None else ""
                say(f"process {one.pid} has ended{where}", answer=True)
    return EXIT_FAIL if left else EXIT_OK


def _chosen(alive: list[Running], which: str | None) -> list[Running]:
    if which is None:
        if len(alive) > 1:
            raise UsageError(
                f"{len(alive)} measurements run: say which by its process, or --all ({_named(alive)})"
            )
        return alive
    if which.isdecimal():
        found = [one for one in alive if one.pid == int(which)]
    else:
        wanted = Path(which).absolute()
        found = [
            one
            for one in alive
            if one.run is not None and wanted in (one.run.absolute(), *one.run.absolute().parents)
        ]
    if not found:
        raise UsageError(f"no measurement runs that is {which}" + (f" ({_named(alive)})" if alive else ""))
    return found


def _named(alive: list[Running]) -> str:
    return ", ".join(f"{one.pid}: {one.situation.program.get('command')}" for one in alive)


def _still_there(chosen: list[Running], wait_s: float) -> list[Running]:
    from station.live.status import running_programs

    until = time.monotonic() + wait_s
    while True:
        alive = {one.pid for one in running_programs() if one.alive}
        left = [one for one in chosen if one.pid in alive]
        if not left or time.monotonic() >= until:
            return left
        time.sleep(_ASK_EVERY_S)


# --------------------
# ``gyrolock panel``: the same in a browser


_CONNECTIONS = 2000  # of browsers, those that say nothing included


@click.command("panel")
@click.argument("directory", type=click.Path(path_type=Path), default=".", metavar="[DIR]")
@click.option("--port", type=click.IntRange(0, 65535), default=8765, metavar="N", help="TCP port [8765]; 0: any.")
@click.option("--host", default="127.0.0.1", metavar="NAME", help="Address to listen on [127.0.0.1].")
@click.option("--open", "opened", is_flag=True, help="Open it in the browser.")
@unused_config_option
@json_option
def panel(directory: Path, port: int, host: str, opened: bool, as_json: bool) -> int:
    """Show and measure in a browser: the runs, campaigns and screens of DIR [.].

    Measurements are processes of their own: they go on when the page or the panel is closed. Who has the second
    address can only look on. Ctrl-C ends the panel. Needs `pip install gyrolock[panel]`.
    """
    try:
        import uvicorn

        from station.panel import server
    except ImportError as error:
        raise UsageError(f"the panel needs {error.name}: pip install 'gyrolock[panel]'") from None
    from station.panel.guard import PanelGuard, tokens_of
    from station.panel.jobs import FOLDER, Jobs

    root = directory.resolve()
    if not root.is_dir():
        raise UsageError(f"{directory}: there is no such folder")
    try:
        tokens = tokens_of(root / FOLDER)
    except OSError as error:
        raise CannotWrite(f"{root / FOLDER}: {error.strerror}") from None
    listening = _listening(host, port)
    at = listening.getsockname()[1]
    local = host in ("127.0.0.1", "localhost", "::1")
    names = {host, "127.0.0.1", "localhost", "::1"} | (
        set() if local else {socket.gethostname(), socket.getfqdn()}
    )
    if not local:
        with suppress(OSError):
            names |= {str(one[4][0]) for one in socket.getaddrinfo(socket.gethostname(), None)}
    shown = socket.gethostname() if host in ("0.0.0.0", "::") else host
    to_control, to_look = (server.address(shown, at, tokens[role]) for role in ("control", "look"))
    if as_json:
        print_json({"control": to_control, "look": to_look, "folder": str(root)})
    else:
        say(f"panel    {to_control}", answer=True)
        say(f"look on  {to_look}")
    if not local:
        remark(f"the panel listens on {host}: whoever has the address can use it, and nothing of it is encrypted")
    if opened:
        webbrowser.open(to_control)
    app = server.create_app(
        server.OpenPanel(root, PanelGuard(frozenset(names), tokens, f"gyrolock-{at}"), Jobs(root))
    )
    config = uvicorn.Config(
        app, log_level="critical", access_log=False, timeout_keep_alive=10, timeout_graceful_shutdown=1,
        limit_concurrency=_CONNECTIONS, server_header=False,
    )  # fmt: skip
    with suppress(KeyboardInterrupt):
        uvicorn.Server(config).run(sockets=[listening])
    return EXIT_OK


def _listening(host: str, port: int) -> socket.socket:
    """A socket that listens; UsageError where it cannot."""
    # silent connections are not to use up the files that measurements need
    with suppress(ImportError, OSError, ValueError):
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(most, 65_536) if most > 0 else 65_536, most))
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        made = socket.socket(family, socket.SOCK_STREAM)
        if sys.platform != "win32":
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((host, port))
        made.listen(128)
    except OSError as error:
        raise UsageError(
            f"port {port} of {host} cannot be listened on ({error.strerror or error}): another panel may run; "
            "give another one with --port"
        ) from None
    return made
