"""The frames of HiSLIP: a header of 16 bytes (prologue, type, control code, parameter, length) and a payload.

Source: IVI-6.1, High-Speed LAN Instrument Protocol, version 1.1, tables 2 to 4 and 12 to 14.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

_PROLOGUE = b"HS"
_HEADER = struct.Struct("!2sBBIQ")


class Kind(IntEnum):
    """Type of a frame."""

    INITIALIZE = 0
    INITIALIZE_RESPONSE = 1
    FATAL_ERROR = 2
    ERROR = 3
    ASYNC_LOCK = 4
    ASYNC_LOCK_RESPONSE = 5
    DATA = 6
    DATA_END = 7
    DEVICE_CLEAR_COMPLETE = 8
    DEVICE_CLEAR_ACKNOWLEDGE = 9
    ASYNC_REMOTE_LOCAL_CONTROL = 10
    ASYNC_REMOTE_LOCAL_RESPONSE = 11
    TRIGGER = 12
    INTERRUPTED = 13
    ASYNC_INTERRUPTED = 14
    ASYNC_MAXIMUM_MESSAGE_SIZE = 15
    ASYNC_MAXIMUM_MESSAGE_SIZE_RESPONSE = 16
    ASYNC_INITIALIZE = 17
    ASYNC_INITIALIZE_RESPONSE = 18
    ASYNC_DEVICE_CLEAR = 19
    ASYNC_SERVICE_REQUEST = 20
    ASYNC_STATUS_QUERY = 21
    ASYNC_STATUS_RESPONSE = 22
    ASYNC_DEVICE_CLEAR_ACKNOWLEDGE = 23
    ASYNC_LOCK_INFO = 24
    ASYNC_LOCK_INFO_RESPONSE = 25


VENDOR_KINDS = range(128, 256)


class Fatal(IntEnum):
    """Why a connection cannot go on."""

    POOR_HEADER = 1
    CHANNEL_MISSING = 2
    BAD_INITIALIZATION = 3
    TOO_MANY_CLIENTS = 4


class Mistake(IntEnum):
    """Why one frame is not carried out."""

    UNKNOWN_KIND = 1
    UNKNOWN_CONTROL_CODE = 2
    UNKNOWN_VENDOR_KIND = 3
    TOO_LARGE = 4


_WORDS: dict[IntEnum, bytes] = {
    Fatal.POOR_HEADER: b"Poorly formed message header",
    Fatal.CHANNEL_MISSING: b"Attempt to use connection without both channels established",
    Fatal.BAD_INITIALIZATION: b"Invalid initialization sequence",
    Fatal.TOO_MANY_CLIENTS: b"Server refused connection due to maximum number of clients exceeded",
    Mistake.UNKNOWN_KIND: b"Unrecognized message type",
    Mistake.UNKNOWN_CONTROL_CODE: b"Unrecognized control code",
    Mistake.UNKNOWN_VENDOR_KIND: b"Unrecognized vendor defined message",
    Mistake.TOO_LARGE: b"Message too large",
}


class PoorHeader(Exception):
    """What came is no HiSLIP; the stream cannot be understood from here on."""


@dataclass(frozen=True)
class Frame:
    """One frame."""

    kind: int  # A `Kind`, or a number that none of them has
    control: int = 0  # their meaning depends on the kind
    parameter: int = 0
    payload: bytes = b""
    too_large: bool = False  # it announced a longer payload than is taken; that was thrown away

    def encoded(self) -> bytes:
        """The bytes that travel.

        Examples
        --------
        >>> Frame(Kind.DATA_END, 0, 0xFFFFFF00, b"*IDN?").encoded().hex(" ", -4)
        '48530700 ffffff00 00000000 00000005 2a49444e 3f'
        """
        header = _HEADER.pack(_PROLOGUE, self.kind, self.control, self.parameter, len(self.payload))
        return header + self.payload


def fatal(reason: Fatal) -> Frame:
    """The last frame of a connection."""
    return Frame(Kind.FATAL_ERROR, reason, 0, _WORDS[reason])


def mistake(reason: Mistake) -> Frame:
    """The answer to a frame that is not carried out."""
    return Frame(Kind.ERROR, reason, 0, _WORDS[reason])


class FrameReader:
    """Cuts a stream of bytes into frames; `largest` is the longest payload that it collects."""

    def __init__(self, largest: int) -> None:
        self._largest = largest
        self._buffer = bytearray()
        self._skipping = 0

    def feed(self, data: bytes) -> Iterator[Frame]:
        """Take in bytes and give the frames that they complete; PoorHeader where there is no header."""
        self._buffer += data
        while True:
            if self._skipping:
                skipped = min(self._skipping, len(self._buffer))
                del self._buffer[:skipped]
                self._skipping -= skipped
            if self._buffer and not _PROLOGUE.startswith(bytes(self._buffer[:2])):
                raise PoorHeader
            if self._skipping or len(self._buffer) < _HEADER.size:
                return
            _, kind, control, parameter, length = _HEADER.unpack_from(self._buffer)
            if length > self._largest:
                del self._buffer[: _HEADER.size]
                self._skipping = length
                yield Frame(kind, control, parameter, too_large=True)
                continue
            if len(self._buffer) < _HEADER.size + length:
                return
            payload = bytes(self._buffer[_HEADER.size : _HEADER.size + length])
            del self._buffer[: _HEADER.size + length]
            yield Frame(kind, control, parameter, payload)
