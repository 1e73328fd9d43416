"""What happens as plain lines on stderr: for logs, pipes, and terminals that should not be drawn on."""

from __future__ import annotations

import time
from contextlib import suppress

from station.display.sentences import campaign_line, duration
from station.events.event import Event
from station.terminal.console import PlainConsole

_EVERY_S = 5.0
_LOST = (OSError, ValueError)  # ValueError: the stream is closed


class PlainLines:
    """Writes a line for what happens; of what is counted, one every few seconds."""

    def __init__(self) -> None:
        self._console = PlainConsole(stderr=True)
        self._last_said = time.monotonic()

    def __call__(self, event: Event) -> None:
        """Take an event."""
        facts = event.facts
        if event.kind == "note":
            self._say(str(facts["text"]), style="dim")
        elif event.kind == "counting":
            self._last_said = time.monotonic()
        elif event.kind == "counted":
            self._count(str(facts["what"]), int(facts["done"]), int(facts["total"]), float(facts["left_s"] or 0))
        elif event.kind == "waiting":
            self._say(f"{facts['what']}: {duration(facts.get('seconds') or 0)}", style="dim")
        elif line := campaign_line(event.kind, facts):
            self._say(line)

    def _count(self, what: str, done: int, total: int, left_s: float) -> None:
        now, finished = time.monotonic(), done == total
        if not finished and now - self._last_said < _EVERY_S:
            return
        self._last_said = now
        self._say(f"{what} {done}/{total}" if finished else f"{what} {done}/{total}, {left_s:.0f} s left")

    def _say(self, text: str, style: str | None = None) -> None:
        with suppress(*_LOST):
            self._console.print(text, style=style, soft_wrap=True)
