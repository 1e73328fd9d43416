"""Progress on stderr: a bar with the time left on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar


class Progress:
    """Tells the operator how far a run is.

    Parameters
    ----------
    quiet : bool, optional
        Say nothing.
    """

    _PLAIN_EVERY_S = 5.0

    def __init__(self, *, quiet: bool = False) -> None:
        self._quiet = quiet
        self._console = Console(stderr=True, highlight=False)
        self._bar: Bar | None = None
        self._task: TaskID | None = None
        self._what, self._total, self._done = "", 0, 0
        self._began = self._last_said = 0.0

    def note(self, text: str) -> None:
        """Say one line."""
        if not self._quiet:
            self.close()
            self._console.print(text, style="dim", soft_wrap=True, markup=False)

    def start(self, what: str, total: int) -> None:
        """Begin to count `total` things."""
        self.close()
        self._what, self._total, self._done = what, total, 0
        self._began = self._last_said = time.monotonic()
        if self._quiet or not sys.stderr.isatty():
            return
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._bar = Bar(*columns, console=self._console, transient=True)
        self._bar.start()
        self._task = self._bar.add_task(what, total=total)

    def advance(self) -> None:
        """Count one more."""
        self._done += 1
        if self._bar is not None and self._task is not None:
            self._bar.advance(self._task)
        elif not self._quiet:
            self._plain_line()

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def _plain_line(self) -> None:
        now = time.monotonic()
        finished = self._done == self._total
        if not finished and now - self._last_said < self._PLAIN_EVERY_S:
            return
        self._last_said = now
        left = (now - self._began) / self._done * (self._total - self._done)
        line = f"{self._what} {self._done}/{self._total}"
        self._console.print(line if finished else f"{line}, {left:.0f} s left", soft_wrap=True, markup=False)
