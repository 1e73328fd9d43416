"""The front panel: the value of every setting, and typed views of it for the parts that acquire."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import wraps
from typing import Any, TypeVar

from instrument.facts import SCAN_FROM
from instrument.simulated.panel.kinds import Value
from instrument.simulated.panel.models import Model
from instrument.simulated.panel.settings_table import Row, setting_rows

LIMITED_BANDWIDTH = 20e6  # Hz, CH<x>:BANdwidth ON
FULL_BANDWIDTH_FROM = 5e-3  # V/div at the BNC; more sensitive scales are limited, too
FULL_BANDWIDTH_SWEEP = 2.5e-6  # s/div


@dataclass(frozen=True)
class ChannelSettings:
    """Vertical settings of one channel. Volts include the probe factor, `position` is in divisions."""

    scale: float
    position: float
    coupling: str
    probe: float
    limited: bool
    inverted: bool
    time_constant: float = 0.0  # s, of the bandwidth as a single pole; 0 where no sample could show it


@dataclass(frozen=True)
class TriggerSettings:
    """Settings of the main trigger; `polarity`, `when` and `width` are those of a pulse, the rest of video."""

    mode: str
    kind: str
    source: str
    coupling: str
    slope: str
    level: float
    holdoff: float
    polarity: str
    when: str
    width: float
    sync: str = "LINE"
    video_inverted: bool = False
    line: int = 1
    standard: str = "NTSC"


class Values(dict[str, Value]):
    """Values by header, and how often one of them was set: what was made of them holds until then."""

    changes = 0

    def __setitem__(self, key: str, value: Value) -> None:
        self.changes += 1
        super().__setitem__(key, value)

    def update(self, *others: Mapping[str, Value]) -> None:  # type: ignore[override]
        """Set several."""
        self.changes += 1
        super().update(*others)


View = TypeVar("View")


def _remembered(make: Callable[[Panel], View]) -> Callable[[Panel], View]:
    """A view of the panel that is made anew only when a setting has changed: it is asked for all the time."""
    name = make.__name__

    @wraps(make)
    def view(panel: Panel) -> View:
        if panel.viewed_at != panel.values.changes:
            panel.viewed_at = panel.values.changes
            panel.views.clear()
        if name not in panel.views:
            panel.views[name] = make(panel)
        found: View = panel.views[name]
        return found

    return view


class Panel:
    """Values of all settings by their full header in capitals (`CH1:SCALE`)."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.rows = {row.header.upper(): row for row in setting_rows(model)}
        self.values = Values({key: row.default for key, row in self.rows.items()})
        self.views: dict[str, Any] = {}
        self.viewed_at = -1

    def text(self, key: str) -> str:
        """Value of a setting that holds a word or a string."""
        return str(self.values[key])

    def number(self, key: str) -> float:
        """Value of a setting that holds a number."""
        return float(self.values[key])

    def flag(self, key: str) -> bool:
        """Value of a switch."""
        return bool(self.values[key])

    def factory(self) -> None:
        """Factory values for every setting that *RST touches."""
        self.values.update({key: row.default for key, row in self._recalled()})

    def stored(self) -> dict[str, Value]:
        """The values that a setup memory keeps."""
        return {key: self.values[key] for key, _ in self._recalled()}

    def recall(self, stored: Mapping[str, Value]) -> None:
        """Bring back what `stored` gave."""
        self.values.update(stored)

    def _recalled(self) -> Iterator[tuple[str, Row]]:
        return ((key, row) for key, row in self.rows.items() if not row.kept)

    def channel(self, name: str) -> ChannelSettings:
        """Vertical settings of `CH1` and so on."""
        return self._channels[name]

    @property
    @_remembered
    def _channels(self) -> dict[str, ChannelSettings]:
        return {name: self._channel(name) for name in self.model.channel_names}

    def _channel(self, name: str) -> ChannelSettings:
        limited = self.flag(f"{name}:BANDWIDTH")
        at_bnc = self.number(f"{name}:SCALE") / self.number(f"{name}:PROBE")
        return ChannelSettings(
            scale=self.number(f"{name}:SCALE"),
            position=self.number(f"{name}:POSITION"),
            coupling=self.text(f"{name}:COUPLING"),
            probe=self.number(f"{name}:PROBE"),
            limited=limited,
            inverted=self.flag(f"{name}:INVERT"),
            time_constant=self._time_constant(limited=limited or at_bnc < FULL_BANDWIDTH_FROM * (1 - 1e-9)),
        )

    def _time_constant(self, *, limited: bool) -> float:
        """Time constant in s of a channel; the full bandwidth counts on sweeps of 100 MS/s and faster only."""
        if limited:
            return 1 / (2 * math.pi * LIMITED_BANDWIDTH)
        fast = self.seconds_per_division <= FULL_BANDWIDTH_SWEEP * (1 + 1e-9)
        return 1 / (2 * math.pi * self.model.bandwidth) if fast else 0.0

    @_remembered
    def trigger(self) -> TriggerSettings:
        """Settings of the main trigger."""
        pulse, video = "TRIGGER:MAIN:PULSE:WIDTH", "TRIGGER:MAIN:VIDEO"
        return TriggerSettings(
            mode=self.text("TRIGGER:MAIN:MODE"),
            kind=self.text("TRIGGER:MAIN:TYPE"),
            source=self.trigger_source,
            coupling=self.text("TRIGGER:MAIN:EDGE:COUPLING"),
            slope=self.text("TRIGGER:MAIN:EDGE:SLOPE"),
            level=self.number("TRIGGER:MAIN:LEVEL"),
            holdoff=self.number("TRIGGER:MAIN:HOLDOFF:VALUE"),
            polarity=self.text(f"{pulse}:POLARITY"),
            when=self.text(f"{pulse}:WHEN"),
            width=self.number(f"{pulse}:WIDTH"),
            sync=self.text(f"{video}:SYNC"),
            video_inverted=self.text(f"{video}:POLARITY") == "INVERT",
            line=int(self.number(f"{video}:LINE")),
            standard=self.text(f"{video}:STANDARD"),
        )

    @property
    def trigger_source(self) -> str:
        """Source of the trigger type in use."""
        return self.text(f"TRIGGER:MAIN:{self.text('TRIGGER:MAIN:TYPE')}:SOURCE")

    @property
    @_remembered
    def seconds_per_division(self) -> float:
        """Main time base, or the window's when it is the view."""
        window = self.text("HORIZONTAL:VIEW") == "WINDOW"
        return self.number("HORIZONTAL:DELAY:SCALE" if window else "HORIZONTAL:MAIN:SCALE")

    @property
    @_remembered
    def horizontal_position(self) -> float:
        """Seconds from the trigger to the centre of the record."""
        window = self.text("HORIZONTAL:VIEW") == "WINDOW"
        return self.number("HORIZONTAL:DELAY:POSITION" if window else "HORIZONTAL:MAIN:POSITION")

    @_remembered
    def displayed_channels(self) -> dict[str, ChannelSettings]:
        """Vertical settings of the channels that are acquired: those on the screen, all for the math waveform."""
        shown = self.displayed
        names = (name for name in self.model.channel_names if name in shown or "MATH" in shown)
        return {name: self.channel(name) for name in names}

    @property
    @_remembered
    def scanning(self) -> bool:
        """True when the record rolls over the screen (AUTO at 100 ms/div and slower)."""
        auto = self.text("TRIGGER:MAIN:MODE") == "AUTO"
        return auto and self.seconds_per_division >= SCAN_FROM * (1 - 1e-9)

    @property
    @_remembered
    def displayed(self) -> frozenset[str]:
        """Names of the waveforms that are turned on."""
        return frozenset(name for name in self.model.waveform_names if self.flag(f"SELECT:{name}"))
