"""What analysing saved records again costs: records per second, memory, and the ratio to the estimates alone.

    python -m benchmarks.reanalysis                      # 10 000 and 100 000 records, of one run and of many
    python -m benchmarks.reanalysis --records 1000000    # peak memory of `gyrolock analyze` too
    python -m benchmarks.reanalysis --several-rates      # runs at several rates, and the fit to all of them
    python -m benchmarks.reanalysis --bench              # records of the default bench, of which some move
    python -m benchmarks.reanalysis --records 40000 --pairs 3     # one process against two, in turn

Every figure is of a process of its own. The ratio is to estimating as many records that lie in memory as volts:
by the clock, and by processor time, which other programs on the machine spoil less. What only the first process
does of the work of two is the serial share: by Amdahl's law two processes are 2 / (1 + share) times as fast.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.reanalysis.records import PER_RUN
from station.terminal import say

MEMORY_FROM = 100_000
"""Records from which on the memory of the command itself is measured too."""


@dataclass(frozen=True)
class Spent:
    """What some work took: seconds by the clock, of the processor in this and in other processes, MB at most."""

    wall_s: float
    own_s: float
    others_s: float
    peak_mb: float
    worker_mb: float

    @property
    def cpu_s(self) -> float:
        """Of all processes."""
        return self.own_s + self.others_s


def measured(mode: str, folder: Path, records: int, processes: int = 1) -> Spent:
    """Do a piece of work in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.reanalysis.work", mode, str(folder), str(records), str(processes)]
    done = subprocess.run(command, capture_output=True, text=True, env=_environment(), check=True)
    return Spent(**json.loads(done.stdout.splitlines()[-1]))


def peak_of_command(*arguments: str) -> float:
    """MB that `gyrolock` with these arguments takes at most."""
    with tempfile.TemporaryFile() as nowhere:
        command = [sys.executable, "-m", "station.cli", *arguments]
        started = subprocess.Popen(command, stdout=nowhere, stderr=nowhere, env=_environment())
        _, status, used = os.wait4(started.pid, 0)
        started.returncode = os.waitstatus_to_exitcode(status)
        if started.returncode:
            nowhere.seek(0)
            raise SystemExit(f"gyrolock {' '.join(arguments)}: {nowhere.read().decode()[-500:]}")
    return used.ru_maxrss / 1e3


def report(records: int, *, several_rates: bool = False) -> None:
    """Print the figures for so many records, at one rate or at several."""
    at = " at rates" if several_rates else ""
    say(f"\n{records} records, load of the machine {os.getloadavg()[0]:.1f}")
    say(f"{'':38}{'records/s':>10}{'CPU us':>8}{'ratio: wall':>13}{'CPU':>6}{'peak MB':>9}{'worker':>8}")
    for name, per_run in ((f"one run{at}", records), (f"runs of {PER_RUN}{at}", PER_RUN)):
        with saved(records, per_run, "make at rates" if several_rates else "make") as folder:
            alone = measured("estimates", folder, min(records, 40_000))
            each = alone.wall_s / min(records, 40_000), alone.cpu_s / min(records, 40_000)
            _line("estimates alone", alone, min(records, 40_000), each)
            for processes in () if several_rates else (1, 2):
                words = f"{name} to a table, {processes} process{'es' * (processes > 1)}"
                _line(words, measured("table", folder, records, processes), records, each)
            result = "result" if per_run == records else f"combined{at}"
            _line(f"{name}, one result", measured(result, folder, records), records, each)
            if records >= MEMORY_FROM:
                _memory(name, folder, one=per_run == records, rates=folder.parent / "rates.csv")


