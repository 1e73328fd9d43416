"""`python -m benchmarks.outages`: a scope that goes away in the middle of a measurement and comes back.

`gyrolock simulate` and `gyrolock measure` run as processes of their own. After the tenth acknowledged record the
server is killed and started again, as a scope that is switched off and on; or its cable is pulled; or it hangs; or
the serial line is gone and comes back under its name. The run must go on to its full count, by itself.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.links.fault_proxy import FaultProxy
from instrument import Tally
from station.runs.store import open_run

COMMAND = [sys.executable, "-m", "station.cli"]
OUTAGES = {"server killed": 20.0, "cable pulled": 60.0, "hang": 30.0, "serial line gone": 20.0}
"""What happens, and for how many seconds."""

STRIKE_AFTER, RECORDS = 10, 40
LINE = "line"
"""Name of the serial line, as udev gives one that stays."""


@dataclass(frozen=True)
class Ended:
    """How the measurement ended."""

    exit_code: int
    records: int
    intact: bool
    complete: bool
    link: Tally
    seconds: float
    said: str


class ServedScope:
    """`gyrolock simulate` in a process of its own, which can be killed and started again."""

    def __init__(self, folder: Path, *where: str) -> None:
        self._folder, self._where = folder, where
        self.start()

    def start(self) -> None:
        """Start it; `resource` is its name."""
        command = [*COMMAND, "simulate", *self._where]
        self.process = subprocess.Popen(command, cwd=self._folder, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.resource = self.process.stdout.readline().strip()

    def start_at(self, port: int) -> None:
        """Start it again on the port that it had."""
        self._where = ("--tcp", str(port))
        self.start()

    def kill(self) -> None:
        """End it as a mains switch would."""
        self.process.kill()
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()

    @property
    def port(self) -> int:
        """Of its TCP server."""
        return int(self.resource.split("::")[2])

    def link_line(self) -> str:
        """Let the name that stays lead to its serial line; returns the resource name."""
        device = self.resource.removeprefix("ASRL").removesuffix("::INSTR")
        name = self._folder / LINE
        name.unlink(missing_ok=True)
        name.symlink_to(device)
        return f"ASRL{name}::INSTR"


@contextmanager
def served(folder: Path, outage: str) -> Iterator[tuple[ServedScope, FaultProxy | None]]:
    """Serve a scope, behind a proxy where its cable is to be pulled."""
    scope = ServedScope(folder, *(("--pty",) if outage == "serial line gone" else ("--tcp", "0")))
    try:
        if outage == "cable pulled":
            with FaultProxy(scope.port, 0.0) as proxy:
                yield scope, proxy
        else:
            yield scope, None
    finally:
        scope.kill()


def strike(outage: str, seconds: float, scope: ServedScope, proxy: FaultProxy | None) -> None:
    """Let it happen, wait, and mend it."""
    if outage == "hang":
        os.kill(scope.process.pid, signal.SIGSTOP)
        time.sleep(seconds)
        os.kill(scope.process.pid, signal.SIGCONT)
    elif proxy is not None:
        proxy.unplugged = True
        time.sleep(seconds)
        proxy.unplugged = False
    else:
        port = 0 if outage == "serial line gone" else scope.port
        scope.kill()
        time.sleep(seconds)
        if port:
            scope.start_at(port)
        else:
            scope.start()
            scope.link_line()


def measure(outage: str, seconds: float, *, records: int = RECORDS) -> Ended:
    """Take one run, and let the outage happen in its middle."""
    with tempfile.TemporaryDirectory() as name, served(Path(name), outage) as (scope, proxy):
        resource = scope.link_line() if outage == "serial line gone" else scope.resource
        resource = resource if proxy is None else proxy.resource_name
        wanted = ["--resource", resource, "--scale-factor", "2000", "--records", str(records)]
        began, acknowledged = time.perf_counter(), 0
        with (
            (Path(name) / "said").open("w") as said,
            subprocess.Popen(
                [*COMMAND, "measure", *wanted, "--no-report", "--jsonl"],
                cwd=name,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=said,
                text=True,
            ) as process,
        ):
            assert process.stdout is not None
            for line in process.stdout:
                acknowledged += "key" in json.loads(line)
                if acknowledged == STRIKE_AFTER:
                    strike(outage, seconds, scope, proxy)
        text = (Path(name) / "said").read_text()
        found = list(Path(name).glob("runs/*/run.sqlite"))
        if not found:
            return Ended(process.returncode, 0, False, False, Tally(), time.perf_counter() - began, text)
        run = open_run(found[0])
        return Ended(
            exit_code=process.returncode,
            records=len(run.taken_for("measure")),
            intact=all(record.intact for record in run.records),
            complete=run.facts.complete,
            link=run.facts.link_faults or Tally(),
            seconds=time.perf_counter() - began,
            said=text,
        )


def main(arguments: list[str] | None = None) -> int:
    """Let every outage happen once, print how each run ended, and return 0 if all are complete."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.outages", description=__doc__)
    parser.add_argument("--records", type=int, default=RECORDS)
    options = parser.parse_args(arguments)
    good = True
    for outage, seconds in OUTAGES.items():
        ended = measure(outage, seconds, records=options.records)
        fine = ended.complete and ended.intact and ended.records == options.records
        good &= fine
        sys.stdout.write(
            f"{outage} for {seconds:g} s: {'complete' if fine else ended.said.strip()[-300:]}, {ended.records} "
            f"records, exit {ended.exit_code}; {ended.link}; {ended.seconds:.0f} s\n"
        )
        sys.stdout.flush()
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
