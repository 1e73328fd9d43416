"""Progress on stderr: a bar with the time left on a terminal, plain lines elsewhere.

It may go nowhere (a full disk, a reader that has gone): what is measured goes on all the same.
"""

from __future__ import annotations

import sys
import time
from contextlib import suppress

from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from station.terminal.console import PlainConsole

_LOST = (OSError, ValueError)  # ValueError: the stream is closed


class Progress:
    """Tells the operator how far a run is.

    Parameters
    ----------
    quiet : bool, optional
        Say nothing.
    """

    _PLAIN_EVERY_S = 5.0

    def __init__(self, *, quiet: bool = False) -> None:
        self._quiet = quiet or sys.stderr is None
        self._console = PlainConsole(stderr=True)
        self._bar: Bar | None = None
        self._task: TaskID | None = None
        self._what, self._total, self._done = "", 0, 0
        self._began = self._last_said = 0.0

    def note(self, text: str) -> None:
        """Say one line."""
        if not self._quiet:
            self.close()
            self._say(text, style="dim")

    def start(self, what: str, total: int) -> None:
        """Begin to count `total` things."""
        self.close()
        self._what, self._total, self._done = what, total, 0
        self._began = self._last_said = time.monotonic()
        if self._quiet:
            return
        with suppress(*_LOST):
            if not sys.stderr.isatty():
                return
            columns = (
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
            )
            # stdout keeps its own way: it belongs to the result
            bar = Bar(
                *columns, console=self._console, transient=True, redirect_stdout=False, redirect_stderr=False
            )
            bar.start()
            self._bar, self._task = bar, bar.add_task(what, total=total)

    def advance(self) -> None:
        """Count one more."""
        self._done += 1
        if self._bar is not None and self._task is not None:
            with suppress(*_LOST):
                self._bar.advance(self._task)
        elif not self._quiet:
            self._plain_line()

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            with suppress(*_LOST):
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
        self._say(line if finished else f"{line}, {left:.0f} s left")

    def _say(self, text: str, style: str | None = None) -> None:
        with suppress(*_LOST):
            self._console.print(text, style=style, soft_wrap=True)
