"""``gyrolock measure``, the main job, ``acquire``, its first half, and ``deadband``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from station.shell.options import (
    CHANNELS,
    RUN_PATH,
    overrides,
    positive,
    report_option,
    run_measurement,
    run_options,
    shown_for,
    take_measurement,
    told_as_options,
)
from station.terminal import print_failure, print_json, say

if TYPE_CHECKING:
    from station.runs.acquisition import Taken

F = TypeVar("F", bound=Callable[..., Any])

_PLACES = {
    "resource": "scope.resource",
    "scale_factor": "gyro.scale_factor_pulses_per_deg",
    "rates": "measurement.rates_over_lock_in",
    "records": "measurement.records",
    "channel": "scope.channel",
}


def _rates(_: click.Context, __: click.Parameter, value: str | None) -> str | list[float] | None:
    if value is None or value == "auto":
        return value
    try:
        return [float(one) for one in value.split(",")]
    except ValueError:
        raise click.BadParameter(f"{value!r} is neither auto nor numbers such as 8 or 3,5,8,15,30") from None


def _bench_options(function: F) -> F:
    """Add the options that say what to acquire with, and how much."""
    options = (
        click.option(
            "--resource",
            metavar="NAME",
            help="VISA name of the oscilloscope. Without one the bench is simulated.",
        ),
        click.option(
            "--scale-factor",
            type=float,
            callback=positive,
            metavar="K",
            help="Pulses per degree. With --resource it must be given, here or in the settings.",
        ),
        click.option(
            "--rates",
            callback=_rates,
            metavar="LIST",
            help="Rates in expected lock-in rates: 8 for one rate, 3,5,8,15,30 for several, auto.",
        ),
        click.option(
            "--records", type=click.IntRange(1, 1_000_000), metavar="N", help="Records at each rate and sense."
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

    Where the table can be set, the gyro goes through several rates in both senses, chosen for the expected lock-in
    rate: they tell distortion of the detector and the laser's gain corner from lock-in. `--rates 8` takes the
    paper's single rate.

    Ctrl-C keeps the records taken so far; --resume goes on with such a run.
    """
    return run_measurement("measure", _with_scale_factor(given), places=_PLACES)


@click.command("acquire")
@_bench_options
def acquire(**given: Any) -> int:
    """Acquire and save records only; `gyrolock analyze` reads them later.

    The scope is set up as `gyrolock measure` does it. Ctrl-C keeps the records taken so far; --resume goes on with
    such a run.
    """
    given = _with_scale_factor(given)
    with shown_for("measure", given) as progress:
        taken = take_measurement("measure", given, progress, places=_PLACES)
        code = _end_acquire(taken, given)
        progress.end(code)
    return code


def _end_acquire(taken: Taken, given: Mapping[str, Any]) -> int:
    """Say what is saved; the exit code."""
    from station.shell.finish import about_run, run_as_it_ends, save_outcome

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


def _with_scale_factor(given: dict[str, Any]) -> dict[str, Any]:
    """Return the options with the scale factor; where nobody has given it, the operator is asked."""
    from station.lock_in.settings import ask_scale_factor, load_settings

    if given["resume"] is not None:
        return given
    with told_as_options(_PLACES):
        settings = load_settings(given["config"], overrides=overrides(given, _PLACES))
    if settings.gyro.scale_factor_pulses_per_deg:
        return given
    return given | {"scale_factor": ask_scale_factor()}


# --------------------
# ``gyrolock deadband``: the search for the dead band


_DEADBAND_PLACES = {
    "resource": "scope.resource",
    "channel": "scope.channel",
    "highest": "sweep.highest_over_lock_in",
    "steps": "sweep.steps",
    "records": "sweep.records",
}


@click.command("deadband")
@click.argument("paths", nargs=-1, type=RUN_PATH, metavar="[RUN]")
@click.option(
    "--resource", metavar="NAME", help="VISA name of the oscilloscope. Without one the bench is simulated."
)
@click.option("--channel", type=CHANNELS, metavar="CHn", help="Input channel, CH1 to CH4.")
@click.option(
    "--highest",
    type=click.FloatRange(1, min_open=True),
    metavar="X",
    help="Highest rate, in expected lock-in rates.",
)
@click.option("--steps", type=click.IntRange(2, 10_000), metavar="N", help="Rates between zero and the highest.")
@click.option("--records", type=click.IntRange(1, 1000), metavar="N", help="Records at each rate.")
@run_options
@report_option
def deadband(paths: tuple[Path, ...], **given: Any) -> int:
    """Search the dead band: sweep the rate through zero, up and down.

    It shows where the beat ends and where it begins again. Without --resource the whole bench is simulated; with
    it an operator sets the table: the program says on the terminal what to set, and asks what the table shows.
    RUN is a saved sweep, to be evaluated again.

    Ctrl-C keeps the records taken so far; --resume goes on with such a run.
    """
    return run_measurement("deadband", given, places=_DEADBAND_PLACES, paths=paths)
