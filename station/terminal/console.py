"""Tables and coloured lines on the terminal."""

from __future__ import annotations

import sys
from typing import Any

from rich.console import Console
from rich.text import Text

from station.terminal.visible import visible


class PlainConsole(Console):
    """A console to which a text is a text: no markup in it, no codes of pictures, nothing unseen that acts."""

    def __init__(self, *, stderr: bool = False, width: int | None = None) -> None:
        super().__init__(stderr=stderr, width=width, highlight=False, markup=False, emoji=False)

    def render_str(self, text: str, **options: Any) -> Text:
        """Turn a text into what is shown."""
        return super().render_str(visible(text), **options)

    def on_broken_pipe(self) -> None:
        """Say nothing more to a reader that has gone; the program goes on."""
        self.quiet = True


def stdout_console() -> Console:
    """Return a console on stdout; wide enough for a table also where there is no terminal."""
    return PlainConsole(width=None if sys.stdout.isatty() else 100)
