"""Where progress and result go may break: the run is as it would have been, and the exit code is the right one."""

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from station.runs.store import open_run

COMMAND = f"{sys.executable} -m station.cli"
MEASURE = f"exec {COMMAND} measure --config my.toml"
SAVED = Path(__file__).parents[2] / "golden" / "single.sqlite"
BENCH = """
gyro.name = "Kreisel Ω"
measurement = { records = 1, tilt_records = 1, rates_over_lock_in = [8.0], both_senses = false }
table.both_senses = false
"""
pytestmark = pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")


@pytest.fixture(autouse=True)
def settings_of_a_small_bench(tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text(BENCH, encoding="utf-8")


def run_shell(folder: Path, script: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a line of a shell, with a limit of files where it sets one."""
    return subprocess.run(
        ["bash", "-c", script],
        cwd=folder,
        capture_output=True,
        encoding=environment.get("PYTHONIOENCODING", "utf-8"),
        timeout=100,
        stdin=subprocess.DEVNULL,
        env={**os.environ, **environment},
    )


def whole_run(folder: Path, *files: str) -> None:
    (path,) = (folder / "runs").glob("*/run.sqlite")
    run = open_run(path)
    assert (len(run.taken_for("tilt")), len(run.taken_for("measure"))) == (1, 1)
    assert run.facts.complete
    assert run.results is not None
    assert sorted(file.name for file in path.parent.iterdir()) == [*files, "run.sqlite"]


@pytest.mark.slow
@pytest.mark.parametrize("where", ["2>/dev/full", pytest.param("2> >(true)", marks=pytest.mark.slow)])
def test_progress_that_cannot_be_written_touches_nothing(tmp_path: Path, where: str) -> None:
    done = run_shell(tmp_path, f"{MEASURE} --no-report --json {where}")
    assert done.returncode == 0
    assert json.loads(done.stdout)["outcome"] == "complete"
    whole_run(tmp_path)


@pytest.mark.slow
def test_with_all_streams_closed_as_under_a_daemon_the_run_is_whole(tmp_path: Path) -> None:
    assert run_shell(tmp_path, f"{MEASURE} <&- >&- 2>&-").returncode == 5
    whole_run(tmp_path, "report.html")


@pytest.mark.parametrize(
    ("where", "said"),
    [
        (">/dev/full", "No space left"),
        pytest.param(">&-", "closed", marks=pytest.mark.slow),
        pytest.param("> >(head -0)", "Broken pipe", marks=pytest.mark.slow),
    ],
)
def test_a_result_that_cannot_be_written_is_told_by_the_exit_code(tmp_path: Path, where: str, said: str) -> None:
    done = run_shell(tmp_path, f"{COMMAND} analyze {SAVED} {where}")
    assert done.returncode == 5
    assert said in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_a_result_that_is_not_read_to_its_end(tmp_path: Path) -> None:
    done = run_shell(tmp_path, f"{MEASURE[5:]} --no-report --jsonl | head -1; exit ${{PIPESTATUS[0]}}")
    assert done.returncode == 5
    assert "Traceback" not in done.stderr
    whole_run(tmp_path)


@pytest.mark.slow
def test_an_encoding_that_lacks_letters_writes_others(tmp_path: Path) -> None:
    done = run_shell(tmp_path, f"{MEASURE} --full --no-report --note Ωµ", PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    assert "\n- " in done.stdout
    assert r"\u03a9" in done.stdout
    whole_run(tmp_path)
    done = run_shell(tmp_path, f"{COMMAND} analyze runs/*", PYTHONIOENCODING="latin-1")
    assert done.returncode == 0, done.stderr
    assert r"Kreisel \u03a9" in done.stdout or r"\u03a9µ" in done.stdout


@pytest.mark.slow
def test_a_verdict_that_cannot_be_written_is_not_one(tmp_path: Path) -> None:
    (tmp_path / "limits.toml").write_text("[limits]\nlock_in_rate_dps = 0.001\n")
    analyze = f"{COMMAND} analyze {SAVED} --config limits.toml"
    assert run_shell(tmp_path, f"{analyze} >/dev/null").returncode == 1
    assert run_shell(tmp_path, f"{analyze} >/dev/full").returncode == 5


@pytest.mark.slow
def test_every_command_stands_broken_streams() -> None:
    """Some commands; `python -m benchmarks.damage.streams` runs them all."""
    command = [sys.executable, "-m", "benchmarks.damage.streams", "--quick"]
    done = subprocess.run(command, cwd=SAVED.parents[2], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_a_reader_that_sleeps_does_not_stop_the_measurement(tmp_path: Path) -> None:
    """Nobody reads what comes on stderr and on stdout, which hold 4096 bytes each."""
    import fcntl

    command = [
        sys.executable,
        "-m",
        "station.cli",
        "measure",
        "--config",
        "my.toml",
        "--records",
        "20",
        "--jsonl",
        "--no-report",
    ]
    out, err = os.pipe(), os.pipe()
    for pipe in (out, err):
        fcntl.fcntl(pipe[1], fcntl.F_SETPIPE_SZ, 4096)
    os.write(err[1], b"x" * 4096)
    with subprocess.Popen(
        command, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=out[1], stderr=err[1]
    ) as process:
        os.close(out[1])
        os.close(err[1])
        while not (runs := list(tmp_path.glob("runs/*/run.sqlite"))) or len(open_run(runs[0]).records) < 21:
            if process.poll() is not None:
                break
        assert len(open_run(runs[0]).records) == 21
        with os.fdopen(out[0], "rb") as lines:
            numbers = [json.loads(line)["number"] for line in lines]
        assert process.wait(timeout=60) == 0
    os.close(err[0])
    assert numbers == list(range(1, 22))


# the report is longer than any file may be from then on; the run is not
LONG_REPORT = """
import resource, sys
import station.report.show as report
from station.cli import main
render = report.render_report
def render_report(evaluated):
    resource.setrlimit(resource.RLIMIT_FSIZE, (4_000_000, 4_000_000))
    return render(evaluated) + "x" * 5_000_000
report.render_report = render_report
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.slow
def test_a_report_that_cannot_be_written_keeps_the_result(tmp_path: Path) -> None:
    command = [sys.executable, "-c", LONG_REPORT, "measure", "--config", "my.toml", "--json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert done.returncode == 5, done.stderr
    document = json.loads(done.stdout)
    assert document["lock_in_rate_dps"] == pytest.approx(0.01, rel=0.1)  # one sense of one rate
    assert document["error"]["kind"] == "output"
    assert "the report cannot be written (File too large)" in document["error"]["message"]
    assert document["outcome"] == document["error"]["message"]
    (path,) = (tmp_path / "runs").glob("*/run.sqlite")
    run = open_run(path)
    assert run.facts["outcome"]["exit_code"] == 5
    assert (run.results or {})["lock_in_rate_dps"] == document["lock_in_rate_dps"]
    assert [file.name for file in path.parent.iterdir()] == ["run.sqlite"]


def small_disk(folder: Path, kilobytes: int, script: str) -> subprocess.CompletedProcess[str]:
    """Run a line of a shell in a file system of its own, of so many bytes; only root may make one."""
    (folder / "disk").mkdir()
    mount = f"mount -t tmpfs -o size={kilobytes}k none disk && cd disk"
    if run_shell(folder, f"unshare -m bash -c '{mount}'").returncode:
        pytest.skip("a small file system cannot be made here")
    return run_shell(folder, f"unshare -m bash -c '{mount} && {script}'")


@pytest.mark.parametrize("kilobytes", [100, pytest.param(300, marks=pytest.mark.slow)])
def test_a_full_disk_is_told_as_what_it_is(tmp_path: Path, kilobytes: int) -> None:
    measure = f"{COMMAND} measure --config ../my.toml --records 40 --json; code=$?; echo"
    measure += f"; {COMMAND} analyze runs/* --json; exit $code"
    done = small_disk(tmp_path, kilobytes, measure)
    assert done.returncode == 5, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    told, _, again = done.stdout.partition("\n\n")
    document = json.loads(told)
    assert document["error"]["kind"] == "output"
    assert "full" in document["error"]["message"] or "No space left" in document["error"]["message"]
    if "records" in document:  # as many as are on the disk, and they are right
        assert abs(document["lock_in_rate_dps"] - 0.01) < 6 * document["lock_in_rate_u_dps"]
        assert json.loads(again)["records"] == document["records"]


ESCAPES = "RLG \x1b[2J\x1b]0;x\x07 [red]7[/red] :smile: \u202e\x9b1m $\\frac{"


@pytest.mark.slow
def test_nothing_of_others_acts_on_the_terminal_or_in_the_report(tmp_path: Path) -> None:
    name = json.dumps(ESCAPES)
    (tmp_path / "my.toml").write_text(f"[gyro]\nname = {name}\n", encoding="utf-8")
    master, slave = pty.openpty()
    command = f"{COMMAND} measure --rates 8 --records 1 --config my.toml --unit '{ESCAPES}' --note '{ESCAPES}'"
    command += f"; {COMMAND} analyze '{ESCAPES}'; {COMMAND} analyze '{ESCAPES}' --json"
    process = subprocess.Popen(
        ["bash", "-c", command], cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=slave, stderr=slave
    )
    os.close(slave)
    said = b""
    while True:
        try:
            piece = os.read(master, 4096)
        except OSError:  # the other end has gone
            break
        if not piece:
            break
        said += piece
    process.wait(timeout=60)
    os.close(master)
    (path,) = (tmp_path / "runs").glob("*/report.html")
    page = path.read_text(encoding="utf-8")
    shown = said.decode(errors="replace")
    for text in (shown, page):
        assert "\x1b[2J" not in text
        assert "\x1b]0" not in text
        assert "\u202e" not in text
        assert "\x9b" not in text
        assert "[red]7[/red]" in text
        assert ":smile:" in text
    assert r"\x1b[2J" in shown
    assert "Traceback" not in shown
    assert "defect" not in shown
