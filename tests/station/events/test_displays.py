"""Displays: a picture that fits its terminal, a measurement on a real one, `status` and `stop` from elsewhere."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from station.cli import main
from station.live.console import PlainLines
from station.live.display import picture, plot
from station.live.events import Events, Progress
from station.live.status import STATE_VARIABLE, Running, Situation, StatusFile, running_programs
from station.runs.store import open_run

BRAILLE = re.compile("[\u2801-\u28ff]")


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(STATE_VARIABLE, str(tmp_path / "state"))
    return tmp_path / "state"


def shown(situation: Situation, width: int, height: int = 40) -> list[str]:
    console = Console(file=io.StringIO(), width=width, height=height, force_terminal=True, color_system=None)
    console.print(picture(situation, width, height))
    return console.file.getvalue().splitlines()  # type: ignore[attr-defined]


def busy() -> Situation:
    """A campaign in its second step, with everything that there is to show."""
    events, situation = Events(), Situation()
    events.read_by(situation.take)
    progress = Progress(events)
    events.emit("program", command="station campaign.toml", unit="RLG-\x1b[2J7", operator="B. Bauer")
    names = [f"{n:02} lock-in rate" for n in range(1, 9)]
    events.emit("campaign_begun", campaign="c", unit="RLG-7", steps=names, of=8)
    events.emit("step_ended", step=names[0], number=1, verdict="MARGINAL")
    events.emit("step_begun", step=names[1], number=2, of=8)
    run = "tests/RLG-7/x/runs/02/2026-11-22T111023Z_001/run.sqlite"
    events.emit("run", run=run, instrument="TDS 2014", records=0)
    times = np.linspace(0, 12, 240)
    trace = {"seconds": 0.04, "unit": "V", "samples": np.sin(times), "fit": np.sin(times)}
    value = {"name": "lock_in_rate_dps", "value": 0.01, "u": 1e-5, "text": "0.010000(10) deg/s", "records": 3}
    for group in range(20):
        both = {"values": [value], "running": [value], "so_far": [value]}
        events.emit("value", key=f"rate {group}, 1", group=f"rate {group}", flags=["clipped"], trace=trace, **both)
    progress.start("records", 100)
    progress.advance()
    events.emit("link", repeated=2, reconnected=1, set_again=0, text="2 exchanges repeated, 1 reconnection")
    progress.note("a note " * 60)
    return situation


@pytest.mark.parametrize("width", [40, 80, 200])
def test_the_picture_fits_its_terminal_and_says_everything(width: int) -> None:
    lines = shown(busy(), width)
    assert max(map(len, lines)) <= width
    assert len(lines) <= 40
    text = " ".join(" ".join(lines).split())
    link = "1 reconnection, all recovered"
    for wanted in ("01 lock-in rate", "MARGINAL", "0.010000(10) deg/s", "1/100", "left", link):
        assert re.search(r"\s*".join(map(re.escape, wanted)), text), wanted
    assert len(BRAILLE.findall(text)) > width / 2
    assert "\x1b" not in text


@pytest.mark.parametrize("width", [40, 80, 200])
def test_while_the_link_is_down_the_picture_says_so_first(width: int) -> None:
    situation, events = busy(), Events()
    events.read_by(situation.take)
    events.emit("note", text="no answer; trying to connect again for 90 s")
    events.emit("link", repeated=2, reconnected=1, set_again=0, down=True, text="1 reconnection")
    lines = shown(situation, width)
    assert lines[1].startswith("LINK DOWN for 0 s")
    assert max(map(len, lines)) <= width and len(lines) <= 40
    text = " ".join(" ".join(lines).split())
    assert " left" not in text and "recovered" not in text
    events.emit("link", repeated=2, reconnected=2, set_again=0, down=False, text="2 reconnections")
    assert not any("DOWN" in line for line in shown(situation, width))


def test_a_situation_of_nothing_can_be_shown() -> None:
    assert shown(Situation(), 80) != []


def test_the_plot_has_its_dots_where_the_samples_are() -> None:
    lines = [text.plain for text in plot([0.0, 1.0], [], 30, 5, unit="V", seconds=0.002)]
    assert lines[0].startswith("1 V ")
    assert lines[3].startswith("0 V ")
    assert lines[4].strip().startswith("0")
    assert lines[4].rstrip().endswith("2 ms")
    # one sample at the lower left, one at the upper right: corners of the Braille cells
    assert [len(BRAILLE.findall(line)) for line in lines] == [1, 0, 0, 1, 0]
    assert lines[0][-1] == "\u2808"
    assert lines[3][4] == "\u2840"
    assert plot([None, float("nan")], [], 30, 5, unit="V", seconds=1)[0].plain == "no record to show"


def test_plain_lines_say_what_happens(capsys: pytest.CaptureFixture[str]) -> None:
    events = Events()
    events.read_by(PlainLines())
    progress = Progress(events)
    progress.note("fast run")
    progress.start("records", 2)
    progress.advance()
    progress.advance()
    events.emit("step_ended", step="dead band", number=2, verdict="FAIL", message="too wide")
    assert capsys.readouterr().err.splitlines() == ["fast run", "records 2/2", "step 2 dead band: FAIL: too wide"]


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """A pseudo-terminal of 100 by 30 characters: our end and the program's."""
    pty = pytest.importorskip("pty", reason="pseudo-terminals are POSIX")
    import fcntl
    import struct
    import termios

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
    yield ours, theirs
    os.close(ours)


