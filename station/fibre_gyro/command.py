"""``gyrolock fog``: scale factor of a fibre gyro, by rate table and by injected staircase."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from station.fibre_gyro.fog_output import finish
from station.fibre_gyro.witness_command import witness
from station.shell.options import config_option, json_option, print_json

if TYPE_CHECKING:
    from station.fibre_gyro.campaign import Campaign
    from station.fibre_gyro.settings import FogSettings

F = TypeVar("F", bound=Callable[..., Any])


@click.group("fog")
def command() -> None:
    """Scale factor of a fibre gyro: rate table, self-calibration, 2π error, figures of merit, oscilloscope.

    Every test takes --json and --config FILE. Without --port gyro and rate table are simulated. PATH is a saved
    run, or a list of logs in CSV (see docs/fibre_gyro.md). Exit codes: 0 done or PASS, 1 FAIL against a limit,
    2 usage or settings, 3 link, 4 no usable signal, 130 interrupted. --resume goes on with a run cut short.
    """


command.add_command(witness)


def _run_options(function: F) -> F:
    options = (
        click.argument("paths", nargs=-1, type=click.Path(path_type=Path), metavar="[PATH...]"),
        click.option("--port", metavar="NAME", help="Serial port of the gyro. Without one it is simulated."),
        click.option("--resume", type=click.Path(path_type=Path), metavar="RUN", help="Go on with this run."),
        click.option("--seed", type=click.IntRange(min=0), metavar="S", help="Seed of the simulation."),
        click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Directory of runs [./runs]."),
        click.option("--report/--no-report", default=True, help="Write report.html beside the run [yes]."),
    )
    for option in reversed(options):
        function = option(function)
    return config_option(json_option(function))


@command.command("table")
@_run_options
def table(**given: Any) -> int:
    """Rate-table run: whole turns, both senses; K of each axis, earth rate and bias, numbers of small rates."""
    return _run("table", **given)


@command.command("selfcal")
@click.option(
    "--table",
    "table_run",
    type=click.Path(path_type=Path),
    metavar="RUN",
    help="Rate-table run that gives the numbers, and the K to compare with.",
)
@_run_options
def selfcal(**given: Any) -> int:
    """Self-calibration: inject a staircase for each rate, fit the slope, and say what it can show."""
    return _run("selfcal", **given)


@command.command("eps")
@_run_options
def eps(**given: Any) -> int:
    """2π error of the modulator's converter, by injection in open loop."""
    return _run("eps", **given)


@command.command("figures")
@_run_options
def figures(**given: Any) -> int:
    """Nonlinearity, asymmetry, repeatability and temperature coefficient, in GJB and IEEE style."""
    return _run("figures", **given)


@command.command("settings")
@click.option("--serial", is_flag=True, help="The example for a gyro on a serial port.")
@config_option
@json_option
def settings_file(serial: bool, config: Path | None, as_json: bool) -> int:
    """Print the commented settings file to copy.

    With --json, or with --config FILE, the values that would be used are printed instead of the file.
    """
    from station.errors import EXIT_OK
    from station.settings.load import shipped_settings

    shipped = shipped_settings("fibre_gyro_serial" if serial else "fibre_gyro")
    if config is not None or as_json:
        from station.fibre_gyro.settings import load_fog_settings

        print_json(load_fog_settings(config or shipped).model_dump(mode="json"))
    else:
        click.echo(shipped.read_text(encoding="utf-8"), nl=False)
    return EXIT_OK


@command.command("serve")
@click.option("--tcp", type=click.IntRange(0, 65535), metavar="PORT", help="On TCP, 0: any free port.")
@click.option("--speed", type=click.FloatRange(min=0, min_open=True), default=1.0, help="Faster than real time.")
@click.option("--rate", type=float, default=0.0, metavar="W", help="Rate of the table, deg/s.")
@config_option
@json_option
def serve(tcp: int | None, speed: float, rate: float, config: Path | None, as_json: bool) -> int:
    """Serve the simulated gyro on a serial terminal (or TCP); the first line on stdout is its port."""
    import threading
    from contextlib import suppress

    from station.errors import EXIT_OK
    from station.fibre_gyro.serial_bench import read_frame_format
    from station.fibre_gyro.served import serve_gyro
    from station.fibre_gyro.settings import load_fog_settings

    settings = load_fog_settings(config)
    layout, ended = read_frame_format(settings), threading.Event()
    with serve_gyro(settings, layout, tcp_port=tcp, speed=speed, rate_dps=rate) as port:
        if as_json:
            print_json({"port": port})
        else:
            click.echo(port)
        with suppress(KeyboardInterrupt):
            # a wait without end could not be interrupted on Windows
            while not ended.wait(timeout=0.5):
                pass
    return EXIT_OK


def _run(
    name: str,
    *,
    paths: tuple[Path, ...],
    port: str | None,
    resume: Path | None,
    seed: int | None,
    out: Path | None,
    report: bool,
    config: Path | None,
    as_json: bool,
    table_run: Path | None = None,
) -> int:
    if resume is not None and (paths or port or seed is not None or config or out or table_run):
        raise click.UsageError("--resume takes everything from the run; give it with --json and --no-report only")
    if paths and (port or seed is not None):
        raise click.UsageError("a saved run or a list of logs needs neither --port nor --seed")
    from station.fibre_gyro.results import evaluate_fog_run
    from station.fibre_gyro.settings import load_fog_settings
    from station.fibre_gyro.store import open_fog_run

    settings = load_fog_settings(config, _overrides(port, seed, out))
    if seed is not None and not settings.simulated:
        raise click.UsageError("--seed belongs to the simulated gyro; a real one has none")
    campaign, given_limits = _campaign(name, settings, paths, resume, table_run)
    limits = settings if config is not None and given_limits else None
    run = open_fog_run(campaign.path)
    return finish(
        run,
        lambda: evaluate_fog_run(run, limits),
        campaign.failure,
        report=report,
        as_json=as_json,
        resumable=None if campaign.failure is None else run.path.parent,
    )


def _campaign(
    name: str, settings: FogSettings, paths: tuple[Path, ...], resume: Path | None, table_run: Path | None
) -> tuple[Campaign, bool]:
    """Take, resume or open the run; also whether the limits of the settings replace the saved ones."""
    from station.fibre_gyro.campaign import Campaign
    from station.fibre_gyro.session import resume_run, run_from_logs, saved_run_of, start_run
    from station.fibre_gyro.store import is_fog_run
    from station.runs.progress import Progress

    progress = Progress()
    if resume is not None:
        return resume_run(name, resume, progress), False
    if not paths:
        return start_run(name, settings, progress, table_run=table_run), False
    if not any(is_fog_run(path) for path in paths):
        return run_from_logs(name, settings, paths, progress, table_run=table_run), False
    if len(paths) > 1:
        raise click.UsageError("give one saved run, or lists of logs")
    return Campaign(saved_run_of(name, paths[0]), None), True


def _overrides(port: str | None, seed: int | None, out: Path | None) -> dict[str, dict[str, object]]:
    chosen: dict[str, dict[str, object]] = {}
    if port is not None:
        chosen["link"] = {"port": port}
    if seed is not None:
        chosen["simulation"] = {"seed": seed}
    if out is not None:
        chosen["output"] = {"directory": str(out)}
    return chosen
