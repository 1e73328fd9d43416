"""`python -m benchmarks.panel`: what the panel costs, beside the same measurement without it.

A process writes the events of a measurement, ten records a second with their fits, to a job of the panel; ten
readers take its events. Printed: the panel's share of a core, how many events came one by one, how long a first
page and a list of ten thousand runs take, memory and open files after reconnects, and whether a thousand
connections that say nothing stop a reader; and the time of a measurement with ten readers over that without them.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

READERS, EACH_S = 10, 0.1
PROGRAM = [sys.executable, "-m", "station.cli"]


@contextmanager
def panel(folder: Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Run a panel; its address and process."""
    process = subprocess.Popen(
        [*PROGRAM, "panel", str(folder), "--port", "0", "--json"], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        yield json.loads(process.stdout.readline())["control"], process
    finally:
        process.terminate()
        process.wait()


class Reader:
    """Somebody who has the page open."""

    def __init__(self, address: str) -> None:
        place = urlsplit(address)
        self.host, self.cookies = place.netloc, ""
        answer = self.ask(f"/?{place.query}")
        self.cookies = "; ".join(
            value.partition(";")[0] for name, value in answer.getheaders() if name == "set-cookie"
        )
        answer.read()

    def ask(self, path: str) -> http.client.HTTPResponse:
        """Ask for a page."""
        connection = http.client.HTTPConnection(self.host, timeout=60)
        connection.request("GET", path, headers={"Cookie": self.cookies})
        return connection.getresponse()

    def follow(self, job: str, until: threading.Event, late: list[float], began: float) -> None:
        """Take events; how late each record came."""
        answer = self.ask(f"/events?job={job}")
        while not until.is_set():
            line = answer.readline()
            if line.startswith(b"data: ") and b'"key": "record ' in line:
                number = int(json.loads(line[6:])["trace"]["key"].split()[1])
                late.append(time.monotonic() - began - number * EACH_S)


def job_that_is_written(folder: Path, seconds: float, began: float) -> None:
    """Write the events of a measurement as it would."""
    time_axis = np.arange(240)
    with (folder / "events.ndjson").open("a", encoding="utf-8") as file:
        for number in range(int(seconds / EACH_S)):
            time.sleep(max(0.0, began + number * EACH_S - time.monotonic()))
            samples = np.sin(0.1 * time_axis + number).round(4).tolist()
            values = [
                {
                    "name": "lock_in_rate_dps",
                    "value": 0.01,
                    "u": 1e-4,
                    "text": f"0.0100({number}) deg/s",
                    "records": 1,
                }
            ]
            value = {"key": f"record {number}", "group": "", "values": values, "running": values, "flags": []}
            value["trace"] = {"seconds": 0.1, "unit": "V", "samples": samples, "fit": samples}
            head = {"counter": number + 1, "event": "value", "at": "2026-01-01T00:00:00Z"}
            file.write(json.dumps({**head, **value}) + "\n")
            file.flush()


def cpu_s(process: subprocess.Popen[str]) -> float:
    """Processor time that a process has taken."""
    fields = Path(f"/proc/{process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_and_files(process: subprocess.Popen[str]) -> tuple[float, int]:
    """Memory, MB, and open files of a process."""
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
    size = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))
    return size / 1024, len(list(Path(f"/proc/{process.pid}/fd").iterdir()))