@pytest.mark.slow
def test_a_measurement_is_watched_and_stopped_from_another_shell(
    terminal: tuple[int, int], state: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ours, theirs = terminal
    program = subprocess.Popen(
        [sys.executable, "-m", "station.cli", "measure", "--rates", "8", "--records", "5000", "--unit", "7",
         "--out", str(tmp_path / "runs"), "--no-report"],
        stdin=theirs, stdout=subprocess.DEVNULL, stderr=theirs, env={**os.environ, "TERM": "xterm"},
    )  # fmt: skip
    os.close(theirs)
    seen = ""
    while "so far" not in seen:
        seen += os.read(ours, 1 << 16).decode(errors="replace")
    assert BRAILLE.search(seen)
    assert "simulated bench" in seen
    assert main(["status"]) == 0
    assert f"process {program.pid}" in capsys.readouterr().out
    assert main(["status", "--json"]) == 0
    [told] = json.loads(capsys.readouterr().out)["programs"]
    assert (told["pid"], told["alive"], told["program"]["unit"]) == (program.pid, True, "7")
    assert main(["stop", "--wait", "0"]) in (0, 1)
    drained = b" "
    while drained:
        try:
            drained = os.read(ours, 1 << 16)
        except OSError:  # Linux: the other end is closed
            break
    assert program.wait(60) == 143
    capsys.readouterr()
    assert main(["status"]) == 1
    assert "no measurement runs" in capsys.readouterr().out
    assert main(["stop"]) == 2
    run = open_run(Path(told["run"]["run"]))
    assert len(run.taken_for("measure")) > 0
    assert "SIGTERM" in run.facts.outcome_text


def test_a_program_ends_as_by_a_signal_where_none_can_be_sent_to_its_main_thread(state: Path) -> None:
    """As on Windows: the main thread is not disturbed, but hears of it as soon as it does something."""
    text = (
        "import signal, sys, time; from station.live.status import StatusFile\n"
        "del signal.pthread_kill\n"
        "from station.errors import Stopped; from station.runs.signals import ending_signals\n"
        "with ending_signals():\n"
        "    StatusFile(); print('there', flush=True)\n"
        "    try:\n"
        "        while True: time.sleep(0.05)\n"
        "    except Stopped as stopped: sys.exit(stopped.number)\n"
    )
    with subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "there\n"
        (path,) = state.glob("*.lock")
        Running(path.with_suffix(".json"), program.pid, True, Situation()).stop()
        assert program.wait(60) == signal.SIGTERM
    assert list(state.glob("*.stop")) == []


def test_a_program_that_was_killed_is_told_as_such(
    state: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (
        "import os; from station.live.status import StatusFile; from station.live.events import Events\n"
        "events = Events(); events.read_by(StatusFile())\n"
        "events.emit('program', command='measure')\n"
        "events.emit('run', run=os.environ['RUN'], records=0)\n"
        "os._exit(9)"
    )
    from station.runs.store import RunWriter

    with RunWriter.create(tmp_path / "runs", {"command": "measure"}) as writer:
        path = writer.path
    subprocess.run([sys.executable, "-c", text], check=False, env={**os.environ, "RUN": str(path)})
    [one] = running_programs()
    assert not one.alive
    assert main(["status"]) == 1
    assert f"was killed; the records are kept: go on with --resume {path.parent}" in capsys.readouterr().out
    with RunWriter(path) as writer:
        writer.save_facts({"outcome": "complete"})
    assert main(["status"]) == 1
    assert "no measurement runs" in capsys.readouterr().out
    assert running_programs() == []


def test_a_status_that_cannot_be_written_harms_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    events, status = Events(), StatusFile(tmp_path / "file" / "below")
    heard: list[object] = []
    events.read_by(status)
    events.read_by(heard.append)
    events.emit("note", text="one")
    time.sleep(0)
    status.close()
    assert len(heard) == 1
