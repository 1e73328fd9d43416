"""What a person reads first fits on a screen: a page of twelve lines, a list of one line a row."""

import shutil
from pathlib import Path

import pytest

from station.cli import main

GOLDEN = sorted((Path(__file__).parents[1] / "golden").glob("[a-z]*.sqlite"))
PAGE, WIDTH = 13, 120  # the name of the source and twelve lines


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for run in GOLDEN:
        shutil.copy(run, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("run", [run.name for run in GOLDEN if run.stem != "locked"])
def test_every_kind_of_run_is_told_on_a_short_page(
    run: str, runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(["analyze", run])
    short = capsys.readouterr().out.splitlines()
    assert code in (0, 1, 6)
    assert len(short) <= PAGE
    assert max(map(len, short)) <= WIDTH
    assert any(line.startswith("quality") for line in short)
    assert main(["analyze", run, "--full"]) == code
    assert len(capsys.readouterr().out.splitlines()) > len(short)
    assert main(["analyze", run, "--quiet"]) == code
    (line,) = capsys.readouterr().out.splitlines()
    assert "; good" in line or "; DOUBTFUL" in line
    assert line.endswith("; PASS") == (code == 0 and any("PASS" in one for one in short))


def test_several_sources_take_a_line_each_with_their_quality(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(["analyze", "single.sqlite", "locked.sqlite", "deadband.sqlite", "default.sqlite", "nothing.csv"])
    said = capsys.readouterr()
    header, *lines, last = said.out.splitlines()
    assert code == 2
    assert len(lines) == 5
    assert max(len(line.rstrip()) for line in (header, *lines)) <= WIDTH
    assert "6/6" in lines[0] and "± " in lines[0] and "good" in lines[0]
    assert "not read" in lines[1] and "holds no record" in said.err
    assert "MARGINAL" in lines[2]
    assert "40/40" in lines[3] and "PASS" in lines[3]
    assert "nothing.csv" in lines[4] and "nothing.csv: No such" in said.err
    assert last.startswith("5 sources: 3 good, 2 not read")


def test_the_list_of_runs_has_one_line_a_run_and_a_word_of_quality(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["runs", "."]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(GOLDEN) + 1
    assert max(len(line.rstrip()) for line in lines) <= WIDTH
    (default,) = (line for line in lines if "default.sqlite" in line)
    assert "± 0.0000096 deg/s" in default and " good " in default


@pytest.mark.slow
@pytest.mark.parametrize(
    "line",
    [
        "analyze default.sqlite single.sqlite", "runs .", "compare default.sqlite single.sqlite",
        "export single.sqlite --to x.npz", "annotate single.sqlite --note x", "report single.sqlite --to x.html",
        "plan", "study --figure 2", "doctor", "list --no-lan",
    ],
)  # fmt: skip
def test_quiet_is_one_line_of_every_command(line: str, runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*line.split(), "--quiet"]) in (0, 3)
    assert len(capsys.readouterr().out.splitlines()) == 1


def test_a_run_is_named_by_its_path_a_beginning_or_as_the_last_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, golden in (("2026-11-23T101500Z_001", "single"), ("2026-11-24T090000Z_001", "fog_eps")):
        (tmp_path / "runs" / name).mkdir(parents=True)
        shutil.copy(GOLDEN[0].with_stem(golden), tmp_path / "runs" / name / "run.sqlite")
    assert main(["analyze", "last"]) == 0
    assert "eps" in capsys.readouterr().out
    assert main(["analyze", "2026-11-23"]) == 0
    assert "lock-in rate" in capsys.readouterr().out
    assert main(["report", "last"]) == 0
    assert "2026-11-24T090000Z_001" in capsys.readouterr().out
    assert main(["analyze", "2026-11"]) == 2
    assert "2 runs begin with '2026-11', such as 2026-11-24T090000Z_001" in capsys.readouterr().err
    assert main(["analyze", "2027"]) == 2
    assert "2027" in capsys.readouterr().err
