"""``gyrolock fog``: the tests of a fibre gyro, `constants`, `sniff`, `serve` and `settings`."""

import inspect
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from station.errors import EXIT_NO_SIGNAL, EXIT_OK
from station.measurements import FIBRE_GYRO_TESTS
from station.shell.options import (
    CHANNELS,
    RUN_PATH,
    SuggestingGroup,
    config_option,
    hold_a_run,
    json_option,
    positive,
    report_option,
    run_measurement,
    run_options,
    transcript_option,
    unused_config_option,
)
from station.terminal import print_json, say, say_briefly

# --------------------
# ``gyrolock fog sniff``: which description of frames fits a gyro


@click.command("sniff")
@click.argument("source", metavar="PORT|FILE")
@click.option(
    "--formats",
    "own",
    type=click.Path(path_type=Path),
    metavar="FILE",
    multiple=True,
    help="TOML file with descriptions of your own, tried beside those that come with the program.",
)
@click.option("--seconds", type=click.FloatRange(0.2, 600), default=3.0, help="To listen with each setting [3].")
@click.option("--baud", type=click.IntRange(50, 12_000_000), metavar="N", help="Only this baud rate.")
@click.option("--poll", is_flag=True, help="Ask gyros that send only when they are asked; this sends bytes.")
@transcript_option
@unused_config_option
@json_option
def sniff_command(
    source: str, own: tuple[Path, ...], seconds: float, baud: int | None, poll: bool, as_json: bool
) -> int:
    """Find the frame format of a gyro on a serial PORT, or of bytes saved in a FILE.

    Every description that comes with the program, and yours, is tried: frames, rate by the computer's clock, gaps
    of the counter, checksums, bytes left over. One is proposed; if none fits, the length of the frames and what is
    constant in them is shown (exit code 4).
    """
    from station.fibre_gyro.sniff import document_of, known_formats, show, sniff_file, sniff_port
    from station.terminal import print_json, remark

    formats = known_formats()
    if own:
        formats |= known_formats(list(own))  # a name of the user's own wins
    path = Path(source)
    if path.is_dir():
        raise click.UsageError(f"{source}: is a folder; give a port, or a file with the gyro's bytes")
    if _is_port(source, path):
        found = sniff_port(source, formats, seconds=seconds, baud=baud, poll=poll, tell=remark)
    else:
        found = sniff_file(path, formats)
    if as_json:
        print_json(document_of(found, formats))
    else:
        show(found, formats)
    return EXIT_OK if found.proposed is not None else EXIT_NO_SIGNAL


def _is_port(source: str, path: Path) -> bool:
    """Whether a name is that of a port: no file of that name is there, or it is a device."""
    try:
        return not stat.S_ISREG(path.stat().st_mode)
    except OSError:
        return not path.suffix or "://" in source or source.startswith("/dev/")


# --------------------
# ``gyrolock fog constants``: what a run gives the gyro's own logic


@click.command("constants")
@click.argument("run", type=RUN_PATH, metavar="RUN")
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
@unused_config_option
@json_option
def constants(run: Path, as_json: bool, **given: Any) -> int:
    """Constants for the gyro's own logic: VHDL, C and CSV; word widths, and what the rounding costs.

    RUN is a saved run of `table` or `selfcal`, which gives the numbers N of small rates, or of `temperature`,
    which gives the compensation table.
    """
    from station.fibre_gyro.constants import (
        WordFormat,
        constants_document,
        constants_of,
        constants_table,
        write_constants,
    )
    from station.live.console import stdout_console
    from station.report.show import text_table

    if given["rounding"] and (given["width"] or given["fraction"] is not None):
        raise click.UsageError("--rounding chooses the words; --width and --fraction give them")
    names = ("axis", "numbers", "unit", "width", "fraction")
    found = constants_of(run, WordFormat(**{name: given[name] for name in names}, error_ppm=given["rounding"]))
    files = {kind: given[kind] for kind in ("vhdl", "c", "csv") if given[kind] is not None}
    write_constants(found, files, floats=given["floats"], replace=given["replace"])
    if as_json:
        print_json(constants_document(found, files))
        return 0
    stdout_console().print(text_table(constants_table(found)))
    say_briefly(f"{len(constants_table(found).rows)} constants{''.join(f'; {path}' for path in files.values())}")
    for path in files.values():
        say(f"saved   {path}")
    return 0


