"""How long `gyrolock runs` takes for many runs: python -m benchmarks.catalogue [--runs 10000].

Copies of one saved run, each in a folder of its own, are listed without an index, with it, after a few changed,
and from a folder in which nothing may be written.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from station.catalogue import INDEX_FILE, list_runs
from station.runs.annotations import add_remark
from station.terminal import say

RUN = Path(__file__).parents[2] / "tests" / "golden" / "turning.sqlite"
CHANGED = 20


def seconds(directory: Path, expected: int) -> float:
    """Time of one list."""
    began = time.perf_counter()
    found = len(list_runs(directory))
    assert found == expected
    return time.perf_counter() - began


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10_000)
    count = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        for number in range(count):
            folder = directory / f"{number // 1000:03d}" / f"{number:06d}"
            folder.mkdir(parents=True)
            shutil.copyfile(RUN, folder / "run.sqlite")
        time.sleep(2.5)  # younger files are looked at again
        say(f"{count} runs of {RUN.stat().st_size / 1e3:.0f} kB")
        say(f"no index:              {seconds(directory, count):7.2f} s")
        say(f"with index:            {seconds(directory, count):7.2f} s")
        for number in range(CHANGED):
            add_remark(directory / "000" / f"{number:06d}" / "run.sqlite", note="seen", by="benchmark")
        say(f"{CHANGED} of them changed:    {seconds(directory, count):7.2f} s")
        time.sleep(2.5)
        seconds(directory, count)
        size = os.path.getsize(directory / INDEX_FILE)
        say(f"size of the index:     {size / 1e6:7.2f} MB")
        for arguments in ([], ["--json"], ["--verdict", "FAIL"]):
            began = time.perf_counter()
            command = [sys.executable, "-m", "station.cli", "runs", name, *arguments]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            say(f"gyrolock runs {' '.join(arguments):16}{time.perf_counter() - began:7.2f} s")


if __name__ == "__main__":
    main()
