"""Which link a name means: two names of one link are one."""

from __future__ import annotations

import ipaddress
import os
import re
import socket
from contextlib import suppress

from pyvisa import rname

from instrument.names import behind_adapter, visa_name

_URL = re.compile(r"(?:ASRL)?(?:socket|rfc2217)://(?P<host>[^:/]+|\[[^]]+\]):(?P<port>\d+).*", re.I)
_CLASSES = ("INSTR", "SOCKET", "INTFC", "RAW")
_HISLIP_PORT = ",4880"  # the one that is meant where none is named


def link_of(name: str) -> str:
    """Return the link that a resource name means, in one spelling: host and port, serial port, bus and address.

    An adapter is one link, whatever is behind it: two programs that send it to two instruments spoil both. What
    never leaves the process (pySerial's ``loop://``) has no link: an empty text.

    Examples
    --------
    >>> link_of("TCPIP0::127.0.0.1::4001::SOCKET"), link_of("socket://127.0.0.2:4001")
    ('tcp 127.0.0.1 4001', 'tcp 127.0.0.1 4001')
    >>> link_of("USB0::0x0699::0x0368::C012345::INSTR"), link_of("GPIB::7")
    ('usb 1689 872 C012345', 'gpib 0 7')
    """
    name = name.strip()
    if (url := _URL.fullmatch(name)) is not None:
        return f"tcp {_address(url['host'].strip('[]'))} {int(url['port'])}"
    if "loop://" in name.lower():
        return ""
    adapter = behind_adapter(name)
    match _parsed(adapter[0] if adapter else visa_name(name)):
        case rname.TCPIPSocket() | rname.PrlgxTCPIPIntfc() as one:
            return f"tcp {_address(one.host_address)} {_plain(one.port)}"
        case rname.TCPIPInstr() as one:
            return f"lan {_address(one.host_address)} {one.lan_device_name.lower().removesuffix(_HISLIP_PORT)}"
        case rname.ASRLInstr() as one:
            return _serial(one.board)
        case rname.PrlgxASRLIntfc() as one:
            return _serial(one.serial_device)
        case rname.USBInstr() | rname.USBRaw() as one:
            return f"usb {_plain(one.manufacturer_id)} {_plain(one.model_code)} {one.serial_number.upper()}"
        case rname.GPIBInstr() as one:
            numbers = (one.board, one.primary_address, one.secondary_address)
            return " ".join(["gpib", *(_plain(number) for number in numbers if number is not None)])
    return name.upper()


def _parsed(name: str) -> rname.ResourceName | None:
    """A VISA name taken apart, in capitals or not; None if it is none, but an alias perhaps."""
    head, colons, last = name.rpartition("::")
    try:
        return rname.parse_resource_name(head + colons + last.upper() if last.upper() in _CLASSES else name)
    except ValueError:
        return None


def _plain(number: str) -> str:
    """A number in one spelling, be it decimal or hexadecimal; any other text in capitals."""
    with suppress(ValueError):
        return str(int(number, 16 if number[:2].lower() == "0x" else 10))
    return number.upper()


def _serial(port: str) -> str:
    """A serial port: links to a device of Linux lead to it, and COM3 of Windows is VISA's port 3."""
    return f"serial {os.path.realpath(port) if port.startswith('/') else port.upper().removeprefix('COM')}"


def _address(host: str) -> str:
    """The address of a host; one for this computer. A name that nobody knows stays as it is."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        try:
            known = {str(entry[4][0]).partition("%")[0] for entry in socket.getaddrinfo(host, None)}
        except OSError:
            return host.lower()
        address = min(map(ipaddress.ip_address, known), key=lambda one: (not one.is_loopback, one.version, one))
    return "127.0.0.1" if address.is_loopback else str(address)
