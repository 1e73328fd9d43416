"""Frames out of damaged streams: what is delivered was sent, and everything else is counted."""

import binascii
import itertools
import math
import struct
import zlib

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from instrument.fibre_gyro import parse_frame_format
from instrument.fibre_gyro.frame_stream import Answer, Damage, FrameStream
from instrument.fibre_gyro.frames import Frame

FIELDS = [{"name": "counter", "bytes": 2}, {"name": "counts", "bytes": 4}]
BINARY = {"kind": "binary", "output_rate_hz": 100.0, "header": "55 AA", "fields": FIELDS}
TEXT = {
    "kind": "ascii",
    "output_rate_hz": 100.0,
    "header": "$",
    "fields": [{"name": "counter", "modulus": 65536}, {"name": "counts"}],
    "checksum": {"kind": "xor8"},
}


def layout(check=None, base=BINARY):
    return parse_frame_format(base | ({"checksum": {"kind": check, "covers": "all"}} if check else {}))


def packed(counter: int, counts: int, check: str = "crc32") -> bytes:
    """A frame packed by hand, independent of the product's own encoder."""
    body = b"\x55\xaa" + struct.pack("<Hi", counter, counts)
    if check == "crc32":
        return body + struct.pack("<I", zlib.crc32(body))
    if check == "crc16":
        return body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))
    return body + bytes([sum(body) % 256])


def line(counter: int, counts: int) -> bytes:
    body = f"{counter},{counts}"
    check = 0
    for character in body:
        check ^= ord(character)
    return f"${body}*{check:02X}\r\n".encode()


def frames_of(events) -> list[tuple[int, float]]:
    return [(event.counter, event.values[0]) for event in events if isinstance(event, Frame)]


def feed_in_pieces(stream: FrameStream, data: bytes, cuts: list[int]):
    events, begin = [], 0
    for end in [*sorted(cut % (len(data) + 1) for cut in cuts), len(data)]:
        events += stream.feed(data[begin:end])
        begin = end
    return events


COUNTS = st.integers(-(2**31), 2**31 - 1)
# Header bytes among the numbers are what makes resynchronization hard.
NASTY = st.one_of(COUNTS, st.sampled_from([0x0000AA55, -0x55AA55AB, 0x55AA55, 0x2A2A2A2A]))
GARBAGE = st.binary(max_size=40) | st.sampled_from(
    [b"\x55", b"\x55\xaa", b"\x55\xaa\x55\xaa", b"\x55\xaa\x00\x00"]
)


def damaged(data: bytes, kind: str, at: int, value: int) -> bytes:
    at %= len(data)
    if kind == "lost byte":
        return data[:at] + data[at + 1 :]
    if kind == "inserted byte":
        return data[:at] + bytes([value]) + data[at:]
    if kind == "flipped bit":
        return data[:at] + bytes([data[at] ^ (1 << value % 8)]) + data[at + 1 :]
    if kind == "cut":
        return data[:at]
    return {"lost": b"", "": data}[kind]


DAMAGE = st.tuples(
    st.sampled_from(["", "", "", "lost byte", "inserted byte", "flipped bit", "cut", "lost"]),
    st.integers(0, 50),
    st.integers(0, 255),
)


@given(st.lists(st.tuples(NASTY, DAMAGE, GARBAGE), max_size=30), st.lists(st.integers(0, 10_000), max_size=20))
def test_delivered_are_exactly_the_undamaged_frames(sent, cuts):
    stream = FrameStream(layout("crc32"))
    data, whole = b"", []
    for counter, (counts, (kind, at, value), garbage) in enumerate(sent):
        frame = packed(counter, counts)
        data += damaged(frame, kind, at, value) + garbage
        if kind == "":
            whole.append((counter, counts))
    events = feed_in_pieces(stream, data, cuts)
    events += stream.feed(bytes(40))  # no header in it: whatever waited is decided
    # A flip may hit nothing but be undone by an inserted byte equal to its neighbour, so compare what was sent.
    delivered = frames_of(events)
    everything = [(counter, counts) for counter, (counts, _, _) in enumerate(sent)]
    assert [one for one in delivered if one in whole] == whole
    assert all(one in everything for one in delivered)
    assert delivered == sorted(delivered)
    tally = stream.tally
    assert tally.good == len(delivered)
    assert tally.received == len(data) + 40 == 12 * tally.good + tally.discarded + stream.held
    assert stream.held <= 2 * 12


def delivered_of(parts: list[bytes], cuts: list[int], check: str = "sum8") -> list[tuple[int, float]]:
    stream = FrameStream(layout(check))
    return frames_of(feed_in_pieces(stream, b"".join(parts), cuts) + stream.feed(b"", silent=True))