def report_bench(records: int) -> None:
    """Print what records of the default bench cost, beside steady ones in memory."""
    say(f"\n{records} records of the default bench, load of the machine {os.getloadavg()[0]:.1f}")
    say(f"{'':38}{'records/s':>10}{'CPU us':>8}{'ratio: wall':>13}{'CPU':>6}{'peak MB':>9}{'worker':>8}")
    with saved(records, records, "make of bench") as folder:
        steady = min(records, 40_000)
        alone = measured("estimates", folder, steady)
        each = alone.wall_s / steady, alone.cpu_s / steady
        _line("estimates of steady records", alone, steady, each)
        for processes in (1, 2):
            words = f"to a table, {processes} process{'es' * (processes > 1)}"
            _line(words, measured("table", folder, records, processes), records, each)
        _line("one result", measured("result", folder, records), records, each)
        if records >= MEMORY_FROM:
            _memory("the run", folder, one=True, rates=Path("none"))


def _line(name: str, done: Spent, records: int, alone: tuple[float, float]) -> None:
    wall, cpu = done.wall_s / records, done.cpu_s / records
    worker = f"{done.worker_mb:8.0f}" if done.worker_mb else ""
    rest = f"{wall / alone[0]:13.2f}{cpu / alone[1]:6.2f}{done.peak_mb:9.0f}{worker}"
    say(f"{name:38}{1 / wall:10.0f}{1e6 * cpu:8.1f}{rest}")


def _memory(name: str, folder: Path, *, one: bool, rates: Path) -> None:
    """Memory of the command as a user types it; `rates`: of the runs, if that file is there."""
    table, report = folder / "results.parquet", folder / "report.html"
    run = next(folder.glob("*/run.sqlite"))
    result = (
        ["analyze", str(run), "--json"] if one else ["analyze", str(folder), "--combine", "--report", str(report)]
    )
    if rates.exists() and not one:
        result += ["--rates-from", str(rates)]
    told = {f"gyrolock analyze of {name}": result}
    told |= {"gyrolock report": ["report", str(run)]} if one else {}
    told |= {"gyrolock analyze --to": ["analyze", str(folder), "--to", str(table)]}
    for words, arguments in told.items():
        say(f"{words:38}{'':37}{peak_of_command(*arguments):9.0f}")


def pairs(records: int, count: int) -> None:
    """Print how much faster two processes are than one, measured in turn."""
    say(f"{records} records of one run, load of the machine {os.getloadavg()[0]:.1f}")
    say(f"{'':12}{'1 process':>12}{'2 processes':>13}{'times as fast':>15}{'serial share':>14}{'so at best':>12}")
    with saved(records, records) as folder:
        for mode in ("table", "result"):
            faster, shares = [], []
            for _ in range(count):
                one, two = (measured(mode, folder, records, processes) for processes in (1, 2))
                faster.append(one.wall_s / two.wall_s)
                shares.append(two.own_s / two.cpu_s)
                bound = 2 / (1 + shares[-1])
                line = f"{one.wall_s:10.2f} s{two.wall_s:11.2f} s{faster[-1]:15.2f}{shares[-1]:14.1%}{bound:12.2f}"
                say(f"{mode:12}{line}")
            say(f"{mode:12}median: {statistics.median(faster):.2f} times as fast, "
                  f"serial share {statistics.median(shares):.1%}")  # fmt: skip


@contextmanager
def saved(records: int, per_run: int, making: str = "make") -> Iterator[Path]:
    """A folder with so many records; made by another process, whose memory does not count."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "runs"
        folder.mkdir()
        measured(making, folder, records, per_run)
        yield folder


def _environment() -> dict[str, str]:
    return os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def main() -> None:
    """Print the figures that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--records", type=int)
    parser.add_argument("--pairs", type=int, default=0, help="compare one process with two so many times")
    parser.add_argument("--several-rates", action="store_true", help="runs at several rates")
    parser.add_argument("--bench", action="store_true", help="records of the default bench")
    given = parser.parse_args()
    if given.pairs:
        pairs(given.records or 40_000, given.pairs)
        return
    for records in [given.records] if given.records else [10_000, 100_000]:
        if given.bench:
            report_bench(records)
        else:
            report(records, several_rates=given.several_rates)


if __name__ == "__main__":
    main()
