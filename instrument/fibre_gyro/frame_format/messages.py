"""Commands to a gyro and its answers, as templates: fixed bytes with places for a number and a checksum.

In a text message everything but the places stands as it is sent: ``"$INJ,{step}*{checksum}\\r\\n"``. In a binary
one the bytes are spelled in hex: ``"A5 01 {step:4} {checksum}"``. The places are

``{step}``
    The number to inject: decimal in text (``{step:+}`` with its sign always, ``{step:+08}`` with leading zeros
    too), so many bytes in binary (``{step:4}``, two's complement, byte order of the frames).
``{checksum}``
    That of the frames, over what precedes it in the message.
``{start}``
    Nothing is sent here; the checksum begins behind it. Without it the checksum begins as in the frames.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from instrument.errors import FrameFormatError
from instrument.fibre_gyro.frame_format.checksums import ByteOrder, CheckRule

_PLACE = re.compile(r"\{([^{}]*)\}")
_TEXT_STEP = re.compile(r"\+?(0[1-9]\d?)?")


@dataclass(frozen=True)
class Message:
    """A template that was read."""

    parts: tuple[bytes | str, ...]  # bytes as they are sent; ``"step"``, ``"checksum"`` or ``"start"`` for a place
    # text: format of the number. Binary: its bytes as a decimal number. Empty without a number.
    step_format: str
    binary: bool
    byte_order: ByteOrder  # of a binary number

    @property
    def has_step(self) -> bool:
        """Whether the message carries a number."""
        return "step" in self.parts

    def step_limits(self) -> tuple[int, int] | None:
        """Lowest and highest number that fit into the message, None in text."""
        if not self.binary or not self.has_step:
            return None
        half = 1 << (8 * int(self.step_format) - 1)
        return -half, half - 1


def read_message(template: str, *, binary: bool, byte_order: ByteOrder, where: str) -> Message:
    """Read a template."""
    parts: list[bytes | str] = []
    step_format = ""
    for number, piece in enumerate(_PLACE.split(template)):
        if number % 2 == 0:
            parts.append(_literal(piece, binary, where))
            continue
        name, _, rule = piece.partition(":")
        if name not in ("step", "checksum", "start") or name in parts or (rule and name != "step"):
            raise FrameFormatError(f"{where} holds {{{piece}}}; only one {{step}}, {{start}} and {{checksum}} may")
        if name == "step":
            step_format = _step_format(rule, binary, where)
        parts.append(name)
    kept = tuple(part for part in parts if part != b"")
    if not any(isinstance(part, bytes) for part in kept):
        raise FrameFormatError(f"{where} holds no bytes to send")
    return Message(kept, step_format, binary, byte_order)


def _literal(piece: str, binary: bool, where: str) -> bytes:
    if "{" in piece or "}" in piece:
        raise FrameFormatError(f"{where} holds a brace without its partner")
    if not binary:
        return piece.encode("ascii")
    try:
        return bytes.fromhex(piece)
    except ValueError:
        raise FrameFormatError(f"{where} must be bytes in hex and places in braces, not {piece!r}") from None


def _step_format(rule: str, binary: bool, where: str) -> str:
    if binary:
        if rule not in ("1", "2", "3", "4", "5", "6", "7", "8"):
            raise FrameFormatError(f"{where}: a number of bytes from 1 to 8 belongs behind step, as in {{step:4}}")
    elif not _TEXT_STEP.fullmatch(rule):
        raise FrameFormatError(f"{where}: {{step:{rule}}} must be {{step}}, {{step:+}} or {{step:+08}}")
    return rule


def compose(message: Message, step: int, check: CheckRule | None) -> bytes:
    """The bytes of a message with the number `step` in it; it must lie within `Message.step_limits`."""
    out, start = b"", None
    for part in message.parts:
        if isinstance(part, bytes):
            out += part
        elif part == "start":
            start = len(out)
        elif part == "step":
            out += _spell(step, message)
        elif check is not None:
            out += check.of(out, start=start, binary=message.binary)
    return out


def _spell(step: int, message: Message) -> bytes:
    if message.binary:
        return step.to_bytes(int(message.step_format), message.byte_order, signed=True)
    return format(step, message.step_format + "d").encode("ascii")
