"""Waveform files of this family: the CSV that the scopes save themselves, ISF, and answers kept by PC software.

A file's content decides what it is, not its name.
"""

import csv
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from instrument import scpi
from instrument.errors import FileFormatError, TransferError
from instrument.scpi import LEVELS_PER_DIVISION, POINTS_PER_DIVISION
from instrument.text_files import read_small_file
from instrument.waveform import Preamble, Waveform, decode_curve

_LARGEST_FILE = 8_000_000  # bytes; a scope's CSV has about 100 kB
PREAMBLE_ENDING = ".wfmpre"
_SETUP = re.compile(r"(CH\d|MTH|REF\w)$", re.IGNORECASE)
_ABOUT = {
    "model": ("Model Number", "Model"),
    "serial": ("Serial Number",),
    "firmware": ("Firmware Version",),
    "probe": ("Probe Atten", "Probe Attenuation"),
}


@dataclass(frozen=True)
class TekFile:
    """A record and what the file says of the scope that wrote it."""

    waveform: Waveform
    kind: str  # {"csv", "isf", "curve"}: CSV; ISF; the answers of ``WFMPre?`` and ``CURVe?`` as they came
    keys: dict[str, str]  # rows of a CSV by their names, as they stand there
    # content of the ``*TEK.SET`` file beside it: the settings of the scope as one text; empty if there is none
    setup: str

    @property
    def about(self) -> dict[str, str]:
        """``model``, ``serial``, ``firmware`` and ``probe``, as far as the file names them."""
        found = {name: next((self.keys[k] for k in keys if self.keys.get(k)), "") for name, keys in _ABOUT.items()}
        found["firmware"] = found["firmware"].removeprefix("FV:")
        return {name: text for name, text in found.items() if text}

    def setting(self, command: str) -> str:
        """Setting of the channel in the setup beside the file: ``COUPLING``, ``INVERT``...; "" if unknown."""
        source = self.waveform.preamble.wfid.split(",")[0].upper()
        for part in self.setup.upper().split(";:"):
            header, _, rest = part.removeprefix(":").partition(":")
            if header == source:
                for one in rest.split(";"):
                    name, _, value = one.partition(" ")
                    if name == command:
                        return value.strip()
        return ""


def read_waveform(path: str | os.PathLike[str]) -> Waveform:
    """Read the record of a waveform file; see `read_tek_file`."""
    return read_tek_file(path).waveform


def read_tek_file(path: str | os.PathLike[str]) -> TekFile:
    """Read a waveform file of a Tektronix oscilloscope; the content decides which kind it is, not the name."""
    file = Path(path)
    content = read_small_file(file, _LARGEST_FILE)
    try:
        with np.errstate(all="ignore"):  # what is not finite is looked for
            waveform, kind, keys = _parsed(file, content)
    except (FileFormatError, TransferError) as error:
        reason = str(error).removesuffix("; ask again")
        raise FileFormatError(f"{file}: {reason}") from None
    except (ArithmeticError, ValueError) as error:
        raise FileFormatError(f"{file}: holds a number that no record has ({error})") from None
    return TekFile(waveform, kind, keys, _setup_beside(file))


def _parsed(file: Path, content: bytes) -> tuple[Waveform, str, dict[str, str]]:
    if content[:64].lstrip().upper().startswith((b":WFMP", b"WFMP")):
        return parse_isf(content), "isf", {}
    start = content.lstrip()[:32].upper()
    start = start.removeprefix(b":").removeprefix(b"CURVE").removeprefix(b"CURV").lstrip()
    if start[:1] == b"#" and start[1:2].isdigit():  # the binary block of CURVe?
        preamble = file.with_suffix(PREAMBLE_ENDING)
        if not preamble.is_file():
            raise FileFormatError(
                "holds the answer of CURVe? alone: put that of WFMPre? beside it in a file named "
                f"{preamble.name}, or both into one file"
            )
        return parse_curve(decoded(read_small_file(preamble, _LARGEST_FILE)), content), "curve", {}
    if (answers := parse_answers(content)) is not None:
        return answers, "curve", {}
    rows = cells_of(decoded(content))
    heading = heading_row(rows)
    if heading is not None:
        waveform, keys = parse_later(rows, heading)
        return waveform, "csv", keys
    waveform, keys = parse_cells(rows)
    return waveform, "csv", keys


