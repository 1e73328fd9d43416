"""From the numbers of frames to the columns of a recording: outputs in counts, and what came with them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from instrument.errors import SettingError
from instrument.fibre_gyro.frame_format.fields import COUNTS, Field, Quantity
from instrument.fibre_gyro.frame_format.layout import FrameFormat
from instrument.fibre_gyro.recording import Floats

_DPS = {"deg/s": 1.0, "deg/h": 1 / 3600, "rad/s": 180 / math.pi}
_DEGREES = {"deg": 1.0, "rad": 180 / math.pi}

ANGLES = tuple(_DEGREES)
"""Units of an output that is the angle since the output before: its rate depends on the interval."""


def columns_of(
    layout: FrameFormat,
    rows: Sequence[tuple[float, ...]],
    counters: Sequence[int],
    *,
    interval_s: float,
    counts_per_dps: float | None,
) -> dict[str, Floats]:
    """All columns by name, outputs in counts; quantities that take turns hold until they come again."""
    table = np.array(rows, dtype=np.float64).reshape(-1, len(layout.names))
    columns: dict[str, Floats] = dict(zip(layout.names, table.T.copy(), strict=True))
    turning = layout.turning
    if turning is not None:
        raw = columns.pop(turning.name)
        for quantity in turning.quantities:
            columns[quantity.name] = _in_turn(turning, quantity, raw, np.array(counters, dtype=np.int64))
    scale = counts_per_unit(layout.unit, interval_s, counts_per_dps)
    if scale != 1.0:
        for name in layout.outputs:
            columns[name] *= scale
    return columns


def counts_per_unit(unit: str, interval_s: float, counts_per_dps: float | None) -> float:
    """Counts for one unit of the output; parameters and errors as `columns_of`."""
    if unit == COUNTS:
        return 1.0
    if counts_per_dps is None:
        raise SettingError(f"the output is in {unit}: say how many counts 1 deg/s is")
    return counts_per_dps * (_DPS[unit] if unit in _DPS else _DEGREES[unit] / interval_s)


def _in_turn(turning: Field, quantity: Quantity, raw: Floats, counters: NDArray[np.int64]) -> Floats:
    """A quantity at every row: the last one that came whole, before the first the first."""
    turn, phase = np.divmod(counters, turning.cycle)
    turn = np.cumsum(np.concatenate([[0], np.diff(turn) != 0])) if turn.size else turn
    size = turning.size
    parts = [
        dict(zip(turn[phase == one].tolist(), np.flatnonzero(phase == one).tolist(), strict=True))
        for one in quantity.phases
    ]
    whole = sorted(set(parts[0]).intersection(*parts[1:]))
    found = np.full(raw.size, np.nan)
    for number in whole:
        places = [part[number] for part in parts]
        value = sum(int(raw[place]) << (8 * size * rank) for rank, place in enumerate(places))
        found[max(places)] = _number(value, 8 * size * len(parts), quantity)
    known = np.flatnonzero(np.isfinite(found))
    if known.size == 0:
        return found
    held = known[np.maximum(np.searchsorted(known, np.arange(raw.size), side="right") - 1, 0)]
    return np.asarray(found[held])


def _number(value: int, bits: int, quantity: Quantity) -> float:
    if quantity.kind == "float":
        number = float(np.array(value, dtype=np.uint32).view(np.float32))
    elif quantity.kind == "signed" and value >> (bits - 1):
        number = float(value - (1 << bits))
    else:
        number = float(value)
    return number * quantity.scale + quantity.offset
