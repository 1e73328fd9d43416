"""What measurement frameworks expect of an instrument: a name, an identity, a snapshot of all settings.

QCoDeS takes any object with ``name`` and ``snapshot`` into its station, and PyMeasure procedures call ``id``,
``check_errors`` and ``shutdown``. So the driver serves both without either being installed.
"""

from __future__ import annotations

import re
from typing import Any

from instrument import scpi
from instrument.errors import ScopeEvent, TransferError
from instrument.tds2014 import setups
from instrument.tds2014.knobs import Controls

# Settings whose unit does not follow from the setting alone (cursors) are left without one.
_UNITS = (
    (re.compile(r"CH\d:SCALE"), "V/div"),
    (re.compile(r"CH\d:POSITION"), "div"),
    (re.compile(r"HORIZONTAL:(MAIN|DELAY):SCALE"), "s/div"),
    (re.compile(r"HORIZONTAL:(MAIN|DELAY):POSITION"), "s"),
    (re.compile(r"TRIGGER:MAIN:LEVEL"), "V"),
    (re.compile(r"TRIGGER:MAIN:(HOLDOFF:VALUE|PULSE:WIDTH:WIDTH)"), "s"),
)


class Snapshots(Controls):
    """A session that tells about itself in the words of measurement frameworks."""

    _snapshot: dict[str, Any] | None = None

    @property
    def name(self) -> str:
        """Model without blanks, such as ``TDS2014``."""
        return self.identity.model.replace(" ", "")

    @property
    def id(self) -> str:
        """The answer to ``*IDN?``, as asked for on opening."""
        return self.identity.text

    def get_idn(self) -> dict[str, str]:
        """Vendor, model, serial number and firmware."""
        known = self.identity
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
        if update or self._snapshot is None:
            found = setups.settings_of(setups.read_setup(self._dialogue))
            parameters = [_parameter(command.lstrip(":"), text) for command, text in found.items()]
            self._snapshot = {
                "name": self.name,
                "__class__": f"{type(self).__module__}.{type(self).__qualname__}",
                "address": self.resource_name,
                "functions": {},
                "submodules": {},
                "parameters": {
                    "IDN": {"name": "IDN", "value": self.get_idn(), "unit": ""},
                    **{parameter["name"]: parameter for parameter in parameters},
                },
            }
        return self._snapshot

    def check_errors(self) -> list[ScopeEvent]:
        """Read and empty the scope's event queue, as `events`."""
        return self.events()

    def shutdown(self) -> None:
        """Put the front panel back as found and close the link, as `close`."""
        self.close()


def _parameter(name: str, text: str) -> dict[str, Any]:
    try:
        value: float | str = scpi.number(text)
    except TransferError:
        value = scpi.unquote(text)
    unit = next((unit for pattern, unit in _UNITS if pattern.fullmatch(name)), "")
    return {"name": name, "value": value, "unit": unit}