def hit_twice(whole: list[bytes], parts: list[bytes]) -> int:
    """Frames between whose header and the next one two faults changed the length: one of their own, and one at the
    first byte of the frame behind, lost or with another in front of it."""
    arrived = [(frame, part) for frame, part in zip(whole, parts, strict=True) if part]
    return sum(
        part != frame and follower in (next_frame[1:], follower[:1] + next_frame)
        for (frame, part), (next_frame, follower) in itertools.pairwise(arrived)
    )


@given(st.lists(st.tuples(COUNTS, DAMAGE), min_size=1, max_size=30), st.lists(st.integers(0, 10_000), max_size=9))
# A byte lost in frame 2, one inserted in front of frame 3: together two faults in the nine bytes behind a header.
@example([(0, ("", 0, 0)), (0, ("", 0, 0)), (-1, ("lost byte", 4, 0)), (0, ("inserted byte", 0, 251))], [])
def test_one_byte_sum_lets_no_single_fault_pass(sent, cuts):
    sent = [(counts, hit) for counts, hit in sent if hit[0] != "cut"]
    whole = [packed(n, counts, "sum8") for n, (counts, _) in enumerate(sent)]
    parts = [damaged(frame, *hit) for frame, (_, hit) in zip(whole, sent, strict=True)]
    everything = {(n, counts) for n, (counts, _) in enumerate(sent)}
    wrong = [frame for frame in delivered_of(parts, cuts) if frame not in everything]
    assert len(wrong) <= hit_twice(whole, parts)


def test_two_faults_before_the_next_header_can_leave_the_bytes_of_another_frame():
    """What the frames carry cannot tell these two streams apart, because they are the same bytes."""
    counts = (0, 0, -1, 0)
    parts = [packed(n, one, "sum8") for n, one in enumerate(counts)]
    parts[2] = damaged(parts[2], "lost byte", 4, 0)
    parts[3] = damaged(parts[3], "inserted byte", 0, 251)
    others = [packed(n, one, "sum8") for n, one in enumerate((0, 0, -33554433, 0))]
    assert b"".join(parts) == b"".join(others)
    strong = [packed(n, one) for n, one in enumerate(counts)]
    for place, value in itertools.product(range(12), range(256)):
        strong[2:] = damaged(packed(2, -1), "lost byte", place, 0), bytes([value]) + packed(3, 0)
        assert set(delivered_of(strong, [], "crc32")) <= set(enumerate(counts))


COUNT = 5000


@pytest.mark.slow
def test_two_faults_before_the_next_header_pass_a_one_byte_sum_once_in_256():
    rng = np.random.default_rng(11)
    wrong = 0
    for _ in range(COUNT):
        before, first, second = (packed(n, int(rng.integers(-(2**31), 2**31)), "sum8") for n in (0, 1, 2))
        lost = damaged(first, "lost byte", int(rng.integers(2, 8)), 0)
        stream = FrameStream(layout("sum8"))
        events = stream.feed(before + before + lost + rng.bytes(1) + second, silent=True)
        wrong += sum(event.counter not in (0, 2) for event in events if isinstance(event, Frame))
    assert wrong == pytest.approx(COUNT / 256, abs=4 * math.sqrt(COUNT / 256))


def test_header_among_the_numbers_is_no_frame_behind_damage():
    """All counts hold a header. One frame loses its own, and the nine bytes from there on have the right sum."""
    frames = [packed(n, 0xAA55, "sum8") for n in (65535, 0, 1, 3, 4)]
    frames[2] = damaged(frames[2], "flipped bit", 0, 0)
    other = (frames[2] + frames[3])[4:13]
    assert other.startswith(b"\x55\xaa") and sum(other[:-1]) % 256 == other[-1] and frames[3][4:6] == b"\x55\xaa"
    assert delivered_of(frames, []) == [(65535, 0xAA55), (3, 0xAA55), (4, 0xAA55)]


def test_good_frame_between_two_damaged_ones_is_kept_because_its_counter_goes_on():
    frames = [packed(n, 7 * n, "sum8") for n in range(6)]
    frames[2] = damaged(frames[2], "lost byte", 5, 0)
    frames[4] = damaged(frames[4], "flipped bit", 5, 2)
    assert delivered_of(frames, []) == [(0, 0), (1, 7), (3, 21), (5, 35)]


