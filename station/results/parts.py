"""What a report is put together from."""

from __future__ import annotations

from dataclasses import dataclass

Rows = list[tuple[str, str]]


@dataclass(frozen=True)
class Headline:
    """The result in large letters and the lines below it."""

    usable: bool
    value: str
    value_dph: str
    lines: tuple[str, ...]


@dataclass(frozen=True)
class PlacedFigure:
    """An SVG element with its caption."""

    svg: str
    caption: str


@dataclass(frozen=True)
class Table:
    """Columns of text; in the first one stands what a row is about."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Section:
    """A heading with sentences, figures (up to two side by side) and a table."""

    title: str
    text: str = ""
    figures: tuple[PlacedFigure, ...] = ()
    sentences: tuple[str, ...] = ()
    table: Table | None = None


@dataclass(frozen=True)
class FactTable:
    """A small table of names and values."""

    title: str
    rows: Rows
