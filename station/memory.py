"""What the system's allocator does with the memory of large arrays; where it is not glibc's nothing is done."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of mallopt(3)
_KEPT_BYTES, _GIVEN_BACK_BYTES = 1 << 25, 1 << 20


def keep_for_batches() -> None:
    """Let this process keep the memory of its arrays for the next ones, which are as large.

    Returned to the system, its pages are cleared anew for the batch that follows, which takes as long as the
    estimates.
    """
    _set_limits(_KEPT_BYTES)


@contextmanager
def given_back() -> Iterator[None]:
    """Return what is free, some 60 MB after the last batch, and meanwhile every large array when it goes.

    Arrays of one number for each of a million records come and go in all sizes: kept, they leave holes. Estimates
    that follow, in a notebook, are batches again.
    """
    _set_limits(_GIVEN_BACK_BYTES)
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    try:
        yield
    finally:
        keep_for_batches()


def _set_limits(size: int) -> None:
    with suppress(OSError, AttributeError):
        libc = ctypes.CDLL("libc.so.6")
        for parameter in (_M_MMAP_THRESHOLD, _M_TRIM_THRESHOLD):
            libc.mallopt(parameter, size)
