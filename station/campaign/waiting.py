"""Letting time pass between steps: by a clock that nobody sets, and so that a signal is heard."""

from __future__ import annotations

import time
from dataclasses import dataclass

from station.runs.progress import Progress

_SLICE_S = 0.5


@dataclass(frozen=True)
class Wait:
    """Waits, and says for what."""

    progress: Progress
    skipped: bool = False  # on a simulated bench no time passes

    def __call__(self, what: str, seconds: float) -> None:
        """Wait so many seconds; zero or less returns at once."""
        if seconds <= 0:
            return
        if self.skipped:
            self.progress.note(f"{what}: {seconds:g} s, passed over on a simulated bench")
            return
        self.progress.events.emit("waiting", what=what, seconds=seconds)
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            time.sleep(min(left, _SLICE_S))
