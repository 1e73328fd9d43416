"""The picture of the screen in every format, and waveforms as the files that the scope saves."""

import io
import itertools
import math
import struct
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from instrument.scpi import DIVISIONS, LEVELS_PER_DIVISION, NO_DATA, POINTS_PER_DIVISION
from instrument.simulated.front_end.traces import Trace

WIDTH, HEIGHT = 320, 240
_LEFT, _TOP, _DIVISION = 20, 16, 25  # pixels; ten by eight divisions
_BLACK, _GREY, _FRAME = 0, 1, 2
COLOURS = (
    (255, 255, 255), (176, 176, 176), (0, 0, 0), (200, 160, 0), (0, 120, 200), (200, 0, 160), (0, 150, 60),
    (200, 40, 0), (90, 90, 90),
)  # fmt: skip

Pixels = NDArray[np.uint8]


def draw(traces: Mapping[str, Trace]) -> Pixels:
    """Graticule and traces as colour numbers, shape (240, 320), first row on top."""
    pixels = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    right, bottom = _LEFT + 10 * _DIVISION, _TOP + 8 * _DIVISION
    pixels[_TOP : bottom + 1 : 5, _LEFT : right + 1 : _DIVISION] = _GREY
    pixels[_TOP : bottom + 1 : _DIVISION, _LEFT : right + 1 : 5] = _GREY
    pixels[[_TOP, bottom], _LEFT : right + 1] = _FRAME
    pixels[_TOP : bottom + 1, [_LEFT, right]] = _FRAME
    for number, trace in enumerate(traces.values()):
        # a vertical bar per column from its lowest to its highest code
        edges = np.arange(10 * _DIVISION + 1) * len(trace.codes) // (10 * _DIVISION)
        columns = [trace.codes[start : max(stop, start + 1)] for start, stop in itertools.pairwise(edges)]
        middle = _TOP + 4 * _DIVISION
        for x, codes in enumerate(columns, start=_LEFT):
            valid = codes[codes != NO_DATA]
            if len(valid):
                rows = middle - np.array([valid.max(), valid.min()], dtype=int) * _DIVISION // LEVELS_PER_DIVISION
                high, low = np.clip(rows, _TOP, _TOP + 8 * _DIVISION)
                pixels[high : low + 1, x] = 3 + number % (len(COLOURS) - 3)
    return pixels


# --------------------
# Picture files of the screen: BMP, RLE (a packed BMP), PCX, TIFF and EPS.
#
# Each function takes colour numbers, shape (height, width), first row on top, and gives the bytes of a file.
# Pillow writes BMP and PCX. It packs no bitmap, puts the directory of a TIFF in front, where programs that read
# the scope's do not look, and draws no PostScript in black and white: those are ours, after the published
# descriptions of the Windows bitmap, TIFF 6.0 and encapsulated PostScript 3.0


_PALETTE = np.zeros((256, 3), dtype=np.uint8)  # red, green, blue
_PALETTE[: len(COLOURS)] = COLOURS
_SHORT, _LONG = 3, 4  # TIFF types


def _file(pixels: Pixels, name: str) -> bytes:
    """A file with 256 colours in a format that Pillow writes."""
    from PIL import Image  # takes 20 ms to import, and few sessions need a picture

    picture, file = Image.fromarray(pixels), io.BytesIO()
    picture.putpalette(_PALETTE.tobytes())
    picture.save(file, name)
    return file.getvalue()


def bitmap(pixels: Pixels) -> bytes:
    """An uncompressed Windows bitmap with 256 colours."""
    return _file(pixels, "BMP")


def packed_bitmap(pixels: Pixels) -> bytes:
    """A Windows bitmap with run lengths (RLE8): header and palette are those of the uncompressed one."""
    plain = bytearray(bitmap(pixels))
    (offset,) = struct.unpack_from("<10xI", plain)
    body = b"".join(b"".join(bytes(run) for run in _runs(row)) + b"\0\0" for row in pixels[::-1]) + b"\0\1"
    struct.pack_into("<I", plain, 2, offset + len(body))
    struct.pack_into("<II", plain, 30, 1, len(body))  # compression, bytes of the picture
    return bytes(plain[:offset]) + body


def pcx(pixels: Pixels) -> bytes:
    """PCX version 5 with 256 colours."""
    return _file(pixels, "PCX")


