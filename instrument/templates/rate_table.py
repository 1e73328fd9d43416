"""A rate table on VISA or a serial line, by a template of its commands."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from instrument.errors import SettingError
from instrument.templates.controller import Controller, stop_by_all_means
from instrument.templates.guard import Guard

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
        stop_by_all_means(self.controller, self._tell)
        if self._guard is not None:
            self._guard.release()