@given(st.lists(st.tuples(COUNTS, DAMAGE), min_size=1, max_size=30), st.lists(st.integers(0, 10_000), max_size=9))
# Three that lose their ends and the good one behind them are longer than any line.
@example(
    [
        (-10000, ("inserted byte", 13, 0)),
        (-998751, ("flipped bit", 14, 255)),
        (-999999, ("inserted byte", 14, 9)),
        (-100194, ("", 0, 0)),
    ],
    [],
)
def test_line_with_one_fault_is_never_another_line(sent, cuts):
    stream = FrameStream(layout(base=TEXT))
    parts = [damaged(line(n, counts), *hit) for n, (counts, hit) in enumerate(sent) if hit[0] != "cut"]
    events = feed_in_pieces(stream, b"".join(parts), cuts)
    delivered = frames_of(events)
    assert set(delivered) <= {(n, counts) for n, (counts, _) in enumerate(sent)}
    # A line is whole if nothing happened to it and the line before it kept its end.
    kept = [hit[0] != "cut" for _, hit in sent]
    clean = [n for n, (_, hit) in enumerate(sent) if hit[0] == "" and kept[n]]
    assert {n for n, _ in delivered} >= set(clean)


@given(st.lists(st.binary(max_size=300), max_size=10), st.sampled_from([None, "sum8", "crc16-modbus"]))
def test_random_bytes_do_no_harm(pieces, check):
    for base in (BINARY, TEXT | {"header": ""}, TEXT | {"separator": " "}):
        rest = {key: value for key, value in base.items() if key != "checksum"}
        stream = FrameStream(layout(check, rest))
        stream.expect(b"\x55\xac\x06" if base is BINARY else b"OK\r\n")
        for piece in pieces:
            stream.feed(piece)
            assert stream.held <= 2 * stream._layout.frame_bytes + len(piece)


def test_random_bytes_hold_no_more_than_two_frames():
    stream = FrameStream(layout("crc32"))
    for n in range(500):
        stream.feed(b"\x55\xaa" * (n % 17) + bytes(range(n % 256)))
        assert stream.held <= 24
    stream = FrameStream(layout(base=TEXT))
    for _ in range(200):
        stream.feed(b"x" * 1000)
        assert stream.held <= stream._layout.frame_bytes + 16
    assert frames_of(stream.feed(b"\r\n" + line(5, -7))) == [(5, -7)]


def test_beginning_in_the_middle_of_a_frame_is_no_damage():
    stream = FrameStream(layout("crc32"))
    events = stream.feed(packed(1, 2)[5:] + packed(2, 3))
    assert frames_of(events) == [(2, 3)]
    assert stream.tally.damaged == 0
    assert stream.tally.discarded == 7
    lines = FrameStream(layout(base=TEXT))
    assert frames_of(lines.feed(line(1, 2)[3:] + line(2, 3))) == [(2, 3)]
    assert lines.tally.damaged == 0


def test_first_piece_of_an_unmarked_line_is_not_believed():
    plain = {key: value for key, value in TEXT.items() if key != "checksum"} | {"header": ""}
    stream = FrameStream(parse_frame_format(plain))
    assert frames_of(stream.feed(b"3,-77\r\n14,-88\r\n")) == [(14, -88)]  # "3" may have been 13 or 103


def test_damage_is_counted_in_frames_with_its_reason():
    stream = FrameStream(layout("crc32"))
    frames = [bytearray(packed(n, n)) for n in range(6)]
    frames[1][7] ^= 4
    frames[3][0] ^= 1
    frames[4][3] ^= 1
    events = stream.feed(b"".join(frames))
    assert [event for event in events if isinstance(event, Damage)] == [
        Damage(1, "wrong checksum"),
        Damage(2, "no header"),
    ]
    assert frames_of(events) == [(0, 0), (2, 2), (5, 5)]
    assert stream.tally.damaged == 3


def test_weak_sum_waits_for_the_next_header_or_silence():
    stream = FrameStream(layout("sum8"))
    assert stream.feed(packed(0, 9, "sum8")) == []
    assert frames_of(stream.feed(b"", silent=True)) == [(0, 9)]
    # The last byte is lost, and the first of the next header happens to be the right sum in its place.
    counts = next(n for n in range(300) if packed(1, n, "sum8")[-1] == 0x55)
    events = stream.feed(
        packed(1, counts, "sum8")[:-1] + packed(2, 5, "sum8") + packed(3, 6, "sum8") + b"\x55\xaa"
    )
    assert frames_of(events) == [(2, 5), (3, 6)]
    strong = FrameStream(layout("crc16-ccitt-false"))
    assert frames_of(strong.feed(packed(0, 9, "crc16"))) == [(0, 9)]


def test_answers_are_found_among_the_frames():
    stream = FrameStream(layout("crc32"))
    key = stream.expect(b"\x55\xac\x06\x01")
    events = stream.feed(packed(0, 1) + b"\x55\xac\x06") + stream.feed(b"\x01" + packed(1, 2))
    assert [type(event) for event in events] == [Frame, Answer, Frame]
    assert events[1].message == key
    assert stream.tally.discarded == 0
    lines = FrameStream(layout(base=TEXT))
    key = lines.expect(b"OK\r\n")
    assert lines.feed(line(0, 1) + b"OK\r\n" + line(1, 2))[1] == Answer(key)


