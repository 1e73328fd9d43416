"""Reading files that must be plain, and whole where they must be small: what is given by name may be anything."""

from __future__ import annotations

import os
import stat
from typing import BinaryIO

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
    """Read a file of at most `largest` bytes."""
    with open_plain_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        content = file.read(largest + 1) if size <= largest else b""
    if max(size, len(content)) > largest:
        megabytes = largest / 1e6
        raise FileFormatError(
            f"{os.fspath(path)}: is larger than any such file ({megabytes:.3g} MB): is it the right one?"
        )
    return content


def open_plain_file(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a plain file for reading; FileFormatError if it is none, OSError if it is not there."""
    if os.path.isdir(path):  # some systems do not open one at all
        raise FileFormatError(f"{os.fspath(path)}: is a directory, not a file")
    descriptor = os.open(path, os.O_RDONLY | _WITHOUT_WAITING)
    try:
        found = os.fstat(descriptor)
        for is_kind, name in _KINDS:
            if is_kind(found.st_mode):
                raise FileFormatError(f"{os.fspath(path)}: is {name}, not a file")
        return os.fdopen(os.dup(descriptor), "rb")
    finally:
        os.close(descriptor)
