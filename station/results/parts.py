"""What a report or a page on the terminal is put together from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

Rows = Sequence[tuple[str, str]]
"""Names and values."""


@dataclass(frozen=True)
class PlacedFigure:
    """An SVG element with its caption."""

    svg: str
    caption: str


@dataclass(frozen=True)
class TextTable:
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
    table: TextTable | None = None


@dataclass(frozen=True)
class FactTable:
    """A small table of names and values."""

    title: str
    rows: Rows
