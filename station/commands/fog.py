"""``gyrolock fog``: scale factor of a fibre gyro, by rate table and by injected staircase."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from station.commands.options import config_option, json_option, print_failure, print_json

if TYPE_CHECKING:
    from station.errors import Failure
    from station.fibre_gyro.campaign import Campaign
    from station.fibre_gyro.settings import FogSettings

F = TypeVar("F", bound=Callable[..., Any])


@click.group("fog")
def command() -> None:
    """Scale factor of a fibre gyro: rate table, self-calibration, 2π error, figures of merit.

    Every test takes --json and --config FILE. Without --port gyro and rate table are simulated. PATH is a saved
    run, or a list of logs in CSV (see docs/fibre_gyro.md). Exit codes: 0 done or PASS, 1 FAIL against a limit,
    2 usage or settings, 3 link, 4 no usable signal, 130 interrupted. --resume goes on with a run cut short.
    """


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
def settings_file(serial: bool) -> int:
    """Print the commented settings file to copy."""
    from station.errors import EXIT_OK
    from station.settings import shipped_settings

    click.echo(
        shipped_settings("fibre_gyro_serial" if serial else "fibre_gyro").read_text(encoding="utf-8"), nl=False
    )
    return EXIT_OK


@command.command("serve")
@click.option("--tcp", type=click.IntRange(0, 65535), metavar="PORT", help="On TCP, 0: any free port.")
@click.option("--speed", type=click.FloatRange(min=0, min_open=True), default=1.0, help="Faster than real time.")
@click.option("--rate", type=float, default=0.0, metavar="W", help="Rate of the table, deg/s.")
@config_option
def serve(tcp: int | None, speed: float, rate: float, config: Path | None) -> int:
    """Serve the simulated gyro on a serial terminal (or TCP); the first line on stdout is its port."""
    import threading

    from station.errors import EXIT_OK
    from station.fibre_gyro.bench import read_frame_format
    from station.fibre_gyro.served_gyro import serve_gyro
    from station.fibre_gyro.settings import load_fog_settings

    settings = load_fog_settings(config)
    layout = read_frame_format(settings)
    with serve_gyro(settings, layout, tcp_port=tcp, speed=speed, rate_dps=rate) as port:
        click.echo(port)
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            return EXIT_OK
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
    from station.fibre_gyro.settings import load_fog_settings

    settings = load_fog_settings(config, _overrides(port, seed, out))
    if seed is not None and not settings.simulated:
        raise click.UsageError("--seed belongs to the simulated gyro; a real one has none")
    campaign, given_limits = _campaign(name, settings, paths, resume, table_run)
    limits = settings if config is not None and given_limits else None
    return _finish(campaign, limits, report=report, as_json=as_json)


def _campaign(
    name: str, settings: FogSettings, paths: tuple[Path, ...], resume: Path | None, table_run: Path | None
) -> tuple[Campaign, bool]:
    """Take, resume or open the run; also whether the limits of the settings replace the saved ones."""
    from station.fibre_gyro.campaign import Campaign
    from station.fibre_gyro.session import resume_run, run_from_logs, saved_run_of, start_run
    from station.fibre_gyro.store import is_fog_run
    from station.progress import Progress

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


def _finish(campaign: Campaign, limits: FogSettings | None, *, report: bool, as_json: bool) -> int:
    """Say what the saved segments say, also when they are fewer than planned."""
    from station.errors import EXIT_FAIL, EXIT_OK, Failure, NoUsableSignal
    from station.fibre_gyro.results import evaluate_fog_run
    from station.fibre_gyro.store import open_fog_run

    run = open_fog_run(campaign.path)
    failure: Failure | None = campaign.failure
    document: dict[str, Any] = {"command": run.facts.get("command")}
    verdict = None
    try:
        result = evaluate_fog_run(run, limits)
    except NoUsableSignal as error:
        failure = failure or Failure(error.kind, str(error), error.exit_code)
    else:
        document, verdict = _show(result, run, report=report, as_json=as_json)
    document["run"] = str(run.path)
    if failure is not None:
        document["error"] = failure.as_json()
    if as_json:
        print_json(document)
    else:
        click.echo(f"\nsaved   {run.path}")
        if "report" in document:
            click.echo(f"report  {document['report']}")
    if failure is not None:
        print_failure(_with_way_on(failure, campaign))
        return failure.exit_code
    return EXIT_FAIL if verdict == "FAIL" else EXIT_OK


def _show(result: Any, run: Any, *, report: bool, as_json: bool) -> tuple[dict[str, Any], str | None]:
    """Save, report and print a result; return its document and its verdict."""
    from station.fibre_gyro.console import print_fog_result
    from station.fibre_gyro.report import write_fog_report
    from station.fibre_gyro.store import save_fog_result

    document = dict(result.document)
    save_fog_result(run.path, document)
    if report:
        document["report"] = str(write_fog_report(result, run))
    if not as_json:
        print_fog_result(result, simulated=run.facts["simulated"], truth=run.facts.get("truth"))
    for one in result.evaluation.left_out:
        click.echo(f"gyrolock: {one.sentence}", err=True)
    return document, result.verdict


def _with_way_on(failure: Failure, campaign: Campaign) -> Failure:
    """Add how to go on to the line of a run that was cut short."""
    from station.errors import Failure

    if campaign.failure is None:
        return failure
    way_on = f"{failure.message} (go on with --resume {campaign.path.parent})"
    return Failure(failure.kind, way_on, failure.exit_code)
