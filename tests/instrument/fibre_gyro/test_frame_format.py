"""The description of frames: what is read from it, and what is said about a mistake in it."""

import copy
import tomllib
from pathlib import Path

import pytest

from instrument import SettingError
from instrument.fibre_gyro import FrameFormatError, parse_frame_format
from instrument.fibre_gyro.frame_fields import CHECKSUMS
from instrument.fibre_gyro.frame_format import compose

EXAMPLES = tomllib.loads((Path(__file__).parents[3] / "config/fibre_gyro_frames.toml").read_text())["formats"]


# Check values of the string "123456789" from the catalogue of CRCs; the sums by hand: 0x31 + ... + 0x39 = 0x1DD.
@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("sum8", 0xDD),
        ("sum8-negated", 0x23),
        ("xor8", 0x31),
        ("sum16", 0x1DD),
        ("crc16-ccitt-false", 0x29B1),
        ("crc16-xmodem", 0x31C3),
        ("crc16-modbus", 0x4B37),
        ("crc32", 0xCBF43926),
    ],
)
def test_checksums_have_their_published_check_values(kind, value):
    assert CHECKSUMS[kind].compute(b"123456789") == value


def test_example_of_binary_frames():
    layout = parse_frame_format(EXAMPLES["binary_frames"])
    assert layout.frame_bytes == 2 + 2 + 4 + 2 + 1 + 2
    assert layout.names == ("counts", "temperature", "status")
    assert layout.interval_s == 0.005
    assert layout.counter.modulus == 65536
    assert layout.byte_time_s == pytest.approx(10 / 115200)
    # 0x01 and the four bytes of -2 * 16384, then the CRC of these five.
    message = compose(layout.commands["inject"], -2 * 16384, layout.check)
    assert message[:7] == bytes.fromhex("A5 5A 01 00 80 FF FF")
    assert len(message) == 9
    assert bitwise_ccitt(message[2:7]) == int.from_bytes(message[7:], "big")


def bitwise_ccitt(data: bytes) -> int:
    """CRC-16/CCITT-FALSE as polynomial division over single bits."""
    register = 0xFFFF
    for bit in (byte >> n & 1 for byte in data for n in range(7, -1, -1)):
        top = register >> 15 ^ bit
        register = (register << 1 & 0xFFFF) ^ (0x1021 if top else 0)
    return register


def test_example_of_lines():
    layout = parse_frame_format(EXAMPLES["ascii_lines"])
    assert layout.has_answers and layout.has_counter
    assert layout.step_range == (-16384, 16384)
    assert layout.step_resolution == 2**-14
    # exclusive or of "INJ,-16384": 49^4E^4A^2C^2D^31^36^33^38^34
    assert compose(layout.commands["inject"], -16384, layout.check) == b"$INJ,-16384*74\r\n"
    assert compose(layout.accepted, 0, layout.check) == b"$ACK*49\r\n"


MINIMAL = {"kind": "binary", "output_rate_hz": 10.0, "header": "55", "fields": [{"name": "counts", "bytes": 3}]}


def test_least_that_a_format_needs():
    layout = parse_frame_format(MINIMAL)
    assert layout.frame_bytes == 4
    assert not layout.has_counter and not layout.has_answers and layout.check is None
    assert layout.step_range == (-float("inf"), float("inf"))


def changed(**entries):
    table = copy.deepcopy(MINIMAL) | entries
    return {key: value for key, value in table.items() if value is not None}


COUNTS = {"name": "counts", "bytes": 4}
COUNTER = {"name": "counter", "bytes": 1}


def turning(**quantity):
    described = {"name": "supply_v", **quantity}
    return {"name": "turns", "bytes": 1, "cycle": 4, "quantities": [described]}


