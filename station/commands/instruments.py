"""``gyrolock list``, ``grab`` and ``simulate``: instruments on the bench, and simulated ones for others."""

from __future__ import annotations

import time
from contextlib import ExitStack, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from station.errors import UsageError
from station.shell.options import config_option, json_option, transcript_option, unused_config_option
from station.terminal import print_json, remark, say

if TYPE_CHECKING:
    from instrument import TDS2014
    from station.lock_in.settings import Settings


@click.command("list")
@click.option("--lan/--no-lan", default=True, help="Search the network too, for two seconds.  [default: --lan]")
@transcript_option
@unused_config_option
@json_option
def list_command(lan: bool, as_json: bool) -> int:
    """List the instruments that VISA can see, and say why one cannot be used.

    A name that is not listed may work all the same: raw TCP sockets cannot be found by looking, and on a slow
    network an instrument may need longer than it is waited for.
    """
    from instrument import find_resources

    if lan:
        remark("looking for instruments, on the network too...")
    found = find_resources(lan=lan)
    if as_json:
        print_json(
            {
                "resources": [
                    {
                        "resource": one.resource_name,
                        "identity": one.identity.text if one.identity else None,
                        "problem": one.problem,
                    }
                    for one in found
                ]
            }
        )
        return 0
    for one in found:
        say(f"{one.resource_name}\t{one.identity.text if one.identity else one.problem}")
    usable = sum(one.identity is not None for one in found)
    looked = f"serial ports, USB and GPIB{' and the network' if lan else ''}"
    hint = (
        "" if usable else ". `gyrolock doctor` says which links can be used here; give others by --resource NAME"
    )
    say(f"{usable} of {len(found)} names on {looked} answer{hint}", answer=True)
    return 0


# --------------------
# ``gyrolock grab``: the screen and the traces of an oscilloscope


@click.command("grab")
@click.option("--resource", metavar="NAME", help="VISA name of the oscilloscope. Without one it is simulated.")
@click.option("--baud", type=click.IntRange(300, 115_200), metavar="N", help="Speed of an RS-232 line.")
@click.option(
    "--channel", "channels", multiple=True, metavar="CH1|1", help="Only this one; else all that are on the screen."
)
@click.option(
    "--to",
    "folder",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path(),
    help="Folder for the files.",
)
@click.option("--screen/--no-screen", default=True, help="Whether to save the picture (80 s on RS-232).")
@click.option(
    "--watch", type=click.FloatRange(min=0.1), metavar="SECONDS", help="Repeat every SECONDS until Ctrl-C."
)
@click.option("--numbers", "numbers_only", is_flag=True, help="Only show the numbers; write no files.")
@transcript_option
@config_option
@json_option
def grab_command(
    resource: str | None,
    baud: int | None,
    channels: tuple[str, ...],
    folder: Path,
    screen: bool,
    watch: float | None,
    numbers_only: bool,
    config: Path | None,
    as_json: bool,
) -> int:
    """Save the screen as PNG and the traces as CSV and NumPy, and show volts peak to peak and frequency.

    A scope that runs takes one record of all traces; one that is stopped keeps what it holds. The front panel is
    put back afterwards.
    """
    from station.lock_in.settings import load_settings
    from station.scope.tools import grab_traces, write_grab

    settings = load_settings(config)
    grabbed = []
    with ExitStack() as stack, suppress(KeyboardInterrupt):
        scope = _open(stack, resource, baud, settings)
        while True:
            traces = grab_traces(scope, [f"CH{name}" if name.isdigit() else name.upper() for name in channels])
            picture = scope.screen().png if screen and not numbers_only else None
            name = f"grab-{datetime.now():%Y%m%d-%H%M%S-%f}"[:-3]
            files = [] if numbers_only else write_grab(folder, name, traces, picture)
            found = {
                "traces": {
                    trace.channel: {
                        "peak_to_peak_v": trace.peak_to_peak,
                        "frequency_hz": trace.frequency,
                        "clipped": trace.waveform.clipped,
                    }
                    for trace in traces
                },
                "files": [str(path) for path in files],
            }
            grabbed.append(found)
            told = "; ".join(map(str, traces)) or "nothing is on the screen"
            remark(told) if as_json else say(told, answer=True)
            if watch is None:
                break
            time.sleep(watch)
    if as_json:
        print_json({"grabs": grabbed})
    elif grabbed and not numbers_only:
        for path in grabbed[-1]["files"]:
            say(str(path))
    return 0


def _open(stack: ExitStack, resource: str | None, baud: int | None, settings: Settings) -> TDS2014:
    """The scope by its name, or a simulated one in this process."""
    from instrument import TDS2014

    if resource is not None:
        return stack.enter_context(TDS2014(resource, baud_rate=baud))
    from instrument.simulated import resource_manager
    from station.lock_in.served import simulated_scopes

    name = "GPIB0::1::INSTR"
    manager = resource_manager(scopes={name: simulated_scopes(settings)[0]})
    stack.callback(manager.close)
    return stack.enter_context(TDS2014(name, resource_manager=manager))


# --------------------
# ``gyrolock simulate``: serve simulated oscilloscopes


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
def simulate_command(
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
    from station.controllers import served_controllers
    from station.lock_in.served import scope_on_table, simulated_scopes
    from station.lock_in.settings import load_settings
    from station.scope.tools import parse_fault, parse_signal, served

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
                say(name, answer=True)
        # a wait without end could not be interrupted on Windows
        while not found.wait(timeout=0.5):
            pass
    return 0


def _replay(path: Path, link: str, port: int, as_json: bool) -> int:
    """Serve the instrument of a transcript."""
    from instrument.simulated.controllers import LineServer, Replay
    from instrument.text_files import read_transcript

    if link != "tcp":
        raise click.UsageError("--replay serves on --tcp only")
    try:
        server = LineServer(Replay(read_transcript(path)), tcp_port=port)
    except OSError as error:
        raise UsageError(f"the transcript cannot be served: {error.strerror or error}") from None
    with suppress(KeyboardInterrupt), server:
        if as_json:
            print_json({"resource": server.resource_name, "resources": [server.resource_name]})
        else:
            say(server.resource_name, answer=True)
        while not server.ended.wait(timeout=0.5):
            pass
    return 0
