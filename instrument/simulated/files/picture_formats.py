"""Picture files of the screen: BMP, RLE (a packed BMP), PCX, TIFF and EPS.

Each function takes colour numbers, shape (height, width), first row on top, and gives the bytes of a file. Pillow
writes BMP and PCX. It packs no bitmap, puts the directory of a TIFF in front, where programs that read the scope's
do not look, and draws no PostScript in black and white: those are ours, after the published descriptions of the
Windows bitmap, TIFF 6.0 and encapsulated PostScript 3.0.
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
