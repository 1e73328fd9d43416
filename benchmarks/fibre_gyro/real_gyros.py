"""Frames as real fibre gyros send them, packed here by hand, without the product's encoder or checksums."""

from __future__ import annotations

import binascii
import math
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class RealGyro:
    """One kind of gyro.

    Attributes
    ----------
    file : str
        Shipped file of its description.
    name : str
        Of the description there.
    pack : callable
        Bytes of frame number n with a raw output (one number, or a triple).
    values : callable
        What is delivered of that frame, in the order of the description's columns, and its counter.
    axes : int
        Outputs in one frame.
    shipped : bool
        Whether the description is that of config/frames, else of config/fibre_gyro_frames.toml.
    """

    file: str
    name: str
    pack: Callable[..., bytes]
    values: Callable[..., tuple[int | None, tuple[float, ...]]]
    axes: int = 1


def xor_of(data: bytes) -> int:
    """Exclusive or of all bytes."""
    total = 0
    for byte in data:
        total = total ^ byte
    return total


def crc_bitwise(data: bytes, width: int, polynomial: int, register: int) -> int:
    """Polynomial division bit by bit, highest bit first."""
    for byte in data:
        for place in range(7, -1, -1):
            top = (register >> (width - 1) & 1) ^ (byte >> place & 1)
            register = register << 1 & ((1 << width) - 1)
            if top:
                register ^= polynomial
    return register


def crc_mpeg(data: bytes) -> int:
    """CRC-32/MPEG-2 by way of zlib's reflected one."""
    turned = bytes(int(f"{byte:08b}"[::-1], 2) for byte in data)
    return int(f"{zlib.crc32(turned) ^ 0xFFFFFFFF:032b}"[::-1], 2)


def sevens(value: int, count: int) -> bytes:
    """So many bytes of seven bits, low ones first."""
    return bytes(value >> 7 * place & 0x7F for place in range(count))


def temperature_of(n: int) -> int:
    """A temperature that creeps, in sixteenths of a deg C."""
    return 400 + n // 250


def float32(value: float) -> float:
    """The nearest number of single precision."""
    return float(struct.unpack(">f", struct.pack(">f", value))[0])


# ---------------------------------------------------------------------- one function for the bytes of each


def packed_7(n: int, raw: int) -> bytes:
    """80, five bytes of seven bits, xor."""
    body = sevens(raw & 0xFFFFFFFF, 5)
    return b"\x80" + body + bytes([xor_of(body)])


def packed_7_temperature(n: int, raw: int) -> bytes:
    """The same with a temperature of 14 bits and a second xor."""
    first = sevens(raw & 0xFFFFFFFF, 5)
    body = first + bytes([xor_of(first)]) + sevens(temperature_of(n), 2)
    return b"\x80" + body + bytes([xor_of(body)])


