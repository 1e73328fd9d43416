"""docs/commands.md, docs/api.md and docs/results.md hold every command, public name and number as they are."""

import runpy
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from station.cli import gyrolock
from station.live.events import KINDS

DOCS = Path(__file__).parents[2] / "docs"


def commands(command: click.Command, context: click.Context) -> Iterator[tuple[str, click.Command]]:
    yield context.command_path, command
    for name in command.list_commands(context) if isinstance(command, click.Group) else ():
        below = command.get_command(context, name)
        yield from commands(below, click.Context(below, info_name=name, parent=context))


EVERY = dict(commands(gyrolock, click.Context(gyrolock, info_name="gyrolock")))


@pytest.mark.parametrize("name", ["commands", "api", "results"])
def test_the_page_is_what_the_program_says(name: str) -> None:
    written = runpy.run_path(str(DOCS / f"{name}.py"))["page"]()
    assert written == (DOCS / f"{name}.md").read_text(encoding="utf-8"), "`make docs` writes it again"


def test_every_event_is_described() -> None:
    page = (DOCS / "watching.md").read_text(encoding="utf-8")
    for kind, (names, meaning) in KINDS.items():
        told = ", ".join(f"`{name}`" for name in names.split()) if names != "*" else "names with their units"
        assert f"| `{kind}` | {told} | {meaning} |" in page


def test_every_command_and_option_has_help() -> None:
    assert len(EVERY) > 12
    silent = [path for path, command in EVERY.items() if not command.help]
    for path, command in EVERY.items():
        options = [one for one in command.params if isinstance(one, click.Option)]
        silent += [f"{path} {one.opts[0]}" for one in options if not one.help]
    assert silent == []
