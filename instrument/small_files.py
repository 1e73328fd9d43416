"""Reading a file whole that must be small and plain: what is given by name may be anything."""

from __future__ import annotations

import os
import stat

from instrument.errors import FileFormatError

_KINDS = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
_WITHOUT_WAITING = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)  # a pipe would wait for its writer


def read_small_file(path: str | os.PathLike[str], largest: int) -> bytes:
    """Read a file of at most `largest` bytes.

    Raises
    ------
    FileFormatError
        It is larger, or no plain file: nothing of it is read then.
    OSError
        It is not there or cannot be read.
    """
    if os.path.isdir(path):  # some systems do not open one at all
        raise FileFormatError(f"{os.fspath(path)}: is a directory, not a file")
    descriptor = os.open(path, os.O_RDONLY | _WITHOUT_WAITING)
    try:
        found = os.fstat(descriptor)
        for is_kind, name in _KINDS:
            if is_kind(found.st_mode):
                raise FileFormatError(f"{os.fspath(path)}: is {name}, not a file")
        size = found.st_size
        with os.fdopen(os.dup(descriptor), "rb") as file:
            content = file.read(largest + 1) if size <= largest else b""
    finally:
        os.close(descriptor)
    if max(size, len(content)) > largest:
        megabytes = largest / 1e6
        raise FileFormatError(
            f"{os.fspath(path)}: is larger than any such file ({megabytes:.3g} MB): is it the right one?"
        )
    return content