def _setup_beside(file: Path) -> str:
    """The ``F0000TEK.SET`` of a record ``F0000CH1.CSV``."""
    stem = _SETUP.sub("TEK", file.stem)
    if stem == file.stem:
        return ""
    for name in (f"{stem}.SET", f"{stem}.set"):
        try:
            return read_small_file(file.with_name(name), _LARGEST_FILE).decode("latin-1").strip()
        except (OSError, FileFormatError):
            continue
    return ""


# --------------------
# ISF files, and the answers of ``WFMPre?`` and ``CURVe?`` as a program has kept them


def parse_isf(content: bytes) -> Waveform:
    """Read the content of an ISF file. Errors as `read_waveform`."""
    marker = _curve_position(content)
    preamble = Preamble.parse(content[:marker].decode("latin-1").strip().rstrip(";"))
    check_length(preamble.nr_pt)
    return _curve_of(content[marker:], preamble)


def parse_curve(preamble: str, content: bytes) -> Waveform:
    """Read the answer of ``CURVe?``, with that of ``WFMPre?`` beside it. Errors as `read_waveform`."""
    described = Preamble.parse(preamble.strip())
    check_length(described.nr_pt)
    return _curve_of(content if content.lstrip()[:1] == b"#" else b"CURVE " + content, described)


def parse_answers(content: bytes) -> Waveform | None:
    """Read the answers of ``WFMPre?`` and ``CURVe?`` behind each other; ``None`` if it begins with no preamble."""
    first = _ANSWER.match(content)
    if first is None:
        return None
    preamble, rest = first.group(1).decode("latin-1"), content[first.end() :].lstrip(b"; \r\n")
    if not rest:
        raise FileFormatError("holds the answer of WFMPre? without that of CURVe?: it is cut, save it again")
    return parse_curve(preamble, rest)


def _curve_of(curve: bytes, preamble: Preamble) -> Waveform:
    start = curve.find(b"#")
    if preamble.encdg == "ASC" or start < 0:
        words = curve.split(maxsplit=1)
        return decode_curve(words[1] if len(words) > 1 else b"", preamble)
    # Some programs put more line ends behind the block than one, and some none.
    block = curve[start:]
    length = preamble.nr_pt * preamble.byt_nr
    end = len(b"#") + 1 + len(str(length)) + length
    if not block[end:].strip(b"\r\n"):
        block = block[:end]
    _, data = scpi.split_block(block, longest=length, terminated=False)
    return decode_curve(data, preamble)


_ANSWER = re.compile(
    rb"\s*([12];(?:8|16);(?:ASC|BIN)[^;]*;R[IP];[ML]SB;\d+;\"[^\"]*\"(?:;[^;\r\n#]*){9})", re.IGNORECASE
)
"""The sixteen fields of a preamble without headers."""


def _curve_position(content: bytes) -> int:
    for spelling in (b":CURVE", b":CURV", b";CURVE", b";CURV"):
        # Only the part before the block is text, so the first hit is the header.
        position = content.upper().find(spelling)
        if position >= 0:
            return position
    raise FileFormatError("the ISF file has a preamble but no curve; it is cut, save it again")


# --------------------
# CSV files of every generation of these scopes, read and written: key rows beside the first points.
#
# It holds volts, not codes. Every value is a whole number of codes times V/div over 25, so the codes come back
# exactly. The FFT that a scope saves as CSV is read as well: its preamble says ``Hz`` and ``dB``


_LONGEST_RECORD = 500_000  # points, 200 times those of this family: more cannot be fitted in a small memory
_NOT_A_CODE = 0.3  # a value farther than this from a whole code is not one that an 8-bit scope wrote
_KEYS = {"Record Length", "Sample Interval", "Trigger Point", "Source", "Vertical Scale"}
"""Key rows of which a file of a scope has at least one."""

_UNITS = {"V": "Volts"}  # the CSV says V where the preamble of the same record says Volts


def parse_csv(text: str) -> Waveform:
    """Read the text of a scope's CSV file. Errors as `read_waveform`."""
    return parse_cells(cells_of(text))[0]


