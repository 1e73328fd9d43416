"""The sending side of a fibre gyro's link: frames out of numbers, commands out of bytes."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping

from instrument.fibre_gyro.frame_format import COUNTER, STATUS, UNUSED, Field, FrameFormat
from instrument.fibre_gyro.messages import Message, compose

_MOST_UNREAD = 4096  # bytes that no command is long enough for


def encode_frame(layout: FrameFormat, counter: int, values: Mapping[str, float]) -> bytes:
    """The bytes of one frame.

    Parameters
    ----------
    values : mapping of str to float
        As they are to be delivered: scale and offset are taken off here. Fields without a value are 0, a status
        without one is good.

    Raises
    ------
    ValueError
        If a number does not fit into its field.
    """
    words = [_word(entry, _number(layout, entry, counter, values), layout.kind) for entry in layout.fields]
    body = layout.header + layout.separator.join(words)
    if layout.check is not None:
        body += layout.check.mark
        body += layout.check.of(body, binary=layout.kind == "binary")
    return body + layout.ending


def _number(layout: FrameFormat, entry: Field, counter: int, values: Mapping[str, float]) -> float:
    if entry.name == COUNTER and layout.counter is not None:
        return counter % layout.counter.modulus
    if entry.name == STATUS:
        return values.get(STATUS, layout.status.value)
    return 0.0 if entry.name == UNUSED else (values.get(entry.name, 0.0) - entry.offset) / entry.scale


def _word(entry: Field, number: float, kind: str) -> bytes:
    if kind == "ascii":
        whole = number == int(number)
        if entry.kind == "hex":
            return b"%02X" % int(number)
        return b"%d" % int(number) if whole else repr(float(number)).encode("ascii")
    if entry.kind == "float":
        order = "<" if entry.byte_order == "little" else ">"
        return struct.pack(order + ("f" if entry.size == 4 else "d"), number)
    try:
        return round(number).to_bytes(entry.size, entry.byte_order, signed=entry.kind == "signed")
    except OverflowError:
        raise ValueError(f"{number:g} does not fit into the {entry.size} bytes of {entry.name}") from None


class CommandReader:
    """Finds the commands of a format in what a computer sends."""

    def __init__(self, layout: FrameFormat) -> None:
        self._layout = layout
        self._patterns = {name: _pattern(message, layout) for name, message in layout.commands.items()}
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
        message = self._layout.commands[name]
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
