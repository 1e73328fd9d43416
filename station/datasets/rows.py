"""The one table that every format holds: a row for each record, with fixed columns.

What a program wants to choose by stands in columns of its own; what gives the same result again (the preamble as
it was sent, the conditions, what is known of the source) stands beside it as text, and a checksum over it. The
bytes of an oscilloscope's record are its codes; whatever else an instrument sent is a payload.
"""

import importlib
import json
import math
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument import InstrumentError, Preamble
from station.errors import RunError, UsageError
from station.results.numbers import LOCK_IN_RATE
from station.runs.database import TODAY
from station.runs.store import SavedRecord
from station.sources.batches import Source

# --------------------
# Output of a fibre gyro as columns: times, counts, temperature and what else its frames hold.
#
# A record of it is a stretch of output. In a run its columns are packed; in a data set they stand as they are, for
# other programs, and the checksum of the row is over them


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


VERSION = 3
SCHEMA = {"name": "gyrolock records", "version": VERSION}
"""Files of the first version, in which outputs of a fibre gyro are packed, are read too, and of the second, whose
codes in Parquet are bytes."""

AT_ONCE = 2000  # rows that are written and read together: 5 MB of codes
_BYTES_AT_ONCE = 20_000_000  # of packed output, which rows may hold much of

TEXT = ("source", "key", "taken_at", "purpose", "channel", "axis", "header", "conditions", "sha256", "source_json")
WHOLE = ("number", "samples", "bytes_per_sample")
NUMBERS = (
    "sample_interval_s",   # XINCR
    "first_sample_s",      # time of the first sample from the trigger
    "volts_per_level",     # volts = (code - level_offset) volts_per_level + volts_offset
    "level_offset",
    "volts_offset",
    "table_rate_dps",
    "azimuth_start_deg",
    "azimuth_end_deg",
    "over_lock_in",
    "true_lock_in_rate_dps",  # of a simulated bench
)  # fmt: skip
COLUMNS = (*TEXT[:1], *WHOLE[:1], *TEXT[1:6], *WHOLE[1:], *NUMBERS, *TEXT[6:])
"""In this order in every format; behind them codes and payload."""


@dataclass(frozen=True)
class Rows:
    """Some rows of the table."""

    # by the names of `COLUMNS`: lists of text, of int, of float (nan where nobody knows)
    columns: dict[str, list[Any]]
    payloads: list[bytes]  # what the instrument sent; empty where it stands in `outputs`
    coded: NDArray[np.bool_]  # whether it is the codes of an oscilloscope's record
    outputs: list[dict[str, Floats] | None]  # output of a fibre gyro, by the names of `OUTPUTS`

    def __len__(self) -> int:
        return len(self.payloads)

    def codes(self, width: int) -> tuple[NDArray[np.int8], NDArray[np.bool_]]:
        """Return codes of `width` bytes as an array (n, width), zeros for others, and which are others."""
        fits = self.coded & np.array([len(payload) == width for payload in self.payloads], dtype=bool)
        joined = b"".join(
            payload if fit else bytes(width) for payload, fit in zip(self.payloads, fits, strict=True)
        )
        return np.frombuffer(joined, np.int8).reshape(len(self), width), ~fits


def described(source: Source, records: int) -> str:
    """Return what is known of a source beside its records, as JSON that stands in each of its rows."""
    known = {
        "name": source.name,
        "kind": source.kind if source.kind != "data set" else getattr(source, "origin", source.kind),
        "is_run": source.is_run,
        "sha256": source.sha256,
        "records": records,
        "facts": dict(source.facts),
        "unusable": dict(source.unusable),
        "protected": source.protected,
    }
    return json.dumps(known, allow_nan=False)


def rows_of(source: Source, about: str, records: Iterable[SavedRecord]) -> Iterator[Rows]:
    """Yield the records of a source as rows, not more than `AT_ONCE` together."""
    held: list[SavedRecord] = []
    size = 0
    for record in records:
        held.append(record)
        size += len(record.payload)
        if len(held) == AT_ONCE or size >= _BYTES_AT_ONCE:
            yield _rows(source, about, held)
            held, size = [], 0
    if held:
        yield _rows(source, about, held)


def joined_rows(parts: Iterable[Rows]) -> Iterator[Rows]:
    """Put rows of small sources together: whoever reads ten thousand of them reads big pieces."""
    held: list[Rows] = []
    for part in parts:
        held.append(part)
        if sum(map(len, held)) >= AT_ONCE:
            yield _joined(held)
            held = []
    if held:
        yield _joined(held)


