"""A claim on a link: one process holds it, tells the others, and loses it with its end; names of instruments.

Each is a file in a directory that all users of the computer share, locked as long as the link is used. The lock
decides; what stands in the file says who has it. Another user's file can be locked, too, but not written.
"""

import errno
import getpass
import importlib.util
import ipaddress
import json
import os
import re
import socket
import sys
import tempfile
import threading
import time
import zlib
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from pyvisa import rname

from instrument.errors import LinkError

DIRECTORY_VARIABLE = "GYROLOCK_LOCKS"

_SYSTEM = Path("/run/lock")  # shared also with services that have a temporary directory of their own
_LONGEST = 120  # characters of a command line
_LARGEST = 4096  # bytes that are read of a claim
_TRIES = 20  # a claim that is given up in the moment in which it is looked at
_WRITTEN_S = 0.05  # after which a claim that was just made says who has it
_READABLE = 0o644


@dataclass(frozen=True)
class Holder:
    """The program that uses a link."""

    pid: int
    user: str
    doing: str  # what it does: its command line, or the campaign
    since: str  # UTC, ISO 8601

    def __str__(self) -> str:
        of_user = f" of {self.user}" if self.user != _user() else ""
        return f"process {self.pid}{of_user} ({self.doing}), since {self.since[:19].replace('T', ' ')} UTC"


class Claim:
    """A link that other programs are kept from until it is released; a context manager."""

    def __init__(self, path: Path | None) -> None:
        self._path = path

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Let others use it; a second call does nothing. Within one process the last one lets go."""
        path, self._path = self._path, None
        if path is not None:
            _let_go(path)


def claim(name: str, doing: str = "", *, means: str = "") -> Claim:
    """Keep other programs of this computer from a link. The same process may do so more than once."""
    # Where no file can be locked (no directory that takes one) nobody is kept from anything.
    link = link_of(means or name)
    if not link:
        return Claim(None)
    plain = re.sub(r"[^A-Za-z0-9]+", "-", link)[:60]
    shared = _SYSTEM if os.access(_SYSTEM, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())
    folder = Path(os.environ.get(DIRECTORY_VARIABLE) or shared)
    path = folder / f"gyrolock-{plain}-{zlib.crc32(link.encode()):08x}.lock"
    with _alone:
        if path in _held:
            _held[path] = (_held[path][0], _held[path][1] + 1)
            return Claim(path)
        descriptor = _locked(path, name)
        if descriptor is None:
            return Claim(None)
        _held[path] = (descriptor, 1)
    _write(
        descriptor,
        Holder(
            os.getpid(),
            _user(),
            doing or _plain(" ".join([Path(sys.argv[0] or "python").name, *sys.argv[1:]])),
            datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
        ),
        link,
    )
    return Claim(path)


_held: dict[Path, tuple[int, int]] = {}
"""Open file and number of claims, by the path of each claim of this process."""
_alone = threading.Lock()


def _let_go(path: Path) -> None:
    with _alone:
        if path not in _held:
            return
        descriptor, count = _held[path]
        if count > 1:
            _held[path] = (descriptor, count - 1)
            return
        del _held[path]
        with suppress(OSError):  # another user's file stays, and Windows takes none away that is open
            path.unlink()
        os.close(descriptor)


def _forget_in_child() -> None:
    """A process that was forked has claims of its own only."""
    global _alone
    _alone = threading.Lock()
    for descriptor, _ in _held.values():
        with suppress(OSError):
            os.close(descriptor)
    _held.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_in_child)


def _locked(path: Path, name: str) -> int | None:
    """The locked file of a claim; None if there can be none. LinkError if another process has locked it."""
    for _ in range(_TRIES):
        try:
            descriptor = _opened(path)
        except OSError:
            return None
        if not lock(descriptor):
            holder = _holder(descriptor)
            os.close(descriptor)
            if holder is None and not path.exists():
                continue  # just released
            who = holder or "another program"
            raise LinkError(f"{name} is in use by {who}; end that program, or use it there")
        with suppress(OSError):
            if os.path.samestat(os.fstat(descriptor), os.stat(path)):
                return descriptor
        os.close(descriptor)  # released between opening and locking: a file that nobody else will ever find
    return None


def _opened(path: Path) -> int:
    flags = os.O_CREAT | os.O_RDWR | _SAFELY
    try:
        return os.open(path, flags, _READABLE)
    except PermissionError:  # another user's
        return os.open(path, os.O_RDONLY | _SAFELY)


_SAFELY = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def _write(descriptor: int, holder: Holder, link: str) -> None:
    text = json.dumps({"link": link, **asdict(holder)}).encode()
    with suppress(OSError):
        os.ftruncate(descriptor, 0)
        os.lseek(descriptor, 0, os.SEEK_SET)
        os.write(descriptor, text)
        if hasattr(os, "fchmod"):
            os.fchmod(descriptor, _READABLE)  # whatever the umask: other users are to read who has it


def _holder(descriptor: int) -> Holder | None:
    """Who says that it has the lock; None where nobody does, or one that is not there any more."""
    for wait in (0.0, _WRITTEN_S):
        time.sleep(wait)
        try:
            os.lseek(descriptor, 0, os.SEEK_SET)
            said = json.loads(os.read(descriptor, _LARGEST))
            holder = Holder(int(said["pid"]), *(_plain(said[name]) for name in ("user", "doing", "since")))
        except (OSError, ValueError, KeyError, TypeError):
            continue
        return holder if _there(holder.pid) else None
    return None


def _plain(text: object) -> str:
    return re.sub(r"[^ -~]", "?", str(text))[:_LONGEST]


def _there(pid: int) -> bool:
    if sys.platform == "win32":  # os.kill would end it
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError, ImportError):
        return str(os.getuid()) if hasattr(os, "getuid") else "?"


# --------------------
# Which link a name means: two names of one link are one


_URL = re.compile(r"(?:ASRL)?(?:socket|rfc2217)://(?P<host>[^:/]+|\[[^]]+\]):(?P<port>\d+).*", re.I)
_CLASSES = ("INSTR", "SOCKET", "INTFC", "RAW")
_HISLIP_PORT = ",4880"  # the one that is meant where none is named


def link_of(name: str) -> str:
    """Return the link that a resource name means, in one spelling: host and port, serial port, bus and address."""
    # An adapter is one link, whatever is behind it: two programs that send it to two instruments spoil both. What
    # never leaves the process (pySerial's ``loop://``) has no link: an empty text.
    name = name.strip()
    if (url := _URL.fullmatch(name)) is not None:
        return f"tcp {_address(url['host'].strip('[]'))} {int(url['port'])}"
    if "loop://" in name.lower():
        return ""
    adapter = behind_adapter(name)
    match _parsed(adapter[0] if adapter else visa_name(name)):
        case rname.TCPIPSocket() | rname.PrlgxTCPIPIntfc() as one:
            return f"tcp {_address(one.host_address)} {_plain_name(one.port)}"
        case rname.TCPIPInstr() as one:
            return f"lan {_address(one.host_address)} {one.lan_device_name.lower().removesuffix(_HISLIP_PORT)}"
        case rname.ASRLInstr() as one:
            return _serial(one.board)
        case rname.PrlgxASRLIntfc() as one:
            return _serial(one.serial_device)
        case rname.USBInstr() | rname.USBRaw() as one:
            return (
                f"usb {_plain_name(one.manufacturer_id)} {_plain_name(one.model_code)} {one.serial_number.upper()}"
            )
        case rname.GPIBInstr() as one:
            numbers = (one.board, one.primary_address, one.secondary_address)
            return " ".join(["gpib", *(_plain_name(number) for number in numbers if number is not None)])
    return name.upper()


def _parsed(name: str) -> rname.ResourceName | None:
    """A VISA name taken apart, in capitals or not; None if it is none, but an alias perhaps."""
    head, colons, last = name.rpartition("::")
    try:
        return rname.parse_resource_name(head + colons + last.upper() if last.upper() in _CLASSES else name)
    except ValueError:
        return None


def _plain_name(number: str) -> str:
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


# --------------------
# A lock on an open file: the operating system takes it away with the process, one that was killed too


_TAKEN = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
_FAR = 1 << 30  # a byte that nobody reads: what Windows locks can be read by nobody else


def lock(descriptor: int) -> bool:
    """Lock an open file for this process as long as it is open; ``False`` if another process has it.

    A file system without locks keeps nobody out: ``True``.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, _FAR, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in _TAKEN
    return True


