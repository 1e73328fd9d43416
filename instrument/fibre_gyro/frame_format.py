"""What a gyro's frames and commands look like, and what follows from it: lengths, times, limits."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from instrument.errors import FrameFormatError, SettingError
from instrument.fibre_gyro.frame_fields import (
    ANY_STATUS,
    CHECK,
    CHECKSUMS,
    COUNTS,
    FIXED,
    PARITY,
    ByteOrder,
    CheckRule,
    Checksum,
    CounterRule,
    Description,
    Field,
    StatusRule,
    byte_order,
    crc,
    is_output,
    read_fields,
)

# --------------------
# Commands to a gyro and its answers, as templates: fixed bytes with places for a number and a checksum.
#
# In a text message everything but the places stands as it is sent: ``"$INJ,{step}*{checksum}\r\n"``. In a binary
# one the bytes are spelled in hex: ``"A5 01 {step:4} {checksum}"``. The places are
#
# ``{step}``
#     The number to inject: decimal in text (``{step:+}`` with its sign always, ``{step:+08}`` with leading zeros
#     too), so many bytes in binary (``{step:4}``, two's complement, byte order of the frames).
# ``{checksum}``
#     That of the frames, over what precedes it in the message.
# ``{start}``
#     Nothing is sent here; the checksum begins behind it. Without it the checksum begins as in the frames


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
            if binary:
                if rule not in ("1", "2", "3", "4", "5", "6", "7", "8"):
                    raise FrameFormatError(
                        f"{where}: a number of bytes from 1 to 8 belongs behind step, as in {{step:4}}"
                    )
            elif not _TEXT_STEP.fullmatch(rule):
                raise FrameFormatError(f"{where}: {{step:{rule}}} must be {{step}}, {{step:+}} or {{step:+08}}")
            step_format = rule
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


def compose(message: Message, step: int, check: CheckRule | None) -> bytes:
    """The bytes of a message with the number `step` in it; it must lie within `Message.step_limits`."""
    out, start = b"", None
    for part in message.parts:
        if isinstance(part, bytes):
            out += part
        elif part == "start":
            start = len(out)
        elif part == "step" and message.binary:
            out += step.to_bytes(int(message.step_format), message.byte_order, signed=True)
        elif part == "step":
            out += format(step, message.step_format + "d").encode("ascii")
        elif check is not None:
            out += check.of(out, start=start, binary=message.binary)
    return out


_LONGEST_NUMBER = 24  # characters of a number in text


@dataclass(frozen=True)
class FrameFormat:
    """Frames, commands and line settings of one kind of gyro; made by `parse_frame_format`."""

    kind: str
    output_rate_hz: float  # frames per second of the gyro's own clock
    header: bytes  # begin and end of every frame; the ending of a line is its terminator
    ending: bytes
    separator: bytes  # between the fields of a line
    fields: tuple[Field, ...]  # in the order in which they are sent, without the checksum
    check: CheckRule | None = None
    counter: CounterRule | None = None
    status: StatusRule = ANY_STATUS
    commands: dict[str, Message] = field(default_factory=dict)  # of `COMMANDS` those that the gyro knows
    accepted: Message | None = None  # answers to a command
    refused: Message | None = None
    answer_time_s: float = 0.5  # longest time until the gyro answers
    step_scale: float = 1.0  # number that is sent for one code per transit time
    largest_step: float = math.inf  # codes; no larger step is injected, in either direction
    baud_rate: int = 115_200
    data_bits: int = 8
    stop_bits: int = 1
    parity: str = "N"  # "N", "E" or "O" as pySerial has them
    poll: Message | None = None  # what the gyro is asked with for each frame; None for one that sends by itself

    @property
    def interval_s(self) -> float:
        """Time between two frames in s."""
        return 1.0 / self.output_rate_hz

    @property
    def names(self) -> tuple[str, ...]:
        """Columns that are delivered, without the counter."""
        return tuple(entry.name for entry in self.fields if entry.delivers)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Columns with an output: "counts" alone, or those of several axes."""
        return tuple(name for name in self.names if is_output(name))

    @property
    def unit(self) -> str:
        """Unit of all outputs, one of `OUTPUT_UNITS`."""
        return next((entry.unit for entry in self.fields if is_output(entry.name)), COUNTS)

    @property
    def turning(self) -> Field | None:
        """The field in which several quantities take turns, None without one."""
        return next((entry for entry in self.fields if entry.cycle), None)

    def output_of(self, axis: str = "") -> str:
        """Column with the output of an axis; of a gyro with one output that one, whatever its axis is called."""
        if len(self.outputs) == 1:
            return self.outputs[0]
        name = f"{COUNTS}_{axis.lower()}" if axis else self.outputs[0]
        if name not in self.outputs:
            raise SettingError(f"the frames hold the outputs {', '.join(self.outputs)}, none of axis {axis}")
        return name

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame; in text, of the longest."""
        check = 0 if self.check is None else self.check.size
        ends = len(self.header) + len(self.ending)
        if self.kind == "binary":
            return ends + sum(entry.size for entry in self.fields) + self._field_bits // 8 + check
        numbers = len(self.fields) * (_LONGEST_NUMBER + len(self.separator))
        return ends + numbers + (2 * check + len(self.check.mark) if self.check else 0)

    @property
    def _field_bits(self) -> int:
        return sum(entry.bits for entry in self.fields)

    @property
    def evidence_bits(self) -> int:
        """Bits of a binary frame that only the right one has: header, ending, checksum, counter, fixed ones."""
        known = len(self.header) + len(self.ending) + (self.check.size if self.check else 0)
        bits = 8 * known + (self.counter.modulus.bit_length() - 1 if self.counter else 0)
        for entry in self.fields:
            if entry.name in (FIXED, PARITY, CHECK):
                bits += entry.bits or 8 * entry.size
            elif entry.size:
                bits += entry.size * 8 - (entry.value_bits or entry.size * entry.data_bits)
        return bits

    @property
    def byte_time_s(self) -> float:
        """Time of one byte on the line in s."""
        return (1 + self.data_bits + (self.parity != "N") + self.stop_bits) / self.baud_rate

    @property
    def has_counter(self) -> bool:
        """Whether frames are counted, so that lost ones are known and time is the gyro's own."""
        return self.counter is not None

    @property
    def has_answers(self) -> bool:
        """Whether the gyro acknowledges what it is told."""
        return self.accepted is not None

    @property
    def step_resolution(self) -> float:
        """Smallest difference between two injected steps, in codes."""
        return 1.0 / self.step_scale

    @property
    def step_range(self) -> tuple[float, float]:
        """Lowest and highest step in codes that can be injected."""
        message = self.commands.get("inject")
        limits = message.step_limits() if message is not None else None
        if limits is None:
            return -self.largest_step, self.largest_step
        lowest, highest = (limit / self.step_scale for limit in limits)
        return max(lowest, -self.largest_step), min(highest, self.largest_step)


