"""``gyrolock fog``: scale factor of a fibre gyro, by rate table and by injected staircase."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from station.fibre_gyro.constants.command import constants
from station.fibre_gyro.sniff.command import command as sniff
from station.shell.command import hold_a_run, run_measurement
from station.shell.options import (
    CHANNELS,
    SuggestingGroup,
    config_option,
    json_option,
    positive,
    report_option,
    run_options,
)
from station.terminal.lines import print_json, say

_UNITS = ["counts", "deg/s", "deg/h", "rad/s"]
F = TypeVar("F", bound=Callable[..., Any])


@click.group("fog", cls=SuggestingGroup)
def command() -> None:
    """Scale factor of a fibre gyro: rate table, self-calibration, 2π error, figures of merit, oscilloscope.

    Every test takes --json and --config FILE. Without --port gyro and rate table are simulated. PATH is a saved
    run, or a list of logs in CSV (see docs/fibre_gyro.md). Exit codes: 0 done or PASS, 1 FAIL against a limit,
    2 usage or settings, 3 link, 4 no usable signal, 130 interrupted. --resume goes on with a run cut short.
    """


command.add_command(sniff)
command.add_command(constants)


def _options(function: F) -> F:
    paths = click.argument("paths", nargs=-1, type=click.Path(path_type=Path), metavar="[PATH...]")
    port = click.option("--port", metavar="NAME", help="Serial port of the gyro. Without one it is simulated.")
    return paths(port(_log_options(run_options(report_option(function)))))


_OF_LOGS = {
    "columns": "logs.columns",
    "units": "logs.units",
    "time_unit": "logs.time_unit",
    "output_rate": "logs.output_rate_hz",
}


def _log_options(function: F) -> F:
    """Add what says how logs are read."""
    options = (
        click.option(
            "--columns",
            callback=_names,
            metavar="NAMES",
            help="Columns of logs in their order: time,counts or time,counts_x,,counts_z; empty: left out.",
        ),
        click.option("--units", type=click.Choice(_UNITS), metavar="UNIT", help="Of logs: counts, deg/s, deg/h."),
        click.option("--time-unit", type=click.Choice(["s", "ms", "us", "min", "h"]), help="Of logs."),
        click.option(
            "--output-rate",
            type=float,
            callback=positive,
            metavar="HZ",
            help="Outputs per second, for logs without a column of the time.",
        ),
    )
    for option in reversed(options):
        function = option(function)
    return function


def _names(_: click.Context, __: click.Parameter, value: str | None) -> list[str] | None:
    return None if value is None else [name.strip() for name in value.split(",")]


def _run(name: str, paths: tuple[Path, ...], given: dict[str, Any], **more: Any) -> int:
    return run_measurement(name, given, paths=paths, places={"port": "link.port"}, for_files=_OF_LOGS, **more)


_noise_option = click.option(
    "--noise",
    type=click.Path(path_type=Path),
    metavar="RUN|FILE",
    help="Noise model to count: a run of `fog allan`, its JSON, or a JSON file with the numbers of a data sheet.",
)


def _with_noise(
    name: str, paths: tuple[Path, ...], noise: Path | None, given: dict[str, Any], known: dict[str, Any]
) -> int:
    """Run what a noise model belongs to."""
    from station.fibre_gyro.allan.noise_model import noise_facts

    if noise is not None and given["resume"] is not None:
        raise click.UsageError("--noise belongs to a new run, or to one that is finished: go on with it first")
    facts = noise_facts(noise)
    return _run(name, paths, given, known={**known, **facts}, choices=facts)


@command.command("table")
@_noise_option
@_options
def table(paths: tuple[Path, ...], noise: Path | None, **given: Any) -> int:
    """Rate-table run: whole turns, both senses; K of each axis, earth rate and bias, numbers of small rates."""
    return _with_noise("table", paths, noise, given, {})


@command.command("selfcal")
@click.option(
    "--table",
    "table_run",
    type=click.Path(path_type=Path),
    metavar="RUN",
    help="Rate-table run that gives the numbers, and the K to compare with.",
)
@_noise_option
@_options
def selfcal(paths: tuple[Path, ...], table_run: Path | None, noise: Path | None, **given: Any) -> int:
    """Self-calibration: inject a staircase for each rate, fit the slope, and say what it can show."""
    if table_run is None:
        return _with_noise("selfcal", paths, noise, given, {})
    if given["resume"] is not None or hold_a_run(paths):
        raise click.UsageError("--table belongs to a new run; a run that was begun has its numbers")
    from station.fibre_gyro.selfcal.numbers import facts_of_table
    from station.fibre_gyro.settings import load_fog_settings

    return _with_noise(
        "selfcal", paths, noise, given, facts_of_table(load_fog_settings(given["config"]), table_run)
    )


@command.command("eps")
@_options
def eps(paths: tuple[Path, ...], **given: Any) -> int:
    """2π error of the modulator's converter, by injection in open loop."""
    return _run("eps", paths, given)


