"""One frame: from its bytes to its numbers, or to the reason why it cannot be used or cannot be meant."""

import itertools
import re
import struct
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from instrument.fibre_gyro.frame_fields import (
    COUNTER,
    FIXED,
    PARITY,
    STATUS,
    TEMPERATURE,
    UNUSED,
    ByteOrder,
    Field,
    FieldQuantity,
    is_output,
)
from instrument.fibre_gyro.frame_format import FrameFormat

_DECIMAL = re.compile(rb"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,3})?")
_WHOLE = re.compile(rb"\d{1,20}")
_PLAIN = re.compile(rb"[+-]?\d+\.?\d*")  # as it is written with a fixed number of decimals
_HEX = re.compile(rb"[0-9A-Fa-f]{1,16}")

_NO_TEXT = re.compile(rb"[^\t\x20-\x7e]")
_IN_NUMBERS = b"0123456789abcdefABCDEF+-."

ONE_CHARACTER = "one character changed"
"""Reason for a damaged line of text that would be whole, had one of its characters been a digit."""
STANDS_OUT = "output stands out from those around it"
"""Reason for a whole line of text that was not sent, by all that can be told without a checksum."""

Number = Callable[[bytes], float]


@dataclass(frozen=True)
class Frame:
    """A frame that arrived whole."""

    counter: int | None
    values: tuple[float, ...]  # in the order of `FrameFormat.names`
    problem: str = ""  # why the values must not be used although nothing was damaged; empty if they may
    # what a status that takes turns with others says of this frame and those behind it: a problem, or none
    # (empty). None where the frame does not hold it.
    standing: str | None = None


class Damaged(Exception):
    """The bytes are no frame; the text is the reason in a few words."""


class FrameReader:
    """Reads the frames of one format."""

    def __init__(self, layout: FrameFormat) -> None:
        self._layout = layout
        self._binary = layout.kind == "binary"
        self._modulus = layout.counter.modulus if layout.counter else 0
        self._first = layout.counter.first if layout.counter else 0
        numbers = [one for one in layout.fields if one.delivers or one.name == COUNTER]
        self._counter_at = next((place for place, one in enumerate(numbers) if one.name == COUNTER), None)
        # of each number that is delivered: its place, and how it becomes a value
        self._values = [
            (place, one.name, one.scale, one.offset, one.lowest, one.highest, one.name == STATUS, one.cycle > 0)
            for place, one in enumerate(numbers)
            if one.delivers
        ]
        self._turns = _Turns(layout) if layout.turning is not None else None
        self._counter_number: Number | None = None
        if self._binary:
            self._end = layout.frame_bytes - len(layout.ending)
            self._check_at = self._end - (layout.check.size if layout.check is not None else 0)
            self._numbers, self._proofs = _compiled(layout)
            if self._counter_at is not None:
                self._counter_number = self._numbers[self._counter_at]
                bits, behind = 8 * len(layout.header), False
                for entry in layout.fields:
                    if behind and bits % 8 == 0:
                        break
                    bits += entry.bits or 8 * entry.size
                    behind = behind or entry.name == COUNTER
                self._counter_end = bits // 8

    def read(self, data: bytes) -> Frame:
        """Read the bytes of one frame, in text without its line end."""
        return self._frame(self._binary_numbers(data) if self._binary else self._text_numbers(data))

    def has_one_character_changed(self, line: bytes) -> bool:
        """Whether a damaged line would be whole, had one character that cannot stand there been a digit."""
        known = _IN_NUMBERS + self._layout.separator
        begin = len(self._layout.header)
        strange = [place for place in range(begin, len(line)) if line[place] not in known]
        if len(strange) != 1:
            return False
        before, behind = line[: strange[0]], line[strange[0] + 1 :]
        # one that is there too much was put in
        return self._is_whole(before + b"0" + behind) and not self._is_whole(before + behind)

    def _is_whole(self, line: bytes) -> bool:
        try:
            self._text_numbers(line)
        except Damaged:
            return False
        return True

    def counter_of(self, data: bytes) -> int | None:
        """Counter of a binary frame that may be cut behind it; None without one, or cut before it."""
        if self._counter_number is None or len(data) < self._counter_end:
            return None
        return int(self._counter_number(data))

    def _binary_numbers(self, data: bytes) -> list[float]:
        layout = self._layout
        if not data.startswith(layout.header):
            raise Damaged("no header")
        if not data.endswith(layout.ending):
            raise Damaged("wrong ending")
        if layout.check is not None and data[self._check_at : self._end] != layout.check.of_frame(
            data[: self._check_at], binary=True
        ):
            raise Damaged("wrong checksum")
        for proof in self._proofs:
            proof(data)
        return [number(data) for number in self._numbers]

    def _text_numbers(self, line: bytes) -> list[float]:
        layout = self._layout
        if not line.startswith(layout.header):
            raise Damaged("no header")
        body = line
        if layout.check is None and _NO_TEXT.search(line):
            raise Damaged("a byte that is no text")
        if layout.check is not None:
            digits = 2 * layout.check.size
            body, found = line[:-digits], line[-digits:]
            if not body.endswith(layout.check.mark) or found.upper() != layout.check.of_frame(body, binary=False):
                raise Damaged("wrong checksum")
            body = body[: len(body) - len(layout.check.mark)]
        words = body[len(layout.header) :].split(layout.separator if layout.separator.strip() else None)
        if len(words) != len(layout.fields):
            raise Damaged("wrong number of fields")
        pairs = zip(words, layout.fields, strict=True)
        return [_text_number(word.strip(), entry) for word, entry in pairs if entry.name != UNUSED]

    def _frame(self, numbers: list[float]) -> Frame:
        counter = None if self._counter_at is None else int(numbers[self._counter_at])
        if counter is not None and not 0 <= counter - self._first < self._modulus:
            raise Damaged("counter out of range")
        problem, values = "", []
        for place, name, scale, offset, lowest, highest, is_status, in_turn in self._values:
            value = numbers[place]
            if is_status:
                if int(value) & self._layout.status.mask != self._layout.status.value:
                    problem = problem or "bad status"
            elif not in_turn:
                value = value * scale + offset
                if not (lowest <= value <= highest and isfinite(value)):
                    problem = problem or f"{name} out of range"
            values.append(value)
        standing = None if self._turns is None or counter is None else self._turns.standing(counter, values)
        return Frame(counter, tuple(values), problem, standing)


