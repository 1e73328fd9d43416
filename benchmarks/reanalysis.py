"""What analysing saved records again costs: records per second, memory, and the ratio to the estimates alone.

    python -m benchmarks.reanalysis                  # 10 000 and 100 000 records, of one run and of many
    python -m benchmarks.reanalysis --records 1000000

Every figure is of a process of its own. The ratio is that of processor times, so that other programs on the
machine do not spoil it: of `gyrolock analyze --to` (reading, checking, estimating, writing rows) over the
estimates of as many records that lie in memory as volts.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

SAMPLES, INTERVAL, SCALE_FACTOR = 2500, 2e-5, 2000.0
PER_RUN = 100
HEADER = (
    '1;8;BIN;RI;MSB;2500;"Ch1, DC coupling, 5.0E-1 V/div, 5.0E-3 s/div, 2500 points, Sample mode";Y;2.0E-5;0;'
    '-2.5E-2;"s";2.0E-2;0.0E0;0.0E0;"Volts"'
)
MODES = ("make", "estimates", "table", "result")


def codes_of_beats(count: int, seed: int) -> np.ndarray:
    """Codes (count, 2500) of beats with the noise of a scope; 200 waveforms, each time with other noise."""
    from analysis import beat_signal

    rng = np.random.default_rng(seed)
    times = np.arange(SAMPLES) * INTERVAL
    beats = np.array(
        [
            beat_signal(
                times,
                scale_factor=SCALE_FACTOR,
                input_rate=0.3 * (1 + 0.01 * rng.random()),
                lock_in_rate=0.02 * (1 + 0.05 * rng.standard_normal()),
                initial_phase=2 * math.pi * rng.random(),
            )
            for _ in range(200)
        ]
    )
    noise = 1.2 * rng.standard_normal((count, SAMPLES), dtype=np.float32)
    return np.rint(90 * beats[rng.integers(0, len(beats), count)] + noise).astype(np.int8)


def make_runs(folder: Path, records: int, per_run: int) -> None:
    """Save so many records as runs of the lock-in measurement."""
    from station.lock_in.settings import RING_LASER
    from station.runs.store import NewRecord, RunWriter
    from station.settings.load import load

    settings = load(RING_LASER, overrides={"gyro": {"scale_factor_pulses_per_deg": SCALE_FACTOR}})
    facts = {"command": "measure", "settings": settings.model_dump(mode="json"), "unit": "SN 1", "simulated": True}
    for first in range(0, records, per_run):
        with RunWriter.create(folder, facts) as writer:
            for begin in range(first, min(first + per_run, records), 2000):
                count = min(2000, first + per_run - begin)
                codes = codes_of_beats(count, begin)
                new = [
                    NewRecord(f"measure, {begin + n}", "measure", HEADER, one.tobytes(), {"channel": "CH1"})
                    for n, one in enumerate(codes, start=1)
                ]
                writer.save_records(new)


def work(mode: str, folder: Path, records: int, processes: int) -> None:
    """Do one piece of work and print what it took as JSON."""
    if mode == "make":
        make_runs(folder, records, processes)
        print(json.dumps({}))  # noqa: T201
        return
    import station.lock_in.measurement  # noqa: F401  # imports are not counted
    import station.reanalysis.tables.parquet  # noqa: F401
    from analysis import estimate_lock_in
    from station.reanalysis.fill import fill_table
    from station.runs.progress import Progress
    from station.shell.evaluated import evaluate_saved
    from station.sources.find import find_sources
    from station.sources.workers import Processes

    found: dict[str, Any] = {}
    estimate_lock_in(np.zeros((2, SAMPLES)), INTERVAL, scale_factor=SCALE_FACTOR)  # what is made once
    begin, cpu = time.perf_counter(), _cpu()
    if mode == "estimates":
        volts = 0.02 * codes_of_beats(1000, 1).astype(np.float64)
        clipped = np.zeros(volts.shape, dtype=bool)
        begin, cpu = time.perf_counter(), _cpu()
        for _ in range(max(1, records // 1000)):
            estimate_lock_in(volts, INTERVAL, scale_factor=SCALE_FACTOR, clipped=clipped, nan_policy="omit")
    elif mode == "table":
        with tempfile.TemporaryDirectory() as place, Processes(processes) as workers:
            table = Path(place) / "results.parquet"
            found["records"] = fill_table(find_sources([folder]), table, {}, workers, Progress(quiet=True)).records
    else:
        (run,) = find_sources([folder])
        with Processes(processes) as workers:
            shown = evaluate_saved(run, workers, Progress(quiet=True), config=None, choices={})
        found["records"] = shown.document()["records"]
    found |= {"wall_s": time.perf_counter() - begin, "cpu_s": _cpu() - cpu}
    own, others = (
        resource.getrusage(who).ru_maxrss / 1e3 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    print(json.dumps(found | {"peak_mb": own, "peak_of_a_worker_mb": others if processes > 1 else 0.0}))  # noqa: T201


def _cpu() -> float:
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in both)


def measured(mode: str, folder: Path, records: int, processes: int = 1) -> dict[str, float]:
    """The same in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.reanalysis", "--work", mode, "--folder", str(folder)]
    command += ["--records", str(records), "--processes", str(processes)]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    read: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return read


def report(records: int) -> None:
    """Print the figures for so many records."""
    head = f"{'':34}{'records/s':>10}{'CPU us each':>13}{'ratio':>7}{'peak MB':>9}{'worker MB':>11}"
    print(f"\n{records} records\n{head}")  # noqa: T201
    alone = measured("estimates", Path(), records)
    each = 1e6 * alone["cpu_s"] / records
    _line("estimates alone", alone, records, each)
    for name, per_run in (("one run", records), (f"runs of {PER_RUN}", PER_RUN)):
        with tempfile.TemporaryDirectory() as place:
            # by another process: the memory that one begins with counts in its peak
            measured("make", Path(place), records, per_run)
            for processes in (1, 2):
                done = measured("table", Path(place), records, processes)
                _line(f"{name} to a table, {processes} process{'es' * (processes > 1)}", done, records, each)
            if per_run == records:
                _line("one run, its result", measured("result", Path(place), records), records, each)


def _line(name: str, done: dict[str, float], records: int, alone_us: float) -> None:
    cpu_us = 1e6 * done["cpu_s"] / records
    line = f"{name:34}{records / done['wall_s']:10.0f}{cpu_us:13.1f}{cpu_us / alone_us:7.2f}{done['peak_mb']:9.0f}"
    print(f"{line}{done['peak_of_a_worker_mb'] or math.nan:11.0f}".replace("nan", "   "))  # noqa: T201


def main() -> None:
    """Print the figures, or do one piece of work for them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--records", type=int)
    parser.add_argument("--work", choices=MODES)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args()
    if given.work:
        work(given.work, given.folder, given.records, given.processes)
        return
    for records in [given.records] if given.records else [10_000, 100_000]:
        report(records)


if __name__ == "__main__":
    main()
