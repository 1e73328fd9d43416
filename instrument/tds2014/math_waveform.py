"""The math waveform: sums, differences and spectra that the scope computes.

Programmer manual 071-1075-04, p. 2-148.
"""

from __future__ import annotations

from instrument import scpi
from instrument.dialogue.dialogue import Dialogue
from instrument.errors import SettingError


def set_math(dialogue: Dialogue, expression: str, displayed: bool) -> None:
    """Define the math waveform, show or hide it, and read both back.

    Raises
    ------
    SettingError
        If the scope holds another expression afterwards.
    ExecutionError
        If this model cannot compute it.
    """
    if '"' in expression or ";" in expression:
        raise SettingError(f"{expression!r} is not a math expression; write for example CH1 - CH2 or FFT(CH1)")
    on = "ON" if displayed else "OFF"
    (held,) = dialogue.checked(f':MATH:DEFINE "{expression}";:SELECT:MATH {on};:MATH:DEFINE?;*ESR?', parts=1)
    # The scope writes blanks of its own and names the window that was left out.
    if not _plain(scpi.unquote(held)).startswith(_plain(expression).rstrip(")")):
        raise SettingError(f"the math waveform was set to {expression} but the scope holds {held}")


def _plain(expression: str) -> str:
    return expression.replace(" ", "").upper()
