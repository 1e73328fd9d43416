"""docs/commands.md holds every command and option as they are."""

import runpy
from collections.abc import Iterator
from pathlib import Path

import click

from station.cli import gyrolock

DOCS = Path(__file__).parents[2] / "docs"


def commands(command: click.Command, context: click.Context) -> Iterator[tuple[str, click.Command]]:
    yield context.command_path, command
    for name in command.list_commands(context) if isinstance(command, click.Group) else ():
        below = command.get_command(context, name)
        yield from commands(below, click.Context(below, info_name=name, parent=context))


EVERY = dict(commands(gyrolock, click.Context(gyrolock, info_name="gyrolock")))


def test_the_page_is_what_the_commands_say() -> None:
    written = runpy.run_path(str(DOCS / "commands.py"))["page"]()
    assert written == (DOCS / "commands.md").read_text(encoding="utf-8"), "`make docs` writes it again"


def test_every_command_and_option_has_help() -> None:
    assert len(EVERY) > 12
    silent = [path for path, command in EVERY.items() if not command.help]
    for path, command in EVERY.items():
        options = [one for one in command.params if isinstance(one, click.Option)]
        silent += [f"{path} {one.opts[0]}" for one in options if not one.help]
    assert silent == []