def _is_number(entry: Field) -> bool:
    return entry.delivers or entry.name == COUNTER


class _Turns:
    """The status among quantities that take turns."""

    def __init__(self, layout: FrameFormat) -> None:
        turning = layout.turning
        quantities: tuple[FieldQuantity, ...] = turning.quantities if turning else ()
        self._status = next((one for one in quantities if one.status is not None and len(one.phases) == 1), None)
        self._cycle = turning.cycle if turning else 1
        self._column = layout.names.index(turning.name) if turning else 0

    def standing(self, counter: int, values: list[float]) -> str | None:
        quantity = self._status
        if quantity is None or quantity.status is None or counter % self._cycle != quantity.phases[0]:
            return None
        bad = int(values[self._column]) & quantity.status.mask != quantity.status.value
        return "bad status" if bad else ""


# ---------------------------------------------------------------------- binary


def _compiled(layout: FrameFormat) -> tuple[list[Number], list[Callable[[bytes], None]]]:
    """How each number of a frame is taken from its bytes, and what must hold besides its checksum."""
    numbers: list[Number] = []
    proofs: list[Callable[[bytes], None]] = []
    position, group = len(layout.header), list[Field]()
    for entry in layout.fields:
        if entry.bits:
            group.append(entry)
            if sum(one.bits for one in group) % 8 == 0:
                size = sum(one.bits for one in group) // 8
                _compile_bits(group, position, size, numbers, proofs)
                position, group = position + size, []
            continue
        part = slice(position, position + entry.size)
        position += entry.size
        if entry.check is not None:
            proofs.append(_inner_check(entry, slice(len(layout.header), part.start), part))
        elif entry.name == FIXED:
            proofs.append(_equals(_whole(entry, part), entry.expected))
        elif _is_number(entry):
            numbers.append(_float(entry, part) if entry.kind == "float" else _whole(entry, part))
        if entry.data_bits < 8 or 0 < entry.value_bits < 8 * entry.size:
            proofs.append(_clear_above(entry, part))
    return numbers, proofs


