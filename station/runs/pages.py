"""Rows out of the pages of a damaged SQLite file, without its trees: each page gives what it holds.

Source: SQLite's file format, sections 1.6 and 2 (sqlite.org/fileformat2.html).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

_TABLE_LEAF, _INDEX_LEAF = 0x0D, 0x0A
_LONGEST_ROW = 64 << 20  # bytes; an hour of output at 1 kHz has 60 MB
_INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}  # serial type, and its bytes

Value = int | str | bytes | None


@dataclass(frozen=True)
class Row:
    """One row: its number (0 in a table that has none), and its cells."""

    number: int
    cells: tuple[Value, ...]


def page_size_of(content: bytes) -> int:
    """Return the size of the pages that a file's header tells, that of ours where it tells none."""
    size = int.from_bytes(content[16:18], "big")
    size = 65_536 if size == 1 else size
    return size if content[:6] == b"SQLite" and size >= 512 and size & (size - 1) == 0 else 16_384


def rows_of(page: bytes, first: bool, others: Mapping[int, bytes]) -> Iterator[Row]:
    """Give the rows of one page, those that can be read."""
    start = 100 if first else 0
    kind = page[start]
    if kind not in (_TABLE_LEAF, _INDEX_LEAF):
        return
    count = int.from_bytes(page[start + 3 : start + 5], "big")
    for place in range(start + 8, min(start + 8 + 2 * count, len(page) - 1), 2):
        try:
            yield _row(page, int.from_bytes(page[place : place + 2], "big"), kind, others)
        except (ValueError, IndexError, KeyError):
            continue


def _row(page: bytes, at: int, kind: int, others: Mapping[int, bytes]) -> Row:
    length, at = _varint(page, at)
    number = 0
    if kind == _TABLE_LEAF:
        number, at = _varint(page, at)
    if not 0 < length <= _LONGEST_ROW:
        raise ValueError("no row is so long")
    most = len(page) - 35 if kind == _TABLE_LEAF else (len(page) - 12) * 64 // 255 - 23
    if length <= most:
        return Row(number, _cells(page[at : at + length]))
    least = (len(page) - 12) * 32 // 255 - 23
    here = least + (length - least) % (len(page) - 4)
    here = here if here <= most else least
    data, following = page[at : at + here], int.from_bytes(page[at + here : at + here + 4], "big")
    while len(data) < length:
        more = others[following]
        data, following = data + more[4:], int.from_bytes(more[:4], "big")
    return Row(number, _cells(data[:length]))


def _cells(data: bytes) -> tuple[Value, ...]:
    length, at = _varint(data, 0)
    kinds = []
    while at < length:
        kind, at = _varint(data, at)
        kinds.append(kind)
    values: list[Value] = []
    for kind in kinds:
        size = _INTEGERS.get(kind, 8 if kind == 7 else (kind - 12) // 2 if kind >= 12 else 0)
        piece = data[at : at + size]
        if len(piece) < size:
            raise ValueError("the row is cut")
        at += size
        values.append(_value(kind, piece))
    return tuple(values)


def _value(kind: int, piece: bytes) -> Value:
    if kind >= 12:
        return piece if kind % 2 == 0 else piece.decode("utf-8", errors="replace")
    if kind in _INTEGERS:
        return int.from_bytes(piece, "big", signed=True)
    return {8: 0, 9: 1}.get(kind)  # a number with a fraction is in none of our columns


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number of one to nine bytes, and where it ends."""
    value = 0
    for place in range(at, at + 8):
        value = value << 7 | data[place] & 0x7F
        if data[place] < 0x80:
            return value, place + 1
    return value << 8 | data[at + 8], at + 9
