"""Checksums of frames, by the names that data sheets use."""

from __future__ import annotations

import binascii
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import xor


@dataclass(frozen=True)
class Checksum:
    """A checksum: how many bytes it has, and how it follows from the bytes that it covers."""

    size: int
    compute: Callable[[bytes], int]


def _modbus(data: bytes) -> int:
    register = 0xFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register >> 1) ^ (0xA001 if register & 1 else 0)
    return register


CHECKSUMS: dict[str, Checksum] = {
    "sum8": Checksum(1, lambda data: sum(data) & 0xFF),
    # All bytes and the checksum itself add up to zero.
    "sum8-negated": Checksum(1, lambda data: -sum(data) & 0xFF),
    "xor8": Checksum(1, lambda data: reduce(xor, data, 0)),
    "sum16": Checksum(2, lambda data: sum(data) & 0xFFFF),
    # Polynomial 0x1021, not reflected: "CCITT" in most data sheets is the first of these two.
    "crc16-ccitt-false": Checksum(2, lambda data: binascii.crc_hqx(data, 0xFFFF)),
    "crc16-xmodem": Checksum(2, lambda data: binascii.crc_hqx(data, 0)),
    "crc16-modbus": Checksum(2, _modbus),
    "crc32": Checksum(4, zlib.crc32),
}
