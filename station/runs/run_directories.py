"""A new directory for each run, named by the time of day."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from station.errors import RunError


def new_run_directory(parent: Path) -> Path:
    """Make the directory of a new run below `parent`; two runs never share one.

    Parameters
    ----------
    parent : Path
        Directory of all runs; made if it is missing.

    Raises
    ------
    RunError
        If nothing can be written there.
    """
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H%M%SZ")
    for count in range(1, 10_000):
        directory = parent / f"{stamp}_{count:03d}"
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            if not parent.is_dir():
                raise RunError(f"{parent}: is not a directory, runs cannot be saved there") from None
            continue
        except OSError as error:
            raise RunError(f"{parent}: runs cannot be saved there ({error.strerror})") from None
        return directory
    raise RunError(f"{parent}: too many runs in one second")
