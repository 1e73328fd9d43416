"""The journal (WAL) beside a run that is being written, or whose program was killed.

SQLite passes over everything behind the first frame that is damaged, without a word. Before a journal is folded
into its run it is therefore looked at: a commit behind a damaged frame means that records were lost there.

Source: SQLite's file format, section 4 (sqlite.org/fileformat2.html).
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_HEADER, _FRAME = 32, 24
_MAGIC = 0x377F0682  # and the same with its lowest bit, for sums of big-endian words


def journal_of(file: Path) -> Path:
    """Return where the journal of a run lies."""
    return file.with_name(f"{file.name}-wal")


def lost_commits(content: bytes) -> int:
    """Return how many commits lie behind a damaged frame, where SQLite does not look."""
    if len(content) < _HEADER:
        return 0
    magic, _, page_size, _, salt_1, salt_2 = struct.unpack(">6I", content[:24])
    frames = enumerate(_frames(content, page_size))
    commits = [place for place, (size, salts) in frames if size and salts == (salt_1, salt_2)]
    if magic & ~1 != _MAGIC:
        return len(commits)
    good = _good_frames(content, page_size)
    return sum(place >= good for place in commits)


def frames_of(content: bytes, page_size: int) -> Iterator[tuple[int, bytes]]:
    """Walk through the pages that a journal holds, the newest last, damaged ones among them: number and page."""
    for start in range(_HEADER, len(content) - _FRAME - page_size + 1, _FRAME + page_size):
        page = start + _FRAME
        yield int.from_bytes(content[start : start + 4], "big"), content[page : page + page_size]


def _frames(content: bytes, page_size: int) -> Iterator[tuple[int, tuple[int, int]]]:
    """Size of the database after the commit (0: it is not the last frame of one) and salts of each frame."""
    if not 512 <= page_size <= 65_536:
        return
    for start in range(_HEADER, len(content) - _FRAME - page_size + 1, _FRAME + page_size):
        size, salt_1, salt_2 = struct.unpack(">3I", content[start + 4 : start + 16])
        yield size, (salt_1, salt_2)


def _good_frames(content: bytes, page_size: int) -> int:
    """How many frames from the first on have the sums that they were written with."""
    order = ">" if content[3] & 1 else "<"
    sums = _summed(content[:24], (0, 0), order)
    if sums != struct.unpack(">2I", content[24:32]):
        return 0
    salts, count = content[16:24], 0
    for start in range(_HEADER, len(content) - _FRAME - page_size + 1, _FRAME + page_size):
        head, page = content[start : start + _FRAME], content[start + _FRAME : start + _FRAME + page_size]
        sums = _summed(head[:8] + page, sums, order)
        if head[8:16] != salts or sums != struct.unpack(">2I", head[16:24]):
            break
        count += 1
    return count


def _summed(data: bytes, sums: tuple[int, int], order: str) -> tuple[int, int]:
    """SQLite's running sums s0 += x[i] + s1, s1 += x[i+1] + s0, modulo 2^32.

    Each sum is a word and the two sums before it: a word weighs in a later sum as the Fibonacci number of their
    distance.
    """
    words = np.frombuffer(data, dtype=f"{order}u4").astype(np.uint32)
    weights, count = _fibonacci(words.size + 1), words.size
    first = int(words[:-1] @ weights[count - 2 :: -1]) + sums[0] * int(weights[count - 2])
    second = int(words @ weights[count - 1 :: -1]) + sums[0] * int(weights[count - 1])
    first += sums[1] * int(weights[count - 1])
    second += sums[1] * int(weights[count])
    return first & 0xFFFFFFFF, second & 0xFFFFFFFF


@functools.cache
def _fibonacci(count: int) -> NDArray[np.uint32]:
    """The first Fibonacci numbers 1, 1, 2, 3, ... modulo 2^32."""
    numbers = [1, 1]
    while len(numbers) < count:
        numbers.append((numbers[-1] + numbers[-2]) & 0xFFFFFFFF)
    return np.array(numbers[:count], dtype=np.uint32)
