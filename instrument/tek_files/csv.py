"""CSV files of every generation of these scopes, read and written: key rows beside the first points.

It holds volts, not codes. Every value is a whole number of codes times V/div over 25, so the codes come back
exactly. The FFT that a scope saves as CSV is read as well: its preamble says ``Hz`` and ``dB``.
"""

import csv
import math
import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from instrument import scpi
from instrument.errors import FileFormatError
from instrument.scpi import LEVELS_PER_DIVISION, POINTS_PER_DIVISION
from instrument.waveform import Preamble, Waveform

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
    y_unit = header.get("Vertical Units", "V")
    preamble = Preamble(
        byt_nr=1,
        bit_nr=8,
        encdg="BIN",
        bn_fmt="RI",
        byt_or="MSB",
        nr_pt=len(values),
        wfid=_wfid(header, scale, y_unit, x_unit, len(values)),
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


def _wfid(header: dict[str, str], scale: float, y_unit: str, x_unit: str, points: int) -> str:
    source = header.get("Source", "?").capitalize()
    horizontal = header_number(header, "Horizontal Scale", 0.0)
    scales = f"{scpi.nr3(scale)} {y_unit}/div, {scpi.nr3(horizontal)} {x_unit}/div"
    return f"{source}, {scales}, {points} points, from a CSV file"


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
