"""CSV of later models (TBS1000C, TBS2000, MDO, MSO...): rows of a key and its value, then time and volts.

Such files give the values with more digits, and some models have more than eight bits: the levels are found from
the values themselves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from instrument import scpi
from instrument.errors import FileFormatError
from instrument.facts import LEVELS_PER_DIVISION
from instrument.tek_files.levels import spacing_of
from instrument.tek_files.scope_csv import check_length, header_number
from instrument.waveform import Preamble, Waveform

_MARGIN = 100
"""Codes to either side of the middle of a record of eight bits."""


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
