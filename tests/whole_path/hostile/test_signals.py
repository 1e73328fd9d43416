"""Ctrl-C, SIGTERM, SIGHUP and a closed terminal: records kept, front panel put back, outcome saved, exit code."""

import json
import os
import pty
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import pyvisa

from station.runs.store import open_run

BENCH = "measurement = { records = 1, tilt_records = 1, rates_over_lock_in = [8.0], both_senses = false }\n"
BENCH += "table.both_senses = false\n"
GIVEN = ("--scale-factor", "2000", "--rates", 8, "--records", 10_000)
pytestmark = pytest.mark.skipif(os.name != "posix", reason="these signals are those of POSIX")


@pytest.fixture(autouse=True)
def settings_of_a_small_bench(tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text(BENCH)


def only_run(folder: Path) -> Path:
    (path,) = (folder / "runs").glob("*/run.sqlite")
    return path


@pytest.mark.parametrize(
    ("name", "code", "kind"),
    [
        pytest.param("SIGINT", 130, "interrupted", marks=pytest.mark.slow),  # as in test_failures
        ("SIGTERM", 143, "terminated"),
        pytest.param("SIGHUP", 129, "hung_up", marks=pytest.mark.slow),
    ],
)
def test_a_signal_ends_a_run_as_a_whole(tmp_path: Path, gyrolock, cut_gyrolock, name, code, kind) -> None:
    ended = cut_gyrolock(name, 1 + 3, "measure", "--config", "my.toml", "--records", 6, "--json")
    assert ended.code == code, ended.err
    assert ended.document["error"]["kind"] == kind
    assert ended.document["error"]["exit_code"] == code
    assert ended.document["records"] == 3
    assert ended.document["outcome"] == ended.document["error"]["message"]
    assert "--resume" in ended.err.splitlines()[-1]
    run = open_run(only_run(tmp_path))
    assert run.facts["outcome"]["kind"] == kind
    assert run.facts.ended_at is not None
    assert len(run.taken_for("measure")) == 3
    assert sorted(file.name for file in run.path.parent.iterdir()) == ["report.html", "run.sqlite"]
    if name == "SIGTERM":
        done = gyrolock("measure", "--resume", run.path, "--json", "--no-report")
        assert done.code == 0, done.err
        assert (done.document["records"], done.document["outcome"]) == (6, "complete")


SLOW = pytest.mark.slow


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        pytest.param(("acquire",), marks=SLOW),
        ("deadband",),
        ("fog", "table"),
        pytest.param(("fog", "witness"), marks=SLOW),
    ],
)
def test_every_command_that_takes_records_ends_so(tmp_path: Path, cut_gyrolock, command) -> None:
    ended = cut_gyrolock("SIGTERM", 2, *command, "--json")
    assert ended.code == 143, ended.err
    assert ended.document["error"]["kind"] == "terminated"
    assert open_run(only_run(tmp_path)).facts["outcome"]["exit_code"] == 143


def front_panel(resource: str) -> str:
    manager = pyvisa.ResourceManager("@py")
    scope = manager.open_resource(resource, read_termination="\n", write_termination="\n", timeout=15_000)
    settings = str(scope.query("SET?"))
    scope.close()
    manager.close()
    return settings


@pytest.mark.slow
def test_the_front_panel_is_put_back(tmp_path: Path, start_gyrolock, serve_scope) -> None:
    scope = serve_scope("--tcp", "0")
    before = front_panel(scope.resource)
    process = start_gyrolock("measure", "--resource", scope.resource, *GIVEN, "--jsonl")
    assert process.stdout is not None
    while '"purpose": "measure"' not in process.stdout.readline():
        assert process.poll() is None
    assert front_panel(scope.resource) != before
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=60)
    assert process.returncode == 143
    assert front_panel(scope.resource) == before


# a bench whose closing never comes back, as a library may hang
HANGING = """
import sys, time
from station.cli import main
from station.runs.acquisition import Acquisition
def hang():
    print("closing", flush=True)
    time.sleep(1000)
def begin(session, *given, begin=Acquisition.begin):
    session.bench.callback(hang)
    return begin(session, *given)
Acquisition.begin = begin
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.slow
def test_a_second_signal_ends_at_once(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HANGING, "measure", "--rates", "8", "--records", "1000"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        while not list(tmp_path.glob("runs/*/run.sqlite")):
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == b"closing\n"
        time.sleep(0.2)
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=20) == 143


@pytest.mark.slow
def test_nohup_is_obeyed(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "station.cli", "measure", "--config", "my.toml", "--records", "9", "--jsonl"]
    process = subprocess.Popen(
        [*command, "--no-report"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGHUP)
    lines = process.communicate(timeout=60)[0].splitlines()
    assert process.returncode == 0
    assert len(lines) == 1 + 9 - 1


@pytest.mark.slow
def test_a_closed_terminal_ends_the_run_and_loses_nothing(tmp_path: Path) -> None:
    """The program is the leader of a session on a terminal of its own, which then goes."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(tmp_path)
        os.execv(
            sys.executable,
            [sys.executable, "-m", "station.cli", "measure", "--config", "my.toml", "--records", "100000"],
        )
    said = b""
    while b"slow rate" not in said:
        said += os.read(terminal, 4096)
    os.read(terminal, 4096)  # the bar of the records
    os.close(terminal)
    _, status = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(status) == 129
    run = open_run(only_run(tmp_path))
    assert run.facts["outcome"]["kind"] == "hung_up"
    records = len(run.taken_for("measure"))
    assert (run.results or {"records": 0})["records"] == records
    assert (run.path.parent / "report.html").exists() == bool(records)


@pytest.mark.slow
def test_a_signal_while_the_result_is_made_leaves_a_run_that_says_so(tmp_path: Path, gyrolock) -> None:
    code = """
import os, signal, sys
import station.report.show as report
from station.cli import main
def write_report(evaluated, path=None):
    os.kill(os.getpid(), signal.SIGTERM)
report.write_report = write_report
sys.exit(main(sys.argv[1:]))
"""
    command = [sys.executable, "-c", code, "measure", "--config", "my.toml", "--records", "2", "--json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 143
    assert json.loads(done.stdout)["error"]["kind"] == "terminated"
    assert open_run(only_run(tmp_path)).facts["outcome"]["kind"] == "terminated"
    again = gyrolock("measure", "--resume", only_run(tmp_path), "--json", "--no-report")
    assert (again.code, again.document["outcome"], again.document["records"]) == (0, "complete", 2)
