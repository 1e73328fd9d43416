"""What measurement frameworks expect of an instrument: a name, an identity, a snapshot of all settings.

QCoDeS takes any object with ``name`` and ``snapshot`` into its station, and PyMeasure procedures call ``id``,
``check_errors`` and ``shutdown``. So the driver serves both without either being installed.
"""

from __future__ import annotations

import re
from typing import Any

from instrument import scpi
from instrument.errors import TransferError
from instrument.tds2014.session import Session
from instrument.tds2014.setup_text import read_setup, settings_of

# Settings whose unit does not follow from the setting alone (cursors) are left without one.
_UNITS = (
    (re.compile(r"CH\d:SCALE"), "V/div"),
    (re.compile(r"CH\d:POSITION"), "div"),
    (re.compile(r"HORIZONTAL:(MAIN|DELAY):SCALE"), "s/div"),
    (re.compile(r"HORIZONTAL:(MAIN|DELAY):POSITION"), "s"),
    (re.compile(r"TRIGGER:MAIN:LEVEL"), "V"),
    (re.compile(r"TRIGGER:MAIN:(HOLDOFF:VALUE|PULSE:WIDTH:WIDTH)"), "s"),
)


class Snapshot:
    """All settings of one scope as a dictionary.

    Parameters
    ----------
    class_name : str
        What the dictionary names as the class of the instrument, with its module.
    """

    def __init__(self, session: Session, class_name: str) -> None:
        self._session, self._class_name = session, class_name
        self._last: dict[str, Any] | None = None

    @property
    def name(self) -> str:
        """Model without blanks, such as ``TDS2014``."""
        return self._session.dialogue.identity.model.replace(" ", "")

    def get_idn(self) -> dict[str, str]:
        """Vendor, model, serial number and firmware."""
        known = self._session.dialogue.identity
        return {
            "vendor": known.manufacturer,
            "model": known.model,
            "serial": known.serial,
            "firmware": known.firmware,
        }

    def snapshot(self, update: bool | None = True) -> dict[str, Any]:
        """All settings of the scope as a dictionary that goes into JSON.

        Parameters
        ----------
        update : bool, optional
            Read them from the scope; otherwise those of the last snapshot serve, if there is one.
        """
        if update or self._last is None:
            found = settings_of(read_setup(self._session.dialogue))
            parameters = [_parameter(command.lstrip(":"), text) for command, text in found.items()]
            self._last = {
                "name": self.name,
                "__class__": self._class_name,
                "address": self._session.dialogue.link.name,
                "functions": {},
                "submodules": {},
                "parameters": {
                    "IDN": {"name": "IDN", "value": self.get_idn(), "unit": ""},
                    **{parameter["name"]: parameter for parameter in parameters},
                },
            }
        return self._last


def _parameter(name: str, text: str) -> dict[str, Any]:
    try:
        value: float | str = scpi.number(text)
    except TransferError:
        value = scpi.unquote(text)
    unit = next((unit for pattern, unit in _UNITS if pattern.fullmatch(name)), "")
    return {"name": name, "value": value, "unit": unit}
