"""What the columns of a log are called, and in which units they stand."""

from __future__ import annotations

import re
from collections.abc import Sequence

from instrument.errors import FileFormatError
from instrument.fibre_gyro.frame_format import COUNTER, COUNTS, STATUS, TEMPERATURE

TIME = "time"
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}
OUTPUT_UNITS = {"counts": 0.0, "deg/s": 1.0, "deg/h": 1 / 3600.0, "rad/s": 180 / 3.141592653589793}
"""Units of the output, and how many deg/s one of each is; counts are none."""

_DEFAULT = {1: (COUNTS,), 2: (TIME, COUNTS)}
_LONG_DEFAULT = (TIME, COUNTS, TEMPERATURE)
_SYNONYMS = {
    TIME: ("time", "t", "seconds", "second", "sec", "timestamp", "time_stamp"),
    COUNTS: ("counts", "count", "output", "gyro", "n", "f", "lsb", "pulses", "rate", "fog"),
    TEMPERATURE: ("temperature", "temp", "t_c", "temperature_degc"),
    STATUS: ("status",),
    COUNTER: ("counter", "frame", "frame_number", "seq", "sequence", "index", "sample"),
}
_AXIS = re.compile(
    r"(?:counts?|gyro|g|w|omega|rate|n|f|output|fog|axis)?_?([xyz])(?:_?(?:axis|counts?|gyro|rate))?"
)
_SUFFIX = re.compile(r"(?:^|_)(s|ms|us|min|dps|dph|deg_s|deg_h|degps|degph)$")
_BRACKET = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$")
_UNIT_WORDS = {
    "counts": ("counts", "count", "lsb", "pulses", "pulse", "codes", "code", "digits", ""),
    "deg/s": ("deg/s", "dps", "deg_s", "degps", "°/s", "deg/sec"),
    "deg/h": ("deg/h", "dph", "deg_h", "degph", "°/h", "deg/hr", "deg/hour"),
    "rad/s": ("rad/s", "rps", "rad/sec"),
}


def axis_column(axis: str) -> str:
    """Name of the column with the output of one axis.

    Examples
    --------
    >>> axis_column("Z")
    'counts_z'
    """
    return f"{COUNTS}_{axis.lower()}"


def default_names(width: int) -> list[str]:
    """Names of the columns of a file without a header."""
    known = _DEFAULT.get(width, _LONG_DEFAULT)
    return [*known, *(f"column_{number}" for number in range(len(known) + 1, width + 1))]


def named_columns(header: Sequence[str]) -> tuple[list[str], list[str]]:
    """Our names of the columns of a header, and the units that it gives ("" where it gives none).

    Examples
    --------
    >>> named_columns(["Time [ms]", "Gyro X (deg/h)", "T_C", "hot"])
    (['time', 'counts_x', 'temperature', 'hot'], ['ms', 'deg/h', '', ''])
    """
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
    if not unit and (suffix := _SUFFIX.search(word)) and suffix.start() > 0:
        stem = word[: suffix.start()]
        for name, synonyms in _SYNONYMS.items():
            if stem in synonyms and name in (TIME, COUNTS):
                return name, suffix[1]
        if axis := _AXIS.fullmatch(stem):
            return axis_column(axis[1]), suffix[1]
    if axis := _AXIS.fullmatch(word):
        return axis_column(axis[1]), unit
    return word, unit


def seconds_of(unit: str) -> float:
    """Seconds in one unit of time; FileFormatError if there is no such unit."""
    if unit not in SECONDS:
        raise FileFormatError(f"the unit of time must be one of {', '.join(SECONDS)}, not {unit!r}")
    return SECONDS[unit]


def output_unit(unit: str, name: str) -> str:
    """Unit of an output as `OUTPUT_UNITS` has it; FileFormatError if it is none of them."""
    for known, words in _UNIT_WORDS.items():
        if unit.lower() in words:
            return known
    raise FileFormatError(
        f"the unit of {name} is {unit!r}; it must be one of {', '.join(OUTPUT_UNITS)}: say which with the "
        "option or setting units"
    )
