"""The picture of the scope's screen: fetched as BMP, given as PNG."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from instrument.errors import ScopeEvent, TransferError
from instrument.tds2014.session import Session

_PICTURE_TIME = 10.0  # s until the first byte: the scope draws the whole picture first
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PALETTE, _RGB = 3, 2  # colour types of PNG


@dataclass(frozen=True)
class ScreenPicture:
    """A picture of the screen; a notebook shows it by itself.

    Attributes
    ----------
    png : bytes
        The picture as a PNG file.
    """

    png: bytes

    def save(self, path: str | Path) -> None:
        """Write the PNG file. OSError if that is not possible."""
        Path(path).write_bytes(self.png)

    def _repr_png_(self) -> bytes:
        return self.png


class Screen:
    """Has the scope draw its screen for us."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def screen(self) -> ScreenPicture:
        """Picture of the screen, as PNG. Over RS-232 it takes about 80 s at 9600 baud."""
        self._session.panel.remember("HARDCOPY")
        self._choose_port()
        return ScreenPicture(png_from_bmp(self._session.dialogue.picture(wait=_PICTURE_TIME)))

    def _choose_port(self) -> None:
        """Send pictures to our own link: first the word that fits it, then the others that this unit may know."""
        dialogue = self._session.dialogue
        words = ["GPIB", "USB"] if dialogue.link.framed else ["RS232"]
        if dialogue.link.name.upper().startswith("USB"):
            words.reverse()
        for word in words:
            try:
                dialogue.command(f":HARDCOPY:FORMAT BMP;PORT {word}")
            except ScopeEvent:
                if word == words[-1]:
                    raise
            else:
                return


def png_from_bmp(bmp: bytes) -> bytes:
    """Turn an uncompressed BMP file of 1, 4, 8 or 24 bits a pixel into a PNG file of the same pixels.

    Raises
    ------
    TransferError
        If it is not such a file, or is cut.
    """
    try:
        first, _, width, height, _, bits, compression = struct.unpack_from("<10xIIiiHHI", bmp)
        (colours,) = struct.unpack_from("<46xI", bmp)
    except struct.error:
        raise TransferError(f"a picture of {len(bmp)} bytes is too short to be one; ask again") from None
    if bmp[:2] != b"BM" or compression or bits not in (1, 4, 8, 24) or width <= 0:
        raise TransferError(f"the picture is no plain BMP ({bits} bits, compression {compression}); ask again")
    rows = _rows(bmp, first, width, height, bits)
    palette = b""
    if bits == 24:
        rows = np.ascontiguousarray(rows.reshape(abs(height), width, 3)[:, :, ::-1]).reshape(abs(height), -1)
    else:
        palette = _palette(bmp, colours or 2**bits)
    kind, depth = (_RGB, 8) if bits == 24 else (_PALETTE, bits)
    filtered = np.insert(rows, 0, 0, axis=1).tobytes()  # before each row: no filter
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, abs(height), depth, kind, 0, 0, 0))]
    if palette:
        chunks.append((b"PLTE", palette))
    chunks += [(b"IDAT", zlib.compress(filtered, 9)), (b"IEND", b"")]
    return _PNG_SIGNATURE + b"".join(_chunk(name, data) for name, data in chunks)


def _rows(bmp: bytes, first: int, width: int, height: int, bits: int) -> NDArray[np.uint8]:
    """Packed pixels, one row each from top to bottom, without the padding to whole words."""
    stride = (width * bits + 31) // 32 * 4
    data = np.frombuffer(bmp, dtype=np.uint8)[first : first + stride * abs(height)]
    if data.size != stride * abs(height):
        raise TransferError("the picture is cut; ask again")
    rows = data.reshape(abs(height), stride)[:, : (width * bits + 7) // 8]
    # A positive height means that the lowest row comes first.
    return rows[::-1] if height > 0 else rows


def _palette(bmp: bytes, colours: int) -> bytes:
    (header_length,) = struct.unpack_from("<14xI", bmp)
    start = 14 + header_length
    entries = np.frombuffer(bmp[start : start + 4 * colours], dtype=np.uint8)
    if entries.size != 4 * colours:
        raise TransferError("the palette of the picture is cut; ask again")
    return entries.reshape(-1, 4)[:, 2::-1].tobytes()


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