def tiff(pixels: Pixels) -> bytes:
    """Uncompressed TIFF with a palette, little-endian, one strip; the directory stands at its end."""
    height, width = pixels.shape
    body = np.ascontiguousarray(pixels).tobytes()
    colours = (_PALETTE.T.astype("<u2") * 257).tobytes()
    at_body, at_colours = 8, 8 + len(body)
    entries = (
        (256, _SHORT, 1, width),
        (257, _SHORT, 1, height),
        (258, _SHORT, 1, 8),  # bits a sample
        (259, _SHORT, 1, 1),  # not compressed
        (262, _SHORT, 1, 3),  # palette
        (273, _LONG, 1, at_body),
        (277, _SHORT, 1, 1),  # samples a pixel
        (278, _SHORT, 1, height),  # rows a strip
        (279, _LONG, 1, len(body)),
        (320, _SHORT, 768, at_colours),
    )
    directory = struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", *entry) for entry in entries)
    header = struct.pack("<2sHI", b"II", 42, at_colours + len(colours))
    return header + body + colours + directory + struct.pack("<I", 0)


def eps(pixels: Pixels) -> bytes:
    """Encapsulated PostScript, black and white: everything that is not background is black."""
    height, width = pixels.shape
    rows = np.packbits(pixels == 0, axis=1)
    lines = [
        "%!PS-Adobe-3.0 EPSF-3.0",
        f"%%BoundingBox: 0 0 {width} {height}",
        "%%EndComments",
        f"/row {rows.shape[1]} string def",
        f"{width} {height} scale",
        f"{width} {height} 1 [{width} 0 0 {-height} 0 {height}]",
        "{currentfile row readhexstring pop} image",
        *(row.tobytes().hex() for row in rows),
        "showpage",
        "%%EOF",
    ]
    return ("\n".join(lines) + "\n").encode("ascii")


def _runs(row: NDArray[np.uint8]) -> Iterator[tuple[int, int]]:
    """Counts, up to 255, and values of equal neighbours."""
    starts = np.flatnonzero(np.diff(row, prepend=row[0] ^ np.uint8(1)))
    for start, stop in zip(starts, [*starts[1:], len(row)], strict=True):
        left = int(stop - start)
        while left:
            yield min(left, 255), int(row[start])
            left -= min(left, 255)


FORMATS: dict[str, Callable[[Pixels], bytes]] = {
    "BMP": bitmap,
    "RLE": packed_bitmap,
    "PCX": pcx,
    "TIFF": tiff,
    "EPSIMAGE": eps,
}


# --------------------
# The CSV file of one waveform as these instruments write it: key rows beside the first points.
#
# Taken from files of real units. A point at the time zero of a record that begins before its trigger is written
# with a minus sign, as they do


_UNITS = {"Volts": "V"}


def csv_file(trace: Trace, source: str, probe: float, keys: dict[str, str]) -> bytes:
    """Content of the file."""
    spectrum = trace.xunit == "Hz"
    width = trace.points / DIVISIONS if spectrum else POINTS_PER_DIVISION
    values = (trace.codes.astype(np.float64) - trace.yoff) * trace.ymult + trace.yzero
    rows = [
        ("Record Length", f"{trace.points:e}"),
        ("Sample Interval", f"{trace.xincr:e}"),
        ("Trigger Point", f"{0.0 if spectrum else -trace.xzero / trace.xincr:.12e}"),
        *[("", "")] * 3,
        ("Source", f"REF{'ABCD'.index(source[-1]) + 1}" if source.startswith("REF") else source),
        ("Vertical Units", _UNITS.get(trace.yunit, trace.yunit)),
        ("Vertical Scale", f"{trace.ymult * LEVELS_PER_DIVISION:e}"),
        ("Vertical Offset", f"{trace.yoff * trace.ymult:e}"),
        ("Horizontal Units", trace.xunit),
        ("Horizontal Scale", f"{trace.xincr * width:e}"),
        ("Pt Fmt", trace.pt_fmt),
        ("Yzero", f"{trace.yzero:e}"),
        ("Probe Atten", f"{probe:e}"),
        *keys.items(),
    ]
    digits = 5 if spectrum else 12
    times = trace.xzero + trace.xincr * np.arange(trace.points)
    first = f"{times[0]:.{digits}f}"
    lines = []
    for number, (time, value) in enumerate(zip(times.tolist(), values.tolist(), strict=True)):
        key, text = rows[number] if number < len(rows) else ("", "")
        when = f"{time:17.{digits}f}" if number < len(rows) else _narrow(time, digits, first)
        lines.append(f"{key},{text},,{when},{value + 0.0:10.5f},\n")
    return "".join(lines).encode("ascii")


def _narrow(time: float, digits: int, first: str) -> str:
    """A time below the key rows: zeros up to the width of the first one, behind the sign."""
    size = f"{abs(time):.{digits}f}".rjust(len(first), "0")
    is_zero = not float(size)
    negative = first.startswith("-") if is_zero else math.copysign(1.0, time) < 0
    return f"-{size}" if negative else size
