"""`python -m benchmarks.fibre_gyro.random_logs --count 1000000`: random logs of gyros at the reader of logs.

Each log is drawn from what loggers write: separators, headers with units, comments, dates, epochs, counters,
decimal commas, rows lost, doubled, torn or out of order, a clock that is set, pauses, words that wrap, NUL, ERR,
nan. It must give a log with as many times as outputs, or one clear error, within 5 s.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from instrument import FileFormatError
from instrument.fibre_gyro import LogChoices, read_log
from station.live.console import PlainLines
from station.live.events import Events, Progress

LONGEST = 5.0  # s of work that one log may take
HEADERS = ("time", "t [s]", "time_ms", "timestamp", "date", "counter", "n", "")
OUTPUTS = ("counts", "gyro [deg/h]", "rate_dps", "omega (rad/s)", "angle [arcsec]", "counts_x", "y", "word")
EXTRAS = ("temperature [degC]", "temp_K", "status", "table_deg", "injected", "note")
SPOILT = ("", "ERR", "nan", "\x00", "1e999", "-", "NaN;", "#", '"', "1.2.3", "12:61:00", "0x1F", "é", "None")


def random_log(rng: np.random.Generator) -> str:
    """Draw one log."""
    rows = int(10 ** rng.uniform(0, 3.7 if rng.random() < 0.02 else 2.3))
    interval = float(10 ** rng.uniform(-3.5, 1.5))
    at = interval * np.arange(rows)
    if rng.random() < 0.4:
        at = at[rng.random(rows) > rng.choice([0.01, 0.1, 0.5])]
    if rng.random() < 0.3 and at.size > 2:
        row = int(rng.integers(1, at.size))
        at[row:] += interval * rng.choice([0.3, 0.5, -0.5, -3.0, 1e3, 1e6, -1e6, 1e12])
    if rng.random() < 0.1:
        at = np.repeat(at, rng.integers(1, 3, at.size))
    if rng.random() < 0.02:
        at = rng.permutation(at)
    at = np.abs(
        at
        + rng.choice([0.0, 0.0, 0.02, 0.2, 0.5], p=[0.3, 0.3, 0.2, 0.15, 0.05])
        * interval
        * rng.standard_normal(at.size)
    )
    if rng.random() < 0.5:
        step = float(rng.choice([1e-3, 1e-2, 0.1, 1.0]))
        at = step * np.round(at / step)
    words = rng.choice([0.0, 1e3, 1e7]) + rng.choice([0.0, 1.0, 300.0]) * rng.standard_normal(at.size)
    if rng.random() < 0.1:
        words = words % rng.choice([256, 65536, 2**24])
    columns = [stamps(rng, at), [f"{word:.{rng.integers(0, 8)}f}" for word in words]]
    columns += [[f"{20 + rng.standard_normal():.3f}"] * at.size for _ in range(rng.integers(0, 3))]
    names = [str(rng.choice(HEADERS)) if rng.random() < 0.3 else "time", str(rng.choice(OUTPUTS))]
    names += [str(rng.choice(EXTRAS)) for _ in columns[2:]]
    order = rng.permutation(len(columns)) if rng.random() < 0.2 else range(len(columns))
    between = str(rng.choice([",", ",", ";", ";", "\t", "\t", ", ", " ", "|"]))
    lines = [between.join(columns[place][row] for place in order) for row in range(at.size)]
    if rng.random() < 0.7:
        lines.insert(0, between.join(names[place] for place in order))
    if rng.random() < 0.3:
        lines[:0] = ["# a comment", "", "serial 12; made by hand"][: rng.integers(1, 4)]
    for _ in range(rng.integers(0, 4) if rng.random() < 0.4 else 0):
        row = int(rng.integers(0, len(lines) + 1))
        lines.insert(row, str(rng.choice([*SPOILT, lines[0] if lines else "", lines[-1][:3] if lines else ""])))
    text = str(rng.choice(["\n", "\n", "\r\n", "\r"])).join(lines)
    if rng.random() < (0.4 if between in (";", "\t") else 0.03):
        text = text.replace(".", ",")
    if rng.random() < 0.05:
        text = text[: int(rng.integers(0, len(text) + 1))]
    return text


def stamps(rng: np.random.Generator, at: np.ndarray) -> list[str]:
    """Times as one of the spellings that loggers have."""
    kind = int(rng.integers(0, 7))
    begin = datetime(2026, 3, 4, 23, 59, 50)
    if kind == 0:
        return [str((begin + timedelta(seconds=float(min(one, 1e9)))).isoformat(" ")) for one in at]
    if kind == 1:
        return [(begin + timedelta(seconds=float(min(one, 1e9)))).strftime("%H:%M:%S.%f")[:-3] for one in at]
    if kind == 2:
        return [str(number % int(rng.choice([256, 65536, 10**9]))) for number in range(at.size)]
    scale, zero = ((1.0, 0.0), (1e3, 0.0), (1.0, 1.77e9), (1e3, 1.77e12))[kind - 3]
    return [f"{zero + scale * one:.{int(rng.integers(0, 7))}f}" for one in at]


def choices(rng: np.random.Generator) -> LogChoices:
    """What a user may say beside."""
    return LogChoices(
        interval_s=float(10 ** rng.uniform(-3, 1)) if rng.random() < 0.3 else None,
        skip_bad_rows=int(rng.choice([0, 3, 100])),
        units=str(rng.choice(["", "", "counts", "deg/h"])),
    )


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 1 if any log ended otherwise, or took too long."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fibre_gyro.random_logs", description=__doc__)
    parser.add_argument("--count", type=float, default=1e6)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args(arguments)
    ends, failures, longest, count = Counter[str](), list[str](), 0.0, int(chosen.count)
    progress = Progress(events := Events())
    events.read_by(PlainLines())
    progress.start("thousands of logs", count // 1000)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        for number in range(count):
            rng = np.random.default_rng([chosen.seed, number])
            text, given = random_log(rng), choices(rng)
            path.write_text(text, "utf-8", newline="")
            begin = time.process_time()
            try:
                log = read_log(path, given).rest
                ends["read"] += 1
                if not len(log.times) == len(log.counts) > 0 or not np.all(np.isfinite(log.times)):
                    failures.append(f"{number}: {len(log.times)} times and {len(log.counts)} outputs")
            except FileFormatError as error:
                ends["refused"] += 1
                if "\n" in str(error) or len(str(error)) > 400:
                    failures.append(f"{number}: {str(error)!r}")
            except Exception as error:
                failures.append(f"{number}: {type(error).__name__}: {error}")
            took = time.process_time() - begin
            longest = max(longest, took)
            if took > LONGEST:
                failures.append(f"{number}: took {took:.1f} s")
            if number % 1000 == 999:
                progress.advance()
    sys.stdout.write(
        f"{count} logs, seed {chosen.seed}: {ends['read']} read, {ends['refused']} refused with one error\n"
        f"longest {longest:.2f} s; ended otherwise or too late: {len(failures)}\n"
    )
    sys.stdout.writelines(f"    {failure}\n" for failure in failures[:20])
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
