"""Write docs/commands.md, every command and option, from the commands themselves: ``make docs``."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path

import click

from station.cli import gyrolock

PAGE = Path(__file__).with_suffix(".md")

HEAD = """# Commands and options

Written by `make docs` from the commands themselves; `gyrolock COMMAND --help` says the same on a terminal. What
stands in square brackets holds when an option is not given. Every command also takes `-h`, `--help`."""


def page() -> str:
    """The whole page; the same commands always give the same text."""
    return "\n\n".join([HEAD, *_parts(gyrolock, click.Context(gyrolock, info_name="gyrolock"))]) + "\n"


def _parts(command: click.Command, context: click.Context) -> Iterator[str]:
    """Heading, usage, help and options of a command, then those of its subcommands."""
    yield f"## {context.command_path}"
    arguments = [_argument(one) for one in command.params if isinstance(one, click.Argument)]
    subcommand = ["COMMAND"] if isinstance(command, click.Group) else []
    yield "    " + " ".join([context.command_path, "[OPTIONS]", *arguments, *subcommand])
    yield inspect.cleandoc(command.help or "")
    options = [option for option in command.params if isinstance(option, click.Option) and not option.hidden]
    if options:
        yield "\n".join(["| option | |", "|---|---|", *map(_row, options)])
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            if below is not None:
                yield from _parts(below, click.Context(below, info_name=name, parent=context))


def _argument(argument: click.Argument) -> str:
    if argument.metavar:
        return argument.metavar
    name = _value(argument) + ("..." if argument.nargs == -1 else "")
    return name if argument.required else f"[{name}]"


def _row(option: click.Option) -> str:
    names = " / ".join([", ".join(option.opts), *option.secondary_opts])
    value = "" if option.is_flag else f" {_value(option)}"
    given = option.to_info_dict()["default"]
    default = "" if option.is_flag or given is None else f"[{given}]"
    text = " ".join(part for part in (option.help, _limits(option), default) if part)
    return f"| `{_in_a_table(names + value)}` | {_in_a_table(text)} |"


def _value(parameter: click.Parameter) -> str:
    """What stands for the value: FILE, N, exact|paper-13."""
    if parameter.metavar:
        return parameter.metavar
    if isinstance(parameter.type, click.Choice):
        return "|".join(map(str, parameter.type.choices))
    return "X" if isinstance(parameter.type, click.FloatRange) else parameter.type.name.upper()


def _limits(option: click.Option) -> str:
    """The range of a number, as (0 < X ≤ 50)."""
    kind = option.type
    if not isinstance(kind, click.IntRange | click.FloatRange):
        return ""
    low = "" if kind.min is None else f"{kind.min} {'<' if kind.min_open else '≤'} "
    high = "" if kind.max is None else f" {'<' if kind.max_open else '≤'} {kind.max}"
    return f"({low}{_value(option)}{high})"


def _in_a_table(text: str) -> str:
    return text.replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
