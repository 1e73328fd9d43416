"""Picture files of the screen: BMP, RLE (a packed BMP), PCX, TIFF and EPS.

Each function takes colour numbers, shape (height, width), first row on top, and gives the bytes of a file.
Sources: the published descriptions of the Windows bitmap, PCX version 5, TIFF 6.0 and encapsulated PostScript 3.0.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from instrument.simulated.files.screen import COLOURS, Pixels

_PALETTE = np.zeros((256, 3), dtype=np.uint8)  # red, green, blue
_PALETTE[: len(COLOURS)] = COLOURS
_SHORT, _LONG = 3, 4  # TIFF types


def bitmap(pixels: Pixels) -> bytes:
    """An uncompressed Windows bitmap with 256 colours."""
    return _windows_bitmap(pixels, np.ascontiguousarray(pixels[::-1]).tobytes(), compression=0)


def packed_bitmap(pixels: Pixels) -> bytes:
    """A Windows bitmap with run lengths (RLE8)."""
    body = b"".join(b"".join(bytes(run) for run in _runs(row, 255)) + b"\0\0" for row in pixels[::-1])
    return _windows_bitmap(pixels, body + b"\0\1", compression=1)


def _windows_bitmap(pixels: Pixels, body: bytes, compression: int) -> bytes:
    palette = np.zeros((256, 4), dtype=np.uint8)
    palette[:, :3] = _PALETTE[:, ::-1]
    height, width = pixels.shape
    offset = 14 + 40 + palette.nbytes
    header = struct.pack("<2sIHHI", b"BM", offset + len(body), 0, 0, offset)
    info = struct.pack("<IiiHHIIiiII", 40, width, height, 1, 8, compression, len(body), 2835, 2835, 256, 0)
    return header + info + palette.tobytes() + body


def pcx(pixels: Pixels) -> bytes:
    """PCX version 5 with 256 colours."""
    height, width = pixels.shape
    corners = struct.pack("<4H", 0, 0, width - 1, height - 1)
    header = bytes((10, 5, 1, 8)) + corners + struct.pack("<2H", 72, 72) + bytes(48)
    header += struct.pack("<BBHH", 0, 1, width + width % 2, 1)
    padded = np.pad(pixels, ((0, 0), (0, width % 2)))
    body = b"".join(_pcx_run(*run) for row in padded for run in _runs(row, 63))
    return header.ljust(128, b"\0") + body + b"\x0c" + _PALETTE.tobytes()


def _pcx_run(count: int, value: int) -> bytes:
    return bytes((value,)) if count == 1 and value < 0xC0 else bytes((0xC0 | count, value))


def tiff(pixels: Pixels) -> bytes:
    """Uncompressed TIFF with a palette, little-endian, one strip."""
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


def _runs(row: NDArray[np.uint8], longest: int) -> Iterator[tuple[int, int]]:
    """Counts and values of equal neighbours."""
    starts = np.flatnonzero(np.diff(row, prepend=row[0] ^ np.uint8(1)))
    for start, stop in zip(starts, [*starts[1:], len(row)], strict=True):
        left = int(stop - start)
        while left:
            yield min(left, longest), int(row[start])
            left -= min(left, longest)


FORMATS: dict[str, Callable[[Pixels], bytes]] = {
    "BMP": bitmap,
    "RLE": packed_bitmap,
    "PCX": pcx,
    "TIFF": tiff,
    "EPSIMAGE": eps,
}
