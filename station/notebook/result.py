"""A result: the JSON document of a command as an object that shows itself."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

from instrument.fibre_gyro import Recording
from station.errors import UsageError
from station.lock_in.found import LockInFound
from station.notebook.records import Record, Records
from station.notebook.show import data_frame, html_table
from station.reanalysis.files import AnalyzedFiles
from station.shell.evaluated import Evaluated

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

    def __init__(self, evaluated: Evaluated | AnalyzedFiles, run: Records, document: Mapping[str, Any]) -> None:
        self.document, self.run = dict(document), run
        self._evaluated, self._said = evaluated, evaluated.result

    @property
    def verdict(self) -> str | None:
        """``"PASS"``, ``"FAIL"`` or, without limits, ``None``."""
        verdict: str | None = self.document.get("verdict")
        return verdict

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
        if isinstance(self.found, LockInFound) and shown.name in self.found.names:
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
            {"name": one.name, "of": one.of, "value": one.value, "unit": one.unit} for one in self._said.measured
        )

    def _record(self, wanted: int | str | None) -> Record:
        names = [record.name for record in self.run.records]
        if isinstance(wanted, str):
            if wanted not in names:
                raise UsageError(f"there is no record {wanted!r}; there are {', '.join(names)}")
            return self.run.records[names.index(wanted)]
        if wanted is None and isinstance(self.found, LockInFound):
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