def parse_cells(rows: list[list[str]]) -> tuple[Waveform, dict[str, str]]:
    """Read the cells of a scope's CSV file; errors as `read_waveform`."""
    header, times, values = _csv_columns(rows)
    check_length(len(values))
    if "Vertical Scale" in header:
        scale = _positive(header, "Vertical Scale")
    else:
        scale = _nearest(spacing_of(values), "level", _LEVEL_CLOSE) * LEVELS_PER_DIVISION
    if "Sample Interval" in header:
        interval = _positive(header, "Sample Interval")
    else:
        interval = nice_interval(float((times[-1] - times[0]) / max(len(times) - 1, 1)))
    x_unit = header.get("Horizontal Units", "s")
    ymult = scale / LEVELS_PER_DIVISION
    yoff = header_number(header, "Vertical Offset", 0.0) / ymult
    # The position moves in whole levels; the file gives it with seven digits.
    yoff = float(round(yoff)) if abs(yoff - round(yoff)) < 1e-3 else yoff
    yzero = header_number(header, "Yzero", 0.0)
    # Adding 0.0 turns the -0 of a scan record into 0.
    xzero = -header_number(header, "Trigger Point", -times[0] / interval) * interval + 0.0
    # Times have twelve decimals, and spreadsheets keep about five digits.
    slack = 0.5 * interval + 2e-12 + 1e-5 * np.abs(times).max()
    steps_off = np.abs(np.diff(times) - interval) > 0.5 * interval + 2e-12 + 1e-5 * np.abs(times[1:])
    wrong = np.flatnonzero(steps_off)
    if wrong.size:
        raise FileFormatError(
            f"the time does not go on evenly after point {wrong[0] + 1}: rows are missing or doubled; "
            "restore the file"
        )
    if abs(times[0] - xzero) > slack:
        raise FileFormatError("the time column does not begin where 'Trigger Point' says; restore the file")
    y_unit, source = header.get("Vertical Units", "V"), header.get("Source", "?").capitalize()
    horizontal = header_number(header, "Horizontal Scale", 0.0)
    scales = f"{scpi.nr3(scale)} {y_unit}/div, {scpi.nr3(horizontal)} {x_unit}/div"
    preamble = Preamble(
        byt_nr=1,
        bit_nr=8,
        encdg="BIN",
        bn_fmt="RI",
        byt_or="MSB",
        nr_pt=len(values),
        wfid=f"{source}, {scales}, {len(values)} points, from a CSV file",
        pt_fmt=header.get("Pt Fmt", "Y"),
        xincr=interval,
        pt_off=0,
        xzero=xzero,
        xunit=x_unit,
        ymult=ymult,
        yzero=yzero,
        yoff=yoff,
        yunit=_UNITS.get(y_unit, y_unit),
    )
    return Waveform(_codes(values, preamble), preamble), header


def _csv_columns(rows: list[list[str]]) -> tuple[dict[str, str], NDArray[np.float64], NDArray[np.float64]]:
    header: dict[str, str] = {}
    times: list[float] = []
    values: list[float] = []
    for line_number, cells in enumerate(rows, start=1):
        line = ",".join(cells)
        if not any(cells):
            continue
        if len(cells) < 5 or not cells[3] or not cells[4]:
            if not times:
                continue  # a title row that somebody put on top
            raise FileFormatError(f"line {line_number} has no time and value ({line[:60]!r}); restore the file")
        try:
            time, value = float(cells[3]), float(cells[4])
        except ValueError:
            if not times:
                continue
            raise FileFormatError(
                f"line {line_number} holds no numbers ({line[:60]!r}); restore the file"
            ) from None
        if not (np.isfinite(time) and np.isfinite(value)):
            raise FileFormatError(f"line {line_number} holds a value that is not a number; restore the file")
        times.append(time)
        values.append(value)
        if cells[0]:
            header[cells[0]] = cells[1]
    if len(times) < 2 or not _KEYS & header.keys():
        raise FileFormatError(
            "this is not a waveform file of a Tektronix TDS, TPS or TBS scope (no 'Sample Interval', "
            "no rows of time and value); choose a file such as F0000CH1.CSV"
        )
    return header, np.array(times), np.array(values)


