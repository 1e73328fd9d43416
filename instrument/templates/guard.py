"""A second process that stops the table if the program that turns it is killed.

A signal that can be heard (Ctrl-C, SIGTERM, a closed terminal), an error or a lost link: there the program stops
the table itself. For what nobody hears (SIGKILL, a crash) this process waits at the end of a pipe: when the pipe
breaks without a farewell, it opens the link and stops the table.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

_FAREWELL = "done"


class Guard:
    """The other process, as long as the table may turn."""

    def __init__(self, resource_name: str, template: Mapping[str, Any]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "instrument.templates.guard"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )
        self._write(json.dumps({"resource": resource_name, "template": dict(template)}))

    def release(self) -> None:
        """Let it end: the table was stopped."""
        self._write(_FAREWELL)
        with suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=10)

    def _write(self, line: str) -> None:
        with suppress(OSError, ValueError):
            if self._process.stdin is not None:
                self._process.stdin.write(line + "\n")
                self._process.stdin.flush()


def watch() -> int:
    """Wait for the end of the program that has started this one; 0 if nothing was to be done."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # what ends the program must not end its guard
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    lines = iter(sys.stdin.readline, "")
    order = json.loads(next(lines, "{}"))
    if not order or any(line.strip() == _FAREWELL for line in lines):
        return 0
    # PyVISA takes its time to be imported: only where it is needed
    from instrument.errors import InstrumentError
    from instrument.templates.controller import Controller
    from instrument.templates.description import parse_template

    template = parse_template(order["template"], "guard")
    for _ in range(template.link.attempts):
        with suppress(InstrumentError, OSError):
            with Controller(order["resource"], template) as controller:
                controller.stop()
            return 0
    return 1


if __name__ == "__main__":
    sys.exit(watch())
