"""What only looks like a record of a beat over time."""

from __future__ import annotations

from instrument import Preamble, Waveform
from station.errors import NoUsableSignal


def check_over_time(waveform: Waveform | Preamble, name: str) -> None:
    """Refuse what only looks like a record."""
    preamble = waveform if isinstance(waveform, Preamble) else waveform.preamble
    unit = preamble.xunit
    if unit.lower() in ("v", "volts"):
        raise NoUsableSignal(f"{name}: is an XY record ({unit} across), none over time: save the channel itself")
    if unit.lower() != "s":
        raise NoUsableSignal(f"{name}: is a spectrum ({unit}), not a record over time: save the channel itself")
    if preamble.pt_fmt == "ENV" or "pk detect" in preamble.wfid.lower():
        raise NoUsableSignal(
            f"{name}: was taken with Peak Detect: it holds minima and maxima, not samples; use SAMPLE mode"
        )
