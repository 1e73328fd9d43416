"""One line on stdout for each record that is on the disk: for programs that must know what is safe."""

from __future__ import annotations

import json
import sys
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from station.terminal.streams import takes_now

if TYPE_CHECKING:
    from station.runs.store import NewRecord

SCHEMA = {"name": "gyrolock record", "version": 1}


class Acknowledgement:
    """Prints the lines. A reader that does not read gets them later: the measurement does not wait for it."""

    def __init__(self) -> None:
        self._held: deque[str] = deque()

    def __call__(self, run: Path, records: Sequence[tuple[int, NewRecord]]) -> None:
        """Tell of the records of one commit."""
        for number, record in records:
            line = {"schema": SCHEMA, "run": str(run), "number": number, "key": record.key}
            self._held.append(json.dumps({**line, "purpose": record.purpose, "conditions": record.conditions}))
        while self._held and takes_now(sys.stdout):
            self._print()

    def rest(self) -> None:
        """Print what the reader has not had yet, however long it takes."""
        while self._held:
            self._print()

    def _print(self) -> None:
        sys.stdout.write(self._held.popleft() + "\n")
        sys.stdout.flush()
