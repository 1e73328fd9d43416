"""Frames of real gyros, packed by hand: each shipped description gives the numbers that were packed."""

import binascii
import tomllib
from pathlib import Path

import numpy as np
import pytest

from benchmarks.fibre_gyro.frames import judge, layout_of, read
from benchmarks.fibre_gyro.real_gyros import REAL_GYROS, crc_mpeg, damaged, is_same, raw_outputs, sevens
from instrument.fibre_gyro import parse_frame_format
from instrument.fibre_gyro.frame_stream import Damage, FrameStream
from instrument.fibre_gyro.recording import RecordBuilder

BY_NAME = {gyro.name: gyro for gyro in REAL_GYROS}
EXACT = [gyro for gyro in REAL_GYROS if gyro.name != "kvh_dsp_3000_100hz"]
FRAMES = Path(__file__).parents[3] / "config" / "frames"
EXTREMES = {
    "packed_7_bits": (-(2**31), -1, 0, 2**31 - 1),
    "packed_7_bits_temperature": (-(2**31), -1, 0, 2**31 - 1),
    "packed_7_bits_sum": (-(2**27), -1, 0, 2**27 - 1),
    "header_99_66": (-(2**23), -1, 0, 2**23 - 1),
    "low_high_mid": (-(2**23), -1, 0, 2**23 - 1),
    "kvh_dsp_3000_1khz": (-(2**25), -1, 0, 2**25 - 1),
}


@pytest.mark.parametrize("gyro", REAL_GYROS, ids=lambda gyro: gyro.name)
def test_every_number_is_what_was_packed(gyro):
    raw = raw_outputs(gyro, 300, np.random.default_rng(5))
    for place, extreme in enumerate(EXTREMES.get(gyro.name, ())):
        raw[10 + place] = extreme
    frames = read(layout_of(gyro), b"".join(gyro.pack(n, one) for n, one in enumerate(raw)))
    begin = 300 - len(frames)
    assert begin <= 1  # of unmarked lines the first is not believed: it may have lost its beginning
    for n, frame in enumerate(frames, start=begin):
        counter, values = gyro.values(n, raw[n])
        assert frame.counter == counter and is_same(frame.values, values), n


@pytest.mark.parametrize("gyro", EXACT, ids=lambda gyro: gyro.name)
def test_damage_makes_no_wrong_number(gyro):
    rng = np.random.default_rng(17)
    raw = raw_outputs(gyro, 1200, rng)
    clean = [gyro.pack(n, one) for n, one in enumerate(raw)]
    parts = [damaged(one, rng) if rng.random() < 0.09 else one for one in clean]
    whole = sum(part == one for part, one in zip(parts, clean, strict=True))
    score = judge(gyro, raw, read(layout_of(gyro), b"".join(parts)))
    assert score.wrong == 0
    assert score.delivered > (0.7 if gyro.name == "kvh_dsp_3000_1khz" else 0.9) * whole


TEXT = BY_NAME["kvh_dsp_3000_100hz"]
NOISE = 0.02  # deg/s, of raw_outputs


def on_a_bad_line(raw, rng, damage=0.09) -> bytes:
    """Lines of text, some of them damaged."""
    clean = [TEXT.pack(n, one) for n, one in enumerate(raw)]
    return b"".join(damaged(one, rng) if rng.random() < damage else one for one in clean)


def test_text_without_a_checksum_is_wrong_by_less_than_its_noise():
    """Nothing tells one digit from another within the noise; what stands out is not used, the rest is counted."""
    rng = np.random.default_rng(17)
    raw = raw_outputs(TEXT, 3000, rng)
    builder = RecordBuilder(layout_of(TEXT), 0, 2980)
    stream = FrameStream(layout_of(TEXT))
    builder.take(stream.feed(on_a_bad_line(raw, rng)), host_s=30.0, silent_s=0.0)
    recording = builder.recording(0, counts_per_dps=1.0)
    sent = {float(f"{one * 1e-6:.6f}") for one in raw}
    wrong = [value for value in recording.counts if value not in sent]
    assert 5 <= len(wrong) <= 30 and recording.counts.size > 2500
    assert max(abs(value - 0.7) for value in wrong) < 7 * NOISE
    assert abs(recording.losses.unseen_digits - len(wrong)) < 4 * np.sqrt(len(wrong))
    assert recording.counts.mean() == pytest.approx(0.7, abs=4 * 1.1 * NOISE / np.sqrt(3000))


@pytest.mark.parametrize("line", [b"\r0.712345 1", b".712345 1", b"0.712345 3", b"0.712345 71", b"0.71e345 1"])
def test_a_line_that_is_certainly_damaged_is_not_used(line):
    """A sign turned into a line end, a digit that is gone, a status that no gyro sends, a power of ten."""
    good = [TEXT.pack(n, one) for n, one in enumerate(raw_outputs(TEXT, 20, np.random.default_rng(2)))]
    assert len(read(layout_of(TEXT), b"".join([*good[:10], line + b"\r\n", *good[10:]]))) == 19


