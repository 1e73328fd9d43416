"""Which program, on which Python, from which source, made a number; memory given back; texts in cells."""

import ctypes
import importlib.metadata
import math
import platform
import re
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_PACKAGES = ("numpy", "scipy", "pyvisa", "pyvisa-py", "pyserial")


_ACTS = re.compile(r"'*[=+\-@\t\r]")


def inert(text: str) -> str:
    """A text as a cell that no spreadsheet carries out (OWASP, CSV injection); :func:`alive` is the way back."""
    if not _ACTS.match(text):
        return text
    try:
        return text if math.isfinite(float(text)) else f"'{text}"
    except ValueError:
        return f"'{text}"


def alive(cell: str) -> str:
    """The text of a cell that :func:`inert` made."""
    return cell[1:] if cell[:1] == "'" and _ACTS.match(cell) else cell


def provenance() -> dict[str, object]:
    """Collect what is needed to make the same numbers again."""
    gyrolock, git = program()
    return {
        "gyrolock": gyrolock,
        "python": platform.python_version(),
        "platform": platform.platform(terse=True),
        "packages": {name: version(name) for name in _PACKAGES},
        "git": git,
    }


def program() -> tuple[str, str | None]:
    """Return the version of gyrolock, and the git state of its source tree."""
    return version("gyrolock"), git_state(Path(__file__).resolve().parent.parent)


def version(distribution: str) -> str:
    """Return the installed version of a distribution, or ``"not installed"``."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def git_state(source: Path) -> str | None:
    """Return the commit of a source tree, with ``+changes`` where files differ from it."""
    git = shutil.which("git")
    if git is None or not (source / ".git").exists():
        return None
    base = [git, "-C", str(source)]
    try:
        commit = subprocess.run(
            [*base, "rev-parse", "--short=12", "HEAD"], capture_output=True, text=True, timeout=5, check=True
        ).stdout.strip()
        changes = subprocess.run(
            [*base, "status", "--porcelain", "--untracked-files=no"],
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None
    return f"{commit}+changes" if changes else commit


# --------------------
# What the system's allocator does with the memory of large arrays; where it is not glibc's nothing is done


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of mallopt(3)
_KEPT_BYTES, _GIVEN_BACK_BYTES = 1 << 25, 1 << 20


def keep_for_batches() -> None:
    """Let this process keep the memory of its arrays for the next ones, which are as large."""
    # Returned to the system, its pages are cleared anew for the batch that follows, which takes as long as the
    # estimates.
    _set_limits(_KEPT_BYTES)


@contextmanager
def given_back() -> Iterator[None]:
    """Return what is free, some 60 MB after the last batch, and meanwhile every large array when it goes."""
    # Arrays of one number for each of a million records come and go in all sizes: kept, they leave holes.
    # Estimates that follow, in a notebook, are batches again.
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
