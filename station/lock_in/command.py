"""``gyrolock measure``, the main job, and ``gyrolock acquire``, its first half."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

from station.shell.command import run_measurement, take_measurement
from station.shell.options import CHANNELS, report_option, run_options
from station.terminal.lines import print_failure, print_json, say

F = TypeVar("F", bound=Callable[..., Any])

_PLACES = {"resource": "scope.resource", "records": "measurement.records", "channel": "scope.channel"}


def _bench_options(function: F) -> F:
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
        click.option("--channel", type=CHANNELS, metavar="CHn", help="Input channel, CH1 to CH4."),
        run_options,
    )
    for option in reversed(options):
        function = option(function)
    return function


@click.command("measure")
@_bench_options
@report_option
def measure(**given: Any) -> int:
    """Measure the lock-in rate: acquire, save, analyse, report.

    Without --resource the whole bench is simulated: rate table, gyro and oscilloscope. With --resource the
    gyro is expected to turn already, unless the settings say that an operator sets the table.

    Ctrl-C keeps the records taken so far; --resume goes on with such a run.
    """
    return run_measurement("measure", given, places=_PLACES)


@click.command("acquire")
@_bench_options
def acquire(**given: Any) -> int:
    """Acquire and save records only; `gyrolock analyze` reads them later.

    The scope is set up as `gyrolock measure` does it. Ctrl-C keeps the records taken so far; --resume goes on with
    such a run.
    """
    from station.shell.ending import run_as_it_ends, save_outcome
    from station.shell.evaluated import about_run

    taken = take_measurement("measure", given, places=_PLACES)
    run, failure = run_as_it_ends(taken), taken.failure
    failure = failure or save_outcome(run, None)
    saved = len(run.taken_for("measure"))
    document: dict[str, object] = {"records": saved, **about_run(run)}
    if failure is not None:
        document["error"] = failure.as_json()
    if given["as_json"]:
        print_json(document)
    elif given["jsonl"] and failure is not None:
        print_json({"error": failure.as_json()})
    elif not given["jsonl"]:
        say(f"saved   {saved} records in {taken.path}")
    if failure is None:
        return 0
    print_failure(failure if taken.failure is None else taken.to_tell)
    return failure.exit_code
