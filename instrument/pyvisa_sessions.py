"""What lies beneath VISA: GPIB adapters of Prologix' kind (also AR488), sockets, and who else has the instrument.

PyVISA-py drives such an adapter as a byte stream beside which `++` orders go. It reads from the instrument only
when it is told to, and gives up when nothing comes within a time that it holds: an answer that takes longer has to
be asked for again. Its stream has no message ends.
"""

import contextlib
import importlib
import os
import re
import socket
from typing import Any, Protocol, cast

import pyvisa
from pyvisa.constants import ResourceAttribute, StatusCode
from pyvisa.resources import MessageBasedResource

from instrument.claims import Claim, advice, behind_adapter, claim, visa_name
from instrument.errors import LinkError

READ_TIME_MS = 3000
"""Longest time that such an adapter waits for a byte of the instrument; the most that it can be set to."""

READ_AGAIN_S = READ_TIME_MS / 1000 + 0.1


class _Interface(Protocol):
    """The part of PyVISA-py's adapter session that is used."""

    interface: object

    def write_oob(self, data: bytes) -> object: ...

    def set_attribute(self, attribute: ResourceAttribute, value: object) -> object: ...


class GpibAdapter:
    """The adapter between this computer and an instrument."""

    def __init__(self, interface: _Interface) -> None:
        self._interface = interface

    def configure(self) -> None:
        """Let it wait for the instrument as long as it can."""
        self._interface.write_oob(f"++read_tmo_ms {READ_TIME_MS}\n".encode())

    def set_timeout(self, milliseconds: float) -> None:
        """Time that a read of the stream may take; the instrument's own attribute does not reach it."""
        self._interface.set_attribute(ResourceAttribute.timeout_value, milliseconds)

    def read_again(self) -> None:
        """Have it listen to the instrument anew: it has given up by now."""
        self._interface.write_oob(b"++read eoi\n")

    @property
    def holder(self) -> object:
        """What has the socket as its attribute `interface`."""
        return self._interface


def adapter_of(resource: MessageBasedResource) -> GpibAdapter | None:
    """The adapter that an opened instrument is behind; None where it is behind none."""
    session = session_of(resource)
    interface = getattr(session, "interface", None)
    return GpibAdapter(cast(_Interface, interface)) if hasattr(interface, "write_oob") else None


def forget_adapter(interface_name: str) -> None:
    """Make an adapter that could not be opened unknown again."""
    # PyVISA-py enters it before it is open and leaves it there, socket and all: every GPIB name would go to it.
    session = _adapters().pop(_board(interface_name), None)
    if session is not None:
        with contextlib.suppress(Exception):
            session.interface.close()


def _adapters() -> dict[str, Any]:
    """PyVISA-py's sessions of adapters, by the number of the board that they stand for."""
    try:
        module = importlib.import_module("pyvisa_py.prologix")
    except ImportError:
        return {}
    boards: dict[str, Any] = getattr(getattr(module, "_PrologixIntfcSession", None), "boards", {})
    return boards


def _board(name: str) -> str:
    """Number of the interface that a name begins with."""
    return re.sub(r"\D", "", name.partition("::")[0]) or "0"


def session_of(resource: MessageBasedResource) -> object | None:
    """PyVISA-py's own session of a resource; None with another VISA."""
    sessions = _sessions_of(resource.visalib)
    return None if sessions is None else sessions.get(resource.session)


def _sessions_of(library: object) -> dict[Any, Any] | None:
    """PyVISA-py's own sessions; None with another VISA."""
    sessions = getattr(library, "sessions", None)
    return sessions if isinstance(sessions, dict) else None


def socket_of(holder: object | None) -> socket.socket | None:
    """The socket of a session, if it has one."""
    peer = getattr(holder, "interface", None)
    return peer if isinstance(peer, socket.socket) else None


def keep_to_oneself(resource: MessageBasedResource) -> bool:
    """Keep other programs from an opened instrument, where the link can do that; False if one of them has it."""
    # A vendor's VISA locks the resource; PyVISA-py does not, but a serial port of POSIX can be locked.
    port: Any = getattr(session_of(resource), "interface", None)
    if hasattr(port, "exclusive"):
        try:
            port.exclusive = True
        except (OSError, ValueError) as error:
            return isinstance(error, ValueError)  # a system without such locks
        return True
    try:
        resource.lock_excl(timeout=0)
    except pyvisa.VisaIOError as error:
        return error.error_code != StatusCode.error_resource_locked
    except (NotImplementedError, AttributeError):
        return True
    return True


