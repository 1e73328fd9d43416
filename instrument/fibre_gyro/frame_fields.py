"""The fields of a frame: how they are described, and checksums; the columns of a log and their units."""

from __future__ import annotations

import binascii
import math
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import xor
from typing import Any, Literal, cast

from instrument.errors import FileFormatError, FrameFormatError

# --------------------
# A table of a settings file, read strictly: every entry is asked for by name, and none may be left over


_MISSING: Any = object()


class Description:
    """One table and the place where it stands, for error texts."""

    def __init__(self, entries: object, where: str) -> None:
        self.where = where
        if not isinstance(entries, Mapping):
            raise FrameFormatError(f"{where or 'the frame format'} must be a table of named entries")
        self._entries = dict(entries)

    def name(self, key: str) -> str:
        """Full name of an entry."""
        return f"{self.where}.{key}" if self.where else key

    def error(self, key: str, problem: str) -> FrameFormatError:
        """The error that says what is wrong with an entry."""
        return FrameFormatError(f"{self.name(key)} {problem}")

    def refuse(self, wrong: bool, key: str, problem: str) -> None:
        """Raise the error if something is wrong."""
        if wrong:
            raise self.error(key, problem)

    def has(self, key: str) -> bool:
        """Whether an entry is there that was not taken yet."""
        return key in self._entries

    def peek(self, key: str) -> Any:
        """Value of an entry that is taken later, None without one."""
        return self._entries.get(key)

    def take(self, key: str, default: Any = _MISSING) -> Any:
        """Value of an entry of any type; each can be taken once."""
        if key in self._entries:
            return self._entries.pop(key)
        if default is _MISSING:
            raise self.error(key, "is missing")
        return default

    def text(self, key: str, default: str | None = None) -> str:
        """Value of an entry that holds text of ASCII characters."""
        value = self.take(key, _MISSING if default is None else default)
        if not isinstance(value, str) or not value.isascii():
            raise self.error(key, f"must be text of ASCII characters, not {value!r}")
        return value

    def choice(self, key: str, choices: tuple[str, ...], default: str | None = None) -> str:
        """Value of an entry that is one of some words."""
        value = self.take(key, _MISSING if default is None else default)
        if value not in choices:
            raise self.error(key, f"must be one of {', '.join(choices)}, not {value!r}")
        return str(value)

    def whole(self, key: str, default: int | None = None, *, lowest: int = 0, highest: int | None = None) -> int:
        """Value of an entry that is a whole number within limits."""
        value = self.take(key, _MISSING if default is None else default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f"must be a whole number, not {value!r}")
        if value < lowest or (highest is not None and value > highest):
            limits = f"at least {lowest}" if highest is None else f"from {lowest} to {highest}"
            raise self.error(key, f"must be {limits}, not {value}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Value of an entry that is true or false."""
        value = self.take(key, default)
        if not isinstance(value, bool):
            raise self.error(key, f"must be true or false, not {value!r}")
        return value

    def number(self, key: str, default: float | None = None, *, positive: bool = False) -> float:
        """Value of an entry that is a number, infinite only where the default is."""
        value = self.take(key, _MISSING if default is None else default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(key, f"must be a number, not {value!r}")
        if math.isnan(value) or (math.isinf(value) and value != default):
            raise self.error(key, f"must be a finite number, not {value}")
        if positive and not value > 0:
            raise self.error(key, f"must be positive, not {value}")
        return float(value)

    def octets(self, key: str, default: str | None = None) -> bytes:
        """Value of an entry that spells bytes in hex, ``"55 AA"``."""
        value = self.text(key, default)
        try:
            return bytes.fromhex(value)
        except ValueError:
            raise self.error(key, f'must be bytes in hex such as "55 AA", not {value!r}') from None

    def table(self, key: str) -> Description | None:
        """A table within this one, None if there is none."""
        value = self.take(key, None)
        return None if value is None else Description(value, self.name(key))

    def tables(self, key: str) -> list[Description]:
        """A list of tables within this one."""
        value = self.take(key)
        if not isinstance(value, list) or not value:
            raise self.error(key, "must be a list of tables, one for each field of a frame")
        return [Description(entry, f"{self.name(key)}[{number}]") for number, entry in enumerate(value, start=1)]

    def finish(self) -> None:
        """Refuse what nobody asked for: a misspelt entry would be ignored otherwise."""
        if self._entries:
            key = sorted(map(str, self._entries))[0]
            raise self.error(key, "is not an entry that is known here; check its spelling")


# --------------------
# Checksums of frames and commands: those with a name, and any CRC by its parameters


ByteOrder = Literal["little", "big"]


@dataclass(frozen=True)
class Checksum:
    """A checksum: how many bytes it has, and how it follows from the bytes that it covers."""

    size: int
    compute: Callable[[bytes], int]


def crc(
    width: int,
    polynomial: int,
    *,
    initial: int = 0,
    reflect_in: bool = False,
    reflect_out: bool = False,
    xor_out: int = 0,
) -> Checksum:
    """A CRC by the parameters of the usual catalogue (R. N. Williams, "A painless guide to CRC", 1993)."""
    step = _reflected_steps if reflect_in else _plain_steps
    compute = step(width, polynomial, initial)
    turn = reflect_in != reflect_out

    def value(data: bytes) -> int:
        register = compute(data)
        return (_reflected(register, width) if turn else register) ^ xor_out

    return Checksum((width + 7) // 8, value)


def _reflected(value: int, width: int) -> int:
    return int(format(value, f"0{width}b")[::-1], 2)


def _plain_steps(width: int, polynomial: int, initial: int) -> Callable[[bytes], int]:
    top, mask, shift = 1 << (width - 1), (1 << width) - 1, width - 8

    def of_byte(byte: int) -> int:
        register = byte << shift
        for _ in range(8):
            register = (register << 1) ^ polynomial if register & top else register << 1
        return register & mask

    table = [of_byte(byte) for byte in range(256)]

    def compute(data: bytes) -> int:
        register = initial
        for byte in data:
            register = (register << 8 & mask) ^ table[(register >> shift) ^ byte]
        return register

    return compute


def _reflected_steps(width: int, polynomial: int, initial: int) -> Callable[[bytes], int]:
    turned, begin = _reflected(polynomial, width), _reflected(initial, width)

    def of_byte(byte: int) -> int:
        register = byte
        for _ in range(8):
            register = (register >> 1) ^ turned if register & 1 else register >> 1
        return register

    table = [of_byte(byte) for byte in range(256)]

    def compute(data: bytes) -> int:
        register = begin
        for byte in data:
            register = (register >> 8) ^ table[(register ^ byte) & 0xFF]
        return register

    return compute


CHECKSUMS: dict[str, Checksum] = {
    "sum8": Checksum(1, lambda data: sum(data) & 0xFF),
    # All bytes and the checksum itself add up to zero.
    "sum8-negated": Checksum(1, lambda data: -sum(data) & 0xFF),
    "xor8": Checksum(1, lambda data: reduce(xor, data, 0)),
    "sum16": Checksum(2, lambda data: sum(data) & 0xFFFF),
    # Polynomial 0x1021, not reflected: "CCITT" in most data sheets is the first of these two.
    "crc16-ccitt-false": Checksum(2, lambda data: binascii.crc_hqx(data, 0xFFFF)),
    "crc16-xmodem": Checksum(2, lambda data: binascii.crc_hqx(data, 0)),
    "crc16-modbus": crc(16, 0x8005, initial=0xFFFF, reflect_in=True, reflect_out=True),
    "crc32": Checksum(4, zlib.crc32),
    "crc32-mpeg2": crc(32, 0x04C11DB7, initial=0xFFFFFFFF),
}


@dataclass(frozen=True)
class CheckRule:
    """Which checksum the messages and frames of a gyro carry, and over what."""

    checksum: Checksum  # one of `CHECKSUMS`, or a `crc`
    skips: bytes  # the header, if the checksum does not cover it; else empty
    mark: bytes  # what stands in front of the checksum and is not covered; only in text, else empty
    byte_order: ByteOrder
    # bytes at the begin of a frame that it does not cover, where these are not just the header
    begins: int | None = None

    @property
    def size(self) -> int:
        """Bytes of the checksum itself; text spells each with two hex digits."""
        return self.checksum.size

    def of(self, before: bytes, *, start: int | None = None, binary: bool) -> bytes:
        """The checksum as it is sent, over what stands `before` it, from byte `start` on if that is given."""
        if start is None:
            start = len(self.skips) if before.startswith(self.skips) else 0
        covered = before[start:].removesuffix(self.mark) if self.mark else before[start:]
        value = self.checksum.compute(covered)
        return value.to_bytes(self.size, self.byte_order) if binary else b"%0*X" % (2 * self.size, value)

    def of_frame(self, before: bytes, *, binary: bool) -> bytes:
        """The checksum of a frame, over what stands `before` it in the frame."""
        return self.of(before, start=self.begins, binary=binary)


COUNTER, COUNTS, TEMPERATURE, STATUS, UNUSED = "counter", "counts", "temperature", "status", "unused"
TABLE_ANGLE = "table_deg"  # of the rate table by its encoder, deg
FIXED, PARITY, CHECK = "fixed", "parity", "check"
_WITHOUT_VALUE = (UNUSED, FIXED, PARITY, CHECK)

RATE_UNITS = {
    **{"deg/s": 1.0, "deg/h": 1 / 3600, "rad/s": 180 / math.pi, "mdeg/s": 1e-3, "mrad/s": 0.18 / math.pi},
    **{"urad/s": 1.8e-4 / math.pi, "arcsec/s": 1 / 3600},
}
"""Units of an output that is a rate, deg/s."""

ANGLE_UNITS = {
    **{"deg": 1.0, "rad": 180 / math.pi, "mdeg": 1e-3, "mrad": 0.18 / math.pi, "urad": 1.8e-4 / math.pi},
    **{"arcsec": 1 / 3600},
}
"""Units of an output that is the angle since the output before, deg: its rate depends on the interval."""

OUTPUT_UNITS = (COUNTS, *RATE_UNITS, *ANGLE_UNITS)

_LARGEST_CYCLE = 256
_LONGEST_ORDER = 8


@dataclass(frozen=True)
class StatusRule:
    """A frame may be used if ``status & mask == value``."""

    mask: int = 0
    value: int = 0


ANY_STATUS = StatusRule()  # every status is good


@dataclass(frozen=True)
class FieldQuantity:
    """One of the quantities that take turns in a field."""

    name: str
    # values of the counter, modulo the cycle, at which the field holds it; at several, its parts, lowest first
    phases: tuple[int, ...]
    kind: str
    scale: float = 1.0
    offset: float = 0.0
    status: StatusRule | None = None  # it is a status: while it is bad no frame is used


@dataclass(frozen=True)
class Field:
    """One field of a frame."""

    # "counter", "counts" or "counts_x" to "counts_z", "temperature", "status", any other word for a further
    # column; "unused", "fixed", "parity" and "check" deliver nothing
    name: str
    # binary: "signed", "unsigned", "float". Text: "decimal", "hex". Parity: "odd", "even".
    kind: str
    # binary: bytes, 0 for a field of bits. Text: 0.
    size: int
    byte_order: ByteOrder
    scale: float = 1.0  # delivered is ``number * scale + offset``
    offset: float = 0.0
    lowest: float = -math.inf  # A delivered value outside is not used
    highest: float = math.inf
    # significance of each byte in the order in which they are sent; empty: `byte_order` says it
    order: tuple[int, ...] = ()
    bits: int = 0  # of a field that is no whole bytes
    data_bits: int = 8  # bits of each byte that carry data; those above them must be 0
    # bits of the number; of all that the bytes carry, those above it must be 0. 0: all.
    value_bits: int = 0
    unit: str = COUNTS  # of an output, one of `OUTPUT_UNITS`
    expected: int = 0  # what a fixed field holds
    decimals: int | None = None  # digits behind the point that a number in text must have
    cycle: int = 0  # frames after which `quantities` come again; 0 for a field that always holds the same
    quantities: tuple[FieldQuantity, ...] = ()
    check: Checksum | None = None  # of the field "check": over everything between header and here

    @property
    def carried_bits(self) -> int:
        """Bits of the number."""
        return self.bits or self.value_bits or self.size * self.data_bits

    @property
    def significance(self) -> tuple[int, ...]:
        """Significance of each byte in the order in which they are sent."""
        rising = tuple(range(self.size))
        return self.order or (rising if self.byte_order == "little" else rising[::-1])

    @property
    def delivers(self) -> bool:
        """Whether it is a column of what is delivered; the counter is none."""
        return self.name not in (COUNTER, *_WITHOUT_VALUE)


@dataclass(frozen=True)
class CounterRule:
    """The counter of frames: it grows by `per_frame` and begins again at `first` after `modulus` numbers."""

    modulus: int
    per_frame: int = 1
    first: int = 0


def is_output(name: str) -> bool:
    """Whether a column holds an output: of the gyro, or of one of its axes."""
    return name == COUNTS or (name.startswith(f"{COUNTS}_") and name[len(COUNTS) + 1 :] in ("x", "y", "z"))


def byte_order(table: Description, default: ByteOrder) -> ByteOrder:
    """Byte order that a table names."""
    return cast(ByteOrder, table.choice("byte_order", ("little", "big"), default))


def read_fields(
    table: Description, binary: bool, order: ByteOrder
) -> tuple[tuple[Field, ...], CounterRule | None, StatusRule]:
    """Read all fields of a format."""
    fields: list[Field] = []
    counter, status = None, ANY_STATUS
    for entry in table.tables("fields"):
        one = _read_field(entry, binary, order)
        if one.delivers and one.name in [known.name for known in fields]:
            raise entry.error("name", f'"{one.name}" is there twice')
        if one.name == COUNTER:
            entry.refuse(counter is not None, "name", '"counter" is there twice')
            full = 1 << one.carried_bits if one.carried_bits else None
            modulus = entry.whole("modulus", full, lowest=2, highest=full)
            first = entry.whole("first", 0, highest=None if full is None else full - modulus)
            counter = CounterRule(modulus, entry.whole("per_frame", 1, lowest=1, highest=modulus - 1), first)
        if one.name == STATUS:
            status = _read_status(entry)
        entry.finish()
        fields.append(one)
    outputs = [one for one in fields if is_output(one.name)]
    names = [one.name for one in outputs]
    if not outputs:
        raise table.error(
            "fields", 'must hold one with name = "counts", the gyro\'s output (or counts_x, counts_y, counts_z)'
        )
    if COUNTS in names and len(names) > 1:
        raise table.error(
            "fields", "must name the outputs of several axes counts_x, counts_y, counts_z, none of them counts"
        )
    if len({one.unit for one in outputs}) > 1:
        raise table.error("fields", "must give all outputs in the same unit")
    open_bits = 0
    for number, one in enumerate([*fields, Field(UNUSED, "unsigned", 1, "big")]):
        if one.bits:
            open_bits += one.bits
        elif open_bits % 8:
            raise table.error(
                f"fields[{number}]", f"ends {open_bits} bits in succession, which are no whole bytes"
            )
        else:
            open_bits = 0
    _check_cycles(table, fields, counter)
    return tuple(fields), counter, status


def _read_field(entry: Description, binary: bool, order: ByteOrder) -> Field:
    name = entry.text("name")
    entry.refuse(not name.isidentifier(), "name", f"must be a word such as counts, not {name!r}")
    entry.refuse(not binary and name in (FIXED, PARITY, CHECK), "name", f'"{name}" is for binary frames only')
    if name == PARITY:
        bits = entry.whole("bits", 1, lowest=1, highest=1)
        return Field(name, entry.choice("type", ("odd", "even")), 0, order, bits=bits)
    if name == CHECK:
        kind = entry.choice("kind", tuple(CHECKSUMS))
        return Field(name, "unsigned", CHECKSUMS[kind].size, byte_order(entry, order), check=CHECKSUMS[kind])
    one = _read_place(entry, name, binary, order)
    if name == FIXED:
        return replace(one, expected=entry.whole("value", lowest=0, highest=(1 << one.carried_bits) - 1))
    if name in (COUNTER, STATUS, UNUSED):
        return one
    if binary and (cycle := entry.whole("cycle", 0, highest=_LARGEST_CYCLE)):
        return _read_turns(entry, replace(one, cycle=cycle, kind="unsigned"))
    return _read_value(entry, one, binary)


def _read_place(entry: Description, name: str, binary: bool, order: ByteOrder) -> Field:
    """Where the field stands and what kind of number it is."""
    whole = name in (COUNTER, STATUS)
    default = ("unsigned" if whole or name == FIXED else "signed") if binary else "decimal"
    kind = entry.choice("type", ("signed", "unsigned", "float") if binary else ("decimal", "hex"), default)
    entry.refuse(whole and kind in ("float", "signed"), "type", f"must be unsigned for the {name}")
    if not binary:
        return Field(name, kind, 0, byte_order(entry, order))
    if entry.has("bits"):
        entry.refuse(kind == "float", "type", "of a field of bits must be signed or unsigned")
        return Field(name, kind, 0, order, bits=entry.whole("bits", lowest=1, highest=64))
    size = entry.whole("bytes", lowest=1, highest=64 if name in (UNUSED, FIXED) else 10)
    one = Field(name, kind, size, order, data_bits=entry.whole("data_bits", 8, lowest=1, highest=8))
    if isinstance(entry.peek("byte_order"), list):
        given = entry.take("byte_order")
        if sorted(map(str, given)) != sorted(map(str, range(size))) or size > _LONGEST_ORDER:
            raise entry.error(
                "byte_order",
                'must be "little", "big" or the significance of each byte as it is sent, such as [0, 2, 1], '
                f"not {given!r}",
            )
        one = replace(one, order=tuple(int(one) for one in given))
    else:
        one = replace(one, byte_order=byte_order(entry, order))
    if kind == "float":
        entry.refuse(size not in (4, 8) or one.data_bits != 8, "bytes", "of a float must be 4 or 8")
        return one
    most = size * one.data_bits
    limited = name not in (UNUSED, FIXED)
    entry.refuse(limited and one.data_bits == 8 and size > 8, "bytes", f"must be from 1 to 8, not {size}")
    return replace(
        one, value_bits=entry.whole("value_bits", min(most, 64) if limited else most, lowest=1, highest=most)
    )


def _read_value(entry: Description, one: Field, binary: bool) -> Field:
    scale = entry.number("scale", 1.0)
    entry.refuse(scale == 0, "scale", "must not be 0")
    lowest, highest = entry.number("lowest", -math.inf), entry.number("highest", math.inf)
    entry.refuse(lowest >= highest, "lowest", "must lie below highest")
    decimals = None
    if not binary and entry.has("decimals"):
        decimals = entry.whole("decimals", lowest=0, highest=15)
    return replace(
        one,
        scale=scale,
        offset=entry.number("offset", 0.0),
        lowest=lowest,
        highest=highest,
        unit=entry.choice("unit", OUTPUT_UNITS, COUNTS) if is_output(one.name) else COUNTS,
        decimals=decimals,
    )


def _read_turns(entry: Description, one: Field) -> Field:
    """A field in which several quantities take turns by the counter."""
    quantities = []
    for inner in entry.tables("quantities"):
        name = inner.text("name")
        inner.refuse(
            not name.isidentifier() or name in (COUNTER, *_WITHOUT_VALUE), "name", "must be a word of its own"
        )
        inner.refuse(is_output(name), "name", "must not be an output: outputs come with every frame")
        phases = inner.take("phases")
        right = isinstance(phases, list) and bool(phases) and all(type(phase) is int for phase in phases)
        inner.refuse(
            not right or not all(0 <= phase < one.cycle for phase in phases) or len(set(phases)) < len(phases),
            "phases",
            f"must be a list of different numbers from 0 to {one.cycle - 1}, not {phases!r}",
        )
        status = _read_status(inner) if name == STATUS else None
        inner.refuse(status is not None and len(phases) > 1, "phases", "of a status must be one")
        kind = inner.choice("type", ("signed", "unsigned", "float"), "unsigned" if name == STATUS else "signed")
        size = len(phases) * one.size
        inner.refuse(kind == "float" and size != 4, "type", "of a float needs four bytes")
        inner.refuse(size > 6, "phases", "make more than 6 bytes")
        quantities.append(
            FieldQuantity(
                name, tuple(phases), kind, inner.number("scale", 1.0), inner.number("offset", 0.0), status
            )
        )
        inner.finish()
    return replace(one, quantities=tuple(quantities))


def _read_status(entry: Description) -> StatusRule:
    rule = StatusRule(entry.whole("good_mask", 0), entry.whole("good_value", 0))
    entry.refuse(bool(rule.value & ~rule.mask), "good_value", "has bits that good_mask has not")
    return rule


def _check_cycles(table: Description, fields: list[Field], counter: CounterRule | None) -> None:
    turning = [one for one in fields if one.cycle]
    if len(turning) > 1:
        raise table.error("fields", "may hold one field with a cycle only")
    for one in turning:
        if counter is None or counter.modulus % one.cycle:
            raise table.error(
                "fields", f"{one.name}.cycle needs a counter whose modulus is a multiple of {one.cycle}"
            )
        names = [quantity.name for quantity in one.quantities]
        if len(set(names) | {known.name for known in fields if known.delivers}) < len(names) + sum(
            known.delivers for known in fields
        ):
            raise table.error("fields", f"{one.name}.quantities: a name is there twice")


# --------------------
# What the columns of a log are called, and in which units they stand


TIME, DATE = "time", "date"
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0, "ns": 1e-9}
_TIME_WORDS = {"sec": "s", "second": "s", "msec": "ms", "usec": "us", "nsec": "ns", "minute": "min", "hour": "h"}
TEMPERATURE_UNITS = {
    **dict.fromkeys(("", "c", "degc", "deg_c", "deg c", "°c", "celsius"), (0.0, 1.0)),
    **dict.fromkeys(("k", "kelvin"), (273.15, 1.0)),
    **dict.fromkeys(("f", "degf", "deg_f", "deg f", "°f"), (32.0, 1.8)),
}
"""What 0 deg C is in a unit, and how many of it are 1 K."""

EACH = "/sample"  # the angle since the output before

_DEFAULT = {1: (COUNTS,), 2: (TIME, COUNTS)}
_LONG_DEFAULT = (TIME, COUNTS, TEMPERATURE)
_SYNONYMS = {
    TIME: ("time", "t", "seconds", "second", "sec", "timestamp", "time_stamp", "datetime", "date_time"),
    DATE: ("date", "datum"),
    COUNTS: ("counts", "count", "output", "gyro", "n", "f", "lsb", "pulses", "rate", "fog"),
    TEMPERATURE: ("temperature", "temp", "t_c", "temperature_degc"),
    STATUS: ("status",),
    TABLE_ANGLE: ("table_deg", "table_angle", "table_position", "encoder_deg", "encoder_angle"),
    COUNTER: ("counter", "frame", "frame_number", "seq", "sequence", "index", "sample"),
}
_INCREMENT = r"(?:delta_?|d_?)(?:theta|angle)|angle_increment|increment"
_AXIS = re.compile(
    rf"(?:counts?|gyro|g|w|omega|rate|n|f|output|fog|axis|{_INCREMENT})?_?([xyz])(?:_?(?:axis|counts?|gyro|rate))?"
)
_SUFFIX = re.compile(
    r"_(s|sec|ms|us|ns|min|m?dps|dph|rps|m?deg_?[sh]|m?degp[sh]|[mu]?rad_s|arcsec_s|m?deg|[mu]?rad|arcsec)$"
)
_BRACKET = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$")
_UNIT_WORDS = {
    **dict.fromkeys(("count", "lsb", "pulses", "pulse", "codes", "code", "digits", ""), COUNTS),
    **{"dps": "deg/s", "mdps": "mdeg/s", "dph": "deg/h", "rps": "rad/s", "degps": "deg/s", "degph": "deg/h"},
    **{"mdegps": "mdeg/s", "asec": "arcsec"},
}


def axis_column(axis: str) -> str:
    """Name of the column with the output of one axis."""
    return f"{COUNTS}_{axis.lower()}"


def default_names(width: int) -> list[str]:
    """Names of the columns of a file without a header."""
    known = _DEFAULT.get(width, _LONG_DEFAULT)
    return [*known, *(f"column_{number}" for number in range(len(known) + 1, width + 1))]


def named_columns(header: Sequence[str]) -> tuple[list[str], list[str]]:
    """Our names of the columns of a header, and the units that it gives ("" where it gives none)."""
    pairs = [_named(cell.strip()) for cell in header]
    return [name for name, _ in pairs], [unit for _, unit in pairs]


def _named(cell: str) -> tuple[str, str]:
    word, unit = cell, ""
    if found := _BRACKET.search(cell):
        word, unit = cell[: found.start()], found[1].strip().lower()
    word = re.sub(r"[\s.-]+", "_", word.strip().lower())
    for name, synonyms in _SYNONYMS.items():
        if word in synonyms:
            return name, unit
    suffix = _SUFFIX.search(word) if not unit else None
    for stem, its_unit in ((word[: suffix.start()], suffix[1]) if suffix else (word, unit), (word, unit)):
        increment = re.match(rf"(?:{_INCREMENT})(?![a-z])", stem)
        its_unit += EACH if increment and its_unit and not its_unit.endswith(EACH) else ""
        if increment and increment.end() == len(stem):
            return COUNTS, its_unit
        for name, synonyms in _SYNONYMS.items():
            if stem in synonyms and name in (TIME, COUNTS, TEMPERATURE):
                return name, its_unit
        if axis := _AXIS.fullmatch(stem):
            return axis_column(axis[1]), its_unit
    return word, unit


def is_unit(word: str) -> bool:
    """Whether a cell below a header is the unit of its column, or none."""
    plain = word.lower()
    return plain in TEMPERATURE_UNITS or _time_unit(word) in SECONDS or _plain_unit(plain) in OUTPUT_UNITS


def _time_unit(word: str) -> str:
    plain = word.strip().lower().replace("µ", "u").replace("μ", "u").rstrip("s") or word
    return _TIME_WORDS.get(plain, word.strip().lower())


def seconds_of(unit: str) -> float:
    """Seconds in one unit of time; FileFormatError if there is no such unit."""
    if (plain := _time_unit(unit)) not in SECONDS:
        raise FileFormatError(f"the unit of time must be one of {', '.join(SECONDS)}, not {unit!r}")
    return SECONDS[plain]


def output_unit(unit: str, name: str) -> str:
    """Unit of an output as `OUTPUT_UNITS` has it; FileFormatError if it is none of them."""
    if (plain := _plain_unit(unit)) not in OUTPUT_UNITS:
        raise FileFormatError(
            f"the unit of {name} is {unit!r}; it must be one of {', '.join(OUTPUT_UNITS)}: say which with the "
            "option or setting units"
        )
    return plain


def _plain_unit(unit: str) -> str:
    plain = re.sub(r"[µμ]", "u", unit.lower()).replace("°", "deg").replace(" ", "").removesuffix(EACH)
    plain = re.sub(r"^(m|u|)(deg|rad)(ree|ian)?s?", r"\1\2", plain)
    plain = re.sub(r"(?:/|_|per)(s|h)(?:ec|r|econd|our)?s?$", r"/\1", plain)
    return _UNIT_WORDS.get(plain, plain)
