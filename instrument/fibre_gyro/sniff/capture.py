"""Some seconds of bytes, from a port with their times, or from a file."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import serial

from instrument.errors import LinkError
from instrument.fibre_gyro.frame_format.layout import FrameFormat
from instrument.fibre_gyro.frame_format.messages import compose
from instrument.fibre_gyro.link import drop_backlog, open_port

LOOKED_AT = 500_000
"""Bytes of a file that are looked at."""


@dataclass(frozen=True)
class Capture:
    """Bytes as they came."""

    # (float, bytes): Time in s by the computer's clock at which a piece was read, and its bytes. From a file there
    # is one piece.
    pieces: tuple[tuple[float, bytes], ...]
    line: str = ""  # how the port was set, "115200 baud 8N1"; empty for a file
    timed: bool = False  # whether the times mean anything

    @property
    def data(self) -> bytes:
        """All bytes."""
        return b"".join(piece for _, piece in self.pieces)

    @property
    def size(self) -> int:
        """How many bytes came."""
        return sum(len(piece) for _, piece in self.pieces)

    @property
    def seconds(self) -> float:
        """From the first piece to the last; 0 for a file."""
        return self.pieces[-1][0] - self.pieces[0][0] if self.timed and self.pieces else 0.0


def capture_port(port: str, layout: FrameFormat, seconds: float, *, poll: bytes = b"") -> Capture:
    """Listen to a port with the line settings of a format."""
    opened = open_port(port, layout)
    pieces: list[tuple[float, bytes]] = []
    try:
        drop_backlog(opened)
        began = due = time.monotonic()
        while (now := time.monotonic()) < began + seconds:
            if poll and now >= due:
                opened.write(poll)
                due = max(due + layout.interval_s, now)
            if data := bytes(opened.read(4096)):
                pieces.append((time.monotonic() - began, data))
    except (serial.SerialException, OSError) as error:
        raise LinkError(f"reading from {port} failed, the link is lost: {error}") from error
    finally:
        opened.close()
    return Capture(tuple(pieces), line_of(layout), timed=True)


def captured_file(path: Path) -> Capture:
    """The first bytes of a file; OSError if it cannot be read."""
    with path.open("rb") as file:
        return Capture(((0.0, file.read(LOOKED_AT)),))


def poll_of(layout: FrameFormat) -> bytes:
    """What a gyro is asked with for one frame; empty where it sends by itself."""
    return b"" if layout.poll is None else compose(layout.poll, 0, layout.check)


def line_of(layout: FrameFormat) -> str:
    """How a format sets the port.

    Examples
    --------
    >>> from instrument.fibre_gyro import parse_frame_format
    >>> fields = [{"name": "counts", "bytes": 4}]
    >>> line_of(parse_frame_format({"kind": "binary", "output_rate_hz": 1, "header": "55", "fields": fields}))
    '115200 baud 8N1'
    """
    return f"{layout.baud_rate} baud {layout.data_bits}{layout.parity}{layout.stop_bits}"
