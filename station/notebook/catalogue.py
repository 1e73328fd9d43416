"""The list of all runs below a folder, for a notebook."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.catalogue.choose import Wanted, chosen
from station.catalogue.entry import Entry
from station.catalogue.index import list_runs
from station.catalogue.listing import runs_table
from station.notebook.run import TakenRun, open_run
from station.notebook.show import data_frame

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SHOWN = 50


class Runs(Sequence[Entry]):
    """Runs, each as what is known of it without opening a record. Made by :func:`runs`.

    Parameters
    ----------
    entries : sequence of Entry
    directory : Path
    """

    def __init__(self, entries: Sequence[Entry], directory: Path) -> None:
        self.entries, self.directory = tuple(entries), directory

    def __getitem__(self, place: Any) -> Any:
        return Runs(self.entries[place], self.directory) if isinstance(place, slice) else self.entries[place]

    def __len__(self) -> int:
        return len(self.entries)

    def open(self) -> Iterator[TakenRun]:
        """Open one after the other."""
        return (open_run(entry.run) for entry in self.entries)

    def to_dataframe(self) -> Any:
        """Return a pandas.DataFrame, one row for each value of a result; ImportError without pandas."""
        rows = []
        for entry in self.entries:
            known = {name: value for name, value in vars(entry).items() if name not in ("values", "remarks")}
            values = [
                {"result_name": one.name, "result_of": one.of, "result": one.value, "result_u": one.u}
                for one in entry.values
            ]
            rows += [{**known, **value} for value in values or [{}]]
        return data_frame(rows)

    def plot(self) -> Figure:
        """Draw the results over time, each unit in its own colour."""
        from station.notebook.plots import draw_runs  # half a second of Matplotlib

        return draw_runs(self.entries)

    def __repr__(self) -> str:
        return f"<{len(self)} runs in {self.directory}>"

    def _repr_html_(self) -> str:
        table = runs_table(self.entries[-_SHOWN:], self.directory)
        head = "".join(f"<th>{escape(name)}</th>" for name in table.header)
        rows = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in table.rows)
        more = f", the last {_SHOWN}" if len(self) > _SHOWN else ""
        return f"<table><caption>{len(self)} runs{more}</caption><tr>{head}</tr>{rows}</table>"


def runs(directory: str | os.PathLike[str] = "runs", *, sort: Sequence[str] = (), **wanted: Any) -> Runs:
    """List all runs below a folder, as the command ``gyrolock runs`` does: fast, and without opening a record.

    Parameters
    ----------
    directory : path, optional
    sort : sequence of str, optional
        ``"when"``, ``"unit"``, ``"result"``, ...; ``"-when"``: the newest first.
    **wanted
        As the options of the command: ``unit``, ``command``, ``operator``, ``gyro``, ``verdict``, ``mark``,
        ``tags``, ``text``, ``since``, ``until``.

    Raises
    ------
    UsageError
        There is no such folder, or no such order.
    """
    tags = wanted.pop("tags", ())
    asked = Wanted(**wanted, tags=(tags,) if isinstance(tags, str) else tuple(tags))
    return Runs(chosen(list_runs(Path(directory)), asked, sort), Path(directory))