@command.command("figures")
@_options
def figures(paths: tuple[Path, ...], **given: Any) -> int:
    """Nonlinearity, asymmetry, repeatability, temperature coefficient; bias repeatability and warm-up."""
    return _run("figures", paths, given)


@command.command("allan")
@click.option("--temperature", is_flag=True, default=None, help="Take the drift with the temperature of logs out.")
@_options
def allan(paths: tuple[Path, ...], **given: Any) -> int:
    """Noise at rest: Allan deviation and noise model. PATH is a saved run, logs as they are, or a list of them."""
    more = {**_OF_LOGS, "temperature": "allan.temperature"}
    return run_measurement("allan", given, paths=paths, places={"port": "link.port"}, for_files=more)


@command.command("threshold")
@_options
def threshold(paths: tuple[Path, ...], **given: Any) -> int:
    """Threshold, resolution and dead zone, by a ladder of small rates in both senses without whole turns."""
    return _run("threshold", paths, given)


@command.command("temperature")
@_options
def temperature(paths: tuple[Path, ...], **given: Any) -> int:
    """Scale factor and bias over a temperature ramp, and a compensation table. PATH may also be a log at rest."""
    return _run("temperature", paths, given)


@command.command("witness")
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path), metavar="[PATH...]")
@click.option("--resource", metavar="NAME", help="VISA name of the oscilloscope. Without one it is simulated.")
@click.option("--channel", type=CHANNELS, metavar="CHn", help="Input channel, CH1 to CH4.")
@click.option("--records", type=click.IntRange(1, 10_000), metavar="N", help="Records.")
@click.option("--port", metavar="NAME", help="Serial port of the gyro: the step is sent to it.")
@report_option
@run_options
def witness(paths: tuple[Path, ...], **given: Any) -> int:
    """Record the modulator staircase with an oscilloscope: step, step time, fall at a reset, V_2π, 2π error.

    PATH is a saved run, or Tektronix CSV or ISF files. With --config a saved run is judged by the [limits],
    half-wave voltage and gain of FILE.
    """
    places = {name: f"witness.{name}" for name in ("resource", "channel", "records")}
    return run_measurement("witness", given, paths=paths, places={**places, "port": "link.port"})


@command.command("settings")
@click.option("--serial", is_flag=True, help="The example for a gyro on a serial port.")
@config_option
@json_option
def settings_file(serial: bool, config: Path | None, as_json: bool) -> int:
    """Print the commented settings file to copy.

    With --json, or with --config FILE, the values that would be used are printed instead of the file.
    """
    from station.settings.load import shipped_settings

    shipped = shipped_settings("fibre_gyro_serial" if serial else "fibre_gyro")
    if config is not None or as_json:
        from station.fibre_gyro.settings import load_fog_settings

        print_json(load_fog_settings(config or shipped).model_dump(mode="json"))
    else:
        say(shipped.read_text(encoding="utf-8").rstrip())
    return 0


@command.command("serve")
@click.option("--tcp", type=click.IntRange(0, 65535), metavar="PORT", help="On TCP, 0: any free port.")
@click.option("--speed", type=click.FloatRange(min=0, min_open=True), default=1.0, help="Faster than real time.")
@click.option("--rate", type=float, default=0.0, metavar="W", help="Rate of the table, deg/s.")
@click.option(
    "--clock-ppm", type=click.FloatRange(-2e5, 2e5), default=0.0, metavar="PPM", help="Gyro's clock: fast by."
)
@click.option("--format", "named", metavar="NAME", help="Frame format; by default that of the settings.")
@config_option
@json_option
def serve(
    tcp: int | None,
    speed: float,
    rate: float,
    clock_ppm: float,
    named: str | None,
    config: Path | None,
    as_json: bool,
) -> int:
    """Serve the simulated gyro on a serial terminal (or TCP); the first line on stdout is its port."""
    from contextlib import suppress

    from station.fibre_gyro.served import serve_gyro
    from station.fibre_gyro.settings import load_fog_settings
    from station.fibre_gyro.sniff.known import read_frame_format

    settings = load_fog_settings(config, {"link": {"frame_format": named}} if named else None)
    layout = read_frame_format(settings)
    with serve_gyro(settings, layout, tcp_port=tcp, speed=speed, rate_dps=rate, clock_ppm=clock_ppm) as server:
        if as_json:
            print_json({"port": server.port})
        else:
            say(server.port)
        with suppress(KeyboardInterrupt):
            # a wait without end could not be interrupted on Windows
            while not server.ended.wait(timeout=0.5):
                pass
    return 0