def _float(entry: Field, part: slice) -> Number:
    unpack = struct.Struct(">f" if entry.size == 4 else ">d").unpack
    if entry.significance == tuple(range(entry.size))[::-1]:
        return lambda data: float(unpack(data[part])[0])
    swap = [entry.significance.index(rank) for rank in range(entry.size - 1, -1, -1)]
    return lambda data: float(unpack(bytes(data[part.start + place] for place in swap))[0])


def _whole(entry: Field, part: slice) -> Number:
    """A whole number of some bytes, each with all of its bits or with some."""
    rising = tuple(range(entry.size))
    signed = entry.kind == "signed"
    if (
        entry.data_bits == 8
        and entry.significance in (rising, rising[::-1])
        and entry.carried_bits == 8 * entry.size
    ):
        order = "little" if entry.significance == rising else "big"
        return lambda data: int.from_bytes(data[part], order, signed=signed)  # type: ignore[arg-type]
    places = [(part.start + n, entry.data_bits * rank) for n, rank in enumerate(entry.significance)]
    keep, sign = (1 << entry.data_bits) - 1, 1 << (entry.carried_bits - 1)

    def number(data: bytes) -> int:
        value = 0
        for at, shift in places:
            value |= (data[at] & keep) << shift
        return (value ^ sign) - sign if signed and value < 2 * sign else value

    return number


def _clear_above(entry: Field, part: slice) -> Callable[[bytes], None]:
    """Bits that carry nothing are 0: those of each byte, and those above the number."""
    marks = ~((1 << entry.data_bits) - 1) & 0xFF
    places = [(part.start + n, entry.data_bits * rank) for n, rank in enumerate(entry.significance)]
    unused = entry.value_bits < entry.size * entry.data_bits

    def prove(data: bytes) -> None:
        if any(byte & marks for byte in data[part]):
            raise Damaged("a bit is set that carries nothing")
        if unused and sum(data[at] << shift for at, shift in places) >> entry.value_bits:
            raise Damaged("a bit is set that carries nothing")

    return prove


def _equals(number: Number, expected: int) -> Callable[[bytes], None]:
    def prove(data: bytes) -> None:
        if number(data) != expected:
            raise Damaged("wrong fixed field")

    return prove


def _inner_check(entry: Field, covered: slice, part: slice) -> Callable[[bytes], None]:
    def prove(data: bytes) -> None:
        if entry.check is not None and entry.check.compute(data[covered]) != int.from_bytes(
            data[part], entry.byte_order
        ):
            raise Damaged("wrong checksum")

    return prove


def _compile_bits(
    group: list[Field], position: int, size: int, numbers: list[Number], proofs: list[Callable[[bytes], None]]
) -> None:
    """Fields of bits: the first is the highest of the number that their bytes make."""
    part, order = slice(position, position + size), group[0].byte_order
    low = 8 * size
    for entry in group:
        low -= entry.bits
        if entry.name == PARITY:
            proofs.append(_parity(part, odd=entry.kind == "odd"))
            continue
        number = _bits(part, order, low, entry)
        if entry.name == FIXED:
            proofs.append(_equals(number, entry.expected))
        elif _is_number(entry):
            numbers.append(number)


def _bits(part: slice, order: str, low: int, entry: Field) -> Number:
    mask, sign = (1 << entry.bits) - 1, 1 << (entry.bits - 1) if entry.kind == "signed" else 0

    def number(data: bytes) -> int:
        value = int.from_bytes(data[part], order) >> low & mask  # type: ignore[arg-type]
        return (value ^ sign) - sign

    return number


def _parity(part: slice, *, odd: bool) -> Callable[[bytes], None]:
    def prove(data: bytes) -> None:
        if int.from_bytes(data[part], "big").bit_count() % 2 != odd:
            raise Damaged("wrong parity")

    return prove


# ---------------------------------------------------------------------- text


def _text_number(word: bytes, entry: Field) -> float:
    if entry.kind == "hex":
        if _HEX.fullmatch(word):
            return int(word, 16)
    elif entry.name in (COUNTER, STATUS):
        if _WHOLE.fullmatch(word):
            return int(word)
    elif _DECIMAL.fullmatch(word):
        if entry.decimals is not None:
            if not _PLAIN.fullmatch(word):
                raise Damaged("not a number")
            if len(word.partition(b".")[2]) != entry.decimals:
                raise Damaged("wrong number of decimals")
        return float(word)
    raise Damaged("not a number")


