"""Which description fits unknown bytes: what they show by themselves, and what each description makes of them."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import serial
from numpy.typing import NDArray

from instrument.errors import LinkError
from instrument.fibre_gyro.frame_fields import CHECKSUMS
from instrument.fibre_gyro.frame_format import FrameFormat, compose
from instrument.fibre_gyro.frame_stream import Damage, FrameStream
from instrument.fibre_gyro.frames import Frame, doubts_about
from instrument.fibre_gyro.link import drop_backlog, open_port
from instrument.fibre_gyro.recording import Arrivals, CounterClock, HostClock

Bytes = NDArray[np.uint8]

_LOOKED_AT = 50_000  # bytes
_LONGEST = 256  # bytes of a frame
_FEWEST_FRAMES = 8
_CONSTANT = 0.9  # of the frames
_AS_GOOD = 0.9  # of the best length: the shortest is taken, for its multiples fit as well
_CLEAR = 0.25  # more than chance
_TEXT = 0.97  # of the bytes
_TRIED = 200  # frames on which checksums are tried


@dataclass(frozen=True)
class Structure:
    """What is periodic in some bytes."""

    text: bool = False  # lines of text
    length: int = 0  # bytes of a frame, or of a typical line; 0 where nothing repeats
    # place in the frame, counted from the first constant byte of the longest run, and what stands there
    constant: dict[int, int] = field(default_factory=dict)
    counting: dict[int, int] = field(default_factory=dict)  # place of a byte that counts, and by how much a frame
    checks: tuple[str, ...] = ()  # checksums that hold: ``"xor8 of bytes 1 to 5 in byte 6"``
    highest_bit_clear: tuple[int, ...] = ()  # places of bytes whose highest bit is never set, although they move
    remarks: tuple[str, ...] = ()  # of lines: fields, separator
    example: bytes = b""  # one frame


def find_structure(data: bytes) -> Structure:
    """Find what repeats."""
    data = data[:_LOOKED_AT]
    if not data:
        return Structure()
    values = np.frombuffer(data, dtype=np.uint8)
    printable = ((values >= 32) & (values < 127)) | (values == 13) | (values == 10) | (values == 9)
    if np.mean(printable) >= _TEXT and (b"\n" in data or b"\r" in data):
        return _lines(data)
    length = _frame_length(values)
    if length == 0:
        return Structure(example=data[:32])
    return _frames(values, length)


def _lines(data: bytes) -> Structure:
    ending = b"\r\n" if b"\r\n" in data else b"\n" if b"\n" in data else b"\r"
    lines = [line for line in data.split(ending)[1:-1] if line.strip()]
    if not lines:
        return Structure(text=True, example=data[:80])
    separator = max((b",", b";", b"\t", b" "), key=lambda one: sum(line.strip().count(one) for line in lines))
    split = None if separator == b" " else separator
    fields = [len(line.split(split)) for line in lines]
    usual = max(set(fields), key=fields.count)
    first = lines[0]
    begins = lines[0][
        : next((n for n in range(len(first)) if any(line[n : n + 1] != first[n : n + 1] for line in lines)), 0)
    ]
    share = f"{100 * fields.count(usual) / len(fields):.0f} %"
    said = [f"lines of text that end with {ending.decode()!r}"]
    if usual > 1:
        said.append(f"{usual} fields separated by {separator.decode()!r} in {share} of them")
    if begins:
        said.append(f"every line begins with {begins.decode('ascii', 'replace')!r}")
    length = int(np.median([len(line) + len(ending) for line in lines]))
    return Structure(text=True, length=length, remarks=tuple(said), example=lines[len(lines) // 2])


def _frame_length(values: Bytes) -> int:
    """Lag at which most bytes repeat; the shortest of those that are as good."""
    longest = min(_LONGEST, values.size // _FEWEST_FRAMES)
    if longest < 2:
        return 0
    chance = float(np.sum((np.bincount(values, minlength=256) / values.size) ** 2))
    # bytes that are constant at a place of the frame repeat there, and only there
    score = np.array([0.0, 0.0, *(np.mean(values[lag:] == values[:-lag]) for lag in range(2, longest + 1))])
    held = np.array([0.0, 0.0, *(_held(values, lag) for lag in range(2, longest + 1))])
    both = np.where(score > chance, score, 0.0) * 0.5 + held
    best = float(both.max())
    if best < _CLEAR / 4:
        return 0
    return int(np.flatnonzero(both >= _AS_GOOD * best)[0])


def _held(values: Bytes, length: int) -> float:
    """Part of the places of a frame that hold the same byte nearly always."""
    frames = _table(values, length, 0)[:2000]
    same = [np.bincount(column).max() / column.size for column in frames.T]
    spread = [len(np.unique(column)) for column in frames.T]
    moving = max(spread) > 1
    return float(np.mean(np.array(same) > _CONSTANT)) if moving else 0.0


def _table(values: Bytes, length: int, begin: int) -> Bytes:
    count = (values.size - begin) // length
    return values[begin : begin + count * length].reshape(count, length)


def _frames(values: Bytes, length: int) -> Structure:
    columns = _table(values, length, 0).T
    same = [np.bincount(column).max() / column.size > _CONSTANT for column in columns]
    usual = [int(np.bincount(column).argmax()) for column in columns]
    frames = _table(values, length, _begin(np.array(same), usual))
    constant: dict[int, int] = {}
    counting: dict[int, int] = {}
    clear: list[int] = []
    for place, column in enumerate(frames.T):
        most = int(np.bincount(column).argmax())
        if np.mean(column == most) > _CONSTANT:
            constant[place] = most
            continue
        steps = np.diff(column.astype(np.int16)) % 256
        step = int(np.bincount(steps).argmax())
        if step and np.mean(steps == step) > _CONSTANT:
            counting[place] = step
        elif column.max() < 128 and len(np.unique(column)) > 16:
            clear.append(place)
    checks = _checks(frames[:_TRIED])
    example = bytes(frames[len(frames) // 2])
    return Structure(False, length, constant, counting, checks, tuple(clear), (), example)


def _begin(constant: NDArray[np.bool_], usual: list[int]) -> int:
    """Where the longest run of constant bytes begins, high bytes of a number aside: most likely the header."""
    if constant.all() or not constant.any():
        return 0
    twice = np.concatenate([constant, constant])
    best, begin = 0, 0
    for place in np.flatnonzero(constant):
        if not constant[place - 1]:
            run = int(np.argmin(twice[place:]))
            if run > best:
                best, begin = run, int(place)
    places = [(begin + step) % constant.size for step in range(best)]
    return next((place for place in places if usual[place] not in (0x00, 0xFF)), begin)


def _checks(frames: Bytes) -> tuple[str, ...]:
    """Checksums of one kind over a part of the frame that hold in nearly all of them."""
    found = []
    rows = [bytes(row) for row in frames]
    length = frames.shape[1]
    for kind, checksum in CHECKSUMS.items():
        for place in range(length - 1, max(1, length - 4), -1):
            end = place + 1 - checksum.size
            if end < 2 or all(row[end : place + 1] == rows[0][end : place + 1] for row in rows):
                continue
            for begin in range(min(5, end - 1)):
                for order in ("little", "big") if checksum.size > 1 else ("little",):
                    right = sum(
                        checksum.compute(row[begin:end]) == int.from_bytes(row[end : place + 1], order)
                        for row in rows
                    )
                    if right > _CONSTANT * len(rows):
                        how = f", {order} byte order" if checksum.size > 1 else ""
                        found.append(f"{kind} of bytes {begin} to {end - 1} stands in byte {end}{how}")
    return tuple(found)


# --------------------
# One description tried on some bytes: frames, rate, gaps, checksums, what is left over


_PIECE = 16_384  # bytes of a file that are looked at in one go
_ENOUGH = 60_000  # bytes without a frame after which none is expected
_FEWEST = 8  # frames that are more than chance
_MOSTLY = 0.5  # of the bytes that a description must explain to be proposed


@dataclass(frozen=True)
class Trial:
    """What one description makes of the bytes."""

    name: str  # of the description
    frames: int  # frames that are right in everything; of them those with a bad status or a value out of range
    unusable: int
    damaged: int  # frames, in lengths of one, between right ones that are not
    checksum_misses: int  # of the damaged ones those with header, length and ending, but another checksum
    has_checksum: bool  # whether the description has them at all
    has_counter: bool
    gaps: int  # places where the counter skips, and frames that it skips
    missing: int
    stated_rate_hz: float
    rate_hz: float | None  # frames per second of the computer's clock; None for a file
    clock: HostClock | None  # the same with its uncertainty, where it can be told
    explained: float  # part of all bytes that right frames are made of
    doubts: tuple[str, ...]  # what shows that the numbers may mean something else
    evidence_bits: int  # bits of each frame that only the right one has

    @property
    def fits(self) -> bool:
        """Whether so much is explained that the description may be the right one."""
        return self.frames >= _FEWEST and self.explained >= _MOSTLY

    @property
    def merit(self) -> tuple[bool, float, bool, int]:
        """The largest is the likeliest: little left over, no doubts, most that chance cannot bring about."""
        right = self.frames - self.unusable
        share = self.explained * (0.5 + 0.5 * right / max(1, self.frames))
        return self.fits and not self.doubts, round(share, 1), not self.missing, self.evidence_bits


def try_format(name: str, layout: FrameFormat, capture: Capture) -> Trial:
    """Try one description on a capture."""
    stream = FrameStream(layout)
    clock, arrivals = CounterClock(layout.counter, layout.interval_s), Arrivals()
    rows: list[tuple[float, ...]] = []
    reasons: Counter[str] = Counter()
    gaps = missing = damaged = explained = 0
    index = -1
    data, pieces = capture.data, list(capture.pieces)
    if not capture.timed:
        pieces = [(0.0, data[begin : begin + _PIECE]) for begin in range(0, len(data), _PIECE)]
    for host_s, piece in [*pieces, (capture.seconds, b"")]:
        before = index
        if index < 0 and stream.tally.received > _ENOUGH:
            break
        for event in stream.feed(piece, silent=not piece):
            if isinstance(event, Damage):
                damaged += event.frames
                reasons[event.reason] += event.frames
            elif isinstance(event, Frame):
                tick = clock.place(
                    event.counter, host_s=host_s, silent_s=0.0, damaged=damaged if index >= 0 else 0
                )
                damaged = 0
                rows.append(event.values)
                if tick is not None:
                    lost = tick.index - index - 1 if index >= 0 else 0
                    gaps, missing, index = gaps + (lost > 0), missing + lost, tick.index
        if capture.timed and piece and index > before:
            arrivals.add(index, host_s)
    tally = stream.tally
    received = max(1, tally.received)
    found = arrivals.clock(layout.interval_s) if capture.timed else None
    explained = tally.received - tally.discarded - stream.held
    rate = found.output_rate_hz if found is not None else None
    if rate is None and capture.timed and capture.seconds > 0:
        rate = index / capture.seconds
    fixed = len(layout.header) + len(layout.ending) + (layout.check.size if layout.check else 0)
    return Trial(
        name=name,
        frames=tally.good + tally.unusable,
        unusable=tally.unusable,
        damaged=tally.damaged,
        checksum_misses=reasons["wrong checksum"] + reasons["wrong parity"],
        has_checksum=layout.check is not None or any(one.name in ("check", "parity") for one in layout.fields),
        has_counter=layout.has_counter,
        gaps=gaps,
        missing=missing,
        stated_rate_hz=layout.output_rate_hz,
        rate_hz=rate if tally.good + tally.unusable else None,
        clock=found,
        explained=explained / received if tally.good + tally.unusable else 0.0,
        doubts=doubts_about(layout, rows),
        evidence_bits=layout.evidence_bits if layout.kind == "binary" else 8 * fixed + len(layout.fields),
    )


# --------------------
# Some seconds of bytes, from a port with their times, or from a file


LOOKED_AT = 500_000  # bytes of a file that are looked at


@dataclass(frozen=True)
class Capture:
    """Bytes as they came."""

    # (float, bytes): Time in s by the computer's clock at which a piece was read, and its bytes. From a file there
    # is one piece.
    pieces: tuple[tuple[float, bytes], ...]
    line: str = ""  # how the port was set, "115200 baud 8N1"; empty for a file
    timed: bool = False  # whether the times mean anything

    @property
    def data(self) -> bytes:
        """All bytes."""
        return b"".join(piece for _, piece in self.pieces)

    @property
    def size(self) -> int:
        """How many bytes came."""
        return sum(len(piece) for _, piece in self.pieces)

    @property
    def seconds(self) -> float:
        """From the first piece to the last; 0 for a file."""
        return self.pieces[-1][0] - self.pieces[0][0] if self.timed and self.pieces else 0.0


def capture_port(port: str, layout: FrameFormat, seconds: float, *, poll: bytes = b"") -> Capture:
    """Listen to a port with the line settings of a format."""
    opened = open_port(port, layout)
    pieces: list[tuple[float, bytes]] = []
    try:
        drop_backlog(opened)
        began = due = time.monotonic()
        while (now := time.monotonic()) < began + seconds:
            if poll and now >= due:
                opened.write(poll)
                due = max(due + layout.interval_s, now)
            if data := bytes(opened.read(4096)):
                pieces.append((time.monotonic() - began, data))
    except (serial.SerialException, OSError) as error:
        raise LinkError(f"reading from {port} failed, the link is lost: {error}") from error
    finally:
        opened.close()
    return Capture(tuple(pieces), line_of(layout), timed=True)


def captured_file(path: Path) -> Capture:
    """The first bytes of a file; OSError if it cannot be read."""
    with path.open("rb") as file:
        return Capture(((0.0, file.read(LOOKED_AT)),))


def poll_of(layout: FrameFormat) -> bytes:
    """What a gyro is asked with for one frame; empty where it sends by itself."""
    return b"" if layout.poll is None else compose(layout.poll, 0, layout.check)


def line_of(layout: FrameFormat) -> str:
    """How a format sets the port."""
    return f"{layout.baud_rate} baud {layout.data_bits}{layout.parity}{layout.stop_bits}"
