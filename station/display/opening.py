"""Who reads the events of a command: the display that was asked for, a file, `gyrolock status`."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any, TypeVar

import click

from station.errors import EXIT_DEFECT, EXIT_OK, describe_failure
from station.events.event import Events
from station.provenance import version
from station.runs.progress import Progress
from station.terminal.give_way import stepping_aside
from station.terminal.lines import remark

F = TypeVar("F", bound=Callable[..., Any])


def display_options(function: F) -> F:
    """Add ``--plain``, ``--quiet`` and ``--events``."""
    options = (
        click.option("--plain", is_flag=True, help="Progress as plain lines, also on a terminal."),
        click.option("--quiet", is_flag=True, help="No progress: the result and what went wrong only."),
        click.option(
            "--events",
            "events_to",
            metavar="FILE",
            help="What happens as lines of JSON: to this file, pipe or open descriptor (a number).",
        ),
    )
    for option in reversed(options):
        function = option(function)
    return function


@contextmanager
def shown(given: Mapping[str, Any], command: str, **labels: str | None) -> Iterator[Progress]:
    """Show what happens while a command measures."""
    from station.events.lines import open_lines
    from station.events.running import StatusFile

    events = Events()
    with ExitStack() as readers:
        if target := given.get("events_to"):
            lines = open_lines(target)
            events.read_by(lines, values=True)
            readers.callback(_tell_lost, lines)
        status = StatusFile()
        events.read_by(status)
        readers.callback(status.close)
        if not given.get("quiet"):
            if given.get("plain") or not _can_be_drawn_on(lines_on_stdout=bool(given.get("jsonl"))):
                from station.display.lines import PlainLines

                events.read_by(PlainLines())
            else:
                from station.display.live import LiveDisplay

                events.read_by(readers.enter_context(LiveDisplay()), values=True)
        readers.enter_context(
            stepping_aside(
                lambda question: events.emit("asked", question=question), lambda: events.emit("answered")
            )
        )
        named = {name: labels.get(name) for name in ("unit", "operator", "note")}
        events.emit("program", command=command, **named, pid=os.getpid(), version=version("gyrolock"))
        progress = Progress(events)
        try:
            yield progress
        except BaseException as error:
            failure = describe_failure(error)
            if failure is None:
                progress.end(EXIT_DEFECT, str(error))
            else:
                progress.end(failure.exit_code, failure.message)
            raise
        progress.end(EXIT_OK)


def _can_be_drawn_on(*, lines_on_stdout: bool) -> bool:
    """Whether stderr is a terminal on which nothing else writes meanwhile."""
    try:
        drawn_on = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        return drawn_on and not (lines_on_stdout and sys.stdout.isatty())
    except (AttributeError, OSError, ValueError):
        return False


def _tell_lost(lines: Any) -> None:
    lines.close()
    if lines.lost:
        remark(f"--events: {lines.lost} lines were not written ({lines.error or 'nobody read them in time'})")
