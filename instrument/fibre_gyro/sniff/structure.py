"""What bytes show without any description: how long a frame is, what is constant in it, what counts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from instrument.fibre_gyro.frame_format.checksums import CHECKSUMS

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
    begins = lines[0][: _common(lines)]
    share = _percent(fields.count(usual), len(fields))
    said = [f"lines of text that end with {ending.decode()!r}"]
    if usual > 1:
        said.append(f"{usual} fields separated by {separator.decode()!r} in {share} of them")
    if begins:
        said.append(f"every line begins with {begins.decode('ascii', 'replace')!r}")
    length = int(np.median([len(line) + len(ending) for line in lines]))
    return Structure(text=True, length=length, remarks=tuple(said), example=lines[len(lines) // 2])


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f} %"


def _common(lines: list[bytes]) -> int:
    first = lines[0]
    return next((n for n in range(len(first)) if any(line[n : n + 1] != first[n : n + 1] for line in lines)), 0)


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
