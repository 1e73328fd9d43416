"""The expression of MATH:DEFINE: a sum, difference or product of two channels, or the spectrum of one.

Source: programmer manual 071-1075-04, p. 2-148.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from instrument.simulated.panel.event_table import Guess, Refusal
from instrument.simulated.panel.formats import abbreviations, quoted
from instrument.simulated.panel.kinds import Value
from instrument.simulated.panel.parsing import Argument

_INVALID_EXPRESSION = 2235
_WINDOWS = {
    spelling: word.upper() for word in ("HANning", "FLATtop", "RECTangular") for spelling in abbreviations(word)
}
_SUM = re.compile(r"CH(\d)([+*-])CH(\d)")
_FFT = re.compile(r"FFT\(CH(\d)(?:,([A-Z]+))?\)")
_PAIRS = {"1+2", "3+4", "1-2", "2-1", "3-4", "4-3"}
_PRODUCTS = {"1*2", "3*4"}


@dataclass(frozen=True)
class MathExpression:
    """The quoted expression of MATH:DEFINE, written as the instrument answers it."""

    channels: int
    products: bool = False  # B, C and TPS multiply, too

    def read(self, argument: Argument) -> str:
        """Canonical form; event 2235 if this family cannot calculate it."""
        if not argument.quoted:
            raise Refusal(Guess.STRING_EXPECTED)
        pairs = _PAIRS | _PRODUCTS if self.products else _PAIRS
        text = re.sub(r"\s+", "", argument.text).upper()
        if (match := _SUM.fullmatch(text)) and "".join(match.groups()) in pairs:
            first, sign, second = match.groups()
            if max(int(first), int(second)) <= self.channels:
                return f"CH{first} {sign} CH{second}"
        if (match := _FFT.fullmatch(text)) and 1 <= int(match[1]) <= self.channels:
            window = _WINDOWS.get(match[2] or "HANNING")
            if window is not None:
                return f"FFT(CH{match[1]},{window})"
        raise Refusal(_INVALID_EXPRESSION)

    def write(self, value: Value, verbose: bool) -> str:
        """In double quotes."""
        return quoted(str(value))


def operands(expression: str) -> list[str]:
    """Channels of an expression.

    Examples
    --------
    >>> operands("CH1 - CH2"), operands("FFT(CH3,HANNING)")
    (['CH1', 'CH2'], ['CH3'])
    """
    return re.findall(r"CH\d", expression)
