"""Options that several commands share."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import click

from station.display.opening import display_options
from station.errors import EXIT_USAGE

F = TypeVar("F", bound=Callable[..., Any])

CHANNELS = click.Choice(["CH1", "CH2", "CH3", "CH4"], case_sensitive=False)


def positive(_: click.Context, __: click.Parameter, value: float | None) -> float | None:
    """Take an option only if it is a finite number above zero; a `callback` of ``click.option``."""
    if value is not None and not (math.isfinite(value) and value > 0):
        raise click.BadParameter(f"{value:g} is not a positive number")
    return value


def not_zero(_: click.Context, __: click.Parameter, value: float | None) -> float | None:
    """Take an option only if it is a finite number other than zero; a `callback` of ``click.option``."""
    if value is not None and not (math.isfinite(value) and value):
        raise click.BadParameter(f"{value:g} is not a finite number other than 0")
    return value


class SuggestingGroup(click.Group):
    """A group that says which command was perhaps meant; called alone it shows its help."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Take the options of the group; without a command show the help, as lines and not as an error."""
        if not args:
            click.echo(ctx.get_help())
            ctx.exit(EXIT_USAGE)
        return super().parse_args(ctx, args)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; a usage error names one that is spelled alike."""
        names = self.list_commands(ctx)
        if args and args[0] not in names and not args[0].startswith("-"):
            like = difflib.get_close_matches(args[0], names, 1)
            meant = f" Did you mean {like[0]!r}?" if like else ""
            raise click.UsageError(f"No such command {args[0]!r}.{meant}", ctx)
        return super().resolve_command(ctx, args)


def json_option(function: F) -> F:
    """Add ``--json``."""
    return click.option("--json", "as_json", is_flag=True, help="One JSON document on stdout, also for an error.")(
        function
    )


def config_option(function: F) -> F:
    """Add ``--config FILE``."""
    return click.option(
        "--config",
        type=click.Path(path_type=Path),
        metavar="FILE",
        help="Settings file; it need only hold what differs from the default.",
    )(function)


def transcript_option(function: F) -> F:
    """Add ``--transcript FILE``: what every link carries while the command runs is written down."""

    def start(context: click.Context, _: click.Parameter, path: Path | None) -> None:
        if path is None:
            return
        from instrument.transcripts.recording import recorded

        try:
            context.with_resource(recorded(path))
        except OSError as error:
            raise click.BadParameter(f"{path} cannot be written: {error.strerror or error}") from None

    return click.option(
        "--transcript",
        type=click.Path(path_type=Path, dir_okay=False),
        metavar="FILE",
        callback=start,
        expose_value=False,
        help="Write each message to and from the instruments into this file.",
    )(function)


def report_option(function: F) -> F:
    """Add ``--report`` and ``--no-report``."""
    return click.option("--report/--no-report", default=True, help="Write report.html beside the run [yes].")(
        function
    )


def run_options(function: F) -> F:
    """Add what every command has that takes records: resume, labels, seed, directory, settings, JSON."""
    options = (
        click.option(
            "--resume",
            type=click.Path(path_type=Path),
            metavar="RUN",
            help="Go on with this run.",
        ),
        click.option("--unit", metavar="TEXT", help="Unit under test: stands in report and JSON."),
        click.option("--operator", metavar="TEXT", help="Who measures."),
        click.option("--note", metavar="TEXT", help="What should be remembered of this run."),
        click.option("--seed", type=click.IntRange(min=0), metavar="S", help="Seed of the simulated bench."),
        click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Directory of runs [./runs]."),
        click.option("--jsonl", is_flag=True, help="One line on stdout for each record, when it is on the disk."),
        transcript_option,
        config_option,
        json_option,
    )
    function = display_options(function)
    for option in reversed(options):
        function = option(function)
    return function


def overrides(given: Mapping[str, Any], places: Mapping[str, str]) -> dict[str, dict[str, object]]:
    """Turn options of the command line into settings; what was not given is left out.

    Examples
    --------
    >>> overrides({"seed": 3, "channel": None}, {"seed": "simulation.seed", "channel": "scope.channel"})
    {'simulation': {'seed': 3}}
    """
    chosen: dict[str, dict[str, object]] = {}
    for name, place in places.items():
        if (value := given.get(name)) is not None:
            section, _, key = place.partition(".")
            chosen.setdefault(section, {})[key] = str(value) if isinstance(value, Path) else value
    return chosen
