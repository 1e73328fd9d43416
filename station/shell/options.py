"""Options that several commands share, and how a command ends."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import click

from station.errors import Failure

F = TypeVar("F", bound=Callable[..., Any])


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


def bench_options(function: F) -> F:
    """Add the options that say what to acquire with, and how much."""
    options = (
        click.option(
            "--resource",
            metavar="NAME",
            help="VISA name of the oscilloscope. Without one the bench is simulated.",
        ),
        click.option(
            "--records", type=click.IntRange(1, 1_000_000), metavar="N", help="Records at the slow rate."
        ),
        click.option(
            "--channel",
            type=click.Choice(["CH1", "CH2", "CH3", "CH4"]),
            metavar="CHn",
            help="Input channel, CH1 to CH4.",
        ),
        click.option("--seed", type=click.IntRange(min=0), metavar="S", help="Seed of the simulated bench."),
        click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Directory of runs [./runs]."),
    )
    for option in reversed(options):
        function = option(function)
    return function


def overrides(
    *, records: int | None, channel: str | None, seed: int | None, out: Path | None, simulated: bool
) -> dict[str, dict[str, object]]:
    """Turn options of the command line into settings; what was not given is left out.

    Parameters
    ----------
    records, channel, seed, out
        As the options of :func:`bench_options`.
    simulated : bool
        Whether the bench is simulated: only then has the seed a meaning.
    """
    chosen: dict[str, dict[str, object]] = {}
    if records is not None:
        chosen["measurement"] = {"records": records}
    if channel is not None:
        chosen["scope"] = {"channel": channel.upper()}
    if out is not None:
        chosen["output"] = {"directory": str(out)}
    if seed is not None:
        if not simulated:
            raise click.UsageError("--seed belongs to the simulated bench; a real one has none")
        chosen["simulation"] = {"seed": seed}
    return chosen


def print_json(document: Mapping[str, Any]) -> None:
    """Print one JSON document; nan is never in it."""
    click.echo(json.dumps(document, allow_nan=False))


def print_failure(failure: Failure) -> None:
    """Print the one line of an error to stderr."""
    click.echo(f"gyrolock: {failure.message}", err=True)
