"""What every source of records gives, whatever its layout."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from pathlib import Path

from station.runs.facts import RunFacts
from station.runs.store import SavedRecord
from station.sources.stretch import Stretch, stretches_of


class Source(ABC):
    """Records that were taken together: one run, or one file of an oscilloscope. It is read anew each time."""

    path: Path  # the file that holds it: that of the run, the CSV or ISF file, or the data set
    name: str  # what it is called in results: its path, or in a data set the path that it was exported from
    kind: str  # {"run", "csv", "isf", "curve", "data set"}: How it is laid out
    facts: RunFacts  # what is known beside the records; of a file what it says of its oscilloscope
    unusable: Mapping[str, str]  # facts that are not what was once saved, and why they are left out
    protected: bool = True  # whether damage to a fact would show
    # records that are missing and facts that are damaged; damaged records show when they are read
    damaged: tuple[str, ...] = ()

    @abstractmethod
    def records(self, numbers: range | None = None) -> Iterator[SavedRecord]:
        """Read the records in the order in which they were taken, one at a time, damaged ones too."""

    def stretches(self, numbers: range | None = None) -> Iterator[Stretch]:
        """Read the same records, those together that lie one behind the other and are alike.

        Errors are those of `records`; what could be read before comes first.
        """
        return stretches_of(self.records(numbers))

    def __str__(self) -> str:
        return self.name

    @abstractmethod
    def __len__(self) -> int:
        """Return how many records it holds."""

    @property
    def span(self) -> tuple[int, int]:
        """Least and largest number of the records; (1, 0) where there are none, (1, 1) where they say nothing."""
        return 1, 1

    @property
    @abstractmethod
    def sha256(self) -> str:
        """SHA-256 of records, settings and command: the same measurement has the same, wherever it lies.

        Notes, results and how the run ended do not count: they change no number.
        """

    @property
    def is_run(self) -> bool:
        """Whether it was taken by a measurement of ours, with its settings."""
        return bool(self.facts.get("settings")) or self.kind == "run"