# --------------------
# Numbers that a frame format gives although their bytes mean something else.
#
# A checksum shows that the bytes are right, not that they are read rightly: seven data bits a byte read as eight,
# the bytes in another order, a signed number read as unsigned. A gyro's output moves little from one frame to the
# next. Read wrongly it is torn over its whole range, or one bit of a lively byte never moves


_FEWEST = 64  # frames: by chance a bit stands still so long once in 1e19
_MOST = 4096
_LIVELY = 24  # different values of a byte whose low bits all move
_TORN = 2.0**-6  # part of its range that an output moves from frame to frame, read wrongly
_CALM = 2.0**-5  # how much less it must move, read in another way, before that is said

Bytes = NDArray[np.uint8]


def doubts_about(layout: FrameFormat, rows: Sequence[tuple[float, ...]]) -> tuple[str, ...]:
    """What the outputs of some frames show of a wrong description; sentences, none where nothing does."""
    if len(rows) < _FEWEST or layout.kind != "binary":
        return ()
    table = np.array(rows[:_MOST], dtype=np.float64)
    fields = {one.name: one for one in layout.fields}
    said = []
    for place, name in enumerate(layout.names):
        if is_output(name):
            said.append(_doubt(fields[name], table[:, place]))
    return tuple(one for one in said if one)


def _doubt(entry: Field, values: NDArray[np.float64]) -> str:
    if entry.kind == "float":
        return _strange_float(entry, (values - entry.offset) / entry.scale)
    if entry.bits or entry.carried_bits > 52 or entry.carried_bits < 16:
        return ""
    whole = np.round((values - entry.offset) / entry.scale).astype(np.int64) & ((1 << entry.carried_bits) - 1)
    shifts = entry.data_bits * np.array(entry.significance, dtype=np.int64)
    sent = np.asarray(whole[:, None] >> shifts & ((1 << entry.data_bits) - 1), dtype=np.uint8)
    return _seven_bits(entry, sent) or _other_reading(entry, sent)


def _strange_float(entry: Field, values: NDArray[np.float64]) -> str:
    sizes = np.abs(values[values != 0])
    if sizes.size < _FEWEST or np.mean((sizes < 1e-25) | (sizes > 1e25)) < 0.2:
        return ""
    return (
        f"{entry.name}: its floats are of every size from {sizes.min():.0e} to {sizes.max():.0e}; is it a float, "
        "in this byte order?"
    )


def _seven_bits(entry: Field, sent: Bytes) -> str:
    """Seven data bits a byte, read as eight: a byte moves in all its low bits, none ever in the highest."""
    if entry.data_bits != 8:
        return ""
    different = sorted((len(set(column.tolist())) for column in sent.T), reverse=True)
    # a byte that carries into the next one has been through all of its values
    if sent.max() >= 128 or different[0] < _LIVELY or different[1] < 2:
        return ""
    return (
        f"{entry.name}: the highest bit of all its bytes was 0 in {len(sent)} frames; if they carry seven bits "
        "each, say data_bits = 7"
    )


def _other_reading(entry: Field, sent: Bytes) -> str:
    """Another order of the bytes, or a sign, with which the output moves much less."""
    now = _moves(entry, sent)
    if now < _TORN:
        return ""
    calmest, how = now, ""
    for other, name in _readings(entry):
        if (moves := _moves(other, sent)) < calmest:
            calmest, how = moves, name
    if calmest > _CALM * now:
        return ""
    return (
        f"{entry.name}: jumps by {100 * now:.2g} % of its range from frame to frame; read {how} it would move by "
        f"{100 * calmest:.2g} % only"
    )


def _readings(entry: Field) -> list[tuple[Field, str]]:
    orders: dict[ByteOrder, str] = {"little": "low byte first", "big": "high byte first"}
    kinds = {"signed": "as a signed number", "unsigned": "as an unsigned number"}
    found = []
    named = [(replace(entry, order=(), byte_order=order), text) for order, text in orders.items()]
    if entry.size == 3:
        mixed = (order for order in itertools.permutations(range(3)) if order not in ((0, 1, 2), (2, 1, 0)))
        named += [(replace(entry, order=order), f"with byte_order = {list(order)}") for order in mixed]
    for kind, sign in kinds.items():
        for one, text in named:
            if (one.significance, kind) != (entry.significance, entry.kind):
                parts = [] if one.significance == entry.significance else [text]
                parts += [] if kind == entry.kind else [sign]
                found.append((replace(one, kind=kind), ", ".join(parts)))
    return found


