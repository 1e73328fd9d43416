"""A simulated temperature chamber that speaks the commands of ``config/controllers/chamber.toml``."""

from __future__ import annotations

import math

from instrument.simulated.clock import Clock, RealClock


class SimulatedChamber:
    """A chamber whose air comes to the set point at a constant rate."""

    _LOWEST, _HIGHEST = -70.0, 150.0

    def __init__(
        self, clock: Clock | None = None, *, ambient_degc: float = 23.0, speed_degc_per_s: float = 0.05
    ) -> None:
        self._clock: Clock = clock if clock is not None else RealClock()
        self._from, self._since, self._to = ambient_degc, self._clock.now(), ambient_degc
        self._speed, self._set, self.on = speed_degc_per_s, ambient_degc, False

    @property
    def temperature(self) -> float:
        """Temperature now, deg C."""
        left = self._to - self._from
        gone = min(abs(left), self._speed * (self._clock.now() - self._since))
        return self._from + math.copysign(gone, left)

    def answer(self, line: str) -> str | None:
        """Carry out a line."""
        text = line.upper().replace(" ", "")
        if text == "TYPE?":
            return "T,T,S2,150.0"
        if text == "TEMP?":
            return f"{self.temperature:.1f},{self._set:.1f},{self._HIGHEST:.1f},{self._LOWEST:.1f}"
        if text.startswith("TEMP,S"):
            return self._go_to(text.removeprefix("TEMP,S"), line)
        if text in ("MODE,CONSTANT", "MODE,STANDBY"):
            self.on = text.endswith("CONSTANT")
            self._begin(self._set if self.on else self.temperature)
            return f"OK:{line}"
        return f"NA:CMDERR:{line}"

    def _go_to(self, text: str, line: str) -> str:
        try:
            wanted = float(text)
        except ValueError:
            return f"NA:PARAERR:{line}"
        if not self._LOWEST <= wanted <= self._HIGHEST:
            return f"NA:DATAOUTOFRANGE:{line}"
        self._set = wanted
        if self.on:
            self._begin(wanted)
        return f"OK:{line}"

    def _begin(self, wanted: float) -> None:
        self._from, self._since, self._to = self.temperature, self._clock.now(), wanted