def _codes(values: NDArray[np.float64], preamble: Preamble) -> NDArray[np.int8]:
    levels = (values - preamble.yzero) / preamble.ymult + preamble.yoff
    if not np.isfinite(levels).all():
        raise FileFormatError("values and vertical scale do not go together: the file was edited")
    codes = np.round(levels)
    worst = int(np.argmax(np.abs(levels - codes)))
    # The file has five decimals, which is coarse against a level at 2 mV/div and a 1:1 probe.
    if abs(levels[worst] - codes[worst]) > _NOT_A_CODE:
        raise FileFormatError(
            f"point {worst + 1} ({values[worst]:g}) is not a whole number of converter levels of "
            f"{preamble.ymult:g}: the values were edited or come from another kind of scope"
        )
    if codes.min() < -128 or codes.max() > 127:
        raise FileFormatError(
            "values lie outside the range of an 8-bit converter at this vertical scale: the file was edited "
            "or comes from another kind of scope"
        )
    return codes.astype(np.int8)


def header_number(header: dict[str, str], key: str, default: float | None = None) -> float:
    """Number of a key row; FileFormatError if it is missing without a default, or no number."""
    text = header.get(key)
    if text is None and default is not None:
        return float(default)
    try:
        value = float(text or "")
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise FileFormatError(f"the row {key!r} is missing or holds no number ({text!r}); restore the file")
    return value


def _positive(header: dict[str, str], key: str) -> float:
    value = header_number(header, key)
    if value <= 0:
        raise FileFormatError(f"the row {key!r} holds {value:g} where a positive number belongs; restore the file")
    return value


def check_length(points: int) -> None:
    """Refuse more points than can be fitted; FileFormatError."""
    if points > _LONGEST_RECORD:
        raise FileFormatError(f"it has {points} points, at most {_LONGEST_RECORD} are read: save a shorter record")


# --------------------
# CSV of later models (TBS1000C, TBS2000, MDO, MSO...): rows of a key and its value, then time and volts.
#
# Such files give the values with more digits, and some models have more than eight bits: the levels are found from
# the values themselves


_MARGIN = 100  # codes to either side of the middle of a record of eight bits


def heading_row(rows: list[list[str]]) -> int | None:
    """Number of the row ``TIME,CH1``; ``None`` if this is no such file."""
    for number, row in enumerate(rows[:100]):
        if row and row[0].upper() in ("TIME", "FREQUENCY") and len(row) > 1 and row[1]:
            return number
    return None


def parse_later(rows: list[list[str]], heading: int) -> tuple[Waveform, dict[str, str]]:
    """Read the cells of such a file."""
    header = {row[0].title(): row[1] for row in rows[:heading] if len(row) > 1 and row[0]}
    columns = [name for name in rows[heading][1:] if name]
    if any("peak detect" in name.lower() for name in columns):
        raise FileFormatError("was taken with Peak Detect: it holds minima and maxima; use SAMPLE mode")
    if len(columns) > 1:
        raise FileFormatError(
            f"holds several traces ({', '.join(columns)}): save each channel as a file of its own"
        )
    if rows[heading][0].upper() == "FREQUENCY":
        raise FileFormatError("is a spectrum, not a record over time: save the channel itself")
    data = [row for row in rows[heading + 1 :] if any(row)]
    check_length(len(data))
    try:
        table = np.array([row[:2] for row in data], dtype=np.float64)
    except ValueError:
        wrong = next((n for n, row in enumerate(data) if not _is_data(row)), 0)
        raise FileFormatError(f"line {heading + wrong + 2} holds no time and value; restore the file") from None
    if table.ndim != 2 or len(table) < 2 or not np.isfinite(table).all():
        raise FileFormatError("holds no rows of time and value")
    times, values = table.T
    interval = float((times[-1] - times[0]) / (len(times) - 1))
    if "Sample Interval" in header:
        stated = header_number(header, "Sample Interval")
        if not abs(interval - stated) < 1e-3 * abs(stated):
            raise FileFormatError("times and 'Sample Interval' do not go together: rows are missing or doubled")
        interval = stated
    if not interval > 0 or np.abs(np.diff(times) - interval).max() > 0.5 * interval:
        raise FileFormatError("the time does not go on evenly: rows are missing or doubled; restore the file")
    return _waveform(header, columns[0], times, values, interval), header


def _is_data(row: list[str]) -> bool:
    try:
        return len(row) > 1 and bool(np.isfinite([float(row[0]), float(row[1])]).all())
    except ValueError:
        return False


