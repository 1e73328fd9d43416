"""Read the measured response of the channel: a CSV file of frequency, gain and phase."""

from __future__ import annotations

import csv
import itertools
import math
from pathlib import Path

from station.errors import SettingsError

Row = tuple[float, float, float]
_COLUMNS = 3


def read_response(path: Path) -> tuple[Row, ...]:
    """Read a table of the channel's response.

    Parameters
    ----------
    path : Path
        CSV with the columns frequency in Hz, gain (1 is neutral) and phase in deg; a line of headings and lines
        that begin with ``#`` are passed over.

    Returns
    -------
    tuple of (float, float, float)
        As they stand in the file.

    Raises
    ------
    SettingsError
        If it cannot be read or a line is not what it should be.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise SettingsError(f"{path}: is not a text file (byte {error.start} is not UTF-8)") from None
    rows: list[Row] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        row = _numbers(line)
        if row is None and not rows and number == _first_written(lines):
            continue  # the headings
        if row is None:
            raise SettingsError(
                f"{path}: line {number}: not three numbers (frequency_hz, gain, phase_deg): {line!r}"
            )
        rows.append(row)
    check_response(rows, str(path))
    return tuple(rows)


def check_response(rows: list[Row] | tuple[Row, ...], where: str) -> None:
    """See that a table can be interpolated.

    Raises
    ------
    SettingsError
        If it has fewer than two rows, or frequencies that do not rise, or gains that are not positive.
    """
    if len(rows) < 2:
        raise SettingsError(f"{where}: a response needs at least two frequencies")
    if any(after[0] <= before[0] for before, after in itertools.pairwise(rows)):
        raise SettingsError(f"{where}: the frequencies must rise from line to line")
    if any(row[0] <= 0 or row[1] <= 0 for row in rows):
        raise SettingsError(f"{where}: frequencies and gains must be positive")


def _numbers(line: str) -> Row | None:
    fields = next(csv.reader([line], skipinitialspace=True))
    try:
        values = [float(field) for field in fields]
    except ValueError:
        return None
    if len(values) != _COLUMNS or not all(math.isfinite(value) for value in values):
        return None
    return values[0], values[1], values[2]


def _first_written(lines: list[str]) -> int:
    """Number of the first line that is neither empty nor a remark."""
    return next(n for n, line in enumerate(lines, start=1) if line.strip() and not line.lstrip().startswith("#"))
