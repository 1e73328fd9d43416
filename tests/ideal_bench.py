"""A simulated bench with nothing that spoils a measurement, at the paper's single rate.

For tests of what has nothing to do with it: fewer records, and the truth lies where the noise alone says.
"""

from typing import Any

from station.live.events import Progress

CLEAN: dict[str, float] = {
    "second_harmonic_dbc": -200.0,
    "third_harmonic_dbc": -200.0,
    "bandwidth_hz": 0.0,
    "gain_corner_hz": 0.0,
    "rate_ripple_dps": 0.0,
    "pump_ripple": 0.0,
    "scale_factor_error_ppm": 0.0,
}
"""Settings of the section ``[simulation.contaminants]``."""

KNOWN: dict[str, float] = {"distortion_limit_dbc": -70.0, "bandwidth_hz": 1.0e6, "gain_corner_hz": 1.0e5}
"""The same as somebody states it who has measured it, for ``[budget]``."""

CLEAN_TOML = "[simulation.contaminants]\n" + "".join(f"{name} = {value}\n" for name, value in CLEAN.items())

IDEAL_TOML = (
    "[measurement]\nrates_over_lock_in = [8.0]\n"
    + CLEAN_TOML
    + "[budget]\n"
    + "".join(f"{name} = {value}\n" for name, value in KNOWN.items())
)
"""As a settings file."""


def ideal_bench(**sections: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Settings by section and name, with more of them laid over."""
    settings: dict[str, dict[str, Any]] = {
        "measurement": {"rates_over_lock_in": [8.0]},
        "simulation": {"contaminants": CLEAN},
        "budget": KNOWN,
    }
    for name, values in sections.items():
        section = settings.get(name, {})
        if name == "simulation" and "contaminants" in values:
            values = values | {"contaminants": CLEAN | values["contaminants"]}
        settings[name] = section | values
    return settings


class Interrupting(Progress):
    """An operator who presses Ctrl-C after so many records at the slow rates."""

    def __init__(self, after: int) -> None:
        super().__init__()
        self._left, self._counting = after, False

    def start(self, what: str, total: int) -> None:
        self._counting = what == "records"

    def advance(self) -> None:
        self._left -= self._counting
        if self._left < 0:
            raise KeyboardInterrupt
