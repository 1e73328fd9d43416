"""What a gyro's frames and commands look like, as a settings file describes it.

``docs/fibre_gyro_link.md`` explains every entry, ``config/fibre_gyro_frames.toml`` holds an example of each kind.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import cast

from instrument.fibre_gyro.description import Description
from instrument.fibre_gyro.messages import CHECKSUMS, ByteOrder, CheckRule, Message, read_message

COMMANDS = ("inject", "close_loop", "open_loop", "hold_feedback")
"""Everything that a gyro can be told here; a format need not have them all."""

COUNTER, COUNTS, TEMPERATURE, STATUS, UNUSED = "counter", "counts", "temperature", "status", "unused"
_LONGEST_FRAME = 4096  # bytes; no gyro sends more at once, and a buffer must end somewhere
_LONGEST_NUMBER = 24  # characters of a number in text
_PARITIES = {"none": "N", "even": "E", "odd": "O"}


@dataclass(frozen=True)
class Field:
    """One field of a frame.

    Attributes
    ----------
    name : str
        "counter", "counts", "temperature", "status", "unused", or any other word for a further column.
    kind : str
        Binary: "signed", "unsigned", "float". Text: "decimal", "hex".
    size : int
        Binary: bytes. Text: 0.
    scale, offset : float
        Delivered is ``number * scale + offset``.
    lowest, highest : float
        A delivered value outside is not used.
    """

    name: str
    kind: str
    size: int
    byte_order: ByteOrder
    scale: float = 1.0
    offset: float = 0.0
    lowest: float = -math.inf
    highest: float = math.inf


@dataclass(frozen=True)
class CounterRule:
    """The counter of frames: it grows by `per_frame` from frame to frame and begins again at `modulus`."""

    modulus: int
    per_frame: int = 1


@dataclass(frozen=True)
class StatusRule:
    """A frame may be used if ``status & mask == value``."""

    mask: int = 0
    value: int = 0


@dataclass(frozen=True)
class FrameFormat:
    """Frames, commands and line settings of one kind of gyro; made by `parse_frame_format`.

    Attributes
    ----------
    output_rate_hz : float
        Frames per second of the gyro's own clock.
    header, ending : bytes
        Begin and end of every frame; the ending of a line is its terminator.
    separator : bytes
        Between the fields of a line.
    fields : tuple of Field
        In the order in which they are sent, without the checksum.
    commands : dict of str to Message
        Of `COMMANDS` those that the gyro knows.
    accepted, refused : Message or None
        Answers to a command.
    answer_time_s : float
        Longest time until the gyro answers.
    step_scale : float
        Number that is sent for one code per transit time.
    largest_step : float
        Codes; no larger step is injected, in either direction.
    parity : str
        "N", "E" or "O" as pySerial has them.
    """

    kind: str
    output_rate_hz: float
    header: bytes
    ending: bytes
    separator: bytes
    fields: tuple[Field, ...]
    check: CheckRule | None = None
    counter: CounterRule | None = None
    status: StatusRule = StatusRule()
    commands: dict[str, Message] = field(default_factory=dict)
    accepted: Message | None = None
    refused: Message | None = None
    answer_time_s: float = 0.5
    step_scale: float = 1.0
    largest_step: float = math.inf
    baud_rate: int = 115_200
    data_bits: int = 8
    stop_bits: int = 1
    parity: str = "N"

    @property
    def interval_s(self) -> float:
        """Time between two frames in s."""
        return 1.0 / self.output_rate_hz

    @property
    def names(self) -> tuple[str, ...]:
        """Columns that are delivered, without the counter."""
        return tuple(entry.name for entry in self.fields if entry.name not in (COUNTER, UNUSED))

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame; in text, of the longest."""
        check = 0 if self.check is None else self.check.size
        ends = len(self.header) + len(self.ending)
        if self.kind == "binary":
            return ends + sum(entry.size for entry in self.fields) + check
        numbers = len(self.fields) * (_LONGEST_NUMBER + len(self.separator))
        return ends + numbers + (2 * check + len(self.check.mark) if self.check else 0)

    @property
    def counter_place(self) -> tuple[int, int] | None:
        """First byte of the counter in a binary frame, and the byte behind it; None without one."""
        begin = len(self.header)
        for entry in self.fields:
            if entry.name == COUNTER:
                return begin, begin + entry.size
            begin += entry.size
        return None

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


def parse_frame_format(entries: Mapping[str, object], where: str = "") -> FrameFormat:
    """Read the description of a gyro's frames.

    Parameters
    ----------
    entries : mapping
        As a TOML reader gives it.
    where : str
        Name of that table in its file, for error texts.

    Raises
    ------
    FrameFormatError
        In one sentence: which entry, what is wrong, what is right.
    """
    table = Description(entries, where)
    kind = table.choice("kind", ("ascii", "binary"))
    binary = kind == "binary"
    order = _byte_order(table, "little")
    header = table.octets("header") if binary else table.text("header", "").encode("ascii")
    if binary:
        separator, ending = b"", table.octets("ending", "")
        _refuse(not header, table, "header", "must hold at least one byte: without it no frame can be found")
    else:
        separator, ending = (
            table.text(*entry).encode("ascii") for entry in (("separator", ","), ("ending", "\r\n"))
        )
        _refuse(not ending, table, "ending", 'must not be empty, for instance "\\r\\n"')
        _refuse(not separator, table, "separator", 'must not be empty, for instance ","')
    fields, counter, status = _read_fields(table, binary, order)
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
    _check_line(table, result)
    table.finish()
    return result


