"""Names under which an instrument is reached, and what to do when one of them cannot be opened.

Beside VISA's own names two kinds are understood: a serial port by its plain name (`COM3`, `/dev/ttyUSB0`), and an
instrument behind a GPIB adapter of Prologix' kind (also AR488) in one name, such as
`PRLGX-TCPIP0::192.168.1.20::1234::GPIB0::1::INSTR` or `PRLGX-ASRL0::/dev/ttyUSB0::GPIB0::1::INSTR`.
"""

from __future__ import annotations

import importlib.util
import re

USB_RULE = 'SUBSYSTEM=="usb", ATTR{idVendor}=="0699", MODE="0666"'
"""The udev line that lets every user of a Linux computer open Tektronix instruments."""

_PLAIN_SERIAL = re.compile(r"(?:COM(?P<number>\d+):?|(?P<path>/dev/\S+))", re.IGNORECASE)
_ADAPTER = re.compile(
    r"(?P<interface>PRLGX-(?:TCPIP|ASRL)(?P<board>\d*)::.+)::GPIB\d*::(?P<address>\d+)(?:::INSTR)?", re.I
)
_DENIED = ("permission", "access denied", "errno 13")


def visa_name(name: str) -> str:
    """The VISA name of a serial port that is given by its plain name; any other name as it is.

    Examples
    --------
    >>> visa_name("COM3"), visa_name("/dev/ttyUSB0"), visa_name("GPIB0::1::INSTR")
    ('ASRL3::INSTR', 'ASRL/dev/ttyUSB0::INSTR', 'GPIB0::1::INSTR')
    """
    plain = _PLAIN_SERIAL.fullmatch(name.strip())
    if plain is None:
        return name
    return f"ASRL{plain['number'] or plain['path']}::INSTR"


def behind_adapter(name: str) -> tuple[str, str] | None:
    """The names of adapter and instrument in a name that holds both; None if it does not.

    Examples
    --------
    >>> behind_adapter("PRLGX-TCPIP1::10.0.0.5::1234::GPIB::7::INSTR")
    ('PRLGX-TCPIP1::10.0.0.5::1234::INTFC', 'GPIB1::7::INSTR')
    """
    found = _ADAPTER.fullmatch(name.strip())
    if found is None:
        return None
    return f"{found['interface']}::INTFC", f"GPIB{found['board'] or 0}::{found['address']}::INSTR"


def advice(name: str, problem: str) -> str:
    """What to do about a name that cannot be opened, as the end of a sentence; empty where nothing is known.

    Examples
    --------
    >>> "0699" in advice("USB0::0x0699::0x0368::C1::INSTR", "[Errno 13] Access denied")
    True
    """
    kind = visa_name(name).upper()
    denied = any(word in problem.lower() for word in _DENIED)
    if kind.startswith("USB") and denied:
        return (
            "; your user may not open USB instruments: on Linux put the line "
            f"{USB_RULE} into /etc/udev/rules.d/99-tektronix.rules, run 'udevadm control --reload' as root, and "
            "plug the cable in again"
        )
    if kind.startswith(("ASRL", "PRLGX-ASRL")) and denied:
        return "; your user may not open this port: on Linux join the group that owns it (often dialout)"
    if kind.startswith("USB") and not importlib.util.find_spec("usb"):
        return "; USB needs pip install 'gyrolock[usb]' and libusb, or a vendor's VISA"
    if kind.startswith("GPIB") and not any(map(importlib.util.find_spec, ("gpib", "gpib_ctypes"))):
        return (
            "; GPIB needs a driver: install a vendor's VISA, or linux-gpib, or gpib-ctypes with the vendor's "
            "driver. An adapter of Prologix' kind needs none: name it PRLGX-TCPIP0::ADDRESS::1234::GPIB0::1::INSTR"
        )
    return ""
