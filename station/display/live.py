"""The live display: how things stand, drawn anew on one terminal while it is measured."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Self

from rich.live import Live

from station.display.picture import picture
from station.display.sentences import campaign_line
from station.events.event import Event
from station.events.situation import Situation
from station.terminal.console import PlainConsole
from station.terminal.give_way import stepping_aside

_LOST = (OSError, ValueError)
_EVERY_S = 0.15
_TICK_S = 1.0  # a time that runs out is shown also while nothing happens


class LiveDisplay:
    """Draws how things stand on stderr; notes go above the drawing and stay. A context manager."""

    def __init__(self) -> None:
        self._console = PlainConsole(stderr=True)
        self._situation = Situation()
        self._live: Live | None = None
        self._drawn_at = 0.0
        self._lock = threading.RLock()
        self._ended = threading.Event()
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        self._stack.enter_context(stepping_aside(lambda question: self._hide(), self._show))
        threading.Thread(target=self._tick, name="display", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._hide()
        self._stack.close()

    def __call__(self, event: Event) -> None:
        """Take an event."""
        with self._lock:
            self._situation.take(event)
            if event.kind == "note":
                self._say(str(event.facts["text"]), "dim")
            elif line := campaign_line(event.kind, event.facts):
                self._say(line, None)
            if event.kind in ("run_ended", "ended"):  # what comes then is the result, on the same terminal
                self._hide()
            elif event.kind in ("run", "counting", "campaign_begun"):
                self._show()
            elif time.monotonic() - self._drawn_at > _EVERY_S:
                self._draw()

    def _say(self, text: str, style: str | None) -> None:
        with suppress(*_LOST):
            self._console.print(text, style=style, soft_wrap=True)  # a path is copied as a whole

    def _show(self) -> None:
        with self._lock, suppress(*_LOST):
            if (
                self._live is None
                and not self._ended.is_set()
                and (self._situation.run or self._situation.counted)
            ):
                # stdout keeps its own way: it belongs to the result
                live = Live(
                    console=self._console,
                    auto_refresh=False,
                    transient=True,
                    redirect_stdout=False,
                    redirect_stderr=False,
                )
                live.start()
                self._live = live
            self._draw()

    def _hide(self) -> None:
        with self._lock, suppress(*_LOST):
            live, self._live = self._live, None
            if live is not None:
                live.stop()

    def _draw(self) -> None:
        if self._live is None:
            return
        self._drawn_at = time.monotonic()
        with suppress(*_LOST):
            width, height = self._console.size
            self._live.update(picture(self._situation, width, height), refresh=True)

    def _tick(self) -> None:
        while not self._ended.wait(_TICK_S):
            with suppress(Exception), self._lock:
                self._draw()
