"""Export as a call."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable

from station.datasets.writing import Exported, check_target
from station.datasets.writing import export as write
from station.sources import find_sources, open_source

PathLike = str | os.PathLike[str]


def export(paths: PathLike | Iterable[PathLike], to: PathLike, *, replace: bool = False) -> Exported:
    """Write the records of runs and files to a data set, as the command ``gyrolock export`` does.

    Parameters
    ----------
    paths : path or iterable of path
        Runs, files of an oscilloscope, data sets, folders of them; a `Run` of :func:`open_run` is one too.
    to : path
        Its ending says the format: ``.parquet``, ``.h5``, ``.npz``, ``.csv``; with ``/`` at its end a folder of
        Parquet parts.
    replace : bool, optional
        Write over what is there.

    Returns
    -------
    Exported
        Files, number of records and sources, and what was left out: a warning names that too.

    Raises
    ------
    UsageError, CannotWrite
        It cannot be written there, or there is no record.
    """
    target = os.fspath(to)
    check_target(target, replace=replace)
    given = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    found = find_sources([os.fspath(one) for one in given])
    done = write((open_source(one) for one in found), target)
    for one in done.left_out:
        warnings.warn(f"left out: {one}", RuntimeWarning, stacklevel=2)
    return done
