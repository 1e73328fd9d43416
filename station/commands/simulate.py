"""``gyrolock simulate``: serve the simulated oscilloscope."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import click

from station.shell.options import config_option, json_option
from station.terminal.lines import print_json, say


@click.command("simulate")
@click.option(
    "--tcp", "tcp_port", type=click.IntRange(0, 65535), metavar="PORT", help="TCP on loopback; 0: any port."
)
@click.option("--pty", "use_pty", is_flag=True, help="A serial terminal (not on Windows).")
@click.option(
    "--baud",
    type=click.Choice(["300", "600", "1200", "2400", "4800", "9600", "19200"]),
    metavar="N",
    help="Pace the serial terminal as RS-232 at N baud.",
)
@click.option("--seed", type=click.IntRange(min=0), metavar="S", help="Seed of noise and phases.")
@click.option("--controllers", is_flag=True, help="Serve rate table, chamber and power supply too, one line each.")
@config_option
@json_option
def command(
    tcp_port: int | None,
    use_pty: bool,
    baud: str | None,
    seed: int | None,
    controllers: bool,
    config: Path | None,
    as_json: bool,
) -> int:
    """Serve the simulated oscilloscope on TCP or a serial terminal.

    CH1 shows the beat of the simulated gyro at the slow rate. The first line on stdout is the VISA resource
    name. With --controllers the table under the gyro can be turned, by the commands of `gyrolock settings
    rate_table`. Ctrl-C or SIGTERM ends it.
    """
    from station.lock_in.served import serve_bench
    from station.lock_in.settings import load_settings

    if (tcp_port is None) == (not use_pty):
        raise click.UsageError("say where to serve: --tcp PORT (0 for any free one) or --pty")
    if baud is not None and not use_pty:
        raise click.UsageError("--baud paces a serial terminal: use it with --pty")
    chosen = {} if seed is None else {"simulation": {"seed": seed}}
    settings = load_settings(config, overrides=chosen)
    baud_rate = int(baud) if baud else None
    with (
        suppress(KeyboardInterrupt),
        serve_bench(settings, tcp_port=tcp_port, baud_rate=baud_rate, controllers=controllers) as (server, others),
    ):
        if as_json:
            print_json({"resource": server.resource_name, **({"controllers": others} if controllers else {})})
        else:
            say("\n".join([server.resource_name, *(f"{name} {resource}" for name, resource in others.items())]))
        # a wait without end could not be interrupted on Windows
        while not server.ended.wait(timeout=0.5):
            pass
    return 0
