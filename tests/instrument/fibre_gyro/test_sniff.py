"""Bytes without a description: what is tried on them, and what they show by themselves."""

import struct

import numpy as np
import pytest

from benchmarks.fibre_gyro.frames import layout_of
from benchmarks.fibre_gyro.real_gyros import REAL_GYROS, damaged, raw_outputs, xor_of
from instrument.fibre_gyro.identify import Capture, find_structure, try_format

ALL = {gyro.name: layout_of(gyro) for gyro in REAL_GYROS}


def captured(data: bytes) -> Capture:
    return Capture(((0.0, data),))


@pytest.mark.parametrize("gyro", REAL_GYROS, ids=lambda gyro: gyro.name)
def test_the_right_description_fits_best(gyro):
    rng = np.random.default_rng(7)
    parts = [gyro.pack(n, raw) for n, raw in enumerate(raw_outputs(gyro, 300, rng))]
    data = b"".join(damaged(part, rng) if rng.random() < 0.02 else part for part in parts)[3:]
    trials = {name: try_format(name, layout, captured(data)) for name, layout in ALL.items()}
    best = max(trials.values(), key=lambda one: one.merit)
    assert best.name == gyro.name and best.fits and best.doubts == ()
    assert best.frames > 230 and best.explained > 0.8 and best.rate_hz is None
    assert [name for name, one in trials.items() if one.fits] == [gyro.name]


def test_gaps_checksums_and_rate_are_counted():
    gyro = next(one for one in REAL_GYROS if one.name == "binary_frames")
    parts = [gyro.pack(n, 1000 + n) for n in range(400)]
    parts[50] = bytes([*parts[50][:6], parts[50][6] ^ 1, *parts[50][7:]])
    del parts[100:103]
    pieces = tuple((0.1 * k, b"".join(parts[20 * k : 20 * k + 20])) for k in range(20))
    trial = try_format(gyro.name, ALL[gyro.name], Capture(pieces, "115200 baud 8N1", timed=True))
    assert (trial.frames, trial.checksum_misses, trial.gaps, trial.missing) == (396, 1, 2, 4)
    assert trial.rate_hz == pytest.approx(200.0, rel=0.1)


def test_length_header_counter_and_checksum_of_unknown_frames():
    rng = np.random.default_rng(1)
    frames = []
    for n in range(400):
        body = (
            b"\xa7\x3c"
            + bytes([2 * n % 256])
            + struct.pack(">h", int(rng.normal(900, 80)))
            + struct.pack("<i", n * n)
        )
        frames.append(body + bytes([xor_of(body)]))
    found = find_structure(b"".join(frames)[4:])
    assert found.length == 10 and not found.text
    assert found.constant[0] == 0xA7 and found.constant[1] == 0x3C
    assert found.counting[2] == 2
    assert any(check.startswith("xor8 of bytes 0 to 8 stands in byte 9") for check in found.checks)


def test_seven_bits_and_a_crc_are_seen():
    rng = np.random.default_rng(2)
    frames = [b"\x90" + bytes(rng.integers(0, 128, 4).tolist()) for _ in range(300)]
    found = find_structure(b"".join(frames))
    assert found.length == 5 and found.highest_bit_clear == (1, 2, 3, 4)
    import binascii

    frames = [body + struct.pack(">H", binascii.crc_hqx(body, 0xFFFF)) for body in frames]
    found = find_structure(b"".join(frames))
    assert found.length == 7
    assert "crc16-ccitt-false of bytes 0 to 4 stands in byte 5, big byte order" in found.checks


def test_lines_of_text_are_told_from_frames():
    lines = [f"#GY;{n};{n * 0.25:.2f};ok\r\n" for n in range(200)]
    found = find_structure("".join(lines).encode())
    assert found.text and "4 fields separated by ';' in 100 % of them" in found.remarks
    assert any("begins with '#GY;" in remark for remark in found.remarks)


def test_noise_has_no_structure():
    assert find_structure(np.random.default_rng(3).bytes(8_000)).length == 0
    assert find_structure(b"").length == 0
    find_structure(b"\x00" * 5000)
    find_structure(b"abc")