@pytest.mark.parametrize("step", [0.1, 0.13, 0.2, 5.0])
def test_a_turn_of_the_table_is_kept_on_a_bad_line(step):
    """Between two lines and over ten of them, there and back: every line that arrived whole is delivered."""
    rng = np.random.default_rng(5)
    course = np.r_[np.zeros(300), np.ones(300), np.linspace(1, 0, 10), np.zeros(300)]
    raw = [one + round(1e6 * step * part) for one, part in zip(raw_outputs(TEXT, 910, rng), course, strict=True)]
    clean = [TEXT.pack(n, one) for n, one in enumerate(raw)]
    parts = [b"0.7123z5 1\r\n" if n % 50 == 30 else one for n, one in enumerate(clean)]
    assert judge(TEXT, raw, read(layout_of(TEXT), b"".join(parts))).wrong == 0
    assert len(read(layout_of(TEXT), b"".join(parts))) == 910 - 18 - 1  # the first is never believed


def test_a_line_that_stands_out_waits_for_those_behind_it():
    """A changed high digit is left out, with its place in time kept; silence ends the wait."""
    raw = raw_outputs(TEXT, 100, np.random.default_rng(6))
    lines = [TEXT.pack(n, one) for n, one in enumerate(raw)]
    lines[40] = b"0.7!2345 1\r\n"
    lines[60] = b"0.9" + lines[60][3:]
    stream = FrameStream(layout_of(TEXT), patience=3)
    before = stream.feed(b"".join(lines[:60]))
    assert stream.feed(lines[60]) == []
    assert stream.feed(b"", silent=True) == []
    assert stream.feed(b"bad" + lines[61]) == []
    behind = stream.feed(b"".join(lines[62:65]))
    assert [type(event).__name__ for event in behind] == ["Damage", "Damage", "Frame", "Frame", "Frame"]
    assert behind[0].reason == "output stands out from those around it"
    assert sum(event.frames for event in [*before, *behind] if isinstance(event, Damage)) == 3
    assert stream.feed(b"9.000000 1\r\n") == []
    silent = [stream.feed(b"", silent=True) for _ in range(3)]
    assert silent[:2] == [[], []] and silent[2][0].values == (9.0, 1)


def test_a_spike_of_the_gyro_on_a_clean_line_is_kept():
    gyro = BY_NAME["eb90"]
    raw = raw_outputs(gyro, 400, np.random.default_rng(2))
    raw[200] = 2_000_000_000
    data = b"".join(gyro.pack(n, one) for n, one in enumerate(raw))
    assert [frame.values[0] for frame in read(layout_of(gyro), data)] == raw


def test_a_step_of_the_rate_on_a_damaged_line_is_kept():
    gyro, rng = BY_NAME["eb90"], np.random.default_rng(3)
    raw = [one + (30_000_000 if n >= 200 else 0) for n, one in enumerate(raw_outputs(gyro, 400, rng))]
    clean = [gyro.pack(n, one) for n, one in enumerate(raw)]
    parts = [damaged(one, rng) if n % 13 == 0 else one for n, one in enumerate(clean)]
    score = judge(gyro, raw, read(layout_of(gyro), b"".join(parts)))
    assert score.wrong == 0 and score.delivered > 350


def test_two_faults_that_leave_a_right_sum_show_by_their_jump():
    """A byte lost in a frame and one inserted before the next header, with a right sum: 1 of 256 such pairs."""
    gyro, rng = BY_NAME["eb90"], np.random.default_rng(4)
    raw = raw_outputs(gyro, 4000, rng)
    parts = [gyro.pack(n, one) for n, one in enumerate(raw)]
    crafted = 0
    for n in range(100, 4000, 40):
        parts[n - 20] = damaged(parts[n - 20], rng)  # the line is seen to be bad
        at = int(rng.integers(2, 6))
        body = (parts[n][:at] + parts[n][at + 1 :])[2:]
        crafted += body[:4] != parts[n][2:6]
        parts[n] = b"\xeb\x90" + body + bytes([sum(body) % 256])
    score = judge(gyro, raw, read(layout_of(gyro), b"".join(parts)))
    assert crafted > 60
    assert score.wrong == 0


