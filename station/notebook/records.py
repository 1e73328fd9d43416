"""Records of a run or of files, as arrays."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument import Waveform
from instrument.fibre_gyro import Recording
from station.datasets.packages import package
from station.errors import UsageError
from station.notebook.show import data_frame, html_table
from station.results.parts import Rows


@dataclass(frozen=True, eq=False, repr=False)
class Record:
    """One record: what an oscilloscope sent, or a stretch of a fibre gyro's output.

    Attributes
    ----------
    name : str
        As in the results: number or file of an oscilloscope's record, key of a stretch (``"Z +20"``).
    conditions : dict
        Under which it was taken: channel, table rate, azimuth, injected step...
    data : Waveform or Recording
    purpose, taken_at : str
        Which part of the measurement it is; UTC, ISO 8601. Empty for a file.
    """

    name: str
    conditions: dict[str, Any]
    data: Waveform | Recording
    purpose: str = ""
    taken_at: str = ""

    @property
    def waveform(self) -> Waveform:
        """An oscilloscope's record; UsageError for a stretch of output."""
        if isinstance(self.data, Waveform):
            return self.data
        raise UsageError(f"record {self.name} is a stretch of a fibre gyro's output: see its recording")

    @property
    def recording(self) -> Recording:
        """A stretch of output: times, counts, temperature, gaps; UsageError for an oscilloscope's record."""
        if isinstance(self.data, Recording):
            return self.data
        raise UsageError(f"record {self.name} is an oscilloscope's: see its waveform")

    @property
    def codes(self) -> NDArray[Any]:
        """What the converter gave, shape (n,)."""
        return self.waveform.codes

    @property
    def volts(self) -> NDArray[np.float64]:
        """Shape (n,); nan where the scope had no data."""
        return self.waveform.volts

    @property
    def times(self) -> NDArray[np.float64]:
        """Seconds from the trigger, or from the begin of the stretch; shape (n,)."""
        return self.data.times

    @property
    def counts(self) -> NDArray[np.float64]:
        """Output of a fibre gyro as it gives it, shape (n,)."""
        return self.recording.counts

    def __len__(self) -> int:
        return len(self.times)

    def __repr__(self) -> str:
        if isinstance(self.data, Waveform):
            return f"<Record {self.name}: {self.data!r}>"
        return f"<Record {self.name}: {len(self)} outputs in {self.data.duration_s:.6g} s>"

    def row(self) -> dict[str, Any]:
        """Return what is known of it as one plain object."""
        known: dict[str, Any] = {"record": self.name, "purpose": self.purpose, "taken_at": self.taken_at}
        if isinstance(self.data, Waveform):
            known |= {"samples": len(self), "sample_interval_s": self.data.sample_interval}
        else:
            known |= {"outputs": len(self), "duration_s": self.data.duration_s, "gaps": len(self.data.gaps)}
        return known | {name: value for name, value in self.conditions.items() if name not in known}


class Records(Sequence[Record]):
    """Records of one run, with what is known of it.

    Parameters
    ----------
    records : sequence of Record
    path : Path
        The run's file, or the file or folder that was read.
    command : str
        What a user types for such a run.
    settings : mapping
        That the run was taken with; empty for files.
    outcome : str
        How the taking ended.
    labels : mapping, optional
        ``unit``, ``operator``, ``note``.
    damaged : sequence of str, optional
        Records that are not what was once saved; they are not among `records`.
    """

    def __init__(
        self,
        records: Sequence[Record],
        path: Path,
        command: str,
        settings: Mapping[str, Any],
        outcome: str,
        labels: Mapping[str, str] | None = None,
        damaged: Sequence[str] = (),
    ) -> None:
        self.records, self.path, self.command = tuple(records), path, command
        self.settings, self.outcome, self.labels = dict(settings), outcome, dict(labels or {})
        self.damaged = tuple(damaged)

    @cached_property
    def volts(self) -> NDArray[np.float64]:
        """Of all records, shape (n, n_samples); UsageError where they have none, or not the same length."""
        sizes = {record.volts.size for record in self.records}
        if len(sizes) > 1:
            raise UsageError(
                f"{self.path}: records of {sorted(sizes)} samples make no array: take them one by one"
            )
        return np.array([record.volts for record in self.records]).reshape(len(self), max(sizes, default=0))

    def to_dataframe(self) -> Any:
        """Return what was taken as a pandas.DataFrame, one row a record; ImportError without pandas."""
        return data_frame(record.row() for record in self.records)

    def to_xarray(self) -> Any:
        """Return all samples as an xarray.Dataset over record and sample; ImportError without xarray.

        Records of an oscilloscope give ``volts`` and ``codes``, stretches of output ``counts``; ``time_s`` belongs
        to them. Shorter ones are filled up with nan (codes with -128, "no data"). What is known of each record
        is a coordinate.
        """
        xarray = package("xarray")
        longest = max(map(len, self.records), default=0)

        def stacked(name: str, fill: float = np.nan, kind: type = float) -> tuple[tuple[str, str], NDArray[Any]]:
            values: NDArray[Any] = np.full((len(self), longest), fill, dtype=kind)
            for row, record in zip(values, self.records, strict=True):
                row[: len(record)] = getattr(record, name)
            return ("record", "sample"), values

        waves = all(isinstance(record.data, Waveform) for record in self.records)
        names = {"volts": "volts"} if waves else {"counts": "counts"}
        data = {name: stacked(name) for name in names}
        if waves:
            wide = any(record.codes.dtype != np.int8 for record in self.records)
            data["codes"] = stacked("codes", -128, np.int16 if wide else np.int8)
        rows = [
            {name: one for name, one in record.row().items() if not isinstance(one, Mapping | list)}
            for record in self.records
        ]
        known = {
            name: ("record", [row.get(name) for row in rows]) for name in dict.fromkeys(n for r in rows for n in r)
        }
        attributes = {"command": self.command, "path": str(self.path), "outcome": self.outcome, **self.labels}
        return xarray.Dataset(data, {**known, "time_s": stacked("times")}, attributes)

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, place: Any) -> Any:
        return self.records[place]

    def __iter__(self) -> Iterator[Record]:
        return iter(self.records)

    def __fspath__(self) -> str:
        return os.fspath(self.path)

    def __str__(self) -> str:
        return str(self.path)

    def __repr__(self) -> str:
        lost = f", {len(self.damaged)} damaged" if self.damaged else ""
        return f"<Run of {self.command}: {len(self)} records{lost}, {self.outcome}, {self.path}>"

    def _repr_html_(self) -> str:
        first = self.records[0].taken_at if self.records else ""
        rows: Rows = [
            *self.labels.items(),
            ("gyro", str(self.settings.get("gyro", {}).get("name", ""))),
            ("taken", first),
            ("records", f"{len(self)}{f', damaged {len(self.damaged)}' if self.damaged else ''}"),
            ("outcome", self.outcome),
            ("saved in", str(self.path)),
        ]
        return html_table(self.command, [(name, value) for name, value in rows if value])
