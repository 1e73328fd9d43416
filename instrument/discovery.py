"""Which instruments are there, and why one of them cannot be used."""

import importlib
import importlib.util
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Thread
from time import monotonic
from typing import Any

import pyvisa
from pyvisa.constants import InterfaceType

from instrument.dialogue.dialogue import Dialogue
from instrument.dialogue.identify import Identity
from instrument.dialogue.link import Link
from instrument.errors import InstrumentError, LinkError
from instrument.pyvisa_sessions import visa_manager

# What PyVISA-py needs beyond itself for each kind of link, and what to install for it.
_TRANSPORTS = (
    ("USB", ("usb",), "install pyusb and libusb"),
    ("GPIB", ("gpib", "gpib_ctypes"), "install linux-gpib, or gpib-ctypes with the vendor's driver"),
    ("RS-232", ("serial",), "install pyserial"),
)

_ON_THE_NETWORK = (InterfaceType.tcpip, InterfaceType.vicp)

LAN_PATIENCE_S = 2.0
"""What is on the network answers in a second; others, behind slow links, are asked by their name."""


@dataclass(frozen=True)
class FoundResource:
    """One VISA resource: its identity if it is a scope of the family, else the problem in one sentence."""

    resource_name: str
    identity: Identity | None
    problem: str | None


def find_resources(
    resource_manager: pyvisa.ResourceManager | None = None, *, lan: bool = True
) -> list[FoundResource]:
    """List every VISA resource that the computer sees and try each one.

    Each is opened, cleared and asked ``*IDN?``; a serial port costs a few seconds if nothing answers. Raw TCP
    sockets cannot be listed by any VISA: use `check_resource` with the name.

    Parameters
    ----------
    lan : bool, optional
        Whether to look on the network, for `LAN_PATIENCE_S` at most; a vendor's VISA looks there as it likes.

    Raises
    ------
    LinkError
        If there is no VISA at all.
    """
    try:
        manager = resource_manager or visa_manager()
        with warnings.catch_warnings():
            # PyVISA-py warns about optional packages for network discovery; `missing_transports` tells more.
            warnings.simplefilter("ignore")
            names = (
                _names_by_pyvisa_py(lan=lan)
                if (type(manager.visalib).__module__.partition(".")[0] == "pyvisa_py")
                else manager.list_resources("?*")
            )
    except (pyvisa.Error, OSError, ValueError) as error:
        raise LinkError(
            f"VISA cannot list any resources: {error}; install pyvisa-py or a vendor's VISA"
        ) from error
    # PyVISA-py offers every serial port once more as a GPIB adapter of Prologix: an interface, no instrument.
    instruments = [name for name in dict.fromkeys(names) if not name.upper().endswith("::INTFC")]
    # serial ports have nothing to do with each other, and each on which nobody answers is waited for
    ports = [name for name in instruments if name.upper().startswith("ASRL")]
    with ThreadPoolExecutor(max_workers=max(len(ports), 1)) as pool:
        waiting = {name: pool.submit(check_resource, name, manager) for name in ports}
        found = {name: check_resource(name, manager) for name in instruments if name not in waiting}
        found |= {name: one.result() for name, one in waiting.items()}
    return [found[name] for name in instruments]


def _names_by_pyvisa_py(*, lan: bool) -> list[str]:
    """Resources that PyVISA-py sees; the kinds of links at the same time, and no longer than is reasonable."""
    # It would itself ask one kind after the other, and wait a second and more for each that is on the network.
    sessions = importlib.import_module("pyvisa_py.sessions")
    found: dict[str, list[str]] = {}
    failed: list[Exception] = []

    def look(name: str, kind: Any) -> None:
        try:
            found[name] = list(kind.list_resources())
        except (OSError, ValueError, pyvisa.Error) as error:
            failed.append(error)

    kinds = {str(key): (key[0], kind) for key, kind in sessions.Session.iter_valid_session_classes()}
    asked = [(name, kind) for name, (interface, kind) in kinds.items() if lan and interface in _ON_THE_NETWORK]
    threads = [Thread(target=look, args=one, daemon=True) for one in asked]
    for thread in threads:
        thread.start()
    until = monotonic() + LAN_PATIENCE_S
    for name, (interface, kind) in kinds.items():
        if interface not in _ON_THE_NETWORK:
            look(name, kind)
    for thread in threads:
        thread.join(max(until - monotonic(), 0.0))
    if failed and not found:
        raise failed[0]
    return [resource for name in kinds for resource in found.get(name, ())]


def check_resource(
    resource_name: str, resource_manager: pyvisa.ResourceManager | None = None, *, baud_rate: int | None = None
) -> FoundResource:
    """Try one resource: who answers there, or why nobody does."""
    try:
        link = Link(resource_name, resource_manager, baud_rate)
    except InstrumentError as error:
        return FoundResource(resource_name, None, str(error))
    try:
        dialogue = Dialogue(link)
        try:
            return FoundResource(resource_name, dialogue.identity, None)
        finally:
            dialogue.close()
    except InstrumentError as error:
        return FoundResource(resource_name, None, str(error))
    finally:
        link.close()


def missing_transports() -> dict[str, str]:
    """Kinds of links that PyVISA-py cannot use on this computer, and what to do about each."""
    missing = {}
    for kind, modules, advice in _TRANSPORTS:
        if not any(importlib.util.find_spec(module) for module in modules):
            missing[kind] = advice
    return missing
