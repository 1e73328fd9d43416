"""A simulated power supply that speaks SCPI, as ``config/controllers/power_supply.toml`` asks."""

from __future__ import annotations

import math


class SimulatedPowerSupply:
    """A supply with a resistance as its load."""

    def __init__(self, *, highest_v: float = 36.0, load_ohm: float = 48.0) -> None:
        self._highest, self._load = highest_v, load_ohm
        self._errors: list[str] = []
        self.set_v, self.on = 0.0, False

    @property
    def voltage(self) -> float:
        """Voltage at the terminals."""
        return self.set_v if self.on else 0.0

    def answer(self, line: str) -> str | None:
        """Carry out a line."""
        word, _, rest = line.upper().partition(" ")
        questions = {
            "*IDN?": "GYROLOCK,SIMULATED SUPPLY,SIM-2,1.0",
            "MEAS:VOLT?": f"{self.voltage:+.5E}",
            "MEAS:CURR?": f"{self.voltage / self._load:+.5E}",
        }
        if word in questions:
            return questions[word]
        if word == "SYST:ERR?":
            return self._errors.pop(0) if self._errors else '+0,"No error"'
        if word == "OUTP" and rest in ("ON", "OFF"):
            self.on = rest == "ON"
        elif word == "VOLT":
            self._set(rest)
        else:
            self._errors.append('-113,"Undefined header"')
        return None

    def _set(self, text: str) -> None:
        try:
            wanted = float(text)
        except ValueError:
            wanted = math.nan
        if 0 <= wanted <= self._highest:
            self.set_v = wanted
        else:
            self._errors.append('-222,"Data out of range"')