def readers(folder: Path, seconds: float) -> list[str]:
    """Ten readers of ten records a second."""
    with panel(folder) as (address, process):
        began, job = time.monotonic(), folder / ".gyrolock-panel" / "jobs" / "2026-01-01T000000-000000"
        job.mkdir(parents=True)
        (job / "words.json").write_text('["measure"]', encoding="utf-8")
        (job / "pid").write_text(str(os.getpid()), encoding="utf-8")
        first = time.monotonic()
        reader = Reader(address)
        page = time.monotonic() - first
        until, late = threading.Event(), list[float]()
        threads = [
            threading.Thread(target=Reader(address).follow, args=(job.name, until, late, began), daemon=True)
            for _ in range(READERS)
        ]
        for one in threads:
            one.start()
        before, at = cpu_s(process), time.monotonic()
        began_writing = time.monotonic()
        late_offset = began_writing - began
        job_that_is_written(job, seconds, began_writing)
        share = (cpu_s(process) - before) / (time.monotonic() - at)
        time.sleep(0.5)
        expected = int(seconds / EACH_S) * READERS
        lines = [
            f"{READERS} readers, {1 / EACH_S:g} records a second: {100 * share:.1f} % of a core; of {expected} "
            f"events {100 * len(late) / expected:.1f} % told one by one, "
            f"{1e3 * statistics.median(one - late_offset for one in late):.0f} ms behind in the median",
            f"first page {page:.2f} s",
        ]
        silent = [socket.create_connection(tuple(urlsplit(address).netloc.split(":"))) for _ in range(1000)]  # type: ignore[arg-type]
        begin = time.monotonic()
        reader.ask("/").read()
        lines.append(f"beside 1000 connections that say nothing: a page in {time.monotonic() - begin:.2f} s")
        until.set()
        for one_socket in silent:
            one_socket.close()
        time.sleep(1.0)
        start = memory_and_files(process)
        for _ in range(2000):
            answer = reader.ask(f"/events?job={job.name}")
            answer.readline()
            answer.close()
        time.sleep(3.0)
        end = memory_and_files(process)
        lines.append(
            f"2000 reconnects: memory {start[0]:.0f} -> {end[0]:.0f} MB, open files {start[1]} -> {end[1]}"
        )
    return lines


def many_runs(folder: Path, count: int) -> list[str]:
    """A list of so many runs."""
    words = [*PROGRAM, "measure", "--records", "2", "--rates", "8", "--quiet", "--no-report"]
    subprocess.run(words, cwd=folder, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    (run,) = (folder / "runs").iterdir()
    for number in range(count):
        shutil.copytree(run, folder / "runs" / f"copy-{number:05d}", copy_function=os.link)
    with panel(folder) as (address, _):
        reader, took = Reader(address), []
        for path in ("/runs", "/runs?q=copy-00", "/runs?verdict=FAIL", "/runs"):
            begin = time.monotonic()
            reader.ask(path).read()
            took.append(time.monotonic() - begin)
            time.sleep(2.5)  # what is known of the folder is then old
    return [f"{count} runs: first {took[0]:.1f} s, then {', '.join(f'{one:.2f}' for one in took[1:])} s"]


def measurement(folder: Path, *, watched: bool) -> float:
    """Time of a measurement, with ten readers of a panel or without one."""
    words = [*PROGRAM, "measure", "--records", "40", "--quiet", "--no-report"]
    begin = time.monotonic()
    if not watched:
        words += ["--events", "events.ndjson"]
        subprocess.run(words, cwd=folder, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return time.monotonic() - begin
    with panel(folder) as (address, _):
        job = folder / ".gyrolock-panel" / "jobs" / f"2026-01-01T0000{time.monotonic_ns() % 100:02d}-000000"
        job.mkdir(parents=True, exist_ok=True)
        (job / "words.json").write_text('["measure"]', encoding="utf-8")
        (job / "pid").write_text(str(os.getpid()), encoding="utf-8")
        until = threading.Event()
        for _ in range(READERS):
            follow = Reader(address).follow
            threading.Thread(target=follow, args=(job.name, until, [], 0.0), daemon=True).start()
        begin = time.monotonic()
        words += ["--events", str(job / "events.ndjson")]
        subprocess.run(words, cwd=folder, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        took = time.monotonic() - begin
        until.set()
    return took


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.panel", description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--pairs", type=int, default=3)
    chosen = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        lines = readers(Path(folder), chosen.seconds)
    with tempfile.TemporaryDirectory() as folder:
        lines += many_runs(Path(folder), chosen.runs)
    ratios = []
    for _ in range(chosen.pairs):
        with tempfile.TemporaryDirectory() as folder:
            alone = measurement(Path(folder), watched=False)
            ratios.append(measurement(Path(folder), watched=True) / alone)
    lines.append(
        f"a measurement with {READERS} readers over one without the panel: {statistics.median(ratios):.2f}"
    )
    sys.stdout.writelines(f"{line}\n" for line in lines)
    return 0


if __name__ == "__main__":
    sys.exit(main())