# ---------------------------------------------------------------------- fields


def _read_fields(
    table: Description, binary: bool, order: ByteOrder
) -> tuple[tuple[Field, ...], CounterRule | None, StatusRule]:
    fields: list[Field] = []
    counter, status = None, StatusRule()
    for entry in table.tables("fields"):
        one = _read_field(entry, binary, order)
        if one.name != UNUSED and one.name in [known.name for known in fields]:
            raise entry.error("name", f'"{one.name}" is there twice')
        if one.name == COUNTER:
            counter = _read_counter(entry, one)
        if one.name == STATUS:
            status = StatusRule(entry.whole("good_mask", 0), entry.whole("good_value", 0))
            _refuse(bool(status.value & ~status.mask), entry, "good_value", "has bits that good_mask has not")
        entry.finish()
        fields.append(one)
    if COUNTS not in [one.name for one in fields]:
        raise table.error("fields", 'must hold one with name = "counts", the gyro\'s output')
    return tuple(fields), counter, status


def _read_field(entry: Description, binary: bool, order: ByteOrder) -> Field:
    name = entry.text("name")
    _refuse(not name.isidentifier(), entry, "name", f"must be a word such as counts, not {name!r}")
    whole = name in (COUNTER, STATUS)
    kinds = ("signed", "unsigned", "float") if binary else ("decimal", "hex")
    default = ("unsigned" if whole else "signed") if binary else "decimal"
    kind = entry.choice("type", kinds, default)
    _refuse(whole and kind in ("float", "signed"), entry, "type", f"must be unsigned for the {name}")
    size = 0
    if binary:
        size = entry.whole("bytes", lowest=1, highest=64 if name == UNUSED else 8)
        _refuse(kind == "float" and size not in (4, 8), entry, "bytes", "of a float must be 4 or 8")
    byte_order = _byte_order(entry, order)
    if whole or name == UNUSED:
        return Field(name, kind, size, byte_order)
    scale = entry.number("scale", 1.0)
    _refuse(scale == 0, entry, "scale", "must not be 0")
    lowest, highest = entry.number("lowest", -math.inf), entry.number("highest", math.inf)
    _refuse(lowest >= highest, entry, "lowest", "must lie below highest")
    return Field(name, kind, size, byte_order, scale, entry.number("offset", 0.0), lowest, highest)


def _read_counter(entry: Description, one: Field) -> CounterRule:
    full = 1 << (8 * one.size) if one.size else None
    modulus = entry.whole("modulus", full, lowest=2, highest=full)
    return CounterRule(modulus, entry.whole("per_frame", 1, lowest=1, highest=modulus - 1))


def _byte_order(table: Description, default: ByteOrder) -> ByteOrder:
    return cast(ByteOrder, table.choice("byte_order", ("little", "big"), default))


def _refuse(wrong: bool, table: Description, key: str, problem: str) -> None:
    if wrong:
        raise table.error(key, problem)


# ---------------------------------------------------------------------- checksum, commands, line


def _read_check(table: Description, binary: bool, header: bytes, order: ByteOrder) -> CheckRule | None:
    entry = table.table("checksum")
    if entry is None:
        return None
    kind = entry.choice("kind", tuple(CHECKSUMS))
    covers = entry.choice("covers", ("all", "after header"), "after header")
    mark = b"" if binary else entry.text("mark", "*").encode("ascii")
    byte_order = _byte_order(entry, order)
    entry.finish()
    return CheckRule(kind, header if covers == "after header" else b"", mark, byte_order)


def _read_dialogue(
    table: Description, binary: bool, order: ByteOrder, check: CheckRule | None
) -> dict[str, object]:
    """Commands and answers, as arguments of `FrameFormat`."""

    def message(entry: Description, key: str) -> Message | None:
        template = entry.text(key, "")
        if not template:
            return None
        read = read_message(template, binary=binary, byte_order=order, where=entry.name(key))
        _refuse("checksum" in read.parts and check is None, entry, key, "needs a table checksum that says which")
        return read

    result: dict[str, object] = {}
    commands = table.table("commands")
    if commands is not None:
        read = {name: found for name in COMMANDS if (found := message(commands, name)) is not None}
        for name, one in read.items():
            _refuse(one.has_step != (name == "inject"), commands, name, _STEP_RULE[name == "inject"])
        result = {
            "commands": read,
            "step_scale": commands.number("step_scale", 1.0, positive=True),
            "largest_step": commands.number("largest_step", math.inf, positive=True),
        }
        commands.finish()
    answers = table.table("answers")
    if answers is not None:
        accepted, refused = message(answers, "accepted"), message(answers, "refused")
        _refuse(accepted is None, answers, "accepted", "is missing")
        result |= {"accepted": accepted, "refused": refused}
        result["answer_time_s"] = answers.number("answer_time_s", 0.5, positive=True)
        answers.finish()
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
