"""Where one setting bounds or moves another: what turning a knob does besides the knob itself.

Source: programmer manual 071-1075-04, chapter 2, and user manual 071-1064-00, p. 156.
"""

from __future__ import annotations

from instrument.facts import POINTS_PER_DIVISION
from instrument.simulated.panel.event_table import Refusal
from instrument.simulated.panel.kinds import Value, nearest
from instrument.simulated.panel.panel import Panel

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
        _settle_horizontal(panel, key)
    elif head == "TRIGGER":
        _settle_trigger(panel)
    elif head == "RS232" and leaf.endswith("FLAGGING") and value:
        other = "HARDFLAGGING" if leaf == "SOFTFLAGGING" else "SOFTFLAGGING"
        panel.values[f"RS232:{other}"] = 0
    elif key == "DISPLAY:FORMAT" and value == "XY":
        panel.values["CURSOR:FUNCTION"] = "OFF"
    elif head == "SELECT" and leaf.startswith("REF") and value and not old:
        _limit_references(panel, leaf)
    elif key == "CURSOR:VBARS:UNITS" and value != old:
        _swap_cursor_units(panel)
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


def _settle_horizontal(panel: Panel, key: str) -> None:
    """Keep the window within the main time base and the positions on the sample grid."""
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


def _limit_references(panel: Panel, newest: str) -> None:
    """Two references fit on the screen; a third turns off the first of the others (a guess)."""
    shown = [name for name in panel.model.reference_names if panel.flag(f"SELECT:{name}") and name != newest]
    for name in shown[:-1]:
        panel.values[f"SELECT:{name}"] = 0


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


def _swap_cursor_units(panel: Panel) -> None:
    for key in ("CURSOR:VBARS:POSITION1", "CURSOR:VBARS:POSITION2"):
        value = panel.number(key)
        panel.values[key] = float(f"{1 / value:.6e}") if value else 0.0


def _bounded(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
