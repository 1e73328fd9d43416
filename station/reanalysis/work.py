"""Work on many sources, cut into pieces of about equal length."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from instrument import InstrumentError
from station.errors import StationError
from station.lock_in.records.pieces import Piece, pieces_of
from station.runs.progress import Progress
from station.runs.store import RUN_FILES
from station.sources.find import open_source
from station.sources.source import Source
from station.sources.workers import Workers

R = TypeVar("R")

TOGETHER = 8_000_000
"""Bytes of small sources that make one piece of work: some 2000 records."""

LARGE = 3 * TOGETHER
"""Bytes from which on a source is cut into pieces."""

_MEGABYTE = 1_000_000
_NOTHING: Mapping[str, str] = {}


class Work:
    """Estimating the records of many sources: small ones together, large ones in parts."""

    def __init__(
        self,
        sources: Iterable[Path | Source],
        choices: Mapping[str, Any],
        known: Mapping[str, str] = _NOTHING,
        *,
        whole: bool = False,
    ) -> None:
        # one that was named twice counts once
        self._sources = [(one, _size(one)) for one in {_name(source): source for source in sources}.values()]
        self._choices, self._known, self._whole = choices, known, whole
        self._begun: deque[int] = deque()

    def __len__(self) -> int:
        """How many sources there are."""
        return len(self._sources)

    @property
    def opened(self) -> dict[str, Source]:
        """Sources that have no path of their own, such as those in a data set, by their names."""
        return {source.name: source for source, _ in self._sources if isinstance(source, Source)}

    def done_by(self, workers: Workers, work: Callable[[list[Piece]], R], progress: Progress) -> Iterator[R]:
        """Have every piece of it done; what comes back is in the order of the sources."""
        told = done = 0
        progress.start("megabytes", max(1, sum(size for _, size in self._sources) // _MEGABYTE))
        for found in workers.map(work, self._pieces()):
            done += self._begun.popleft()
            while told < done // _MEGABYTE:
                told += 1
                progress.advance()
            yield found

    def _pieces(self) -> Iterator[list[Piece]]:
        """Pieces of work; the bytes of each are noted as it is begun."""
        waiting: list[Piece] = []
        size = 0
        for source, here in self._sources:
            parts = self._parts(source) if here >= LARGE else None
            if parts is not None:
                if waiting:
                    self._begun.append(size)
                    yield waiting
                waiting, size = [], 0
                for part in parts:
                    self._begun.append(here // len(parts))
                    yield part
                continue
            waiting.append(Piece(source, None, self._choices, known=self._known.get(_name(source), "")))
            size += here
            if size >= TOGETHER:
                self._begun.append(size)
                yield waiting
                waiting, size = [], 0
        if waiting:
            self._begun.append(size)
            yield waiting

    def _parts(self, source: Path | Source) -> list[list[Piece]] | None:
        """Parts of a large source; ``None`` where it is read as a whole: it is known, or cannot be opened."""
        try:
            opened = open_source(source)
            if opened.name in self._known and self._known[opened.name] == opened.sha256:
                return None
            return pieces_of(opened, self._choices, whole=self._whole)
        except (StationError, InstrumentError, OSError):
            return None


def _name(source: Path | Source) -> str:
    """Name of a source that has not been opened."""
    if isinstance(source, Path) and source.is_dir():
        return str(next((source / name for name in RUN_FILES if (source / name).is_file()), source))
    return str(source)


def _size(source: Path | Source) -> int:
    """Bytes of a source, about."""
    if isinstance(source, Source):
        return 2700 * len(source)
    try:
        return Path(_name(source)).stat().st_size
    except OSError:
        return 0
