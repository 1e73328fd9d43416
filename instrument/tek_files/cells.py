"""A text of separated values as cells, whatever a spreadsheet has made of it."""

from __future__ import annotations

import csv
import re

_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*")
_LOOKED_AT = 40


def decoded(content: bytes) -> str:
    """Text of a file: UTF-8 with or without its mark, or UTF-16 with it."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16", errors="replace")
    return content.decode("utf-8-sig", errors="replace")


def cells_of(text: str) -> list[list[str]]:
    """Split lines into cells; separators are commas, semicolons or tabs, decimal commas become points."""
    lines = text.splitlines()
    first = [line for line in lines if line.strip()][:_LOOKED_AT]
    separator = ","
    for other in ("\t", ";"):
        if first and sum(other in line for line in first) > len(first) // 2:
            separator = other
    if '"' in text:
        rows = [list(row) for row in csv.reader(lines, delimiter=separator)]
    else:
        rows = [line.split(separator) for line in lines]
    if separator != "," or '"' in text:
        rows = [[_pointed(cell) for cell in row] for row in rows]
    return [[cell.strip() for cell in row] for row in rows]


def _pointed(cell: str) -> str:
    return cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell
