"""Which oscilloscope is it: the answer to ``*IDN?`` and what the model name says about the unit."""

from __future__ import annotations

import re
from dataclasses import dataclass

from instrument.errors import WrongInstrument

FAMILY = "TDS1000/TDS2000 (also B and C) or TPS2000"

# A blank stands between letters and number in *IDN?, and none in the files that the scopes write.
_FAMILY_MODEL = re.compile(r"(TDS|TPS) ?([12]\d{3})([BC]?)")


@dataclass(frozen=True)
class Identity:
    """The parts of ``*IDN?``.

    Attributes
    ----------
    manufacturer, model, serial, firmware : str
        For example ``TEKTRONIX``, ``TDS 2014``, ``0``, ``CF:91.1CT FV:v4.12 TDS2CM:CMV:v1.04``. The first
        series and the TPS send ``0`` for a serial number.
    text : str
        The answer as it came.
    """

    manufacturer: str
    model: str
    serial: str
    firmware: str
    text: str

    @property
    def channel_count(self) -> int:
        """4 for models whose number ends in 4, else 2."""
        return 4 if re.sub(r"\D", "", self.model).endswith("4") else 2

    def same_unit(self, other: Identity) -> bool:
        """Whether both are of one unit: by serial number, or where the series has none, by the whole answer."""
        if self.serial.strip("0") and other.serial.strip("0"):
            return (self.model, self.serial) == (other.model, other.serial)
        return self.text == other.text


def parse_identity(answer: str) -> Identity:
    """Read ``*IDN?`` and check that the unit is of this family."""
    parts = [part.strip() for part in answer.strip().split(",", 3)]
    if len(parts) == 4 and parts[0].upper() == "TEKTRONIX" and _FAMILY_MODEL.fullmatch(parts[1].upper()):
        manufacturer, model, serial, firmware = parts
        return Identity(manufacturer, model, serial, firmware, answer.strip())
    raise WrongInstrument(
        f"the instrument calls itself {answer.strip()[:80]!r}, which is not a Tektronix {FAMILY}; "
        "check the resource name"
    )