def _waveform(
    header: dict[str, str], source: str, times: NDArray[np.float64], values: NDArray[np.float64], interval: float
) -> Waveform:
    scale = header_number(header, "Vertical Scale", 1.0)
    spacing = spacing_of(values)
    if not np.isfinite(spacing):
        spacing = scale / LEVELS_PER_DIVISION
    # zero volts is a level of most of these; what is left is the offset
    yzero = float(values[0] - np.rint(values[0] / spacing) * spacing)
    levels = np.rint((values - yzero) / spacing)
    middle = float(np.rint((levels.min() + levels.max()) / 2))
    shift = 0.0 if np.abs(levels).max() <= _MARGIN else middle
    codes, wide = levels - shift, bool(np.abs(levels - shift).max() > 127)
    if wide and np.abs(codes).max() > 32767:
        raise FileFormatError("the values need more than 16 bits: they were calculated, not measured")
    units, vertical = header.get("Horizontal Units", "s"), header.get("Vertical Units", "V")
    per_division = header_number(header, "Horizontal Scale", 0.0)
    preamble = Preamble(
        byt_nr=2 if wide else 1,
        bit_nr=16 if wide else 8,
        encdg="BIN",
        bn_fmt="RI",
        byt_or="MSB",
        nr_pt=len(values),
        wfid=f"{source.capitalize()}, {scpi.nr3(scale)} {vertical}/div, {scpi.nr3(per_division)} "
        f"{units.lower()}/div, {len(values)} points, from a CSV file",
        pt_fmt="Y",
        xincr=interval,
        pt_off=0,
        xzero=float(times[0]),
        xunit="s" if units.lower() == "s" else units,
        ymult=spacing,
        yzero=yzero,
        yoff=-shift,
        yunit="Volts" if vertical.upper() == "V" else vertical,
    )
    return Waveform(codes.astype(np.int16) if wide else codes.astype(np.int8), preamble)


# --------------------
# The CSV file of a record as the scopes of this family write it, byte for byte.
#
# The layout was found in files of real units. A point at the time zero of a record that begins before its trigger
# is written with a minus sign, as they do


_UNITS_WRITTEN = {"Volts": "V"}
_DECIMALS = 12


def csv_text(waveform: Waveform, keys: Mapping[str, str] | None = None) -> str:
    """Return the text of the CSV file; `read_waveform` of it gives the same codes."""
    preamble = waveform.preamble
    if waveform.codes.dtype != np.int8 or preamble.xunit != "s":
        raise FileFormatError("a CSV of this family holds records over time of eight bits: take another kind")
    if not np.isfinite(waveform.volts).all():
        raise FileFormatError("a CSV of this family has no sign for missing samples: take another kind")
    rows = [
        ("Record Length", f"{preamble.nr_pt:e}"),
        ("Sample Interval", f"{preamble.xincr:e}"),
        ("Trigger Point", f"{-preamble.xzero / preamble.xincr + 0.0:.12e}"),
        *[("", "")] * 3,
        ("Source", preamble.wfid.split(",")[0].upper()),
        ("Vertical Units", _UNITS_WRITTEN.get(preamble.yunit, preamble.yunit)),
        ("Vertical Scale", f"{preamble.ymult * LEVELS_PER_DIVISION:e}"),
        ("Vertical Offset", f"{preamble.yoff * preamble.ymult + 0.0:e}"),
        ("Horizontal Units", preamble.xunit),
        ("Horizontal Scale", f"{_per_division(preamble):e}"),
        ("Pt Fmt", preamble.pt_fmt),
        ("Yzero", f"{preamble.yzero:e}"),
        *(keys or {}).items(),
    ]
    times = preamble.xzero + preamble.xincr * np.arange(preamble.nr_pt)
    first = f"{times[0]:.{_DECIMALS}f}"
    # a record that begins before its trigger has its time zero with a minus sign
    last_negative = 0.5 * preamble.xincr if preamble.xzero < 0 else -0.5 * preamble.xincr
    lines = []
    for number, (time, value) in enumerate(zip(times.tolist(), waveform.volts.tolist(), strict=True)):
        key, text = rows[number] if number < len(rows) else ("", "")
        digits, sign = f"{abs(time):.{_DECIMALS}f}", "-" if time < last_negative else ""
        # below the key rows zeros after the sign, up to the width of the first value, instead of blanks
        when = f"{sign + digits:>17}" if number < len(rows) else sign + digits.zfill(len(first))
        lines.append(f"{key},{text},,{when},{value + 0.0:10.5f},\n")
    return "".join(lines)


