"""The rate table under the gyro: what any table must do, and a table that a person turns by hand or panel."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Protocol

from instrument.errors import InstrumentError, LinkError, SettingError

if TYPE_CHECKING:
    from instrument.controllers import Controller


_AS_ASKED = 0.1  # share of a rate by which a table may be off without being asked about

_ANTICLOCKWISE = r"""
      .--<--.
     /       \       seen from above:
    v    o    ^      anticlockwise, + on the display
     \       /
      '-->--'
"""

_CLOCKWISE = r"""
      .-->--.
     /       \       seen from above:
    ^    o    v      clockwise, - on the display
     \       /
      '--<--'
"""


class RateTable(Protocol):
    """A single-axis turntable. Rates in deg/s, angles in deg; positive is anticlockwise seen from above."""

    def set_rate(self, rate_dps: float) -> None:
        """Bring the table to `rate_dps` and return when it turns steadily."""

    def rate(self) -> float:
        """Rate of the table in deg/s."""

    def azimuth(self) -> float:
        """Angle of the table in deg from its zero mark."""

    def close(self) -> None:
        """Stop the table and let it go."""


class ManualRateTable:
    """A table without a remote interface: the operator sets it and confirms.

    Parameters
    ----------
    ask : callable
        Shows a question and returns the typed answer; `input` by default.
    azimuth_deg : float
        Angle of the table that is reported; a slow table without read-out stays near where it was set.

    Attributes
    ----------
    why : str
        What the next rate is for and what comes then, one sentence each: stands in the question.
    """

    def __init__(self, *, ask: Callable[[str], str] = input, azimuth_deg: float = 0.0) -> None:
        self._ask = ask
        self._azimuth_deg = azimuth_deg
        self._rate_dps = 0.0
        self.why = ""

    def set_rate(self, rate_dps: float) -> None:
        """Ask the operator to set the rate, and which rate the table shows then.

        An empty answer means "exactly as asked". A rate of the other sense, or a tenth off, must be typed twice.
        LinkError if the operator cannot be asked (no terminal).
        """
        lines = [f"Set the rate table to {rate_dps:+.6g} deg/s and wait until it turns steadily."]
        if rate_dps:
            lines.append((_ANTICLOCKWISE if rate_dps > 0 else _CLOCKWISE).strip("\n"))
        if self.why:
            lines.append(self.why)
        question = "\n".join([*lines, "Press Enter when done, or type the rate that it shows in deg/s: "])
        typed: float | None = None
        while True:
            answer = self._answer(question)
            number = _number(answer) if answer else rate_dps
            if number is None:
                question = f"{answer!r} is not a number. Rate in deg/s (Enter for {rate_dps:+.6g}): "
            elif number == typed or abs(number - rate_dps) <= _AS_ASKED * abs(rate_dps):
                self._rate_dps = number
                return
            else:
                typed = number
                question = (
                    f"The table was to turn at {rate_dps:+.6g} deg/s, not at {number:+.6g}. If it does, type it "
                    "again; else set it right and press Enter, or type what it shows: "
                )

    def doubt(self, seen: str) -> bool:
        """Ask again because of what the beat shows: whether the operator has set the table or its rate right."""
        question = (
            f"The beat does not fit the table's rate of {self._rate_dps:+.6g} deg/s: {seen}.\n"
            "Look at the table: does it turn at this rate, in this sense, and is its display in deg/s?\n"
            "Set it right and press Enter, or type the rate that it shows; if all is right, type ok: "
        )
        while True:
            answer = self._answer(question)
            if answer.lower() in ("ok", "yes", "y"):
                return False
            if not answer:
                return True
            if (number := _number(answer)) is not None:
                self._rate_dps = number
                return True
            question = f"{answer!r} is neither a number nor ok. Rate in deg/s, Enter, or ok: "

    def rate(self) -> float:
        """Rate in deg/s that the operator confirmed last."""
        return self._rate_dps

    def azimuth(self) -> float:
        """Angle in deg, as given when the table was set up."""
        return self._azimuth_deg

    def close(self) -> None:
        """Ask the operator to stop the table, if it still turns."""
        if self._rate_dps != 0.0:
            self.why = ""
            self.set_rate(0.0)

    def _answer(self, question: str) -> str:
        try:
            return self._ask(question).strip()
        except EOFError:
            raise LinkError(
                "the rate table must be set by hand, but there is nobody to ask; run this in a terminal"
            ) from None


def _number(text: str) -> float | None:
    try:
        number = float(text.replace(",", "."))
    except ValueError:
        return None
    return number if math.isfinite(number) else None


# --------------------
# A rate table on VISA or a serial line, by a template of its commands; and what stops it for a killed program.
#
# A signal that can be heard (Ctrl-C, SIGTERM, a closed terminal), an error or a lost link: there the program stops
# the table itself. For what nobody hears (SIGKILL, a crash) a second process waits at the end of a pipe: when it
# breaks without a farewell, it opens the link and stops the table


_TURN_DEG = 360.0


class ControlledRateTable:
    """A :class:`instrument.rate_table.RateTable` that a controller turns."""

    def __init__(
        self,
        controller: Controller,
        guard: Guard | None = None,
        tell: Callable[[str], None] = lambda text: None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.controller, self._guard, self._tell, self._now = controller, guard, tell, now
        self._rate_dps = 0.0
        self._last: tuple[float, float] | None = None
        try:
            if controller.template.kind != "rate table":
                raise SettingError(f"{controller.name} is a {controller.template.kind}, not a rate table")
            controller.do("on")
        except BaseException:
            controller.close()
            raise

    def set_rate(self, rate_dps: float) -> None:
        """Bring the table to a rate in deg/s and return when it turns steadily."""
        self._last = None  # while the rate changes nobody knows how many turns pass
        self._rate_dps = self.controller.set("rate", rate_dps)

    def rate(self) -> float:
        """Rate in deg/s that the controller reads, or the one that was set."""
        rate = self.controller.template.rate
        return self.controller.read("rate") if rate is not None and rate.ask else self._rate_dps

    def azimuth(self) -> float:
        """Angle in deg that the controller reads, not folded into one turn; nan where it tells none."""
        position = self.controller.template.position
        if position is None or not position.ask:
            return math.nan
        azimuth, now = self.controller.read("position"), self._now()
        if self._last is not None:
            # a display begins anew with every turn: the turn is the one that the rate leads to
            expected = self._last[0] + self._rate_dps * (now - self._last[1])
            azimuth += _TURN_DEG * round((expected - azimuth) / _TURN_DEG)
        self._last = (azimuth, now)
        return azimuth

    def home(self) -> None:
        """Send the table to its zero mark, where the controller has an order for it."""
        self.controller.do("home")

    def close(self) -> None:
        """Stop the table and let it go; never raises, and says so where it cannot be stopped."""
        from instrument.controllers import stop_by_all_means

        stop_by_all_means(self.controller, self._tell)
        if self._guard is not None:
            self._guard.release()


_FAREWELL = "done"
_AGAIN_S = 0.5


class Guard:
    """The other process, as long as the table may turn."""

    def __init__(self, resource_name: str, template: Mapping[str, Any]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "instrument.rate_table"],
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
    from instrument.controllers import Controller, parse_template

    template = parse_template(order["template"], "guard")
    # the link may be held for a while by what is left of the killed program
    until = time.monotonic() + template.link.reconnect_s
    attempts = 0
    while attempts < template.link.attempts or time.monotonic() < until:
        with suppress(InstrumentError, OSError):
            with Controller(order["resource"], template) as controller:
                controller.stop()
            return 0
        attempts += 1
        time.sleep(_AGAIN_S)
    return 1


if __name__ == "__main__":
    sys.exit(watch())
