"""What every results table gives, whatever file it is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from station.errors import RunError
from station.reanalysis.tables.columns import VERSION, Rows

Key = tuple[str, str]
"""Source and analysis of a row."""


class TableFile(ABC):
    """One kind of file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @abstractmethod
    def known(self) -> dict[Key, str]:
        """SHA-256 of each source and analysis that the table holds."""

    @abstractmethod
    def rows(self) -> Iterator[dict[str, Any]]:
        """Read the rows one by one; errors as `known`."""

    @abstractmethod
    def begin(self) -> None:
        """Begin to write; what is there stays valid until `end`."""

    @staticmethod
    @abstractmethod
    def packed(parts: Sequence[Rows]) -> Any:
        """Return rows as :meth:`add` takes them: done by the process that computes them, many at a time."""

    @abstractmethod
    def add(self, packed: Any) -> None:
        """Add rows that were packed."""

    @abstractmethod
    def end(self, replaced: set[Key]) -> None:
        """Put the new rows behind those that are there, without the old ones of `replaced`."""

    @abstractmethod
    def give_up(self) -> None:
        """Leave the table as it was."""

    def _checked(self, version: object) -> None:
        if not isinstance(version, int) or isinstance(version, bool) or version < 1:
            raise RunError(f"{self.path}: is not a results table of gyrolock")
        if version > VERSION:
            raise RunError(
                f"{self.path}: was written by a newer gyrolock (table {version}, this one knows {VERSION}): "
                "update this one"
            )
