"""``gyrolock plan``, what reaches a wanted uncertainty, and ``gyrolock study``, the paper's simulations."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from station.results.numbers import AMPLITUDE, LOCK_IN_RATE
from station.shell.options import config_option, dither_option, json_option, unused_config_option
from station.terminal import print_json, say, say_briefly

if TYPE_CHECKING:
    from station.plan import PlannedMeasurement
    from station.study import Study

_AT_A_RATE = {
    "plot": "--plot", "rates": "--rates", "both_senses": "--both-senses", "reference": "--reference",
    "lock_in_factor": "--factor", "distortion_dbc": "--distortion", "tilt_deg": "--tilt", "tilt_u_deg": "--tilt-u",
}  # of which a plan for a gyro that dithers has no use  # fmt: skip
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
    "--lock-in-rate", LOCK_IN_RATE.key(), type=_positive, metavar="WL", help="Expected, deg/s [settings]."
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
    "--amplitude", AMPLITUDE.key(), type=_positive, metavar="V", help="Of the beat at the input [settings, 0.4]."
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
@dither_option
@click.option("--baud", type=click.IntRange(300, 1_000_000), metavar="B", help="Of a serial link [settings].")
@click.option(
    "--transfer", "transfer_s", type=click.FloatRange(min=0), metavar="S", help="Seconds a record [from --baud]."
)
@click.option(
    "--plot", type=click.Path(path_type=Path), metavar="FILE", help="Draw u against W/WL: .svg, .png, .pdf."
)
@config_option
@json_option
def plan_command(plot: Path | None, config: Path | None, dither: str | None, as_json: bool, **options: Any) -> int:
    """Plan a measurement: which rate, time base, vertical scale, and how many records.

    Exit code 1 if the wanted uncertainty cannot be reached; the plan then is the best there is.
    """
    from station.errors import EXIT_FAIL, EXIT_OK
    from station.lock_in.settings import load_settings
    from station.plan import PlanOptions, make_plan, plan_dithered, plan_document, plan_sentences
    from station.report.figure import check_picture_name

    if plot is not None:
        check_picture_name(plot)
    settings, chosen = load_settings(config), PlanOptions(**options)
    if dither == "on" or (dither is None and settings.dither.on):
        said = click.get_current_context().get_parameter_source
        if idle := [option for name, option in _AT_A_RATE.items() if said(name) is ParameterSource.COMMANDLINE]:
            raise click.UsageError(
                f"{', '.join(idle)}: of a gyro that turns; one that dithers is measured at rest"
            )
        found = plan_dithered(settings, chosen)
        print_json(found) if as_json else _print_dithered(found)
        return EXIT_OK if found["reached"] else EXIT_FAIL
    planned = make_plan(settings, chosen)
    sentences = plan_sentences(planned)
    if plot is not None:
        from station.plan import write_plan_plot

        write_plan_plot(plot, planned)
    if as_json:
        print_json({**plan_document(planned, sentences), "plot": str(plot) if plot is not None else None})
    else:
        _print(planned, sentences, plot)
    return EXIT_OK if planned.reached else EXIT_FAIL


def _print_dithered(found: dict[str, Any]) -> None:
    from station.live.console import stdout_console
    from station.plan import dithered_words
    from station.report.show import text_table

    said, table = dithered_words(found)
    console = stdout_console()
    console.print(text_table(table, left=1))
    say_briefly(said)
    console.print(f"\n• {said}")


def _print(planned: PlannedMeasurement, sentences: list[str], plot: Path | None) -> None:
    from station.live.console import stdout_console
    from station.lock_in.result import short_budget_table
    from station.plan import rate_words
    from station.report.show import text_table
    from station.results.result import TextTable

    console = stdout_console()
    header = ("rate", "beat", "time base", "vertical", "record", "records")
    rates = TextTable(header, tuple(tuple(rate_words(rate)) for rate in planned.plan.rates))
    console.print(text_table(rates, left=len(header)))
    console.print()
    say_briefly(sentences[0])
    for sentence in sentences:
        console.print(f"• {sentence}")
    console.print()
    console.print(text_table(short_budget_table(planned.plan.budget), left=1))
    if plot is not None:
        console.print(f"\nplot    {plot}", soft_wrap=True)


# --------------------
# ``gyrolock study``: the paper's simulations beside the exact method


@click.command("study")
@click.option(
    "--figure",
    "figures",
    type=click.IntRange(2, 6),
    multiple=True,
    metavar="N",
    help="Only this figure of the paper, 2 to 6; may be given several times.",
)
@click.option(
    "--to",
    "--out",
    "out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Write plots, tables (CSV) and study.json there.",
)
@click.option(
    "--format",
    "kind",
    type=click.Choice(["svg", "png", "pdf"]),
    default="svg",
    show_default=True,
    help="Of the plots.",
)
@unused_config_option
@json_option
def study_command(figures: tuple[int, ...], out: Path | None, kind: str, as_json: bool) -> int:
    """Repeat the paper's simulations, by its method and exactly: Figs. 2 to 6.

    Zhan et al., Acta Optica Sinica 29, 960 (2009): K = 2000 pulses per degree, 20 kHz, 3 s. Without --figure the
    bias of its formulas and the causes of its error are told as well. Nothing in a settings file changes this.
    """
    from station.shell.options import shown
    from station.study import run_study, study_document, study_sentences

    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    with shown({}, "study") as progress:
        study = run_study(figures, progress)
    sentences = study_sentences(study)
    files = _write(out, study, sentences, kind) if out is not None else []
    if as_json:
        print_json(study_document(study, sentences, files))
    else:
        from station.live.console import stdout_console
        from station.report.show import text_table
        from station.results.result import TextTable
        from station.study import study_tables

        console = stdout_console()
        for table in study_tables(study):
            console.print(table.title, style="bold")
            console.print(text_table(TextTable(table.columns, tuple(map(tuple, table.texts())))))
            console.print()
        for sentence in sentences:
            console.print(f"• {sentence}")
        say_briefly(sentences[0] if sentences else f"tables: {len(study_tables(study))}")
        for file in files:
            say(f"wrote   {file}")
    return 0


def _write(out: Path, study: Study, sentences: list[str], kind: str) -> list[str]:
    import json

    from station.results.result import plain
    from station.study import study_document, study_tables, write_study_plots

    files = [str(path) for path in write_study_plots(out, study, kind)]
    for table in study_tables(study):
        path = out / f"{table.name}.csv"
        path.write_text(table.as_csv(), encoding="utf-8")
        files.append(str(path))
    path = out / "study.json"
    document = study_document(study, sentences, [*files, str(path)])
    path.write_text(json.dumps(plain(document), indent=1, allow_nan=False), encoding="utf-8")
    return [*files, str(path)]
