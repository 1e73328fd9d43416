"""One piece of work of this benchmark, in a process of its own: prints what it took, as JSON."""

from __future__ import annotations

import json
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.reanalysis.records import (
    INTERVAL,
    SAMPLES,
    SCALE_FACTOR,
    codes_of_beats,
    make_runs,
    make_runs_at_rates,
    make_runs_of_bench,
)

IN_MEMORY, AT_ONCE = 5000, 1000


def main(mode: str, folder: Path, records: int, processes: int) -> None:
    """Do a piece of work: ``estimates``, ``table``, ``result``, ``combined``, or what makes records.

    ``make``, ``make at rates`` and ``make of bench`` take for `processes` the records of a run; ``combined at
    rates`` knows the rates of the runs from the file beside the folder.
    """
    making = {"make": make_runs, "make at rates": make_runs_at_rates, "make of bench": make_runs_of_bench}
    if mode in making:
        making[mode](folder, records, processes)
        processes = 1
    began = _begin()
    if mode == "estimates":
        began = _estimates(records)
    elif mode not in making:
        began = _analysis(mode, folder, processes)
    now = _begin()
    own, others = (
        resource.getrusage(who).ru_maxrss / 1e3 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    spent = dict(zip(("wall_s", "own_s", "others_s"), np.subtract(now, began).tolist(), strict=True))
    from station.terminal import say

    say(json.dumps({**spent, "peak_mb": own, "worker_mb": others if processes > 1 else 0.0}))


def _begin() -> tuple[float, float, float]:
    """The clock, and processor time of this process and of those that it started."""
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return time.perf_counter(), *(one.ru_utime + one.ru_stime for one in both)


def _estimates(records: int) -> tuple[float, float, float]:
    """Estimate so many records that lie in memory as volts: more of them than a processor's cache holds."""
    from analysis import estimate_lock_in

    volts = 0.02 * codes_of_beats(IN_MEMORY, 1).astype(np.float64)
    clipped = np.zeros(volts.shape, dtype=bool)
    estimate_lock_in(volts[:2], INTERVAL, scale_factor=SCALE_FACTOR)  # what is made once
    began = _begin()
    for number in range(max(1, records // AT_ONCE)):
        some = slice(number * AT_ONCE % IN_MEMORY, number * AT_ONCE % IN_MEMORY + AT_ONCE)
        estimate_lock_in(
            volts[some], INTERVAL, scale_factor=SCALE_FACTOR, clipped=clipped[some], nan_policy="omit"
        )
    return began


def _analysis(mode: str, folder: Path, processes: int) -> tuple[float, float, float]:
    """Analyse what is saved in a folder, as the command does; imports are not counted."""
    import station.lock_in.measurement  # noqa: F401
    import station.reanalysis.parquet_table  # noqa: F401
    from analysis import estimate_lock_in
    from station.live.events import Progress
    from station.reanalysis.analyze_table import fill_table
    from station.reanalysis.combine import combine
    from station.shell.finish import evaluate_saved
    from station.sources.find import find_sources
    from station.sources.workers import Processes

    estimate_lock_in(np.zeros((2, SAMPLES)), INTERVAL, scale_factor=SCALE_FACTOR)  # what is made once
    began, quiet = _begin(), Progress()
    with Processes(processes) as workers:
        if mode == "table":
            with tempfile.TemporaryDirectory() as place:
                fill_table(find_sources([folder]), Path(place) / "results.parquet", {}, workers, quiet)
        elif mode.startswith("combined"):
            rates = folder.parent / "rates.csv" if mode == "combined at rates" else None
            combine(find_sources([folder]), {}, workers, quiet, rates=rates).document()
        else:
            (run,) = find_sources([folder])
            evaluate_saved(run, workers, quiet, config=None, choices={}).document()
    return began


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), *map(int, sys.argv[3:]))
