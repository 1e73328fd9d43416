"""``gyrolock deadband``: the search for the dead band."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from station.shell.command import run_measurement
from station.shell.options import CHANNELS, report_option, run_options

_PLACES = {
    "resource": "scope.resource",
    "channel": "scope.channel",
    "highest": "sweep.highest_over_lock_in",
    "steps": "sweep.steps",
    "records": "sweep.records",
}


@click.command("deadband")
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path), metavar="[RUN]")
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
def command(paths: tuple[Path, ...], **given: Any) -> int:
    """Search the dead band: sweep the rate through zero, up and down.

    It shows where the beat ends and where it begins again. Without --resource the whole bench is simulated; with
    it an operator sets the table: the program says on the terminal what to set, and asks what the table shows.
    RUN is a saved sweep, to be evaluated again.

    Ctrl-C keeps the records taken so far; --resume goes on with such a run.
    """
    return run_measurement("deadband", given, places=_PLACES, paths=paths)
