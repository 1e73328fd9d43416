"""One frame: from its bytes to its numbers, or to the reason why it cannot be used."""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass

from instrument.fibre_gyro.frame_format import COUNTER, STATUS, UNUSED, Field, FrameFormat

_DECIMAL = re.compile(rb"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,3})?")
_WHOLE = re.compile(rb"\d{1,20}")
_HEX = re.compile(rb"[0-9A-Fa-f]{1,16}")


@dataclass(frozen=True)
class Frame:
    """A frame that arrived whole.

    Attributes
    ----------
    values : tuple of float
        In the order of `FrameFormat.names`.
    problem : str
        Why the values must not be used although nothing was damaged; empty if they may.
    """

    counter: int | None
    values: tuple[float, ...]
    problem: str = ""


class Damaged(Exception):
    """The bytes are no frame; the text is the reason in a few words."""


def decode_frame(data: bytes, layout: FrameFormat) -> Frame:
    """Read the bytes of one frame, in text without its line end.

    Raises
    ------
    Damaged
        If header, ending, checksum, number of fields or a number is not as it should be.
    """
    if layout.kind == "binary":
        return _as_frame(_binary_numbers(data, layout), layout)
    return _as_frame(_text_numbers(data, layout), layout)


def _binary_numbers(data: bytes, layout: FrameFormat) -> list[float]:
    if not data.startswith(layout.header):
        raise Damaged("no header")
    if not data.endswith(layout.ending):
        raise Damaged("wrong ending")
    end = len(data) - len(layout.ending)
    if layout.check is not None:
        end -= layout.check.size
        if data[end : end + layout.check.size] != layout.check.of(data[:end], binary=True):
            raise Damaged("wrong checksum")
    position, numbers = len(layout.header), []
    for entry in layout.fields:
        numbers.append(_binary_number(data[position : position + entry.size], entry))
        position += entry.size
    return numbers


def _binary_number(data: bytes, entry: Field) -> float:
    if entry.kind == "float":
        sign = "<" if entry.byte_order == "little" else ">"
        return float(struct.unpack(sign + ("f" if entry.size == 4 else "d"), data)[0])
    return int.from_bytes(data, entry.byte_order, signed=entry.kind == "signed")


def _text_numbers(line: bytes, layout: FrameFormat) -> list[float]:
    if not line.startswith(layout.header):
        raise Damaged("no header")
    body = line
    if layout.check is not None:
        digits = 2 * layout.check.size
        body, found = line[:-digits], line[-digits:]
        if not body.endswith(layout.check.mark) or found.upper() != layout.check.of(body, binary=False):
            raise Damaged("wrong checksum")
        body = body[: len(body) - len(layout.check.mark)]
    words = body[len(layout.header) :].split(layout.separator if layout.separator.strip() else None)
    if len(words) != len(layout.fields):
        raise Damaged("wrong number of fields")
    return [_text_number(word.strip(), entry) for word, entry in zip(words, layout.fields, strict=True)]


def _text_number(word: bytes, entry: Field) -> float:
    if entry.name == UNUSED:
        return 0.0
    if entry.kind == "hex":
        if _HEX.fullmatch(word):
            return int(word, 16)
    elif entry.name in (COUNTER, STATUS):
        if _WHOLE.fullmatch(word):
            return int(word)
    elif _DECIMAL.fullmatch(word):
        return float(word)
    raise Damaged("not a number")


def _as_frame(numbers: list[float], layout: FrameFormat) -> Frame:
    counter, problem, values = None, "", []
    for number, entry in zip(numbers, layout.fields, strict=True):
        if entry.name == UNUSED:
            continue
        if entry.name == COUNTER:
            counter = int(number)
            continue
        value = number
        if entry.name == STATUS:
            if int(number) & layout.status.mask != layout.status.value:
                problem = problem or "bad status"
        else:
            value = number * entry.scale + entry.offset
            if not (math.isfinite(value) and entry.lowest <= value <= entry.highest):
                problem = problem or f"{entry.name} out of range"
        values.append(value)
    if counter is not None and layout.counter is not None and counter >= layout.counter.modulus:
        raise Damaged("counter out of range")
    return Frame(counter, tuple(values), problem)
