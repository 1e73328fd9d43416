"""What the scope itself measures and computes: measurements, cursors, the math waveform, references.

Programmer manual 071-1075-04, pp. 2-75 to 2-83, 2-148 and 2-159 to 2-170.
"""

from __future__ import annotations

from dataclasses import dataclass

from instrument import scpi
from instrument.dialogue.events import is_error, scope_event
from instrument.errors import SettingError
from instrument.tds2014.front_panel import Change, one_of
from instrument.tds2014.session import Session

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


class Measurements:
    """The scope's MEASURE, CURSOR, MATH and REF menus."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._panel = session.panel

    def measure(self, kind: str, channel: str | int) -> Measurement:
        """One of `MEASUREMENTS` on the record that the scope holds.

        Raises
        ------
        ExecutionError
            With the scope's event if there is no value: no period in the record, too small an amplitude...
        """
        word = one_of("the measurement", kind, MEASUREMENTS)
        self._panel.remember("MEASUREMENT")
        source, wait = self._session.source(channel), self._session.acquisition_time().longest
        branch = ":MEASUREMENT:IMMED"
        answers, events = self._session.dialogue.ask_with_events(
            f"{branch}:TYPE {word};SOURCE {source};{branch}:VALUE?;UNITS?", parts=2, wait=wait
        )
        value = scpi.number(answers[0])
        for event in events:
            if is_error(event):
                raise event
        if abs(value) >= NO_VALUE:
            raise scope_event(2200, f"{word} of {source} has no value", "look at the record: is the signal there?")
        return Measurement(word, source, value, scpi.unquote(answers[1]), tuple(event.text for event in events))

    def set_cursors(
        self, bars: str, *, source: str | int = "CH1", positions: tuple[float, float] | None = None
    ) -> Cursors:
        """Show cursors: ``VBARS`` at two times in s, ``HBARS`` at two values in V, or ``OFF``."""
        word = one_of("the cursors", bars, ("VBARS", "HBARS", "OFF"))
        name = self._session.source(source)
        self._panel.remember("CURSOR", "CURSOR KIND")
        self._panel.change(Change(":CURSOR:SELECT:SOURCE", name), Change(":CURSOR:FUNCTION", word))
        if word == "VBARS":
            self._panel.change(Change(":CURSOR:VBARS:UNITS", "SECONDS"))
        if positions is not None:
            if word == "OFF":
                raise SettingError("cursors that are off have no positions; choose VBARS or HBARS")
            tolerance = _CURSOR_PRECISION * max(abs(position) for position in positions)
            self._panel.change(
                *(
                    Change(f":CURSOR:{word}:POSITION{number}", position, tolerance)
                    for number, position in enumerate(positions, start=1)
                )
            )
        return self.cursors()

    def cursors(self) -> Cursors:
        """The cursors as they stand now."""
        bars, source = self._panel.read((":CURSOR:FUNCTION", ":CURSOR:SELECT:SOURCE"))
        if bars == "OFF":
            return Cursors(bars, source)
        branch = f":CURSOR:{bars}"
        first, second, difference, unit = self._panel.read(
            tuple(f"{branch}:{leaf}" for leaf in ("POSITION1", "POSITION2", "DELTA", "UNITS"))
        )
        unit = {"SECONDS": "s", "HERTZ": "Hz"}.get(unit, unit)
        return Cursors(bars, source, (scpi.number(first), scpi.number(second)), scpi.number(difference), unit)

    def set_math(self, expression: str, *, displayed: bool = True) -> None:
        """Define the math waveform, ``"CH1 - CH2"`` or ``"FFT(CH1, HANNING)"``; read it with ``fetch("MATH")``.

        Raises
        ------
        SettingError
            If the scope holds another expression afterwards.
        ExecutionError
            If this model cannot compute it.
        """
        if '"' in expression or ";" in expression:
            raise SettingError(f"{expression!r} is not a math expression; write for example CH1 - CH2 or FFT(CH1)")
        self._session.before_changing("MATH")
        on = "ON" if displayed else "OFF"
        message = f':MATH:DEFINE "{expression}";:SELECT:MATH {on};:MATH:DEFINE?;*ESR?'
        (held,) = self._session.dialogue.checked(message, parts=1)
        # The scope writes blanks of its own and names the window that was left out.
        if not _plain(scpi.unquote(held)).startswith(_plain(expression).rstrip(")")):
            raise SettingError(f"the math waveform was set to {expression} but the scope holds {held}")

    def save_reference(self, reference: str, source: str | int) -> None:
        """Store a displayed waveform in ``REFA``..., over what was there, and show it. It stays stored."""
        name = self._session.source(reference)
        if not name.startswith("REF"):
            raise SettingError(f"there is no reference {name}; choose REFA, REFB...")
        self._session.before_changing(name)
        self._session.dialogue.command(f":SAVE:WAVEFORM {self._session.source(source)},{name}")
        self._panel.change(Change(f":SELECT:{name}", True))


def _plain(expression: str) -> str:
    return expression.replace(" ", "").upper()
