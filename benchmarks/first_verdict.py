"""`python -m benchmarks.first_verdict`: from a clone to the first verdict, as a new user comes to it.

It clones this repository, takes the commands out of `docs/first_measurement.md` as they stand there, carries them
out in a shell, one after the other, and prints how long each took. Packages come from where pip is set up to find
them. It ends with 1 where a command fails. The part on an oscilloscope of one's own is left out.
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
_DONE = "--done--"


def commands(guide: str) -> Iterator[tuple[str, str]]:
    """Give every command of the guide with the heading that it stands under."""
    heading = ""
    for line in guide.partition(OWN_OSCILLOSCOPE)[0].splitlines():
        if line.startswith("## "):
            heading = re.sub(r"^## \d+\. | \(.*\)$", "", line)
        elif line.startswith("    "):
            yield heading, line.strip()


class Shell:
    """One shell, in which a user types one command after the other."""

    def __init__(self, folder: Path) -> None:
        environment = {
            name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")
        }
        self._process = subprocess.Popen(
            ["sh"],
            cwd=folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def run(self, command: str) -> tuple[int, str]:
        """Carry out a command that asks nothing; its exit code, and what it said."""
        stdin, stdout = self._process.stdin, self._process.stdout
        if stdin is None or stdout is None:
            raise OSError("the shell has no pipes")
        stdin.write(f"{command} </dev/null\necho {_DONE} $?\n")
        stdin.flush()
        said = []
        for line in stdout:
            if line.startswith(_DONE):
                return int(line.split()[1]), "".join(said)
            said.append(line)
        return 1, "".join(said)


def main(arguments: Sequence[str] | None = None) -> int:
    """Follow the guide; 1 if one of its commands does not do what it says."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args(
        arguments
    )
    out = sys.stdout.write
    with tempfile.TemporaryDirectory() as folder:
        clone, began = Path(folder) / "gyrolock", time.monotonic()
        subprocess.run(["git", "clone", "--quiet", str(HERE), str(clone)], check=True)
        shell = Shell(clone)
        out(f"{time.monotonic() - began:6.0f} s  git clone\n")
        for heading, command in commands((clone / GUIDE).read_text(encoding="utf-8")):
            started = time.monotonic()
            code, said = shell.run(command)
            now = time.monotonic()
            out(f"{now - began:6.0f} s  {command}  ({now - started:.0f} s; {heading})\n")
            sys.stdout.flush()
            if code:
                out(f"ended with {code}:\n{said}\n")
                return 1
        records = list(clone.glob("*/tests/RLG-001/*/record.html"))
        out(f"{time.monotonic() - began:6.0f} s in all, with {len(records)} record of a test\n")
    return int(len(records) != 1)


if __name__ == "__main__":
    sys.exit(main())