TURNS = turning(phases=[0])


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        (changed(kind="hex"), r"f\.kind must be one of ascii, binary, not 'hex'"),
        (changed(kind=None), r"f\.kind is missing"),
        (changed(header=""), r"f\.header must hold at least one byte"),
        (changed(header="5"), r"f\.header must be bytes in hex"),
        (changed(output_rate_hz=0), r"f\.output_rate_hz must be positive, not 0"),
        (changed(output_rate_hz=float("nan")), r"f\.output_rate_hz must be a finite number"),
        (changed(output_rate_hz="fast"), r"f\.output_rate_hz must be a number, not 'fast'"),
        (changed(output_rate_hz=5000), r"115200 baud carries at most 2880 such frames a second"),
        (changed(baud_rate=True), r"f\.baud_rate must be a whole number"),
        (changed(parity="maybe"), r"f\.parity must be one of none, even, odd"),
        (changed(heeder="55"), r"f\.heeder is not an entry that is known here; check its spelling"),
        (changed(fields=[]), r"f\.fields must be a list of tables"),
        (changed(fields=[{"name": "angle", "bytes": 4}]), r'f\.fields must hold one with name = "counts"'),
        (changed(fields=[COUNTS, COUNTS]), r'f\.fields\[2\]\.name "counts" is there twice'),
        (changed(fields=[COUNTS | {"bytes": 9}]), r"f\.fields\[1\]\.bytes must be from 1 to 8, not 9"),
        (changed(fields=[COUNTS | {"bytes": 3, "type": "float"}]), r"of a float must be 4 or 8"),
        (changed(fields=[COUNTS | {"scale": 0}]), r"scale must not be 0"),
        (changed(fields=[COUNTS | {"lowest": 3, "highest": 2}]), r"lowest must lie below highest"),
        (changed(fields=[COUNTS, {"name": "counter", "bytes": 1, "modulus": 300}]), r"from 2 to 256, not 300"),
        (changed(fields=[COUNTS, {"name": "counter", "bytes": 1, "type": "signed"}]), r"unsigned for the counter"),
        (
            changed(fields=[COUNTS, {"name": "status", "bytes": 1, "good_mask": 1, "good_value": 2}]),
            r"good_value has bits that good_mask has not",
        ),
        (changed(checksum={"kind": "md5"}), r"f\.checksum\.kind must be one of sum8,.*not 'md5'"),
        (changed(commands={"inject": "A5"}), r"f\.commands\.inject must hold \{step\}"),
        (changed(commands={"open_loop": "A5 {step:2}"}), r"open_loop must not hold \{step\}"),
        (changed(commands={"inject": "A5 {step}"}), r"a number of bytes from 1 to 8 belongs behind step"),
        (changed(commands={"inject": "A5 {step:2} {checksum}"}), r"inject needs a table checksum"),
        (changed(commands={"inject": "A5 {stop:2}"}), r"inject holds \{stop:2\}"),
        (changed(commands={"inject": "A5 {step:2"}), r"a brace without its partner"),
        (changed(commands={"inject": "INJ {step:2}"}), r"must be bytes in hex and places in braces"),
        (changed(answers={"refused": "15"}), r"f\.answers\.accepted is missing"),
        (changed(answers=3), r"f\.answers must be a table"),
        ("text", r"f must be a table of named entries"),
        (changed(fields=[COUNTS | {"byte_order": [0, 1, 1, 2]}]), r"significance of each byte as it is sent"),
        (
            changed(fields=[COUNTS | {"unit": "furlong"}]),
            r"unit must be one of counts, deg/s, deg/h, rad/s, mdeg/s, mrad/s, urad/s, arcsec/s, deg, rad, mdeg, ",
        ),
        (changed(fields=[COUNTS, COUNTS | {"name": "counts_x"}]), r"must name the outputs of several axes"),
        (
            changed(fields=[COUNTS | {"name": "counts_x"}, COUNTS | {"name": "counts_y", "unit": "deg"}]),
            r"must give all outputs in the same unit",
        ),
        (
            changed(fields=[{"name": "counts", "bits": 26}]),
            r"ends 26 bits in succession, which are no whole bytes",
        ),
        (
            changed(fields=[COUNTS | {"data_bits": 7, "value_bits": 29}]),
            r"value_bits must be from 1 to 28, not 29",
        ),
        (changed(fields=[COUNTS, {"name": "fixed", "bits": 8, "value": 256}]), r"value must be from 0 to 255"),
        (changed(fields=[COUNTS | {"decimals": 3}]), r"decimals is not an entry that is known here"),
        (changed(fields=[COUNTS, TURNS]), r"cycle needs a counter whose modulus is a multiple of 4"),
        (changed(fields=[COUNTER, COUNTS, TURNS, TURNS]), r'"turns" is there twice'),
        (changed(fields=[COUNTER, COUNTS, turning(phases=[4])]), r"different numbers from 0 to 3, not \[4\]"),
        (changed(fields=[COUNTER, COUNTS, turning(phases=[0], type="float")]), r"of a float needs four bytes"),
        (changed(fields=[COUNTER, COUNTS, turning(name="counts", phases=[0])]), r"outputs come with every frame"),
        (changed(fields=[COUNTER, COUNTS, turning(name="status", phases=[0, 1])]), r"of a status must be one"),
        (changed(fields=[COUNTS, COUNTER | {"first": 1}]), r"first must be from 0 to 0, not 1"),
        (changed(checksum={"kind": "crc", "width": 4, "polynomial": 3}), r"width must be from 8 to 64"),
        (changed(checksum={"kind": "crc", "width": 8, "polynomial": 300}), r"polynomial must be from 1 to 255"),
        (
            changed(checksum={"kind": "crc", "width": 8, "polynomial": 7, "reflect_in": "no"}),
            r"reflect_in must be true or false, not 'no'",
        ),
        (changed(poll={"answer_time_s": 1.0}), r"f\.poll\.command is missing"),
        (changed(poll={"command": "A5 {step:2}"}), r"must not hold \{step\}"),
    ],
)
def test_every_mistake_is_named_in_one_sentence(entries, said):
    with pytest.raises(FrameFormatError, match=said) as caught:
        parse_frame_format(entries, where="f")
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, SettingError)


def test_frames_without_a_header_need_something_else_that_shows_where_they_begin():
    counted = changed(header="", fields=[COUNTS, {"name": "counter", "bits": 8}])
    assert parse_frame_format(counted).evidence_bits == 8
    polled = changed(header="", fields=[COUNTS], poll={"command": "3F"})
    assert parse_frame_format(polled).evidence_bits == 0


def test_step_range_is_the_narrower_of_field_and_converter():
    commands = {"inject": "A5 {step:2}", "step_scale": 4.0}
    assert parse_frame_format(changed(commands=commands)).step_range == (-8192.0, 8191.75)
    limited = changed(commands=commands | {"largest_step": 100})
    assert parse_frame_format(limited).step_range == (-100, 100)
