"""What happens as plain lines on stderr, the sentences that displays share, and the consoles."""

import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from rich.console import Console
from rich.text import Text

from station.live.events import Event
from station.terminal import PRINTS_ONE_LINE, prints, visible

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
            self._count(facts)
        elif event.kind == "waiting":
            self._say(f"{facts['what']}: {duration(facts.get('seconds') or 0)}", style="dim")
        elif line := campaign_line(event.kind, facts):
            self._say(line)

    def _count(self, facts: Mapping[str, Any]) -> None:
        now = time.monotonic()
        if facts["done"] != facts["total"] and now - self._last_said < _EVERY_S:
            return
        self._last_said = now
        done, total = facts.get("all_done", facts["done"]), facts.get("all_total", facts["total"])
        left = "" if done == total else f", {facts.get('all_left_s', facts['left_s']) or 0:.0f} s left"
        self._say(f"{facts['what']} {done}/{total}{left}")

    def _say(self, text: str, style: str | None = None) -> None:
        with suppress(*_LOST):
            self._console.print(text, style=style, soft_wrap=True)


# --------------------
# What displays say in the same words


def duration(seconds: float) -> str:
    """Write a time as a person says it."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest} s" if rest and minutes < 10 else f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if minutes else f"{hours} h"


def campaign_line(kind: str, facts: Mapping[str, Any]) -> str:
    """Return what a campaign's event says in one line; empty for an event that is not a campaign's."""
    if kind == "campaign_begun":
        again = "goes on" if facts.get("resumed") else "begins"
        about = f", about {duration(facts['seconds'])}" if facts.get("seconds") else ""
        return f"{facts.get('campaign')}: test of {facts.get('unit')} {again}, {facts.get('of')} steps{about}"
    if kind == "step_begun":
        return f"step {facts.get('number')} of {facts.get('of')}: {facts.get('title') or facts.get('step')}"
    if kind == "step_ended":
        return f"step {facts.get('number')} {facts.get('step')}: {_verdict(facts)}"
    if kind == "campaign_ended":
        return _verdict(facts)
    return ""


def _verdict(facts: Mapping[str, Any]) -> str:
    """A verdict and why, which may begin with the verdict itself."""
    verdict, why = str(facts.get("verdict") or "done"), str(facts.get("message") or "")
    return why if why.startswith(verdict) else f"{verdict}: {why}" if why else verdict


def link_words(link: Mapping[str, Any]) -> str:
    """Return the health of the link in words."""
    return str(link.get("text") or "no faults")


def run_name(run: Mapping[str, Any]) -> str:
    """Return the name of a run's directory from its event; empty without one."""
    parts = str(run.get("run") or "").replace("\\", "/").rstrip("/").split("/")
    named = parts[-2:] if len(parts) > 1 else parts
    return named[0] if named and named[-1].endswith(".sqlite") else named[-1]


# --------------------
# Tables and coloured lines on the terminal


class PlainConsole(Console):
    """A console to which a text is a text: no markup in it, no codes of pictures, nothing unseen that acts."""

    def __init__(self, *, stderr: bool = False, width: int | None = None) -> None:
        super().__init__(stderr=stderr, width=width, highlight=False, markup=False, emoji=False)

    def render_str(self, text: str, **options: Any) -> Text:
        """Turn a text into what is shown."""
        return super().render_str(visible(text), **options)

    def print(self, *objects: Any, **how: Any) -> None:
        """Print; in a file or a pipe without the blanks that fill the width."""
        if self.quiet:
            return
        if self.is_terminal or self.stderr:
            super().print(*objects, **how)
            return
        with self.capture() as drawn:
            super().print(*objects, **how)
        self.file.write("".join(f"{line.rstrip()}\n" for line in drawn.get().splitlines()))

    def on_broken_pipe(self) -> None:
        """Say nothing more to a reader that has gone; the program goes on."""
        self.quiet = True


def stdout_console() -> Console:
    """Return a console on stdout; wide enough for a table also where there is no terminal."""
    console = PlainConsole(width=None if sys.stdout.isatty() else 100)
    console.quiet = prints(PRINTS_ONE_LINE)
    return console
