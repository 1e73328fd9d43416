"""Which program, on which Python, from which state of the source, made a number."""

from __future__ import annotations

import importlib.metadata
import platform
import shutil
import subprocess
from pathlib import Path

_PACKAGES = ("numpy", "scipy", "pyvisa", "pyvisa-py", "pyserial")


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
