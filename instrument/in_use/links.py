"""Which link a name means: two names of one link are one."""

from __future__ import annotations

import ipaddress
import os
import re
import socket

from instrument.names import behind_adapter, visa_name

_URL = re.compile(r"(?:ASRL)?(?:socket|rfc2217)://(?P<host>[^:/]+|\[[^]]+\]):(?P<port>\d+).*", re.I)
_NUMBER = re.compile(r"0x[0-9a-f]+|\d+", re.I)
_CLASSES = ("INSTR", "SOCKET", "INTFC", "RAW")


def link_of(name: str) -> str:
    """Return the link that a resource name means, in one spelling: host and port, serial port, bus and address.

    An adapter is one link, whatever is behind it: two programs that send it to two instruments spoil both. What
    never leaves the process (pySerial's ``loop://``) has no link: an empty text.

    Parameters
    ----------
    name : str
        VISA resource name, name of a serial port, or ``socket://host:port``.

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
    first, *rest = (adapter[0] if adapter else visa_name(name)).split("::")
    kind, family = first.upper(), rest.pop().upper() if rest and rest[-1].upper() in _CLASSES else "INSTR"
    bare_port = kind.startswith("PRLGX-TCPIP") or (kind.startswith("TCPIP") and family == "SOCKET")
    if bare_port and len(rest) > 1:
        return f"tcp {_address(rest[0])} {rest[1]}"
    if kind.startswith("PRLGX-ASRL") and rest:
        return _serial(rest[0])
    if kind.startswith("TCPIP") and rest:
        return f"lan {_address(rest[0])} {(rest[1] if rest[1:] else 'inst0').lower()}"
    if kind.startswith("ASRL"):
        return _serial(first[4:])
    if kind.startswith("USB") and len(rest) > 2:
        numbers = (str(int(one, 0)) if _NUMBER.fullmatch(one) else one for one in rest[:2])
        return f"usb {' '.join(numbers)} {rest[2].upper()}"
    if kind.startswith("GPIB"):
        return " ".join(["gpib", kind[4:] or "0", *rest])
    return name.upper()


def _serial(port: str) -> str:
    """A serial port: links to a device of Linux lead to it."""
    return f"serial {os.path.realpath(port) if port.startswith('/') else port.upper()}"


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