def test_a_quantity_sent_in_turn_holds_until_it_comes_again():
    gyro = BY_NAME["low_high_mid"]
    layout = layout_of(gyro)
    raw = raw_outputs(gyro, 2000, np.random.default_rng(6))
    builder = RecordBuilder(layout, 0, 1990)
    for frame in read(layout, b"".join(gyro.pack(n, one) for n, one in enumerate(raw))):
        builder.take([frame], host_s=0.0, silent_s=0.0)
    recording = builder.recording(0)
    assert np.array_equal(recording.counts, raw[:1990])
    sixteenths = np.array([400 + (n - n % 4) // 250 for n in range(1990)])
    held = np.concatenate([[400], sixteenths[:-1]])  # its second byte comes one frame after the first
    assert np.array_equal(recording.temperature, held / 16)
    assert set(recording.extra["source_ma"]) == {93.0}


def test_while_a_status_sent_in_turn_is_bad_nothing_is_used():
    gyro = BY_NAME["low_high_mid"]
    layout = layout_of(gyro)
    parts = [bytearray(gyro.pack(n, 700_000 + n)) for n in range(40)]
    for n in (19, 23):  # the state comes with every fourth frame
        parts[n][6] = 0
        table = [0]
        for byte in parts[n][2:7]:
            table[0] = _crc8(table[0], byte)
        parts[n][7] = table[0]
    builder = RecordBuilder(layout, 0, 40)
    for frame in read(layout, b"".join(map(bytes, parts))):
        builder.take([frame], host_s=0.0, silent_s=0.0)
    recording = builder.recording(0)
    assert recording.losses.reasons == {"bad status": 8}
    assert [gap.missing for gap in recording.gaps] == [8] and recording.gaps[0].start_s == pytest.approx(0.019)


def _crc8(register: int, byte: int) -> int:
    register ^= byte
    for _ in range(8):
        register = (register << 1 ^ (0x07 if register & 0x80 else 0)) & 0xFF
    return register


def test_counter_of_two_bits_is_helped_by_what_came_damaged():
    gyro = BY_NAME["kvh_dsp_3000_1khz"]
    layout = layout_of(gyro)
    raw = raw_outputs(gyro, 400, np.random.default_rng(8))
    parts = [gyro.pack(n, one) for n, one in enumerate(raw)]
    for n in range(100, 109):  # nine frames: two whole rounds of the counter and one more
        parts[n] = bytes([parts[n][0] ^ 0x18, *parts[n][1:]])
    builder = RecordBuilder(layout, 0, 390)
    stream = FrameStream(layout)
    builder.take(stream.feed(b"".join(parts)), host_s=0.0, silent_s=0.0)
    recording = builder.recording(0, counts_per_dps=1 / 60e-6)
    places = np.round(recording.times / recording.interval_s).astype(int)
    assert np.allclose(recording.counts, np.array(raw)[places])
    assert 9 <= sum(gap.missing for gap in recording.gaps) <= 12


@pytest.mark.parametrize(
    ("parameters", "value"),
    [
        # from the catalogue of parametrised CRC algorithms
        ({"width": 32, "polynomial": 0x04C11DB7, "initial": 0xFFFFFFFF}, 0x0376E6E7),
        (
            {"width": 32, "polynomial": 0x04C11DB7, "initial": 0xFFFFFFFF, "reflect_in": True, "reflect_out": True,
             "xor_out": 0xFFFFFFFF},
            0xCBF43926,
        ),
        ({"width": 8, "polynomial": 0x07}, 0xF4),
        ({"width": 8, "polynomial": 0x31, "reflect_in": True, "reflect_out": True}, 0xA1),
        ({"width": 16, "polynomial": 0x8005, "reflect_in": True, "reflect_out": True, "xor_out": 0xFFFF}, 0x44C2),
        ({"width": 16, "polynomial": 0xC867, "initial": 0xFFFF}, 0x4C06),
        ({"width": 24, "polynomial": 0x864CFB, "initial": 0xB704CE}, 0x21CF02),
        ({"width": 12, "polynomial": 0x80F, "reflect_out": True}, 0xDAF),
        (
            {"width": 64, "polynomial": 0x42F0E1EBA9EA3693, "initial": 0xFFFFFFFFFFFFFFFF, "reflect_in": True,
             "reflect_out": True, "xor_out": 0xFFFFFFFFFFFFFFFF},
            0x995DC9BBDF1939FA,
        ),
    ],
)  # fmt: skip
def test_crcs_have_the_values_of_the_catalogue(parameters, value):
    table = {
        "kind": "binary",
        "output_rate_hz": 1.0,
        "header": "55",
        "fields": [{"name": "counts", "bytes": 4}],
        "checksum": {"kind": "crc", **parameters, "check_value": value},
    }
    assert parse_frame_format(table).check.checksum.compute(b"123456789") == value
    table["checksum"]["check_value"] = value ^ 1
    with pytest.raises(Exception, match=r'but these parameters give 0x\w+ for "123456789"'):
        parse_frame_format(table)


def test_the_packers_agree_with_other_programs():
    """The checks of these tests are right themselves: seven bits by hand, the CRC by bits and by zlib."""
    assert sevens(0x12345678, 5) == bytes([0x78, 0x2C, 0x51, 0x11, 0x01])
    assert crc_mpeg(b"123456789") == 0x0376E6E7
    assert binascii.crc_hqx(b"123456789", 0xFFFF) == 0x29B1


def test_every_shipped_description_can_be_read_and_says_where_it_comes_from():
    files = sorted(FRAMES.glob("*.toml"))
    assert len(files) >= 8
    for file in files:
        text = file.read_text(encoding="utf-8")
        assert text.startswith("# gyrolock: ")
        for name, table in tomllib.loads(text)["formats"].items():
            parse_frame_format(table, name)
