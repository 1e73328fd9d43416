"""`python -m benchmarks.fibre_gyro.long_log`: a log of many rows through `gyrolock fog allan`, in time and memory.

A gyro of 4 kHz with N = 0.005 deg/sqrt(h) and a random walk, made here, one row in two thousand lost; 345.6
million rows are a day. Printed: rows a second, beside what `numpy.loadtxt` alone reads, peak memory, and N.
"""

from __future__ import annotations

import argparse
import io
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERTZ, N, K = 4000.0, 0.005 / 60, 2e-6
BLOCK = 1 << 20
COMMAND = "import sys; from station.cli import main; sys.exit(main())"


def write(path: Path, rows: int) -> None:
    """Write the log, block by block."""
    rng, level = np.random.default_rng(1), 1e-3
    with path.open("w") as out:
        out.write("time_s,gyro (deg/s),temperature\n")
        for begin in range(0, rows, BLOCK):
            size = min(BLOCK, rows - begin)
            walk = level + np.cumsum(rng.standard_normal(size)) * K / HERTZ**0.5
            level = float(walk[-1])
            rate = walk + N * HERTZ**0.5 * rng.standard_normal(size)
            kept = rng.random(size) >= 5e-4
            at = (begin + np.arange(size)) / HERTZ
            out.writelines(f"{t:.5f},{w:.6f},25.0\n" for t, w in zip(at[kept], rate[kept], strict=True))


def plain_rows_per_s(path: Path) -> float:
    """Rows that NumPy reads a second, without a question what they are."""
    with path.open() as log:
        text = "".join([log.readline(), *(log.readline() for _ in range(500_000))])
    began = time.perf_counter()
    read = np.loadtxt(io.StringIO(text), delimiter=",", skiprows=1)
    return len(read) / (time.perf_counter() - began)


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; 0 if the memory stays below 1 GB and N is right."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fibre_gyro.long_log", description=__doc__)
    parser.add_argument("--rows", type=float, default=2e7)
    rows = int(parser.parse_args(arguments).rows)
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.csv"
        write(log, rows)
        plain, began = plain_rows_per_s(log), time.perf_counter()
        told = subprocess.run(
            [sys.executable, "-c", COMMAND, "fog", "allan", str(log), "--out", folder, "--json"],
            capture_output=True, check=True, text=True,
        )  # fmt: skip
        seconds = time.perf_counter() - began
    found = json.loads(told.stdout)
    walk, u = (found[f"angle_random_walk_deg_per_sqrt_h{end}"] for end in ("", "_u"))
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6
    off = (walk - 60 * N) / u
    sys.stdout.write(
        f"{rows} rows in {seconds:.0f} s: {rows / seconds:.0f} a second (evaluation and report included), "
        f"{rows / seconds / plain:.2f} of what numpy.loadtxt alone reads\npeak memory {peak:.2f} GB\n"
        f"N = {walk:.6f}({u:.6f}) deg/sqrt(h), {off:+.1f} u from the truth\n"
    )
    return 0 if peak < 1.0 and abs(off) < 4 else 1


if __name__ == "__main__":
    sys.exit(main())
