"""``gyrolock fog sniff``: which description of frames fits a gyro."""

from __future__ import annotations

import stat
from pathlib import Path

import click

from station.errors import EXIT_NO_SIGNAL, EXIT_OK
from station.shell.options import json_option, transcript_option


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
@json_option
def command(
    source: str, own: tuple[Path, ...], seconds: float, baud: int | None, poll: bool, as_json: bool
) -> int:
    """Find the frame format of a gyro on a serial PORT, or of bytes saved in a FILE.

    Every description that comes with the program, and yours, is tried: frames, rate by the computer's clock, gaps
    of the counter, checksums, bytes left over. One is proposed; if none fits, the length of the frames and what is
    constant in them is shown (exit code 4).
    """
    from station.fibre_gyro.sniff.known import known_formats
    from station.fibre_gyro.sniff.search import sniff_file, sniff_port
    from station.fibre_gyro.sniff.shown import document_of, show
    from station.terminal.lines import print_json, remark

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
