"""The sending side of a fibre gyro's link: frames out of numbers, commands out of bytes."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping

from instrument.fibre_gyro.frame_format.fields import COUNTER, FIXED, PARITY, STATUS, UNUSED, Field, Quantity
from instrument.fibre_gyro.frame_format.layout import FrameFormat
from instrument.fibre_gyro.frame_format.messages import Message, compose

_MOST_UNREAD = 4096  # bytes that no command is long enough for
POLL = "poll"
"""Name of the command that asks for a frame."""


def encode_frame(layout: FrameFormat, counter: int, values: Mapping[str, float]) -> bytes:
    """The bytes of one frame."""
    if layout.kind == "ascii":
        words = [_written(entry, _number(layout, entry, counter, values)) for entry in layout.fields]
        body = layout.header + layout.separator.join(words)
    else:
        body = _packed(layout, counter, values)
    if layout.check is not None:
        body += layout.check.mark
        body += layout.check.of_frame(body, binary=layout.kind == "binary")
    return body + layout.ending


def _packed(layout: FrameFormat, counter: int, values: Mapping[str, float]) -> bytes:
    body = layout.header
    word = bits = 0
    parity: tuple[int, bool] | None = None
    for entry in layout.fields:
        if not entry.bits:
            if entry.check is not None:
                covered = body[len(layout.header) :]
                body += entry.check.compute(covered).to_bytes(entry.size, entry.byte_order)
            else:
                body += _bytes_of(entry, _number(layout, entry, counter, values))
            continue
        word, bits = word << entry.bits, bits + entry.bits
        if entry.name == PARITY:
            parity = (bits, entry.kind == "odd")
        else:
            word |= _whole(entry, _number(layout, entry, counter, values))
        if bits % 8 == 0:
            if parity is not None and word.bit_count() % 2 != parity[1]:
                word |= 1 << (bits - parity[0])
            body += word.to_bytes(bits // 8, entry.byte_order)
            word, bits, parity = 0, 0, None
    return body


def _number(layout: FrameFormat, entry: Field, counter: int, values: Mapping[str, float]) -> float:
    rule = layout.counter
    if entry.name == COUNTER and rule is not None:
        return rule.first + counter % rule.modulus
    if entry.name == STATUS:
        return values.get(STATUS, layout.status.value)
    if entry.name == FIXED:
        return entry.expected
    if entry.cycle and rule is not None:
        return _in_turn(entry, (rule.first + counter % rule.modulus) % entry.cycle, values)
    return 0.0 if entry.name == UNUSED else (values.get(entry.name, 0.0) - entry.offset) / entry.scale


def _in_turn(entry: Field, phase: int, values: Mapping[str, float]) -> int:
    """What a field holds whose quantities take turns."""
    for quantity in entry.quantities:
        if phase in quantity.phases:
            whole = _quantity(quantity, entry.size, values)
            return whole >> (8 * entry.size * quantity.phases.index(phase)) & ((1 << 8 * entry.size) - 1)
    return 0


def _quantity(quantity: Quantity, size: int, values: Mapping[str, float]) -> int:
    good = quantity.status.value if quantity.status is not None else quantity.offset
    number = (values.get(quantity.name, good) - quantity.offset) / quantity.scale
    if quantity.kind == "float":
        return int.from_bytes(struct.pack("<f", number), "little")
    return round(number) & ((1 << 8 * size * len(quantity.phases)) - 1)


def _written(entry: Field, number: float) -> bytes:
    whole = number == int(number)
    if entry.kind == "hex":
        return b"%02X" % int(number)
    if entry.decimals is not None:
        return f"{number:.{entry.decimals}f}".encode("ascii")
    return b"%d" % int(number) if whole else repr(float(number)).encode("ascii")


def _bytes_of(entry: Field, number: float) -> bytes:
    if entry.kind == "float":
        packed = struct.pack("<f" if entry.size == 4 else "<d", number)
        return bytes(packed[rank] for rank in entry.significance)
    whole, keep = _whole(entry, number), (1 << entry.data_bits) - 1
    return bytes(whole >> (entry.data_bits * rank) & keep for rank in entry.significance)


def _whole(entry: Field, number: float) -> int:
    """A whole number as the bits that carry it."""
    span = 1 << entry.carried_bits
    lowest = -span // 2 if entry.kind == "signed" else 0
    if not lowest <= round(number) < lowest + span:
        width = f"{entry.bits} bits" if entry.bits else f"{entry.size} bytes"
        raise ValueError(f"{number:g} does not fit into the {width} of {entry.name}")
    return round(number) % span


class CommandReader:
    """Finds the commands of a format in what a computer sends."""

    def __init__(self, layout: FrameFormat) -> None:
        self._layout = layout
        self._messages = dict(layout.commands)
        if layout.poll is not None:
            self._messages[POLL] = layout.poll
        self._patterns = {name: _pattern(message, layout) for name, message in self._messages.items()}
        self._buffer = b""

    def feed(self, data: bytes) -> list[tuple[str, int]]:
        """Take bytes; returns name and number of every whole and undamaged command, in their order."""
        self._buffer = (self._buffer + data)[-_MOST_UNREAD:]
        found: list[tuple[str, int]] = []
        while True:
            matches = [(name, pattern.search(self._buffer)) for name, pattern in self._patterns.items()]
            hits = [(match.start(), name, match) for name, match in matches if match is not None]
            if not hits:
                return found
            _, name, match = min(hits, key=lambda hit: hit[0])
            number = self._value(name, match)
            # What only looked like a command is passed over by its first byte.
            self._buffer = self._buffer[match.start() + 1 if number is None else match.end() :]
            if number is not None:
                found.append((name, number))

    def _value(self, name: str, match: re.Match[bytes]) -> int | None:
        message = self._messages[name]
        spelled = match.groupdict().get("step", b"0")
        number = int.from_bytes(spelled, message.byte_order, signed=True) if message.binary else int(spelled)
        if not message.has_step:
            number = 0
        return number if compose(message, number, self._layout.check) == match[0] else None


def _pattern(message: Message, layout: FrameFormat) -> re.Pattern[bytes]:
    pattern = b""
    for part in message.parts:
        if isinstance(part, bytes):
            pattern += re.escape(part)
        elif part == "step":
            size = message.step_format.encode("ascii")
            pattern += b"(?P<step>.{" + size + b"})" if message.binary else rb"(?P<step>[+-]?\d{1,19})"
        elif part == "checksum" and layout.check is not None:
            size = b"%d" % (layout.check.size if message.binary else 2 * layout.check.size)
            pattern += b".{" + size + b"}"
    return re.compile(pattern, re.DOTALL)
