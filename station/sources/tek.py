"""A file of an oscilloscope as a source: one record, and what the file and its neighbours say of the scope."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from instrument import Waveform, read_waveform
from station.runs.facts import RunFacts
from station.runs.store import SavedRecord
from station.sources.source import Source

PURPOSE = "measure"


class TekFile(Source):
    """One CSV, ISF or curve file.

    Raises
    ------
    FileFormatError, OSError
        If it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, str(path)
        self.waveform: Waveform = read_waveform(path)
        self.kind = "isf" if path.suffix.lower() == ".isf" else "csv"
        self.facts = RunFacts({})
        self.unusable = {}
        self.channel = self.waveform.preamble.wfid.split(",")[0].upper()

    def __len__(self) -> int:
        return 1

    def records(self, numbers: range | None = None) -> Iterator[SavedRecord]:
        """Give the one record; see `Source`."""
        if numbers is not None and 1 not in numbers:
            return
        codes = self.waveform.codes
        payload = codes.tobytes() if codes.dtype == "int8" else codes.astype(">i2").tobytes()
        header, conditions = self.waveform.preamble.to_text(), {"channel": self.channel}
        yield SavedRecord(1, self.path.name, "", PURPOSE, header, payload, True, conditions)

    @property
    def sha256(self) -> str:
        """SHA-256 of the file."""
        return hashlib.sha256(self.path.read_bytes()).hexdigest()
