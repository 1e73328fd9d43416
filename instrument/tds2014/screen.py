"""The picture of the scope's screen: fetched as BMP, given as PNG."""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from pathlib import Path

from instrument.errors import ScopeEvent, TransferError
from instrument.tds2014.session import Session

_PICTURE_TIME = 10.0  # s until the first byte: the scope draws the whole picture first


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
        words = ["GPIB", "USB"] if dialogue.link.on_bus else ["RS232"]
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
        width, bits, compression = struct.unpack_from("<18xi4x2xHI16x", bmp)
    except struct.error:
        raise TransferError(f"a picture of {len(bmp)} bytes is too short to be one; ask again") from None
    if bmp[:2] != b"BM" or compression or bits not in (1, 4, 8, 24) or width <= 0:
        raise TransferError(f"the picture is no plain BMP ({bits} bits, compression {compression}); ask again")
    from PIL import Image  # takes 20 ms to import, and few sessions need a picture

    png = io.BytesIO()
    try:
        with Image.open(io.BytesIO(bmp), formats=["BMP"]) as picture:
            picture.save(png, "PNG")
    except (OSError, ValueError, Image.DecompressionBombError):
        raise TransferError("the picture is cut; ask again") from None
    return png.getvalue()
