"""How far a run is, told as events: whoever reads them shows it."""

from __future__ import annotations

import time

from station.events.event import Events


class Progress:
    """Tells how far a run is."""

    def __init__(self, events: Events | None = None, *, quiet: bool = False) -> None:
        if events is None:
            events = Events()
            if not quiet:
                from station.display.lines import PlainLines

                events.read_by(PlainLines())
        self.events = events
        self._what, self._total, self._done = "", 0, 0
        self._began = 0.0
        self._ended = False

    def note(self, text: str) -> None:
        """Say one line."""
        self.events.emit("note", text=text)

    def start(self, what: str, total: int) -> None:
        """Begin to count `total` things."""
        self._what, self._total, self._done = what, total, 0
        self._began = time.monotonic()
        self.events.emit("counting", what=what, total=total)

    def advance(self) -> None:
        """Count one more."""
        self._done += 1
        left = (time.monotonic() - self._began) / self._done * max(self._total - self._done, 0)
        self.events.emit("counted", what=self._what, done=self._done, total=self._total, left_s=round(left, 3))

    def end(self, exit_code: int, message: str = "") -> None:
        """Say how the command ends; the first time counts."""
        if not self._ended:
            self._ended = True
            self.events.emit("ended", exit_code=exit_code, message=message)
