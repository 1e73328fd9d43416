"""One line on standard error that says what runs and how long it still takes."""

from __future__ import annotations

import sys
import time


class Progress:
    """Progress of one step; use as a context manager and call `done` as work is finished."""

    def __init__(self, step: str, total: int) -> None:
        self._step, self._total, self._finished = step, total, 0
        self._start = self._shown = time.monotonic()

    def __enter__(self) -> Progress:
        self._show()
        return self

    def __exit__(self, *_: object) -> None:
        took = time.monotonic() - self._start
        sys.stderr.write(("\r\x1b[K" if sys.stderr.isatty() else "") + f"{self._step}: took {took:.0f} s\n")
        sys.stderr.flush()

    def done(self, amount: int = 1) -> None:
        """`amount` more of the total is finished."""
        self._finished += amount
        if time.monotonic() - self._shown > 0.5:
            self._show()

    def _show(self) -> None:
        self._shown = time.monotonic()
        took = self._shown - self._start
        left = f", {took / self._finished * (self._total - self._finished):.0f} s left" if self._finished else ""
        line = f"{self._step}: {self._finished} of {self._total}{left}"
        if sys.stderr.isatty():
            sys.stderr.write("\r\x1b[K" + line)
        elif not self._finished or took > 10:
            sys.stderr.write(line + "\n")
        sys.stderr.flush()