def _per_division(preamble: Preamble) -> float:
    """s/div, from the interval; 2.5 ns/div and its like are rounded to what the knob has."""
    wanted = preamble.xincr * POINTS_PER_DIVISION
    exponent = math.floor(math.log10(wanted))
    steps = [float(f"{digit}e{exponent}") for digit in ("1", "2.5", "5", "10")]
    nearest = min(steps, key=lambda one: abs(one / wanted - 1))
    return nearest if abs(nearest / wanted - 1) < 1e-6 else wanted


# --------------------
# Which level of the converter each value of a file is, where the file does not give the scale itself


_NICE = {"time": (1.0, 2.0, 4.0), "level": (2.0, 4.0, 8.0)}
"""Leading digits of the interval at 1-2.5-5 s/div over 250 points, and of a level at 1-2-5 V/div over 25."""

_TIME_CLOSE, _LEVEL_CLOSE = 2e-4, 0.05

_PARTS, _OFF = 8, 0.15


def spacing_of(values: NDArray[np.float64]) -> float:
    """Spacing of the levels on which values lie; nan where all are equal."""
    levels = np.unique(values)
    if levels.size < 2:
        return math.nan
    gaps = np.diff(levels)
    # decimals that were cut make one level look like two very close ones
    gaps = gaps[gaps > 1e-3 * gaps.max()] if gaps.min() < 1e-6 * (levels[-1] - levels[0]) else gaps
    above = levels - levels[0]
    for part in range(1, _PARTS + 1):  # records that skip levels show several of them as the least gap
        spacing = float(gaps.min()) / part
        for _ in range(3):
            steps = np.rint(above / spacing)
            spacing = float(np.dot(steps, above) / np.dot(steps, steps))
        if np.abs(above / spacing - np.rint(above / spacing)).max() < _OFF:
            return spacing
    raise FileFormatError("the values do not lie on the levels of a converter: they were edited or calculated")


def nice_interval(interval: float) -> float:
    """The sample interval of a 1-2.5-5 time base next to a measured one; the same where there is none."""
    try:
        return _nearest(interval, "time", _TIME_CLOSE)
    except FileFormatError:
        return interval


def _nearest(value: float, kind: str, close: float) -> float:
    if not (math.isfinite(value) and value > 0):
        raise FileFormatError(
            "the row 'Vertical Scale' is missing, and the values do not tell it; restore the file"
        )
    exponent = math.floor(math.log10(value))
    candidates = [
        float(f"{digit:g}e{power}") for power in (exponent - 1, exponent, exponent + 1) for digit in _NICE[kind]
    ]
    best = min(candidates, key=lambda one: abs(math.log(one / value)))
    if abs(best / value - 1) > close:
        raise FileFormatError(
            f"the row 'Vertical Scale' is missing, and levels {value:.4g} apart fit no scale; restore the file"
        )
    return best


# --------------------
# A text of separated values as cells, whatever a spreadsheet has made of it


_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*")
_LOOKED_AT = 40


def decoded(content: bytes) -> str:
    """Text of a file: UTF-8 with or without its mark, or UTF-16 with it."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16", errors="replace")
    return content.decode("utf-8-sig", errors="replace")


def cells_of(text: str) -> list[list[str]]:
    """Split lines into cells; separators are commas, semicolons or tabs, decimal commas become points."""
    lines = text.splitlines()
    first = [line for line in lines if line.strip()][:_LOOKED_AT]
    separator = ","
    for other in ("\t", ";"):
        if first and sum(other in line for line in first) > len(first) // 2:
            separator = other
    if '"' in text:
        rows = [list(row) for row in csv.reader(lines, delimiter=separator)]
    else:
        rows = [line.split(separator) for line in lines]
    if separator != "," or '"' in text:
        rows = [
            [(cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell) for cell in row] for row in rows
        ]
    return [[cell.strip() for cell in row] for row in rows]