F = TypeVar("F", bound=Callable[..., Any])


class _TestGroup(SuggestingGroup):
    """Tests by their list, each with the options that all have where it has none of its own; then the others."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*FIBRE_GYRO_TESTS, *(name for name in self.commands if name not in FIBRE_GYRO_TESTS)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in self.commands or cmd_name not in FIBRE_GYRO_TESTS:
            return super().get_command(ctx, cmd_name)

        @click.command(cmd_name, help=FIBRE_GYRO_TESTS[cmd_name])
        @_options
        def test(paths: tuple[Path, ...], **given: Any) -> int:
            return _run(cmd_name, paths, given)

        return test


def _test(name: str) -> Callable[[F], click.Command]:
    """The command of a test that has options of its own; what its docstring says follows what the list says."""

    def made(function: F) -> click.Command:
        more = inspect.cleandoc(function.__doc__ or "")
        return command.command(name, help="\n\n".join(filter(None, (FIBRE_GYRO_TESTS[name], more))))(function)

    return made


@click.group("fog", cls=_TestGroup)
def command() -> None:
    """Scale factor of a fibre gyro: rate table, self-calibration, 2π error, figures of merit, oscilloscope.

    Every test takes --json and --config FILE. Without --port gyro and rate table are simulated. PATH is a saved
    run, or a list of logs in CSV (see docs/fibre_gyro.md). Exit codes: 0 done or PASS, 1 FAIL against a limit,
    2 usage or settings, 3 link, 4 no usable signal, 130 interrupted. --resume goes on with a run cut short.
    """


command.add_command(sniff_command)
command.add_command(constants)


def _options(function: F) -> F:
    paths = click.argument("paths", nargs=-1, type=RUN_PATH, metavar="[PATH...]")
    port = click.option("--port", metavar="NAME", help="Serial port of the gyro. Without one it is simulated.")
    return paths(port(_log_options(run_options(report_option(function)))))


_OF_LOGS = {
    "columns": "logs.columns",
    "units": "logs.units",
    "time_unit": "logs.time_unit",
    "output_rate": "logs.output_rate_hz",
    "skip_bad_rows": "logs.skip_bad_rows",
}


def _log_options(function: F) -> F:
    """Add what says how logs are read."""
    options = (
        click.option(
            "--columns",
            callback=lambda _, __, text: None if text is None else [name.strip() for name in text.split(",")],
            metavar="NAMES",
            help="Columns of logs in their order: time,counts or time,counts_x,,counts_z; empty: left out.",
        ),
        click.option(
            "--units", metavar="UNIT", help="Output unit of logs: counts, deg/s, mrad/s, deg (an angle a row), .."
        ),
        click.option("--time-unit", type=click.Choice(["s", "ms", "us", "min", "h"]), help="Time unit of logs."),
        click.option(
            "--output-rate",
            type=float,
            callback=positive,
            metavar="HZ",
            help="Outputs per second, for logs without a column of the time.",
        ),
        click.option(
            "--skip-bad-rows",
            type=click.IntRange(0, 1_000_000),
            metavar="N",
            help="Leave out up to N rows of a log that cannot be read, or are out of order; each is named.",
        ),
    )
    for option in reversed(options):
        function = option(function)
    return function


def _run(name: str, paths: tuple[Path, ...], given: dict[str, Any], **more: Any) -> int:
    return run_measurement(name, given, paths=paths, places={"port": "link.port"}, for_files=_OF_LOGS, **more)


_noise_option = click.option(
    "--noise",
    type=RUN_PATH,
    metavar="RUN|FILE",
    help="Noise model to count: a run of `fog allan`, its JSON, or a JSON file with the numbers of a data sheet.",
)


def _with_noise(
    name: str, paths: tuple[Path, ...], noise: Path | None, given: dict[str, Any], known: dict[str, Any]
) -> int:
    """Run what a noise model belongs to."""
    from station.fibre_gyro.allan import noise_facts

    if noise is not None and given["resume"] is not None:
        raise click.UsageError("--noise belongs to a new run, or to one that is finished: go on with it first")
    facts = noise_facts(noise)
    return _run(name, paths, given, known={**known, **facts}, choices=facts)


@_test("table")
@_noise_option
@_options
def table(paths: tuple[Path, ...], noise: Path | None, **given: Any) -> int:
    """With --noise the slow noise of the gyro counts in the uncertainty of K."""
    return _with_noise("table", paths, noise, given, {})


@_test("selfcal")
@click.option(
    "--table",
    "table_run",
    type=RUN_PATH,
    metavar="RUN",
    help="Rate-table run that gives the numbers, and the K to compare with.",
)
@_noise_option
@_options
def selfcal(paths: tuple[Path, ...], table_run: Path | None, noise: Path | None, **given: Any) -> int:
    """Without --table the numbers come from the design, or a simulated bench takes a rate-table run first."""
    if table_run is None:
        return _with_noise("selfcal", paths, noise, given, {})
    if given["resume"] is not None or hold_a_run(paths):
        raise click.UsageError("--table belongs to a new run; a run that was begun has its numbers")
    from station.fibre_gyro.selfcal import facts_of_table
    from station.fibre_gyro.settings import load_fog_settings

    return _with_noise(
        "selfcal", paths, noise, given, facts_of_table(load_fog_settings(given["config"]), table_run)
    )


@_test("allan")
@click.option("--temperature", is_flag=True, default=None, help="Take the drift with the temperature of logs out.")
@_options
def allan(paths: tuple[Path, ...], **given: Any) -> int:
    """PATH is a saved run, logs as they are, or a list of them."""
    more = {**_OF_LOGS, "temperature": "allan.temperature"}
    return run_measurement("allan", given, paths=paths, places={"port": "link.port"}, for_files=more)


@_test("witness")
@click.argument("paths", nargs=-1, type=RUN_PATH, metavar="[PATH...]")
@click.option("--resource", metavar="NAME", help="VISA name of the oscilloscope. Without one it is simulated.")
@click.option("--channel", type=CHANNELS, metavar="CHn", help="Input channel, CH1 to CH4.")
@click.option("--records", type=click.IntRange(1, 10_000), metavar="N", help="Records.")
@click.option("--port", metavar="NAME", help="Serial port of the gyro: the step is sent to it.")
@report_option
@run_options
def witness(paths: tuple[Path, ...], **given: Any) -> int:
    """PATH is a saved run, or Tektronix CSV or ISF files. With --config a saved run is judged by the [limits],
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
    from station.settings import shipped_settings

    shipped = shipped_settings("fibre_gyro_serial" if serial else "fibre_gyro")
    if config is not None or as_json:
        from station.fibre_gyro.settings import load_fog_settings

        print_json(load_fog_settings(config or shipped).model_dump(mode="json"))
    else:
        say(shipped.read_text(encoding="utf-8").rstrip(), answer=True)
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

    from station.fibre_gyro.bench import serve_gyro
    from station.fibre_gyro.settings import load_fog_settings
    from station.fibre_gyro.sniff import read_frame_format

    settings = load_fog_settings(config, {"link": {"frame_format": named}} if named else None)
    layout = read_frame_format(settings)
    with serve_gyro(settings, layout, tcp_port=tcp, speed=speed, rate_dps=rate, clock_ppm=clock_ppm) as server:
        if as_json:
            print_json({"port": server.port})
        else:
            say(server.port, answer=True)
        with suppress(KeyboardInterrupt):
            # a wait without end could not be interrupted on Windows
            while not server.ended.wait(timeout=0.5):
                pass
    return 0
