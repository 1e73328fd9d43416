"""A lock on an open file: the operating system takes it away with the process, one that was killed too."""

from __future__ import annotations

import errno
import os
import sys

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