# --------------------
# Names under which an instrument is reached, and what to do when one of them cannot be opened.
#
# Beside VISA's own names two kinds are understood: a serial port by its plain name (`COM3`, `/dev/ttyUSB0`), and
# an instrument behind a GPIB adapter of Prologix' kind (also AR488) in one name, such as `PRLGX-
# TCPIP0::192.168.1.20::1234::GPIB0::1::INSTR` or `PRLGX-ASRL0::/dev/ttyUSB0::GPIB0::1::INSTR`


USB_RULE = 'SUBSYSTEM=="usb", ATTR{idVendor}=="0699", MODE="0666"'
"""The udev line that lets every user of a Linux computer open Tektronix instruments."""

_PLAIN_SERIAL = re.compile(r"(?:COM(?P<number>\d+):?|(?P<path>/dev/\S+))", re.IGNORECASE)
_ADAPTER = re.compile(
    r"(?P<interface>PRLGX-(?:TCPIP|ASRL)(?P<board>\d*)::.+)::GPIB\d*::(?P<address>\d+)(?:::INSTR)?", re.I
)
_DENIED = ("permission", "access denied", "errno 13")


def visa_name(name: str) -> str:
    """The VISA name of a serial port that is given by its plain name; any other name as it is."""
    plain = _PLAIN_SERIAL.fullmatch(name.strip())
    if plain is None:
        return name
    return f"ASRL{plain['number'] or plain['path']}::INSTR"


def behind_adapter(name: str) -> tuple[str, str] | None:
    """The names of adapter and instrument in a name that holds both; None if it does not."""
    found = _ADAPTER.fullmatch(name.strip())
    if found is None:
        return None
    return f"{found['interface']}::INTFC", f"GPIB{found['board'] or 0}::{found['address']}::INSTR"


def advice(name: str, problem: str) -> str:
    """What to do about a name that cannot be opened, as the end of a sentence; empty where nothing is known."""
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
