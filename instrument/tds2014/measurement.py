"""The scope's own measurements and cursors as values with their unit.

Programmer manual 071-1075-04, pp. 2-75 to 2-83 and 2-159 to 2-170.
"""

from __future__ import annotations

from dataclasses import dataclass

from instrument import scpi
from instrument.dialogue.dialogue import Dialogue
from instrument.dialogue.events import is_error, scope_event
from instrument.errors import SettingError
from instrument.tds2014.front_panel import Change, FrontPanel, one_of

MEASUREMENTS = (
    *("FREQUENCY", "PERIOD", "MEAN", "PK2PK", "CRMS", "MINIMUM", "MAXIMUM"),
    *("RISE", "FALL", "PWIDTH", "NWIDTH"),
)
"""Names of the measurements of this family."""

NO_VALUE = 9.9e37
"""Stands for a value that could not be measured."""

_CURSOR_PRECISION = 0.02  # of the largest position; cursors stand on pixels


@dataclass(frozen=True)
class Measurement:
    """One value that the scope measured.

    Attributes
    ----------
    kind, source : str
        For example ``FREQUENCY`` of ``CH1``.
    value : float
        In `unit`.
    unit : str
        ``Hz``, ``s``, ``V``.
    warnings : tuple of str
        What the scope says about it, such as a clipped record; mostly empty.
    """

    kind: str
    source: str
    value: float
    unit: str
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.kind} of {self.source}: {self.value:.6g} {self.unit}"


@dataclass(frozen=True)
class Cursors:
    """A pair of cursors as the scope holds it.

    Attributes
    ----------
    bars : str
        ``VBARS`` (times), ``HBARS`` (volts) or ``OFF``.
    source : str
        Waveform that they belong to.
    positions : tuple of float
        Of both, in `unit`; empty when off.
    difference : float
        Second minus first; 0 when off.
    unit : str
        ``s`` or what the scope calls it: ``VOLTS``, ``DECIBELS``...
    """

    bars: str
    source: str
    positions: tuple[float, ...] = ()
    difference: float = 0.0
    unit: str = ""


def measure(dialogue: Dialogue, kind: str, source: str, *, wait: float) -> Measurement:
    """Measure the present record of a channel.

    Raises
    ------
    ExecutionError
        With the scope's event if there is no value: no period in the record, too small an amplitude...
    """
    word = one_of("the measurement", kind, MEASUREMENTS)
    branch = ":MEASUREMENT:IMMED"
    answers, events = dialogue.ask_with_events(
        f"{branch}:TYPE {word};SOURCE {source};{branch}:VALUE?;UNITS?", parts=2, wait=wait
    )
    value = scpi.number(answers[0])
    for event in events:
        if is_error(event):
            raise event
    if abs(value) >= NO_VALUE:
        raise scope_event(2200, f"{word} of {source} has no value", "look at the record: is the signal there?")
    return Measurement(word, source, value, scpi.unquote(answers[1]), tuple(event.text for event in events))


def set_cursors(panel: FrontPanel, bars: str, source: str, positions: tuple[float, float] | None) -> Cursors:
    """Show a pair of cursors, or none, and read it back."""
    word = one_of("the cursors", bars, ("VBARS", "HBARS", "OFF"))
    panel.remember("CURSOR", "CURSOR KIND")
    panel.change(Change(":CURSOR:SELECT:SOURCE", source), Change(":CURSOR:FUNCTION", word))
    if word == "VBARS":
        panel.change(Change(":CURSOR:VBARS:UNITS", "SECONDS"))
    if positions is not None:
        if word == "OFF":
            raise SettingError("cursors that are off have no positions; choose VBARS or HBARS")
        tolerance = _CURSOR_PRECISION * max(abs(position) for position in positions)
        changes = [Change(f":CURSOR:{word}:POSITION{n}", at, tolerance) for n, at in enumerate(positions, start=1)]
        panel.change(*changes)
    return read_cursors(panel)


def read_cursors(panel: FrontPanel) -> Cursors:
    """The cursors as they stand now."""
    bars, source = panel.read((":CURSOR:FUNCTION", ":CURSOR:SELECT:SOURCE"))
    if bars == "OFF":
        return Cursors(bars, source)
    branch = f":CURSOR:{bars}"
    first, second, difference, unit = panel.read(
        tuple(f"{branch}:{leaf}" for leaf in ("POSITION1", "POSITION2", "DELTA", "UNITS"))
    )
    unit = {"SECONDS": "s", "HERTZ": "Hz"}.get(unit, unit)
    return Cursors(bars, source, (scpi.number(first), scpi.number(second)), scpi.number(difference), unit)
