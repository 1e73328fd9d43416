"""A claim on a link: held by one process, told to the others, and gone with the process that made it.

Each is a file in a directory that all users of the computer share, locked as long as the link is used. The lock
decides; what stands in the file says who has it. Another user's file can be locked, too, but not written.
"""

from __future__ import annotations

import getpass
import json
import os
import re
import sys
import tempfile
import threading
import time
import zlib
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from instrument.errors import LinkError
from instrument.in_use.file_lock import lock
from instrument.in_use.links import link_of

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

    def __enter__(self) -> Claim:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Let others use it; a second call does nothing. Within one process the last one lets go."""
        path, self._path = self._path, None
        if path is not None:
            _let_go(path)


def claim(name: str, doing: str = "", *, means: str = "") -> Claim:
    """Keep other programs of this computer from a link. The same process may do so more than once.

    Where no file can be locked (no directory that takes one) nobody is kept from anything.
    """
    link = link_of(means or name)
    if not link:
        return Claim(None)
    path = _directory() / _file_name(link)
    with _alone:
        if path in _held:
            _held[path] = (_held[path][0], _held[path][1] + 1)
            return Claim(path)
        descriptor = _locked(path, name)
        if descriptor is None:
            return Claim(None)
        _held[path] = (descriptor, 1)
    _write(descriptor, Holder(os.getpid(), _user(), doing or _command_line(), _now()), link)
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


def _directory() -> Path:
    if given := os.environ.get(DIRECTORY_VARIABLE):
        return Path(given)
    return _SYSTEM if os.access(_SYSTEM, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())


def _file_name(link: str) -> str:
    return f"gyrolock-{re.sub(r'[^A-Za-z0-9]+', '-', link)[:60]}-{zlib.crc32(link.encode()):08x}.lock"


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError, ImportError):
        return str(os.getuid()) if hasattr(os, "getuid") else "?"


def _command_line() -> str:
    return _plain(" ".join([Path(sys.argv[0] or "python").name, *sys.argv[1:]]))


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
