"""``gyrolock simulate``: serve simulated oscilloscopes."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from pathlib import Path

import click

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
    from station.controllers.serve import serve_controllers
    from station.lock_in.served import simulated_scopes
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
    settings = load_settings(config, overrides={} if seed is None else {"simulation": {"seed": seed}})
    scopes, first = simulated_scopes(
        settings,
        signals=[parse_signal(text) for text in signals],
        models=models,
        faults=[parse_fault(text) for text in faults],
    )
    with suppress(KeyboardInterrupt), ExitStack() as stack:
        found = stack.enter_context(served(scopes, link, port=port, baud_rate=int(baud) if baud else None))
        others = {}
        if controllers:
            others = stack.enter_context(serve_controllers(first.table, first.clock, terminals=use_pty))
        if as_json:
            names = {"resource": found.resource_names[0], "resources": list(found.resource_names)}
            print_json({**names, **({"controllers": others} if controllers else {})})
        else:
            for name in (*found.resource_names, *(f"{name} {resource}" for name, resource in others.items())):
                say(name)
        # a wait without end could not be interrupted on Windows
        while not found.wait(timeout=0.5):
            pass
    return 0
