"""``gyrolock plan``: which rate, time base, vertical scale and how many records reach a wanted uncertainty."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.shell.options import config_option, json_option
from station.terminal.lines import print_json

if TYPE_CHECKING:
    from station.plan.plan import PlannedMeasurement

_positive = click.FloatRange(min=0, min_open=True)


def _numbers(_context: click.Context, _option: click.Parameter, text: str | None) -> tuple[float, ...] | None:
    if text is None:
        return None
    if text == "best":
        return ()
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = (math.nan,)
    if not all(math.isfinite(value) for value in values):
        raise click.BadParameter(f"{text!r} is neither a list of numbers such as 3,8,15 nor best")
    return values


@click.command("plan")
@click.option(
    "--lock-in-rate", "lock_in_rate_dps", type=_positive, metavar="WL", help="Expected, deg/s [settings]."
)
@click.option(
    "--factor",
    "lock_in_factor",
    type=click.FloatRange(1, 50),
    default=2.0,
    show_default=True,
    help="The expectation may be wrong by this factor.",
)
@click.option(
    "--wanted",
    "wanted_percent",
    type=_positive,
    default=1.0,
    show_default=True,
    metavar="PERCENT",
    help="Standard uncertainty (k = 1) wanted.",
)
@click.option("--scale-factor", type=_positive, metavar="K", help="Pulses per degree [settings].")
@click.option(
    "--amplitude", "amplitude_v", type=_positive, metavar="V", help="Of the beat at the input [settings, 0.4]."
)
@click.option(
    "--noise",
    "noise_v",
    type=click.FloatRange(min=0),
    metavar="V",
    help="White noise in each sample, rms [settings, 1 % of the amplitude].",
)
@click.option(
    "--distortion",
    "distortion_dbc",
    type=click.FloatRange(-200, 0, max_open=True),
    metavar="DBC",
    help="Largest second harmonic of detector and scope, dB of the beat [settings].",
)
@click.option(
    "--rates",
    callback=_numbers,
    metavar="X,X,...",
    help="Rates in lock-in rates, or best: the best single one [those of gyrolock measure].",
)
@click.option("--both-senses", is_flag=True, help="Each rate in both senses of rotation.")
@click.option(
    "--reference",
    type=click.Choice(["beat", "rate"]),
    default="beat",
    show_default=True,
    help="The record's own beat frequency, or the rate of the table.",
)
@click.option(
    "--tilt",
    "tilt_deg",
    type=click.FloatRange(0, 90, max_open=True),
    metavar="DEG",
    help="Gyro axis to table axis.",
)
@click.option(
    "--tilt-u",
    "tilt_u_deg",
    type=click.FloatRange(min=0),
    default=0.01,
    show_default=True,
    metavar="DEG",
    help="Its standard uncertainty.",
)
@click.option("--baud", type=click.IntRange(300, 1_000_000), metavar="B", help="Of a serial link [settings].")
@click.option(
    "--transfer", "transfer_s", type=click.FloatRange(min=0), metavar="S", help="Seconds a record [from --baud]."
)
@click.option(
    "--plot", type=click.Path(path_type=Path), metavar="FILE", help="Draw u against W/WL: .svg, .png, .pdf."
)
@config_option
@json_option
def command(plot: Path | None, config: Path | None, as_json: bool, **options: Any) -> int:
    """Plan a measurement: which rate, time base, vertical scale, and how many records.

    Exit code 1 if the wanted uncertainty cannot be reached; the plan then is the best there is.
    """
    from station.errors import EXIT_FAIL, EXIT_OK
    from station.lock_in.settings import load_settings
    from station.plan.plan import PlanOptions, make_plan, plan_document
    from station.plan.sentences import plan_sentences
    from station.report.figure import check_picture_name

    if plot is not None:
        check_picture_name(plot)
    planned = make_plan(load_settings(config), PlanOptions(**options))
    sentences = plan_sentences(planned)
    if plot is not None:
        from station.plan.plot import write_plan_plot

        write_plan_plot(plot, planned)
    if as_json:
        print_json({**plan_document(planned, sentences), "plot": str(plot) if plot is not None else None})
    else:
        _print(planned, sentences, plot)
    return EXIT_OK if planned.plan.reached else EXIT_FAIL


def _print(planned: PlannedMeasurement, sentences: list[str], plot: Path | None) -> None:
    from station.lock_in.presentation.budget_table import short_budget_table
    from station.plan.sentences import rate_words
    from station.report.console import text_table
    from station.results.parts import TextTable
    from station.terminal.console import stdout_console

    console = stdout_console()
    header = ("rate", "beat", "time base", "vertical", "record", "records")
    rates = TextTable(header, tuple(tuple(rate_words(rate)) for rate in planned.plan.rates))
    console.print(text_table(rates, left=len(header)))
    console.print()
    for sentence in sentences:
        console.print(f"• {sentence}")
    console.print()
    console.print(text_table(short_budget_table(planned.plan.budget), left=1))
    if plot is not None:
        console.print(f"\nplot    {plot}", soft_wrap=True)