def claim_instrument(name: str, manager: pyvisa.ResourceManager | None) -> Claim:
    """Keep other programs from the link of a name, before anything is sent; LinkError says which one has it."""
    # An instrument that is simulated within this program is nobody else's.
    manager = _manager(name, manager)
    return (
        Claim(None)
        if getattr(manager.visalib, "in_this_program", False)
        else claim(name, means=_meant(name, manager))
    )


def meant_by(name: str) -> str:
    """The resource name that an alias stands for with PyVISA's own choice of a VISA; any other name as it is."""
    if "::" in name or "/" in name:
        return name
    try:
        return _meant(name, visa_manager())
    except Exception:  # without any VISA there are no aliases
        return name


def _meant(name: str, manager: pyvisa.ResourceManager) -> str:
    """What a VISA understands by an alias; of a GPIB name the adapter that PyVISA-py has put behind its board."""
    if name.upper().startswith("GPIB") and _sessions_of(manager.visalib) is not None:
        adapter = _adapters().get(_board(name))
        return name if adapter is None else str(adapter.parsed)
    try:
        return manager.resource_info(name).resource_name or name
    except Exception:  # a name of ours, or none at all: opening it will say so
        return name


def open_instrument(
    name: str, manager: pyvisa.ResourceManager | None, seconds: float
) -> tuple[MessageBasedResource, pyvisa.resources.Resource | None]:
    """The instrument of a name, and the adapter that was opened for it; LinkError after so many seconds."""
    beneath, timeout = None, round(seconds * 1000)
    manager = _manager(name, manager)
    try:
        adapter, visa = behind_adapter(name) or (None, visa_name(name))
        if adapter is not None:
            beneath = manager.open_resource(adapter, open_timeout=timeout)
        resource = manager.open_resource(visa, open_timeout=timeout)
    except Exception as error:  # PyVISA-py raises whatever its transport does, down to bare Exception
        if beneath is not None:
            beneath.close()
        elif (names := behind_adapter(name)) is not None:
            forget_adapter(names[0])
        if name and "::" not in name:  # no alias of this VISA either
            port = name.startswith("/dev/") or name.upper().startswith("COM")
            form = f"ASRL{name}::INSTR" if port else f"TCPIP0::{name}::INSTR or TCPIP0::{name}::PORT::SOCKET"
            raise LinkError(f"cannot open {name}, which is no VISA name: write {form}") from error
        reason = _reason(error)
        raise LinkError(f"cannot open {name}: {reason}{advice(name, reason)}") from error
    if not isinstance(resource, MessageBasedResource):
        resource.close()
        raise LinkError(f"{name} is not an instrument that takes text messages; check the resource name")
    return resource, beneath


_BACKENDS = {"pyvisa_py": "@py", "pyvisa": "@ivi"}
_PTY = "ASRL/dev/pts/"  # of a simulated instrument: no vendor's VISA knows such a port
_found: list[str] = []  # the backend that PyVISA chose; it asks ldd and a compiler for a vendor's, 0.1 s each time


def visa_manager(backend: str = "") -> pyvisa.ResourceManager:
    """A resource manager of one backend, else by PYVISA_LIBRARY, else by the choice that PyVISA makes once."""
    if backend or "PYVISA_LIBRARY" in os.environ:
        return pyvisa.ResourceManager(backend)
    manager = pyvisa.ResourceManager(*_found)
    if not _found and (known := _BACKENDS.get(type(manager.visalib).__module__.split(".")[0])):
        _found.append(known)
    return manager


def _manager(name: str, manager: pyvisa.ResourceManager | None) -> pyvisa.ResourceManager:
    """The manager that was given, or PyVISA's own choice; an adapter needs PyVISA-py."""
    try:
        return manager or visa_manager("@py" if behind_adapter(name) or name.startswith(_PTY) else "")
    except Exception as error:
        raise LinkError(f"cannot open {name}: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    if isinstance(error, pyvisa.VisaIOError):
        return f"{error.description} Check the name with 'gyrolock list'"
    text = " ".join(str(error).split())
    return text or type(error).__name__
