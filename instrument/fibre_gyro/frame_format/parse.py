"""Reads the description of a gyro's frames and commands out of a settings file.

``docs/fibre_gyro_link.md`` explains every entry, ``config/fibre_gyro_frames.toml`` holds an example of each kind.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from instrument.fibre_gyro.frame_format.checksums import CHECKSUMS, ByteOrder, CheckRule, Checksum, crc
from instrument.fibre_gyro.frame_format.description import Description
from instrument.fibre_gyro.frame_format.fields import byte_order, read_fields
from instrument.fibre_gyro.frame_format.layout import FrameFormat
from instrument.fibre_gyro.frame_format.messages import Message, read_message

COMMANDS = ("inject", "close_loop", "open_loop", "hold_feedback")
"""Everything that a gyro can be told here; a format need not have them all."""

_LONGEST_FRAME = 4096  # bytes; no gyro sends more at once, and a buffer must end somewhere
_PARITIES = {"none": "N", "even": "E", "odd": "O"}
_LEAST_EVIDENCE = 5  # bits of a frame without a header that are not free: fewer, and its begin cannot be found


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
