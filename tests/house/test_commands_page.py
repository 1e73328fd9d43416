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
        options = [one for one in command.params if isinstance(one, click.Option) and not one.hidden]
        silent += [f"{path} {one.opts[0]}" for one in options if not one.help]
    assert silent == []


# an option has one meaning; where its words differ, it is the same thing of something else
SAME_THING = {
    "--table": "who turns the table; of `fog selfcal` the run on one",
    "--to": "where what is written goes",
    "--runs": "directory of runs",
    "--channel": "an input of the scope",
    "--baud": "speed of a serial line",
    "--resource": "VISA name",
    "--port": "serial port",
    "--tcp": "port to serve on",
    "--scale-factor": "pulses per degree",
    "--rates": "rates in lock-in rates",
    "--records": "how many",
    "--noise": "noise of what is measured",
    "--unit": "unit under test; of `fog constants` that of numbers",
    "--operator": "who measures",
    "--note": "a note",
    "--tag": "a word at a run",
    "--seed": "seed",
    "--resume": "go on with it",
    "--report": "the HTML report",
    "--plot": "a picture",
    "--csv": "a table as CSV",
    "--json": "one JSON document",
    "--jsonl": "a JSON object a line",
    "--config": "settings file",
    "--format": "form of what is sent or drawn",
    "--numbers": "which numbers",
    "--replace": "write over files",
    "--watch": "again and again",
}


def test_every_command_prints_one_document_or_one_line() -> None:
    for path, command in EVERY.items():
        if not isinstance(command, click.Group):
            assert {"--json", "--quiet"} <= {one.opts[0] for one in command.params}, path


def test_an_option_means_one_thing() -> None:
    meanings: dict[str, set[str]] = {}
    for command in EVERY.values():
        for option in command.params:
            if isinstance(option, click.Option) and not option.hidden:
                meanings.setdefault(option.opts[0], set()).add(option.help or "")
    assert {name for name, said in meanings.items() if len(said) > 1} <= set(SAME_THING)
    written = ("page goes", "Write plots", "Folder for", "Directory of tests")
    assert all(
        not any(text in one for text in written)
        for name, said in meanings.items()
        if name != "--to"
        for one in said
    )
