"""``gyrolock fog witness``: the modulator staircase on an oscilloscope."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from station.fibre_gyro.fog_output import finish
from station.shell.options import config_option, json_option

if TYPE_CHECKING:
    from station.fibre_gyro.campaign import Campaign
    from station.fibre_gyro.settings import FogSettings


@click.command("witness")
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path), metavar="[PATH...]")
@click.option("--resource", metavar="NAME", help="VISA name of the oscilloscope. Without one it is simulated.")
@click.option(
    "--channel",
    type=click.Choice(["CH1", "CH2", "CH3", "CH4"], case_sensitive=False),
    metavar="CHn",
    help="Input channel, CH1 to CH4.",
)
@click.option("--records", type=click.IntRange(1, 10_000), metavar="N", help="Records.")
@click.option("--port", metavar="NAME", help="Serial port of the gyro: the step is sent to it.")
@click.option("--seed", type=click.IntRange(min=0), metavar="S", help="Seed of the simulation.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Directory of runs [./runs].")
@click.option("--report/--no-report", default=True, help="Write report.html beside the run [yes].")
@config_option
@json_option
def witness(
    paths: tuple[Path, ...], config: Path | None, report: bool, as_json: bool, **given: str | int | Path | None
) -> int:
    """Record the modulator staircase with an oscilloscope: step, step time, fall at a reset, V_2π, 2π error.

    PATH is a saved run, or Tektronix CSV or ISF files. With --config a saved run is judged by the [limits],
    half-wave voltage and gain of FILE.
    """
    from station.fibre_gyro.results import evaluate_witness_run
    from station.fibre_gyro.settings import load_fog_settings
    from station.runs.store import open_run

    live = [name for name in ("resource", "channel", "records", "port", "seed") if given[name] is not None]
    if paths and live:
        raise click.UsageError(f"saved records and --{live[0]} exclude each other")
    settings = load_fog_settings(config, _overrides(**given))
    if given["seed"] is not None and settings.witness.resource:
        raise click.UsageError("--seed belongs to the simulated oscilloscope; a real one has none")
    campaign, saved = _campaign(settings, paths)
    known = settings if saved and config is not None else None
    run = open_run(campaign.path)
    return finish(run, lambda: evaluate_witness_run(run, known), campaign.failure, report=report, as_json=as_json)


def _overrides(**given: str | int | Path | None) -> dict[str, dict[str, object]]:
    places = {
        "witness": ("resource", "channel", "records"),
        "link": ("port",),
        "simulation": ("seed",),
    }
    chosen: dict[str, dict[str, object]] = {
        section: {name: given[name] for name in names if given[name] is not None}
        for section, names in places.items()
    }
    if given["out"] is not None:
        chosen["output"] = {"directory": str(given["out"])}
    return chosen


def _campaign(settings: FogSettings, paths: tuple[Path, ...]) -> tuple[Campaign, bool]:
    """Take the run, make it of files, or open it; also whether it was saved before."""
    from station.fibre_gyro.campaign import Campaign
    from station.fibre_gyro.witness.take import staircase_run_from_files, take_staircase_run
    from station.runs.database import is_database
    from station.runs.progress import Progress
    from station.runs.store import run_file

    if not paths:
        return take_staircase_run(settings, Progress()), False
    if not any(is_database(path) for path in paths):
        return staircase_run_from_files(settings, paths), False
    if len(paths) > 1:
        raise click.UsageError("give one saved run, or files of an oscilloscope")
    return Campaign(run_file(paths[0]), None), True
