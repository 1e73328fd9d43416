"""Short forms of the benchmarks that let system calls fail, kill the program, and damage files."""

import os
import subprocess
import sys

import pytest

from benchmarks import kills
from benchmarks.damage import fuzz_files

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(kills.__file__)))


@pytest.mark.slow
def test_a_system_call_that_fails_loses_nothing() -> None:
    """Some of all calls; `python -m benchmarks.damage.inside_faults` lets every one fail."""
    command = [sys.executable, "-m", "benchmarks.damage.inside_faults", "--first", "5", "--step", "29"]
    command += ["--seconds", "4"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    if done.returncode == 77:
        pytest.skip(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
    assert int(done.stdout.split()[0]) >= 2


@pytest.mark.skipif(os.name != "posix", reason="this system has no SIGKILL")
def test_kill_9_loses_no_acknowledged_record() -> None:
    """In a process of its own: it forks."""
    command = [sys.executable, "-m", "benchmarks.kills", "--count", "2", "--seed", "5"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are those of Linux")
@pytest.mark.parametrize(
    ("kind", "count"), [("csv", 60), ("isf", 150), ("logs", 400), ("toml", 80), ("runs", 40), ("commands", 60)]
)
def test_a_damaged_file_is_read_or_refused(kind: str, count: int) -> None:
    """In a process of its own: it limits its memory."""
    code = f"from benchmarks.damage import fuzz_files as f; print(f.try_files({kind!r}, {count}, 3).failures)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=200)
    assert done.stdout == "[]\n", done.stdout + done.stderr
    assert fuzz_files.COUNTS[kind] > count