def packed_7_sum(n: int, raw: int) -> bytes:
    """80, four bytes of seven bits, high ones first, temperature, sum."""
    body = sevens(raw & 0xFFFFFFF, 4)[::-1] + bytes([temperature_of(n) // 16])
    return b"\x80" + body + bytes([sum(body) % 256])


def eb90(n: int, raw: int) -> bytes:
    """EB 90, four bytes, sum."""
    body = struct.pack("<i", raw)
    return b"\xeb\x90" + body + bytes([sum(body) % 256])


def eb90_temperature(n: int, raw: int) -> bytes:
    """EB 90, four bytes, temperature, sum."""
    body = struct.pack("<ih", raw, temperature_of(n))
    return b"\xeb\x90" + body + bytes([sum(body) % 256])


def header_99_66(n: int, raw: int) -> bytes:
    """99 66, A5, three bytes, temperature, sum."""
    body = b"\xa5" + struct.pack("<i", raw)[:3] + struct.pack("<h", temperature_of(n))
    return b"\x99\x66" + body + bytes([sum(body) % 256])


def dsp_3000_text(n: int, raw: int) -> bytes:
    """A line of text, deg/s with six decimals, and 1."""
    return f"{raw * 1e-6:.6f} 1\r\n".encode()


def dsp_3000_bits(n: int, raw: int, kind: int = 0) -> bytes:
    """32 bits: valid, two that count, two of type, odd parity, 26 of output."""
    word = 1 << 31 | n % 4 << 29 | kind << 27 | raw & 0x3FFFFFF
    if f"{word:b}".count("1") % 2 == 0:
        word |= 1 << 26
    return word.to_bytes(4, "big")


def kvh_1750(n: int, raw: tuple[int, int, int]) -> bytes:
    """Format A: three floats of rotation, three of acceleration, state, sequence, temperature, CRC."""
    body = (
        b"\xfe\x81\xff\x55"
        + struct.pack(">3f", *(one * 1e-10 for one in raw))
        + struct.pack(">3f", 0.0, 0.01, 1.0)
    )
    body += struct.pack(">BBh", 0x77, n % 128, temperature_of(n) // 16)
    return body + struct.pack(">I", crc_mpeg(body))


def kvh_1775_c(n: int, raw: tuple[int, int, int]) -> bytes:
    """Format C: a float in which four quantities take turns."""
    body = (
        b"\xfe\x81\xff\x57"
        + struct.pack(">3f", *(one * 1e-10 for one in raw))
        + struct.pack(">3f", 0.0, 0.01, 1.0)
    )
    body += struct.pack(">f", in_turn(n)) + struct.pack(">BB", 0x77, n % 128)
    return body + struct.pack(">I", crc_mpeg(body))


def in_turn(n: int) -> float:
    """What that float holds."""
    return (temperature_of(n) / 16, 0.21, -0.05, 0.44)[n % 4]


def low_high_mid(n: int, raw: int) -> bytes:
    """C0 C0, counter, low, high and middle byte, housekeeping in turn, CRC of eight bits."""
    low, mid, high = (raw >> shift & 0xFF for shift in (0, 8, 16))
    temperature = temperature_of(n - n % 4) * 8
    housekeeping = (temperature & 0xFF, temperature >> 8, 93, 1)[n % 4]
    body = bytes([n % 256, low, high, mid, housekeeping])
    return b"\xc0\xc0" + body + bytes([crc_bitwise(body, 8, 0x07, 0)])


def three_axes(n: int, raw: tuple[int, int, int]) -> bytes:
    """AA AA, counter from 1, state, three gyros and what goes with them, xor from byte 4, BB."""
    celsius = temperature_of(n)
    body = struct.pack("<3i3f", *raw, 0.0, 0.01, 1.0) + struct.pack("<5h", *[celsius] * 5)
    return b"\xaa\xaa" + bytes([1 + n % 200, 0xFF]) + body + bytes([xor_of(body)]) + b"\xbb"


def text_with_sum(n: int, raw: int) -> bytes:
    """$FOG, counter, counts, temperature, status, xor."""
    body = f"FOG,{n % 65536:05d},{raw % 0x7FFFFF},25.31,00".encode()
    return b"$" + body + f"*{xor_of(body):02X}\r\n".encode()


def crc_frames(n: int, raw: int) -> bytes:
    """55 AA, counter, counts, temperature, status, CRC."""
    body = struct.pack("<Hih", n % 65536, raw, 2531) + b"\x80"
    return b"\x55\xaa" + body + struct.pack(">H", binascii.crc_hqx(body, 0xFFFF))


# ---------------------------------------------------------------------- all of them

_PACKED, _KVH, _DSP = "frames/packed_7_bits", "frames/kvh_1750", "frames/kvh_dsp_3000"
_GRAVITY = tuple(float32(one) for one in (0.0, 0.01, 1.0))


def _scaled(raw: tuple[int, int, int]) -> tuple[float, ...]:
    return tuple(float32(one * 1e-10) for one in raw)


REAL_GYROS = (
    RealGyro(_PACKED, "packed_7_bits", packed_7, lambda n, raw: (None, (raw,))),
    RealGyro(
        _PACKED,
        "packed_7_bits_temperature",
        packed_7_temperature,
        lambda n, raw: (None, (raw, temperature_of(n) / 16)),
    ),
    RealGyro(_PACKED, "packed_7_bits_sum", packed_7_sum, lambda n, raw: (None, (raw, temperature_of(n) // 16))),
    RealGyro("frames/eb90", "eb90", eb90, lambda n, raw: (None, (raw,))),
    RealGyro(
        "frames/eb90", "eb90_temperature", eb90_temperature, lambda n, raw: (None, (raw, temperature_of(n) / 16))
    ),
    RealGyro(
        "frames/header_99_66",
        "header_99_66",
        header_99_66,
        lambda n, raw: (None, (0xA5, raw, temperature_of(n) / 16)),
    ),
    RealGyro(_DSP, "kvh_dsp_3000_100hz", dsp_3000_text, lambda n, raw: (None, (float(f"{raw * 1e-6:.6f}"), 1))),
    RealGyro(_DSP, "kvh_dsp_3000_1khz", dsp_3000_bits, lambda n, raw: (n % 4, (1, raw * 60e-6))),
    RealGyro(
        _KVH,
        "kvh_1750",
        kvh_1750,
        lambda n, raw: (n % 128, (*_scaled(raw), *_GRAVITY, 0x77, temperature_of(n) // 16)),
        axes=3,
    ),
    RealGyro(
        _KVH,
        "kvh_1775_format_c",
        kvh_1775_c,
        lambda n, raw: (
            n % 128,
            (*_scaled(raw), *_GRAVITY, struct.unpack(">I", struct.pack(">f", in_turn(n)))[0], 0x77),
        ),
        axes=3,
    ),
    RealGyro(
        "frames/low_high_mid",
        "low_high_mid",
        low_high_mid,
        lambda n, raw: (n % 256, (raw, low_high_mid(n, raw)[6])),
    ),
    RealGyro(
        "frames/three_axes",
        "three_axes",
        three_axes,
        lambda n, raw: (1 + n % 200, (0xFF, *raw, *_GRAVITY, *[temperature_of(n) / 16] * 3)),
        axes=3,
    ),
    RealGyro(
        "fibre_gyro_frames", "ascii_lines", text_with_sum, lambda n, raw: (n % 65536, (raw % 0x7FFFFF, 25.31, 0))
    ),
    RealGyro("fibre_gyro_frames", "binary_frames", crc_frames, lambda n, raw: (n % 65536, (raw, 25.31, 0x80))),
)


def raw_outputs(gyro: RealGyro, frames: int, rng: np.random.Generator) -> list[int] | list[tuple[int, int, int]]:
    """Outputs of a gyro that turns: noise on a rate, in counts."""
    noise = rng.normal(0, 20_000, (frames, gyro.axes)).round().astype(int) + 700_000
    return [tuple(row) if gyro.axes == 3 else row[0] for row in noise.tolist()]


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """A frame with one byte lost or inserted, or one bit flipped, anywhere."""
    at, kind = int(rng.integers(len(data))), int(rng.integers(3))
    if kind == 0:
        return data[:at] + data[at + 1 :]
    if kind == 1:
        return data[:at] + bytes([int(rng.integers(256))]) + data[at:]
    return data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :]


def is_same(delivered: tuple[float, ...], sent: tuple[float, ...]) -> bool:
    """Whether two frames hold the same numbers."""
    return len(delivered) == len(sent) and all(
        math.isclose(one, other, rel_tol=1e-12, abs_tol=1e-12) for one, other in zip(delivered, sent, strict=True)
    )
