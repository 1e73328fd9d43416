"""``gyrolock grab``: the screen and the traces of an oscilloscope."""

from __future__ import annotations

import time
from contextlib import ExitStack, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from station.shell.options import config_option, json_option, transcript_option
from station.terminal.lines import print_json, remark, say

if TYPE_CHECKING:
    from instrument import TDS2014
    from station.lock_in.settings import Settings


@click.command("grab")
@click.option("--resource", metavar="NAME", help="VISA name of the oscilloscope. Without one it is simulated.")
@click.option("--baud", type=click.IntRange(300, 115_200), metavar="N", help="Speed of an RS-232 line.")
@click.option(
    "--channel", "channels", multiple=True, metavar="CHn", help="Only this one; else all that are on the screen."
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
    "--watch",
    type=click.FloatRange(min=0.1),
    metavar="SECONDS",
    help="Again and again, so far apart, until Ctrl-C.",
)
@click.option("--numbers", "numbers_only", is_flag=True, help="Only show the numbers; write no files.")
@transcript_option
@config_option
@json_option
def command(
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
    from station.scope.grab import grab_traces, write_grab

    settings = load_settings(config)
    grabbed = []
    with ExitStack() as stack, suppress(KeyboardInterrupt):
        scope = _open(stack, resource, baud, settings)
        while True:
            traces = grab_traces(scope, [name.upper() for name in channels])
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
            tell = remark if as_json else say
            tell("; ".join(map(str, traces)) or "nothing is on the screen")
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
