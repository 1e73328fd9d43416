"""A result and its records as objects that show themselves."""

from __future__ import annotations

import difflib
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from instrument import Waveform
from instrument.fibre_gyro import Recording
from station.datasets.rows import package
from station.errors import UsageError
from station.lock_in.evaluate import LockInEvaluation
from station.reanalysis.combine import AnalyzedFiles
from station.results.quantity import Value, headline_values
from station.results.result import Rows
from station.shell.finish import Evaluated

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Result:
    """What records say. Every key of `document` is an attribute too: ``result.lock_in_rate_dps``.

    Parameters
    ----------
    evaluated : Evaluated or AnalyzedFiles
    run : Records
        The run or the files that it was found from.
    document : mapping
        What the command prints with ``--json``: plain JSON. Without a result its numbers are ``None``, and it has
        a key ``error``.
    """

    def __init__(self, evaluated: Evaluated | AnalyzedFiles, run: RunRecords, document: Mapping[str, Any]) -> None:
        self.document, self.run = dict(document), run
        self._evaluated, self._said = evaluated, evaluated.result

    @property
    def verdict(self) -> str | None:
        """``"PASS"``, ``"FAIL"`` or, without limits, ``None``."""
        verdict: str | None = self.document.get("verdict")
        return verdict

    @property
    def value(self) -> float:
        """The number that lists show first, in the unit of its key; nan where there is none."""
        return self._headline.value

    @property
    def u(self) -> float:
        """Its standard uncertainty."""
        return self._headline.u

    @property
    def interval(self) -> tuple[float, float]:
        """Its 95 % interval, all uncertainties included."""
        return self._headline.low_95, self._headline.high_95

    @property
    def _headline(self) -> Value:
        return next(iter(headline_values(self._said.document, self._said.quantities)), Value(math.nan))

    @property
    def problem(self) -> str:
        """Why there is no result; empty if there is one."""
        return self._said.problem

    @property
    def sentences(self) -> tuple[str, ...]:
        """What it means, and what to watch."""
        return (*self._said.sentences, *self._said.to_watch)

    @property
    def found(self) -> Any:
        """What the measurement computed, as arrays: of `measure` an LockInFound with ``each`` and ``combined``."""
        return self._evaluated.found

    def plot(self, record: int | str | None = None) -> Figure:
        """Draw one record: samples, fit and residual; of a fibre gyro a stretch of its output.

        Parameters
        ----------
        record : int or str, optional
            Its place from 0, or its name; by default the first that gave a value.
        """
        # half a second of Matplotlib, for those who want a picture
        from station.notebook.plots import draw_output, draw_record

        shown = self._record(record)
        name = f"{self.run.command}: record {shown.name}"
        if isinstance(shown.data, Recording):
            return draw_output(shown.data, name)
        ratio = math.nan
        if isinstance(self.found, LockInEvaluation) and shown.name in self.found.names:
            ratio = float(self.found.each.ratio[self.found.names.index(shown.name)])
        return draw_record(shown.waveform, name, ratio)

    def to_dataframe(self) -> Any:
        """Return a pandas.DataFrame, one row a record; where there are none one row a limited number.

        Raises
        ------
        ImportError
            Without pandas.
        """
        if not isinstance(self._evaluated, Evaluated) or self._evaluated.kind.rows(self.found):
            return data_frame(self._evaluated.rows())
        return data_frame(
            {"name": one.quantity.limit_name, "of": one.of, "value": one.value, "unit": one.unit}
            for one in self._said.measured
        )

    def _record(self, wanted: int | str | None) -> Record:
        names = [record.name for record in self.run.records]
        if not names:
            raise UsageError(f"{self.run.path}: holds no record to draw")
        if isinstance(wanted, str):
            if wanted not in names:
                raise UsageError(f"there is no record {wanted!r}; there are {', '.join(names)}")
            return self.run.records[names.index(wanted)]
        if wanted is None and isinstance(self.found, LockInEvaluation):
            usable = [name for name, good in zip(self.found.names, self.found.each.usable, strict=True) if good]
            wanted = names.index(usable[0]) if usable else 0
        return self.run.records[wanted or 0]

    def __getattr__(self, name: str) -> Any:
        document = self.__dict__.get("document", {})
        if name in document:
            return document[name]
        like = difflib.get_close_matches(name, document, 1)
        raise AttributeError(f"this result has no {name!r}{f'; did you mean {like[0]!r}?' if like else ''}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.document]

    def __len__(self) -> int:
        return len(self.run)

    def __repr__(self) -> str:
        said = f"no result ({self.problem})" if self.problem else f"{self._said.name} {self._said.value}"
        verdict = f", {self.verdict}" if self.verdict else ""
        return f"<Result of {self.run.command}: {said}, {len(self)} records{verdict}>"

    def _repr_html_(self) -> str:
        heading = f"{self.verdict} · {self._said.value}" if self.verdict else self._said.value
        rows = [*self.run.labels.items(), *self._said.summary]
        limits = [one["name"] for one in self.document.get("limits", []) if not one["passed"]]
        to_say = [
            *filter(None, [self.problem]),
            *(f"{name} is beyond its limit." for name in limits),
            *self.sentences,
        ]
        sentences = "".join(f"<li>{escape(sentence)}</li>" for sentence in to_say)
        return html_table(f"{self._said.name}: {heading}", rows) + (f"<ul>{sentences}</ul>" if sentences else "")


# --------------------
# Records of a run or of files, as arrays


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


class RunRecords(Sequence[Record]):
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
        """Return all samples as an xarray.Dataset over record and sample; ImportError without xarray."""
        # Records of an oscilloscope give ``volts`` and ``codes``, stretches of output ``counts``; ``time_s``
        # belongs to them. Shorter ones are filled up with nan (codes with -128, "no data"). What is known of each
        # record is a coordinate.
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


# --------------------
# Showing in a notebook: small tables of HTML, tables of pandas where it is installed


def html_table(caption: str, rows: Rows) -> str:
    """Return names and values as a table of HTML."""
    cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows)
    return f"<table><caption>{escape(caption)}</caption>{cells}</table>"


def data_frame(rows: Iterable[Mapping[str, Any]]) -> Any:
    """Return a pandas.DataFrame of plain JSON objects; what lies deeper goes by ``outer.inner``."""
    frame, times = package("pandas").json_normalize([dict(row) for row in rows]), "taken_at"
    if times in frame:
        frame[times] = package("pandas").to_datetime(frame[times], utc=True, errors="coerce", format="ISO8601")
    return frame
