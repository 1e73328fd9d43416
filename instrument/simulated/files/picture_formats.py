"""Picture files of the screen: BMP, RLE (a packed BMP), PCX, TIFF and EPS.

Each function takes colour numbers, shape (height, width), first row on top, and gives the bytes of a file. Pillow
writes what it can; the packed bitmap and the PostScript of black and white are ours, after the published
descriptions of the Windows bitmap and of encapsulated PostScript 3.0.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from instrument.simulated.files.screen import COLOURS, Pixels

_PALETTE = np.zeros((256, 3), dtype=np.uint8)  # red, green, blue
_PALETTE[: len(COLOURS)] = COLOURS


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
    """Uncompressed TIFF with a palette."""
    return _file(pixels, "TIFF")


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
