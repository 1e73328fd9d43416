"""Showing in a notebook: small tables of HTML, tables of pandas where it is installed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from typing import Any

from station.datasets.packages import package
from station.results.parts import Rows


def html_table(caption: str, rows: Rows) -> str:
    """Return names and values as a table of HTML.

    Examples
    --------
    >>> html_table("run", [("unit", "<7>")])
    '<table><caption>run</caption><tr><th>unit</th><td>&lt;7&gt;</td></tr></table>'
    """
    cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows)
    return f"<table><caption>{escape(caption)}</caption>{cells}</table>"


def data_frame(rows: Iterable[Mapping[str, Any]]) -> Any:
    """Return a pandas.DataFrame of plain JSON objects; what lies deeper goes by ``outer.inner``."""
    return package("pandas").json_normalize([dict(row) for row in rows])