def test_bad_status_and_range_are_whole_frames_that_must_not_be_used():
    status = {"name": "status", "bytes": 1, "good_mask": 0x81, "good_value": 0x80}
    temperature = {"name": "temperature", "bytes": 2, "scale": 0.01, "offset": -40, "lowest": -55, "highest": 90}
    entries = BINARY | {"fields": [*FIELDS, status, temperature], "ending": "0D", "byte_order": "big"}
    stream = FrameStream(parse_frame_format(entries))

    def frame(counter, status, hundredths):
        return struct.pack(">2sHiBh", b"\x55\xaa", counter, -5, status, hundredths) + b"\x0d"

    data = frame(1, 0x80, 6500) + frame(2, 0x81, 6500) + frame(3, 0xFE, 6500) + frame(4, 0x80, 20000)
    events = stream.feed(data, silent=True)
    assert [(event.counter, event.problem) for event in events] == [
        (1, ""),
        (2, "bad status"),
        (3, ""),
        (4, "temperature out of range"),
    ]
    assert events[0].values == (-5.0, 0x80, pytest.approx(25.0))
    assert (stream.tally.good, stream.tally.unusable, stream.tally.damaged) == (2, 2, 0)


@pytest.mark.parametrize("text", [b"$1,2,3*00", b"$1*31", b"$1,x*xx", b"$1,1e999*", b"$,*2C", b"$1,--2*"])
def test_lines_that_are_no_frames(text):
    plain = {key: value for key, value in TEXT.items() if key != "checksum"}
    for entries in (TEXT, plain):
        stream = FrameStream(parse_frame_format(entries))
        stream.feed(line(1, 1) if "checksum" in entries else b"$1,1\r\n")
        events = stream.feed(text + b"\r\n")
        assert not [event for event in events if isinstance(event, Frame) and not event.problem]


def test_floats_and_hexadecimal():
    float_counts = BINARY | {"fields": [{"name": "counts", "bytes": 8, "type": "float"}]}
    stream = FrameStream(parse_frame_format(float_counts))
    data = b"\x55\xaa" + struct.pack("<d", -1.25e-3) + b"\x55\xaa" + struct.pack("<d", float("nan"))
    good, bad = stream.feed(data, silent=True)
    assert good.values == (-1.25e-3,) and not good.problem
    assert bad.problem == "counts out of range"
    hexadecimal = {"kind": "ascii", "output_rate_hz": 10.0, "fields": [{"name": "counts", "type": "hex"}]}
    lines = FrameStream(parse_frame_format(hexadecimal))
    assert [event.values for event in lines.feed(b"junk\r\n1fF\r\n") if isinstance(event, Frame)] == [(511.0,)]


def exclusive_or(counter: int, counts: int) -> bytes:
    """A frame whose status is its header again: read one byte later it has a header and the right sum, too."""
    body = b"\x55\x55" + bytes([counter % 256]) + struct.pack("<i", counts)
    total = 0
    for byte in body:
        total ^= byte
    return body + bytes([total])


STATUS_LIKE_HEADER = {
    "kind": "binary",
    "output_rate_hz": 100.0,
    "header": "55",
    "fields": [{"name": "status", "bytes": 1}, {"name": "counter", "bytes": 1}, {"name": "counts", "bytes": 4}],
    "checksum": {"kind": "xor8", "covers": "all"},
}


def test_a_status_that_looks_like_the_header_lets_no_false_frame_pass():
    rng = np.random.default_rng(3)
    sent = [int(value) for value in rng.integers(-(2**31), 2**31, 4000)]
    parts = []
    for n, counts in enumerate(sent):
        kind = ("lost byte", "inserted byte", "flipped bit")[rng.integers(3)] if rng.random() < 0.09 else ""
        parts.append(damaged(exclusive_or(n, counts), kind, int(rng.integers(8)), int(rng.integers(256))))
    stream = FrameStream(parse_frame_format(STATUS_LIKE_HEADER))
    events = stream.feed(b"".join(parts)) + stream.feed(b"", silent=True)
    frames = [event for event in events if isinstance(event, Frame)]
    counter_of = {counts: n % 256 for n, counts in enumerate(sent)}
    assert all(counter_of.get(int(frame.values[1])) == frame.counter for frame in frames)
    whole = sum(part == exclusive_or(n, counts) for n, (part, counts) in enumerate(zip(parts, sent, strict=True)))
    assert len(frames) > 0.95 * whole


def test_beginning_one_byte_late_a_false_frame_is_not_believed():
    data = b"".join(exclusive_or(n, 1000 + 77 * n) for n in range(8))
    assert frames_of(FrameStream(parse_frame_format(STATUS_LIKE_HEADER)).feed(data[1:]))[0][0] == 1
