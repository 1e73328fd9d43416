"""``gyrolock simulate``: serve simulated oscilloscopes."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import click

from station.errors import UsageError
from station.shell.options import config_option, json_option
from station.terminal.lines import print_json, say


@click.command("simulate")
@click.option(
    "--tcp", "tcp_port", type=click.IntRange(0, 65535), metavar="PORT", help="TCP on loopback; 0: any port."
)
@click.option(
    "--hislip",
    "hislip_port",
    type=click.IntRange(0, 65535),
    metavar="PORT",
    help="HiSLIP on loopback, with message ends; VISA expects 4880; 0: any port.",
)
@click.option(
    "--prologix",
    "prologix_port",
    type=click.IntRange(0, 65535),
    metavar="PORT",
    help="As a GPIB adapter of Prologix' kind does it, at address 1; its own is 1234; 0: any port.",
)
@click.option("--pty", "use_pty", is_flag=True, help="A serial terminal (not on Windows).")
@click.option(
    "--baud",
    type=click.Choice(["300", "600", "1200", "2400", "4800", "9600", "19200"]),
    metavar="N",
    help="Pace the serial terminal as RS-232 at N baud.",
)
@click.option(
    "--signal",
    "signals",
    multiple=True,
    metavar="[CHn=]WHAT",
    help="gyro (default), sine[:HZ[:VOLTS[:OFFSET]]], square[:...], or a CSV or ISF file, repeated. May be given "
    "for several channels.",
)
@click.option(
    "--model", "models", multiple=True, metavar="NAME", help="TDS2014, TDS2024B...; each one is one scope."
)
@click.option(
    "--faults",
    multiple=True,
    metavar="KIND[:CHANCE]",
    help="What goes wrong, such as 'cut answer:0.05' or 'late answer'.",
)
@click.option(
    "--replay",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    metavar="FILE",
    help="Answer on --tcp as a transcript of a real session says, byte for byte.",
)
@click.option("--seed", type=click.IntRange(min=0), metavar="S", help="Seed of noise and phases.")
@click.option("--controllers", is_flag=True, help="Serve rate table, chamber and power supply too, one line each.")
@config_option
@json_option
def command(
    tcp_port: int | None,
    hislip_port: int | None,
    prologix_port: int | None,
    use_pty: bool,
    baud: str | None,
    signals: tuple[str, ...],
    models: tuple[str, ...],
    faults: tuple[str, ...],
    replay: Path | None,
    seed: int | None,
    controllers: bool,
    config: Path | None,
    as_json: bool,
) -> int:
    """Serve the simulated oscilloscope on TCP, HiSLIP, a GPIB adapter or a serial terminal.

    CH1 shows the beat of the simulated gyro at the slow rate, or what --signal says. The first line on stdout is
    the VISA resource name; with several scopes there is one line for each. With --controllers the table under the
    gyro can be turned, by the commands of `gyrolock settings rate_table`. Ctrl-C or SIGTERM ends it.
    """
    from station.controllers.open import served_controllers
    from station.lock_in.served import scope_on_table, simulated_scopes
    from station.lock_in.settings import load_settings
    from station.scope.faults import parse_fault
    from station.scope.serve import served
    from station.scope.signals import parse_signal

    links = {"tcp": tcp_port, "hislip": hislip_port, "prologix": prologix_port, "pty": 0 if use_pty else None}
    chosen = [(link, port) for link, port in links.items() if port is not None]
    if len(chosen) != 1:
        raise click.UsageError(
            "say where to serve: --tcp, --hislip or --prologix with a PORT (0: any free one), or --pty"
        )
    if baud is not None and not use_pty:
        raise click.UsageError("--baud paces a serial terminal: use it with --pty")
    (link, port) = chosen[0]
    if replay is not None:
        return _replay(replay, link, port, as_json)
    settings = load_settings(config, overrides={} if seed is None else {"simulation": {"seed": seed}})
    befalling = [parse_fault(text) for text in faults]
    table = None
    if controllers:
        if signals or models:
            raise click.UsageError("--controllers turns the table under the gyro: leave --signal and --model out")
        scope, table = scope_on_table(settings)
        scope.faults.add(*befalling)
        scopes = [scope]
    else:
        shown = [parse_signal(text) for text in signals]
        scopes = simulated_scopes(settings, signals=shown, models=models, faults=befalling)
    with (
        suppress(KeyboardInterrupt),
        served(scopes, link, port=port, baud_rate=int(baud) if baud else None) as found,
        served_controllers(table, tcp=link != "pty") as others,
    ):
        if as_json:
            first, *_ = found.resource_names
            named = {"controllers": others} if others else {}
            print_json({"resource": first, "resources": list(found.resource_names), **named})
        else:
            for name in (*found.resource_names, *(f"{name} {resource}" for name, resource in others.items())):
                say(name)
        # a wait without end could not be interrupted on Windows
        while not found.wait(timeout=0.5):
            pass
    return 0


def _replay(path: Path, link: str, port: int, as_json: bool) -> int:
    """Serve the instrument of a transcript."""
    from instrument.simulated.links.replay import ReplayServer
    from instrument.transcripts.reading import read_transcript

    if link != "tcp":
        raise click.UsageError("--replay serves on --tcp only")
    try:
        server = ReplayServer(read_transcript(path), port=port)
    except OSError as error:
        raise UsageError(f"the transcript cannot be served: {error.strerror or error}") from None
    with suppress(KeyboardInterrupt), server:
        if as_json:
            print_json({"resource": server.resource_name, "resources": [server.resource_name]})
        else:
            say(server.resource_name)
        while not server.ended.wait(timeout=0.5):
            pass
    return 0
