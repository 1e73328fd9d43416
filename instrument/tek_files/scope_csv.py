"""The CSV file that a scope of this family saves: key rows beside the first points.

It holds volts, not codes. Every value is a whole number of codes times V/div over 25, so the codes come back
exactly. The FFT that a scope saves as CSV is read as well: its preamble says ``Hz`` and ``dB``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from instrument import scpi
from instrument.errors import FileFormatError
from instrument.facts import LEVELS_PER_DIVISION
from instrument.tek_files.cells import cells_of
from instrument.tek_files.levels import nice_interval, nice_level, spacing_of
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
        scale = nice_level(spacing_of(values)) * LEVELS_PER_DIVISION
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
    _check_times(times, xzero, interval)
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


def _check_times(times: NDArray[np.float64], xzero: float, interval: float) -> None:
    """The time column must run evenly: a missing or doubled row would shift everything behind it."""
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
