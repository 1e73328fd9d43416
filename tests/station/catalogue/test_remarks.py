"""What is said of a run afterwards, beside a measurement that stays as it was."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from station.catalogue import list_runs
from station.cli import main
from station.errors import CannotWrite, RunError, UsageError
from station.runs.annotations import add_remark, read_remarks, remarks_file
from station.runs.store import open_run

GOLDEN = Path(__file__).parents[2] / "golden"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    file = tmp_path / "runs" / "one" / "run.sqlite"
    file.parent.mkdir(parents=True)
    shutil.copyfile(GOLDEN / "single.sqlite", file)
    return file


def test_notes_tags_and_marks_and_who_said_them(run: Path) -> None:
    before = hashlib.sha256(run.read_bytes()).hexdigest()
    add_remark(run, note="the table was touched ", tags=["touched", "august"], mark="bad", by="Grace")
    add_remark(run, untagged=["august"], mark="good", by="Ada")
    add_remark(run, mark=None)
    said = read_remarks(run)
    assert (said.mark, said.tags) == (None, ("touched",))
    assert [(one.by, one.note) for one in said.notes] == [("Grace", "the table was touched")]
    assert [one.mark for one in said.said] == ["bad", "good", None]
    assert all(one.at.endswith("Z") for one in said.said)
    assert hashlib.sha256(run.read_bytes()).hexdigest() == before
    assert not open_run(run).damaged


def test_the_list_shows_what_was_said_at_once(run: Path) -> None:
    assert list_runs(run.parents[1])[0].mark is None
    add_remark(run, tags=["x"], mark="bad", note="why")
    (entry,) = list_runs(run.parents[1])
    assert (entry.mark, entry.tags, entry.remarks[0]["note"]) == ("bad", ("x",), "why")


def test_the_list_says_who_said_it_and_when(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    add_remark(run, note="the lamp was new", mark="bad", by="Grace")
    add_remark(run, tags=["seen"], by="Ada")
    day = read_remarks(run).said[0].at[:10]
    assert main(["runs", str(run.parents[1])]) == 0
    shown = capsys.readouterr().out
    assert f"bad, Grace {day}" in shown
    assert f"{day} Grace: the lamp was new" in shown


@pytest.mark.slow
def test_the_report_shows_what_was_said_and_by_whom(run: Path) -> None:
    assert main(["report", str(run)]) == 0
    page = (run.parent / "report.html").read_text()
    assert "Said of it afterwards" not in page
    add_remark(run, note="the lamp <was> changed", tags=["drift"], mark="bad", by="Grace")
    add_remark(run, untagged=["drift"], by="Ada")
    assert main(["report", str(run)]) == 0
    page = (run.parent / "report.html").read_text()
    assert "Said of it afterwards" in page
    assert "bad, by Grace, " in page
    assert "marked bad; +drift; the lamp &lt;was&gt; changed" in page
    assert "-drift" in page
    assert page.index("Grace") < page.index("Ada")
    remarks_file(run).write_text('{"schema": {"name": "gyrolock remark", "version": 9}}\n')
    assert main(["report", str(run)]) == 0
    assert "written by a newer gyrolock" in (run.parent / "report.html").read_text()


def test_a_line_that_a_power_failure_cut_costs_itself_only(run: Path) -> None:
    add_remark(run, note="first")
    file = remarks_file(run)
    file.write_bytes(file.read_bytes() + b'{"schema": {"name": "gyrolock rem')
    add_remark(run, note="second")
    said = read_remarks(run)
    assert ([one.note for one in said.notes], said.unreadable) == (["first", "second"], 1)


def test_two_who_say_something_at_the_same_time(run: Path) -> None:
    program = (
        "import sys; from pathlib import Path; from station.runs.annotations import add_remark\n"
        "for n in range(50): add_remark(Path(sys.argv[1]), note=f'{sys.argv[2]} {n}')"
    )
    both = [subprocess.Popen([sys.executable, "-c", program, str(run), name]) for name in ("a", "b")]
    assert [one.wait() for one in both] == [0, 0]
    said = read_remarks(run)
    assert said.unreadable == 0
    for name in ("a", "b"):
        assert [one.note for one in said.notes if one.note[0] == name] == [f"{name} {n}" for n in range(50)]


def test_remarks_of_a_newer_program_are_refused_in_one_line(run: Path) -> None:
    add_remark(run, note="today")
    file = remarks_file(run)
    file.write_text(file.read_text().replace('"version": 1', '"version": 2'))
    with pytest.raises(RunError, match="newer gyrolock"):
        read_remarks(run)
    (entry,) = list_runs(run.parents[1])
    assert "newer gyrolock" in entry.problem
    assert entry.values  # the run itself is read all the same


def test_what_cannot_be_said(run: Path) -> None:
    with pytest.raises(UsageError, match="nothing is said"):
        add_remark(run, note=" ")
    with pytest.raises(UsageError, match="no single word"):
        add_remark(run, tags=["two words"])
    remarks_file(run).mkdir()
    with pytest.raises(CannotWrite, match="not saved"):
        add_remark(run, note="x")


def test_the_command(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = run.parents[1] / "two" / "run.sqlite"
    other.parent.mkdir()
    shutil.copyfile(run, other)
    both = [str(run.parent), str(other)]
    assert main(["annotate", *both, "--bad", "--tag", "drift", "--note", "a new lamp", "--by", "Ada"]) == 0
    assert capsys.readouterr().out.count("Ada: a new lamp") == 2
    assert main(["annotate", str(run), "--unmark", "--untag", "drift", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["mark"], document["tags"], document["remarks"][0]["by"]) == (None, [], "Ada")
    assert main(["runs", str(run.parents[1]), "--mark", "bad", "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["runs"]
    assert found["run"] == str(other)
    missing = os.fspath(run.parent / "none.sqlite")
    assert main(["annotate", missing, "--good"]) == 2
    assert not remarks_file(Path(missing)).exists()
