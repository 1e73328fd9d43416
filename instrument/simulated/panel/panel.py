"""The front panel: the value of every setting, and typed views of it for the parts that acquire."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import wraps
from typing import Any, TypeVar

from instrument.scpi import POINTS_PER_DIVISION, SCAN_FROM
from instrument.simulated.panel.events import Refusal
from instrument.simulated.panel.models import Model
from instrument.simulated.panel.settings import Row, Value, nearest, setting_rows

LIMITED_BANDWIDTH = 20e6  # Hz, CH<x>:BANdwidth ON
FULL_BANDWIDTH_FROM = 5e-3  # V/div at the BNC; more sensitive scales are limited, too
FULL_BANDWIDTH_SWEEP = 2.5e-6  # s/div


@dataclass(frozen=True)
class PanelChannel:
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

    def _recalled(self) -> Iterator[tuple[str, Row]]:
        return ((key, row) for key, row in self.rows.items() if not row.kept)

    def channel(self, name: str) -> PanelChannel:
        """Vertical settings of `CH1` and so on."""
        return self._channels[name]

    @property
    @_remembered
    def _channels(self) -> dict[str, PanelChannel]:
        return {name: self._channel(name) for name in self.model.channel_names}

    def _channel(self, name: str) -> PanelChannel:
        limited = self.flag(f"{name}:BANDWIDTH")
        at_bnc = self.number(f"{name}:SCALE") / self.number(f"{name}:PROBE")
        narrow = limited or at_bnc < FULL_BANDWIDTH_FROM * (1 - 1e-9)
        corner = LIMITED_BANDWIDTH if narrow else self.model.bandwidth
        # the full bandwidth counts on sweeps of 100 MS/s and faster only
        seen = narrow or self.seconds_per_division <= FULL_BANDWIDTH_SWEEP * (1 + 1e-9)
        return PanelChannel(
            scale=self.number(f"{name}:SCALE"),
            position=self.number(f"{name}:POSITION"),
            coupling=self.text(f"{name}:COUPLING"),
            probe=self.number(f"{name}:PROBE"),
            limited=limited,
            inverted=self.flag(f"{name}:INVERT"),
            time_constant=1 / (2 * math.pi * corner) if seen else 0.0,
        )

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
    def displayed_channels(self) -> dict[str, PanelChannel]:
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


# --------------------
# Where one setting bounds or moves another: what turning a knob does besides the knob itself.
#
# Source: programmer manual 071-1075-04, chapter 2, and user manual 071-1064-00, p. 156


# Largest position in divisions at the volts per division of the BNC, p. 2-68
POSITION_RANGES = {
    2e-3: 1000.0, 5e-3: 400.0, 10e-3: 200.0, 20e-3: 100.0, 50e-3: 40.0, 100e-3: 20.0,
    200e-3: 10.0, 500e-3: 100.0, 1.0: 50.0, 2.0: 25.0, 5.0: 10.0,
}  # fmt: skip
TRIGGER_DIVISIONS = 8.0  # the level reaches this far from the centre of the screen
EXTERNAL_LEVEL = {"EXT": 1.6, "EXT5": 8.0, "EXT10": 16.0}  # V
RESTARTING = ("ACQUIRE:", "HORIZONTAL:", "CH", "TRIGGER:", "SELECT:")
NOT_RESTARTING = ("TRIGGER:MAIN:LEVEL", "TRIGGER:MAIN:HOLDOFF:VALUE")


def store(panel: Panel, key: str, value: Value) -> None:
    """Put a value on the panel, bounded by the other settings, and let the others follow."""
    old = panel.values[key]
    head, _, leaf = key.partition(":")
    if head in panel.model.channel_names:
        _store_channel(panel, head, leaf, value)
    elif _conflicts(panel, key, value):
        raise Refusal(221)
    elif key != "DISPLAY:INVERT":  # accepted and always OFF on this family
        panel.values[key] = value
    if head == "HORIZONTAL":
        main, delay = "HORIZONTAL:MAIN:SCALE", "HORIZONTAL:DELAY:SCALE"
        if panel.number(delay) > panel.number(main):
            source, target = (delay, main) if key == delay else (main, delay)
            panel.values[target] = panel.values[source]
        for branch in ("MAIN", "DELAY"):
            scale = panel.number(f"HORIZONTAL:{branch}:SCALE")
            latest = 20e-3 if scale <= 10e-9 else 50e-3 if scale <= 100e-6 else 50.0
            where = f"HORIZONTAL:{branch}:POSITION"
            step = scale / POINTS_PER_DIVISION
            position = _bounded(panel.number(where), -4 * scale, latest)
            panel.values[where] = float(f"{round(position / step) * step:.9e}")
    elif head == "TRIGGER":
        _settle_trigger(panel)
    elif head == "RS232" and leaf.endswith("FLAGGING") and value:
        other = "HARDFLAGGING" if leaf == "SOFTFLAGGING" else "SOFTFLAGGING"
        panel.values[f"RS232:{other}"] = 0
    elif key == "DISPLAY:FORMAT" and value == "XY":
        panel.values["CURSOR:FUNCTION"] = "OFF"
    elif head == "SELECT" and leaf.startswith("REF") and value and not old:
        shown = [name for name in panel.model.reference_names if panel.flag(f"SELECT:{name}") and name != leaf]
        for name in shown[:-1]:
            panel.values[f"SELECT:{name}"] = 0
    elif key == "CURSOR:VBARS:UNITS" and value != old:
        for bar in ("CURSOR:VBARS:POSITION1", "CURSOR:VBARS:POSITION2"):
            place = panel.number(bar)
            panel.values[bar] = float(f"{1 / place:.6e}") if place else 0.0
    if head in ("CURSOR", "HORIZONTAL", *panel.model.channel_names):
        _settle_cursors(panel)


def _conflicts(panel: Panel, key: str, value: Value) -> bool:
    """True if the other settings forbid this one."""
    if key == "TRIGGER:MAIN:LEVEL":
        return panel.trigger_source in ("AC LINE", "LINE")
    return key == "CURSOR:FUNCTION" and value != "OFF" and panel.text("DISPLAY:FORMAT") == "XY"


def restarts(key: str, *, averages: bool = False) -> bool:
    """True if changing this setting starts the acquisition anew, p. 2-47; averages begin anew with every one."""
    return key.startswith(RESTARTING) and (averages or key not in NOT_RESTARTING)


def _store_channel(panel: Panel, name: str, leaf: str, value: Value) -> None:
    """Probe changes scale the readout, the scale bounds the position, both bound the trigger level."""
    scale, old_probe = f"{name}:SCALE", panel.number(f"{name}:PROBE")
    panel.values[f"{name}:{leaf}"] = value
    probe = panel.number(f"{name}:PROBE")
    if leaf == "PROBE":
        panel.values[scale] = panel.number(scale) * probe / old_probe
        if panel.trigger_source == name:
            panel.values["TRIGGER:MAIN:LEVEL"] = panel.number("TRIGGER:MAIN:LEVEL") * probe / old_probe
    at_bnc = min(max(panel.number(scale) / probe, 2e-3), 5.0)
    panel.values[scale] = float(f"{at_bnc * probe:.6e}")
    limit = POSITION_RANGES[nearest(at_bnc, tuple(POSITION_RANGES))]
    panel.values[f"{name}:POSITION"] = _bounded(panel.number(f"{name}:POSITION"), -limit, limit)
    _settle_trigger(panel)


def _settle_trigger(panel: Panel) -> None:
    source = panel.trigger_source
    level = panel.number("TRIGGER:MAIN:LEVEL")
    if source in panel.model.channel_names:
        scale = panel.number(f"{source}:SCALE")
        centre = -panel.number(f"{source}:POSITION") * scale
        low, high = centre - TRIGGER_DIVISIONS * scale, centre + TRIGGER_DIVISIONS * scale
    else:
        high = EXTERNAL_LEVEL.get(source, 0.0)
        low = -high
    panel.values["TRIGGER:MAIN:LEVEL"] = float(f"{_bounded(level, low, high):.6e}")


def _settle_cursors(panel: Panel) -> None:
    """Keep the cursors within the graticule."""
    bounds = {}
    source = panel.text("CURSOR:SELECT:SOURCE")
    if source in panel.model.channel_names:
        scale, position = panel.number(f"{source}:SCALE"), panel.number(f"{source}:POSITION")
        bounds["HBARS"] = (-4 - position) * scale, (4 - position) * scale
    if panel.text("CURSOR:VBARS:UNITS") == "SECONDS":
        scale, middle = panel.seconds_per_division, panel.horizontal_position
        bounds["VBARS"] = middle - 5 * scale, middle + 5 * scale
    for bars, (low, high) in bounds.items():
        for key in (f"CURSOR:{bars}:POSITION1", f"CURSOR:{bars}:POSITION2"):
            panel.values[key] = float(f"{_bounded(panel.number(key), low, high):.6e}")


def _bounded(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