# --------------------
# Reads the description of a gyro's frames and commands out of a settings file.
#
# ``docs/fibre_gyro_link.md`` explains every entry, ``config/fibre_gyro_frames.toml`` holds an example of each kind


COMMANDS = ("inject", "close_loop", "open_loop", "hold_feedback")
"""Everything that a gyro can be told here; a format need not have them all."""

_LONGEST_FRAME = 4096  # bytes; no gyro sends more at once, and a buffer must end somewhere
_PARITIES = {"none": "N", "even": "E", "odd": "O"}
_LEAST_EVIDENCE = 5  # bits of a frame without a header that are not free: fewer, and its begin cannot be found


def parse_frame_format(entries: Mapping[str, object], where: str = "") -> FrameFormat:
    """Read the description of a gyro's frames."""
    table = Description(entries, where)
    kind = table.choice("kind", ("ascii", "binary"))
    binary = kind == "binary"
    order = byte_order(table, "little")
    header = table.octets("header") if binary else table.text("header", "").encode("ascii")
    if binary:
        separator, ending = b"", table.octets("ending", "")
    else:
        separator, ending = (
            table.text(*entry).encode("ascii") for entry in (("separator", ","), ("ending", "\r\n"))
        )
        table.refuse(not ending, "ending", 'must not be empty, for instance "\\r\\n"')
        table.refuse(not separator, "separator", 'must not be empty, for instance ","')
    fields, counter, status = read_fields(table, binary, order)
    check = _read_check(table, binary, header, order)
    result = FrameFormat(
        kind=kind,
        output_rate_hz=table.number("output_rate_hz", positive=True),
        header=header,
        ending=ending,
        separator=separator,
        fields=fields,
        check=check,
        counter=counter,
        status=status,
        baud_rate=table.whole("baud_rate", 115_200, lowest=50),
        data_bits=table.whole("data_bits", 8, lowest=7, highest=8),
        stop_bits=table.whole("stop_bits", 1, lowest=1, highest=2),
        parity=_PARITIES[table.choice("parity", tuple(_PARITIES), "none")],
        **_read_dialogue(table, binary, order, check),  # type: ignore[arg-type]
    )
    table.refuse(
        binary and not header and result.poll is None and result.evidence_bits < _LEAST_EVIDENCE,
        "header",
        "must hold at least one byte: without it no frame can be found",
    )
    _check_line(table, result)
    table.finish()
    return result


