"""``gyrolock fog constants``: what a run gives the gyro's own logic."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from station.shell.options import json_option, positive
from station.terminal.lines import print_json, say


@click.command("constants")
@click.argument("run", type=click.Path(path_type=Path), metavar="RUN")
@click.option("--vhdl", type=click.Path(path_type=Path), metavar="FILE", help="Write a VHDL package.")
@click.option("--c", "c", type=click.Path(path_type=Path), metavar="FILE", help="Write a C header.")
@click.option("--csv", type=click.Path(path_type=Path), metavar="FILE", help="Write a table.")
@click.option("--axis", default="", metavar="AXIS", help="Which, where the run has several.")
@click.option(
    "--numbers",
    type=click.Choice(["differences", "fit"]),
    default="differences",
    show_default=True,
    help="Of a rate-table run: as in the patent, or K by least squares times the rate.",
)
@click.option(
    "--unit",
    type=click.Choice(["codes", "counts"]),
    default="codes",
    show_default=True,
    help="Of numbers: codes of the staircase's step, or counts of the output.",
)
@click.option("--width", type=click.IntRange(2, 64), metavar="BITS", help="Of a word, with its sign.")
@click.option("--fraction", type=click.IntRange(-32, 96), metavar="BITS", help="Behind the point.")
@click.option(
    "--rounding",
    type=float,
    callback=positive,
    metavar="PPM",
    help="Largest rounding error; without it, and without --width and --fraction, a tenth of the uncertainty.",
)
@click.option("--floats", is_flag=True, help="Doubles in the C header instead of words.")
@click.option("--replace", is_flag=True, help="Write over files that are there.")
@json_option
def constants(run: Path, as_json: bool, **given: Any) -> int:
    """Constants for the gyro's own logic: VHDL, C and CSV; word widths, and what the rounding costs.

    RUN is a saved run of `table` or `selfcal`, which gives the numbers N of small rates, or of `temperature`,
    which gives the compensation table.
    """
    from station.fibre_gyro.constants.found import Wanted, constants_of
    from station.fibre_gyro.constants.write import constants_document, constants_table, write_constants
    from station.report.console import text_table
    from station.terminal.console import stdout_console

    if given["rounding"] and (given["width"] or given["fraction"] is not None):
        raise click.UsageError("--rounding chooses the words; --width and --fraction give them")
    names = ("axis", "numbers", "unit", "width", "fraction")
    found = constants_of(run, Wanted(**{name: given[name] for name in names}, error_ppm=given["rounding"]))
    files = {kind: given[kind] for kind in ("vhdl", "c", "csv") if given[kind] is not None}
    write_constants(found, files, floats=given["floats"], replace=given["replace"])
    if as_json:
        print_json(constants_document(found, files))
        return 0
    stdout_console().print(text_table(constants_table(found)))
    for path in files.values():
        say(f"saved   {path}")
    return 0