def _moves(entry: Field, sent: Bytes) -> float:
    """How far a number moves from frame to frame, the 95th percentile, as part of its range."""
    shifts = entry.data_bits * np.array(entry.significance, dtype=np.int64)
    numbers = np.sum(sent.astype(np.int64) << shifts, axis=1)
    if entry.kind == "signed":
        half = 1 << (entry.carried_bits - 1)
        numbers = (numbers ^ half) - half
    return float(np.quantile(np.abs(np.diff(numbers)), 0.95)) / float(1 << entry.carried_bits)


# --------------------
# How outputs move from frame to frame, and which of them jump further than they ever do


_FEWEST_OUTPUTS = 24  # frames before anything is judged
_MEMORY = 64  # frames over which the usual movement is taken
_FAR = 10.0  # times the usual movement; Gaussian noise gets so far once in 1e14
_AROUND = 8  # frames whose range tells whether an output stands out
_BEYOND = 4.5
"""Times the usual movement beyond that range: of Gaussian noise 6.5 standard deviations off, once in 1e8."""


class OutputContinuity:
    """The usual movement of the outputs, and of the temperature, from one frame to the next."""

    def __init__(self, layout: FrameFormat) -> None:
        steps = {one.name: abs(one.scale) for one in layout.fields}
        floats = {one.name for one in layout.fields if one.kind in ("float", "decimal")}
        self._watched = [
            (place, 0.0 if name in floats else 2.0 * steps[name])
            for place, name in enumerate(layout.names)
            if is_output(name) or name == TEMPERATURE
        ]
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._last: tuple[float, ...] | None = None
        self._recent: deque[tuple[float, ...]] = deque(maxlen=_AROUND)
        self._usual = [0.0] * len(self._watched)
        self._seen = 0

    def follow(self, frame: Frame) -> None:
        """Take a frame that is used."""
        if frame.problem:
            return
        last, self._last = self._last, frame.values
        self._recent.append(frame.values)
        if last is None:
            return
        self._seen += 1
        weight = 1.0 / self._seen if self._seen < _MEMORY else 1.0 / _MEMORY
        values, usuals = frame.values, self._usual
        for number, (place, _) in enumerate(self._watched):
            moved = abs(values[place] - last[place])
            if moved:  # an output that stands still most of the time moves by its smallest step
                usual = usuals[number]
                if (
                    usual and moved > 8 * usual and self._seen > _FEWEST_OUTPUTS
                ):  # a step of the rate is no usual movement
                    moved = 8 * usual
                usuals[number] = usual + weight * (moved - usual)

    def jumps(self, frame: Frame) -> bool:
        """Whether an output lies further from the last one than it ever moves."""
        return self._last is not None and self._apart(self._last, frame.values)

    def stands_out(self, frame: Frame) -> bool:
        """Whether an output lies beyond all the last ones, by far more than it usually moves."""
        return not frame.problem and self._beyond(frame, _BEYOND)

    def is_back(self, frame: Frame) -> bool:
        """Whether the outputs of a frame behind one that stood out lie again where they were before it."""
        return not self._beyond(frame, _BEYOND / 2)

    def leap(self, before: Frame, behind: Frame) -> bool:
        """Whether two neighbours lie further apart than neighbours ever do."""
        return self._apart(before.values, behind.values)

    def _apart(self, one: tuple[float, ...], other: tuple[float, ...]) -> bool:
        if self._seen < _FEWEST_OUTPUTS:
            return False
        return any(
            usual + smallest > 0 and abs(other[place] - one[place]) > _FAR * (usual + smallest)
            for usual, (place, smallest) in zip(self._usual, self._watched, strict=True)
        )

    def _beyond(self, frame: Frame, far: float) -> bool:
        if self._seen < _FEWEST_OUTPUTS:
            return False
        for usual, (place, smallest) in zip(self._usual, self._watched, strict=True):
            margin, value = far * (usual + smallest), frame.values[place]
            around = [one[place] for one in self._recent]
            if margin > 0 and not min(around) - margin <= value <= max(around) + margin:
                return True
        return False