# ---------------------------------------------------------------------- checksum, commands, line


def _read_check(table: Description, binary: bool, header: bytes, order: ByteOrder) -> CheckRule | None:
    entry = table.table("checksum")
    if entry is None:
        return None
    kind = entry.choice("kind", (*CHECKSUMS, "crc"))
    checksum = _read_crc(entry) if kind == "crc" else CHECKSUMS[kind]
    covers = entry.choice("covers", ("all", "after header"), "after header")
    begins = entry.whole("from_byte", 0, highest=_LONGEST_FRAME) if entry.has("from_byte") else None
    entry.refuse(begins is not None and not binary, "from_byte", "is for binary frames only")
    mark = b"" if binary else entry.text("mark", "*").encode("ascii")
    its_order = byte_order(entry, order)
    entry.finish()
    return CheckRule(checksum, header if covers == "after header" else b"", mark, its_order, begins)


def _read_crc(entry: Description) -> Checksum:
    """A CRC by its parameters, and whether they give the value that the catalogue has for "123456789"."""
    width = entry.whole("width", lowest=8, highest=64)
    highest = (1 << width) - 1
    made = crc(
        width,
        entry.whole("polynomial", lowest=1, highest=highest),
        initial=entry.whole("initial", 0, highest=highest),
        reflect_in=entry.flag("reflect_in", False),
        reflect_out=entry.flag("reflect_out", False),
        xor_out=entry.whole("xor_out", 0, highest=highest),
    )
    if entry.has("check_value"):
        stated, found = entry.whole("check_value", highest=highest), made.compute(b"123456789")
        entry.refuse(
            stated != found,
            "check_value",
            f'is 0x{stated:X}, but these parameters give 0x{found:X} for "123456789"; correct one of them',
        )
    return made


def _read_dialogue(
    table: Description, binary: bool, order: ByteOrder, check: CheckRule | None
) -> dict[str, object]:
    """Commands and answers, as arguments of `FrameFormat`."""

    def message(entry: Description, key: str) -> Message | None:
        template = entry.text(key, "")
        if not template:
            return None
        read = read_message(template, binary=binary, byte_order=order, where=entry.name(key))
        entry.refuse("checksum" in read.parts and check is None, key, "needs a table checksum that says which")
        return read

    result: dict[str, object] = {}
    commands = table.table("commands")
    if commands is not None:
        read = {name: found for name in COMMANDS if (found := message(commands, name)) is not None}
        for name, one in read.items():
            commands.refuse(one.has_step != (name == "inject"), name, _STEP_RULE[name == "inject"])
        result = {
            "commands": read,
            "step_scale": commands.number("step_scale", 1.0, positive=True),
            "largest_step": commands.number("largest_step", math.inf, positive=True),
        }
        commands.finish()
    answers = table.table("answers")
    if answers is not None:
        accepted, refused = message(answers, "accepted"), message(answers, "refused")
        answers.refuse(accepted is None, "accepted", "is missing")
        result |= {"accepted": accepted, "refused": refused}
        result["answer_time_s"] = answers.number("answer_time_s", 0.5, positive=True)
        answers.finish()
    polling = table.table("poll")
    if polling is not None:
        poll = message(polling, "command")
        polling.refuse(poll is None, "command", "is missing")
        polling.refuse(poll is not None and poll.has_step, "command", "must not hold {step}; only inject has one")
        result["poll"] = poll
        if polling.has("answer_time_s"):
            result["answer_time_s"] = polling.number("answer_time_s", positive=True)
        polling.finish()
    return result


_STEP_RULE = {True: "must hold {step}, the number to inject", False: "must not hold {step}; only inject has one"}


def _check_line(table: Description, read: FrameFormat) -> None:
    """Frames must be of sane length and fit onto the line in time."""
    if read.frame_bytes > _LONGEST_FRAME:
        raise table.error(
            "fields", f"make a frame of {read.frame_bytes} bytes; at most {_LONGEST_FRAME} can be read"
        )
    shortest = read.frame_bytes
    if read.kind == "ascii":
        shortest = len(read.header) + len(read.ending) + len(read.fields) * (1 + len(read.separator)) - 1
    fits = 1.0 / (shortest * read.byte_time_s)
    if read.output_rate_hz > fits:
        raise table.error(
            "output_rate_hz",
            f"is {read.output_rate_hz:g}, but a line of {read.baud_rate} baud carries at most {fits:.4g} such "
            "frames a second; correct one of the two",
        )
