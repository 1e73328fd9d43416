"""Output of a fibre gyro as columns: times, counts, temperature and what else its frames hold.

A record of it is a stretch of output. In a run its columns are packed; in a data set they stand as they are, for
other programs, and the checksum of the row is over them.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

OUTPUTS = ("output_time_s", "output_counts", "output_temperature", "output_status", "output_extra")
"""Columns of a data set. A stretch without a temperature or a status has none there; further columns, which its
header names, stand one behind the other in the last."""

_CALLED = dict(zip(("times", "counts", "temperature", "status"), OUTPUTS, strict=False))


def unpacked(header: str, payload: bytes) -> dict[str, Floats] | None:
    """Return the output that a record of a run holds, by the names of `OUTPUTS`."""
    if not header.startswith("{"):
        return None
    try:
        names = json.loads(header)["columns"]
        data = zlib.decompress(payload)
        table = np.frombuffer(data, "<f8").reshape(len(names), -1)
        found: dict[str, Floats] = {name: np.empty(0) for name in OUTPUTS}
        found |= {_CALLED[name]: column for name, column in zip(names, table, strict=True) if name in _CALLED}
        further = [column for name, column in zip(names, table, strict=True) if name not in _CALLED]
        found[OUTPUTS[-1]] = np.concatenate([np.empty(0), *further])
        return found if data and bytes_of(header, found) == data else None
    except (zlib.error, ValueError, KeyError, TypeError):
        return None


def bytes_of(header: str, outputs: Mapping[str, Floats]) -> bytes:
    """Return the columns one behind the other, as the header names them: what the checksum is over."""
    names: Sequence[str] = json.loads(header)["columns"]
    length = len(outputs[OUTPUTS[0]])
    if not length:
        return b""
    further = iter(np.asarray(outputs[OUTPUTS[-1]], np.float64).reshape(-1, length))
    columns = [outputs[_CALLED[name]] if name in _CALLED else next(further, np.empty(0)) for name in names]
    if any(len(column) != length for column in columns) or next(further, None) is not None:
        raise ValueError("the columns of an output are not of one length")
    # nan of every kind is one and the same in text: other bits than its usual ones would be lost there
    return b"".join(np.where(np.isnan(column), np.nan, column).astype("<f8").tobytes() for column in columns)


def packed(header: str, outputs: Mapping[str, Floats]) -> tuple[bytes, bytes]:
    """Return the payload of a record in a run, and what its sum in a data set is over; errors as `bytes_of`."""
    data = bytes_of(header, outputs)
    return zlib.compress(data, 1), data
