"""Checksums of frames and commands: those with a name, and any CRC by its parameters."""

from __future__ import annotations

import binascii
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import xor
from typing import Literal

ByteOrder = Literal["little", "big"]


@dataclass(frozen=True)
class Checksum:
    """A checksum: how many bytes it has, and how it follows from the bytes that it covers."""

    size: int
    compute: Callable[[bytes], int]


def crc(
    width: int,
    polynomial: int,
    *,
    initial: int = 0,
    reflect_in: bool = False,
    reflect_out: bool = False,
    xor_out: int = 0,
) -> Checksum:
    """A CRC by the parameters of the usual catalogue (R. N. Williams, "A painless guide to CRC", 1993).

    Examples
    --------
    >>> hex(crc(32, 0x04C11DB7, initial=0xFFFFFFFF).compute(b"123456789"))  # CRC-32/MPEG-2
    '0x376e6e7'
    """
    step = _reflected_steps if reflect_in else _plain_steps
    compute = step(width, polynomial, initial)
    turn = reflect_in != reflect_out

    def value(data: bytes) -> int:
        register = compute(data)
        return (_reflected(register, width) if turn else register) ^ xor_out

    return Checksum((width + 7) // 8, value)


def _reflected(value: int, width: int) -> int:
    return int(format(value, f"0{width}b")[::-1], 2)


def _plain_steps(width: int, polynomial: int, initial: int) -> Callable[[bytes], int]:
    top, mask, shift = 1 << (width - 1), (1 << width) - 1, width - 8

    def of_byte(byte: int) -> int:
        register = byte << shift
        for _ in range(8):
            register = (register << 1) ^ polynomial if register & top else register << 1
        return register & mask

    table = [of_byte(byte) for byte in range(256)]

    def compute(data: bytes) -> int:
        register = initial
        for byte in data:
            register = (register << 8 & mask) ^ table[(register >> shift) ^ byte]
        return register

    return compute


def _reflected_steps(width: int, polynomial: int, initial: int) -> Callable[[bytes], int]:
    turned, begin = _reflected(polynomial, width), _reflected(initial, width)

    def of_byte(byte: int) -> int:
        register = byte
        for _ in range(8):
            register = (register >> 1) ^ turned if register & 1 else register >> 1
        return register

    table = [of_byte(byte) for byte in range(256)]

    def compute(data: bytes) -> int:
        register = begin
        for byte in data:
            register = (register >> 8) ^ table[(register ^ byte) & 0xFF]
        return register

    return compute


CHECKSUMS: dict[str, Checksum] = {
    "sum8": Checksum(1, lambda data: sum(data) & 0xFF),
    # All bytes and the checksum itself add up to zero.
    "sum8-negated": Checksum(1, lambda data: -sum(data) & 0xFF),
    "xor8": Checksum(1, lambda data: reduce(xor, data, 0)),
    "sum16": Checksum(2, lambda data: sum(data) & 0xFFFF),
    # Polynomial 0x1021, not reflected: "CCITT" in most data sheets is the first of these two.
    "crc16-ccitt-false": Checksum(2, lambda data: binascii.crc_hqx(data, 0xFFFF)),
    "crc16-xmodem": Checksum(2, lambda data: binascii.crc_hqx(data, 0)),
    "crc16-modbus": crc(16, 0x8005, initial=0xFFFF, reflect_in=True, reflect_out=True),
    "crc32": Checksum(4, zlib.crc32),
    "crc32-mpeg2": crc(32, 0x04C11DB7, initial=0xFFFFFFFF),
}


@dataclass(frozen=True)
class CheckRule:
    """Which checksum the messages and frames of a gyro carry, and over what."""

    checksum: Checksum  # one of `CHECKSUMS`, or a `crc`
    skips: bytes  # the header, if the checksum does not cover it; else empty
    mark: bytes  # what stands in front of the checksum and is not covered; only in text, else empty
    byte_order: ByteOrder
    # bytes at the begin of a frame that it does not cover, where these are not just the header
    begins: int | None = None

    @property
    def size(self) -> int:
        """Bytes of the checksum itself; text spells each with two hex digits."""
        return self.checksum.size

    def of(self, before: bytes, *, start: int | None = None, binary: bool) -> bytes:
        """The checksum as it is sent, over what stands `before` it, from byte `start` on if that is given."""
        if start is None:
            start = len(self.skips) if before.startswith(self.skips) else 0
        covered = before[start:].removesuffix(self.mark) if self.mark else before[start:]
        value = self.checksum.compute(covered)
        return value.to_bytes(self.size, self.byte_order) if binary else b"%0*X" % (2 * self.size, value)

    def of_frame(self, before: bytes, *, binary: bool) -> bytes:
        """The checksum of a frame, over what stands `before` it in the frame."""
        return self.of(before, start=self.begins, binary=binary)