def record_of(row: Mapping[str, Any], payload: bytes) -> SavedRecord:
    """Return a row as the record that it was; one that has not its checksum is not intact."""
    cells = {name: row[name] for name in ("key", "taken_at", "purpose", "header", "conditions")}
    summed, outputs = payload, row.get("outputs")
    if outputs is not None:
        try:
            payload, summed = packed(cells["header"], outputs)
        except (ValueError, KeyError, TypeError):
            payload = summed = b""
    intact = TODAY.checksum({**cells, "payload": summed}) == row["sha256"]
    try:
        conditions = json.loads(cells["conditions"])
    except ValueError:
        conditions, intact = {}, False
    return SavedRecord(int(row["number"]), **{**cells, "conditions": conditions}, payload=payload, intact=intact)


def rows_with(numbers: range, held: NDArray[np.int64], first: int) -> tuple[int, int]:
    """Return the first row of records with these numbers and the one behind the last; `held` begins at `first`."""
    found = np.flatnonzero((held >= numbers.start) & (held < numbers.stop))
    return (first + int(found[0]), first + int(found[-1]) + 1) if found.size else (first, first)


def check_schema(schema: Mapping[str, Any] | None, place: str) -> None:
    """Refuse what is no data set, or one of a newer program."""
    if not schema or schema.get("name") != SCHEMA["name"]:
        raise RunError(f"{place}: is no data set of gyrolock: `gyrolock export` writes one")
    if schema.get("version") not in range(1, VERSION + 1):
        version = schema.get("version")
        raise RunError(f"{place}: was written by a newer gyrolock (records {version}): update this one")


def _rows(source: Source, about: str, records: Sequence[SavedRecord]) -> Rows:
    columns: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    coded = np.zeros(len(records), dtype=bool)
    outputs: list[dict[str, Floats] | None] = []
    for place, record in enumerate(records):
        output = unpacked(record.header, record.payload) if record.intact else None
        outputs.append(output)
        summed = record.payload if output is None else bytes_of(record.header, output)
        conditions = json.dumps(record.conditions)
        cells = {
            "key": record.key,
            "taken_at": record.taken_at,
            "purpose": record.purpose,
            "header": record.header,
            "conditions": conditions,
        }
        seen, coded[place] = _preamble_columns(record)
        truth = record.conditions.get("truth")
        true = truth.get(LOCK_IN_RATE.key()) if isinstance(truth, dict) else None
        row: dict[str, Any] = {
            **cells,
            **seen,
            "channel": str(record.conditions.get("channel") or ""),
            "axis": str(record.conditions.get("axis") or ""),
            **{name: _number(record.conditions.get(name)) for name in NUMBERS[5:-1]},
            "true_lock_in_rate_dps": _number(true),
            "source": source.name,
            "number": record.number,
            # one that is damaged stays so: its sum must not become right again
            "sha256": TODAY.checksum({**cells, "payload": summed}) if record.intact else "",
            "source_json": about,
        }
        for name, column in columns.items():
            column.append(row[name])
    payloads = [b"" if output else record.payload for record, output in zip(records, outputs, strict=True)]
    return Rows(columns, payloads, coded, outputs)


def _preamble_columns(record: SavedRecord) -> tuple[dict[str, Any], bool]:
    """What the preamble says, and whether the payload is codes that fit it."""
    try:
        preamble = None if record.header.startswith("{") else Preamble.parse(record.header)
    except InstrumentError:
        preamble = None
    if preamble is None or len(record.payload) != preamble.nr_pt * preamble.byt_nr:
        unknown = dict.fromkeys(NUMBERS[:5], math.nan)
        return {"samples": 0, "bytes_per_sample": 0, **unknown}, False
    return {
        "samples": preamble.nr_pt,
        "bytes_per_sample": preamble.byt_nr,
        "sample_interval_s": preamble.xincr,
        "first_sample_s": preamble.xzero - preamble.xincr * preamble.pt_off,
        "volts_per_level": preamble.ymult,
        "level_offset": preamble.yoff,
        "volts_offset": preamble.yzero,
    }, True


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


def _joined(parts: Sequence[Rows]) -> Rows:
    if len(parts) == 1:
        return parts[0]
    columns = {name: [one for part in parts for one in part.columns[name]] for name in COLUMNS}
    payloads = [payload for part in parts for payload in part.payloads]
    outputs = [output for part in parts for output in part.outputs]
    return Rows(columns, payloads, np.concatenate([part.coded for part in parts]), outputs)


# --------------------
# Packages that only some need, imported when they are


class MissingPackage(UsageError, ImportError):
    """An extra is not installed."""


def package(name: str, extra: str = "data") -> Any:
    """Import a package of an extra."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise MissingPackage(
            f"{name.partition('.')[0]} is not installed: pip install 'gyrolock[{extra}]'"
        ) from None
