"""`python -m benchmarks.first_verdict`: from a clone to the first verdict as a new user comes to it, by the guide alone.

It clones this repository, takes the commands out of `docs/first_measurement.md` as they stand there, carries them out in a
shell, one after the other, and prints how long each took. Packages come from where pip is set up to find them. A command
that ends with another exit code than the guide leads one to expect ends it with 1. The part on an oscilloscope of one's own
is left out.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

HERE = Path(__file__).parents[1]
GUIDE = "docs/first_measurement.md"
OWN_OSCILLOSCOPE = "## 5."


def commands(guide: str) -> Iterator[tuple[str, str]]:
    """Give every command of the guide with the heading that it stands under."""
    heading = ""
    for line in guide.partition(OWN_OSCILLOSCOPE)[0].splitlines():
        if line.startswith("## "):
            heading = re.sub(r"^## \d+\. | \(.*\)$", "", line)
        elif line.startswith("    "):
            yield heading, line.strip()


def main(arguments: Sequence[str] | None = None) -> int:
    """Follow the guide; 1 if one of its commands does not do what it says."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args(
        arguments
    )
    out = sys.stdout.write
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    with tempfile.TemporaryDirectory() as folder:
        clone, began = Path(folder) / "gyrolock", time.monotonic()
        subprocess.run(["git", "clone", "--quiet", str(HERE), str(clone)], check=True)
        out(f"{time.monotonic() - began:6.0f} s  git clone\n")
        for heading, command in commands((clone / GUIDE).read_text(encoding="utf-8")):
            started = time.monotonic()
            done = subprocess.run(command, shell=True, cwd=clone, env=environment, capture_output=True, text=True)
            now = time.monotonic()
            out(f"{now - began:6.0f} s  {command}  ({now - started:.0f} s; {heading})\n")
            sys.stdout.flush()
            if done.returncode:
                out(f"ended with {done.returncode}:\n{done.stdout}{done.stderr}\n")
                return 1
        records = list(clone.glob("tests/RLG-001/*/record.html"))
        out(f"{time.monotonic() - began:6.0f} s in all, with {len(records)} record of a test\n")
    return int(len(records) != 1)


if __name__ == "__main__":
    sys.exit(main())
