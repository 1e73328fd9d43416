"""What every kind of run can do: be gone on with, be judged, be labelled, be reported and evaluated again."""

import json
import re
import shutil
import signal
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from station.cli import main
from station.measurements import MEASUREMENTS, measurement
from station.runs.store import open_run
from tests.ideal_bench import CLEAN_TOML

GOLDEN = Path(__file__).parent.parent / "golden"
KINDS = {
    "single": "measure",
    "several": "measure",
    "acquired": "measure",
    "fog_table": "table",
    "fog_logs": "table",
    "fog_selfcal": "selfcal",
    "fog_eps": "eps",
    "fog_figures": "figures",
    "fog_witness": "witness",
}


def saved(name: str, folder: Path) -> Path:
    """Copy a golden run into a directory of its own."""
    (folder / name).mkdir()
    return Path(shutil.copy(GOLDEN / f"{name}.sqlite", folder / name / "run.sqlite"))


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_report_and_analyze_take_every_kind(name: str, tmp_path: Path, capsys) -> None:
    run = saved(name, tmp_path)
    assert main(["report", str(run.parent)]) == 0
    page = Path(capsys.readouterr().out.strip())
    assert page == run.parent / "report.html"
    assert page.read_text(encoding="utf-8").count("<svg") >= 1
    code = main(["analyze", str(run), "--json"])
    document = json.loads(capsys.readouterr().out)
    assert document["command"] == KINDS[name]
    assert document["schema"]["name"] == f"gyrolock {KINDS[name]}"
    assert document["started_at"].startswith("2026-")
    assert document["outcome"] == "complete"
    assert document["software"]["gyrolock"] == "0.1.0"
    assert code == {"FAIL": 1, "MARGINAL": 6}.get(document["verdict"], 0)


@pytest.mark.slow
def test_several_runs_of_several_kinds_in_one_go(tmp_path: Path, capsys) -> None:
    runs = [str(saved(name, tmp_path)) for name in ("single", "fog_eps")]
    assert main(["analyze", *runs, "--json"]) == 0
    first, second = json.loads(capsys.readouterr().out)["results"]
    assert (first["command"], second["command"]) == ("measure", "eps")
    assert main(["report", *runs, "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["results"]) == 2
    assert main(["report", *runs, "--output", str(tmp_path / "one.html")]) == 2
    capsys.readouterr()
    assert main(["report", runs[0], str(tmp_path / "nowhere")]) == 2
    assert (tmp_path / "single" / "report.html").is_file()


def test_limits_judge_a_ring_laser_too(tmp_path: Path, capsys) -> None:
    run = saved("single", tmp_path)
    text = "[limits]\nlock_in_rate_dps = {}\ntilt_deg = 89.0\n"
    for limit, code, verdict in ((0.02, 0, "PASS"), (0.01, 6, "MARGINAL"), (0.005, 1, "FAIL")):
        (tmp_path / "limits.toml").write_text(text.format(limit))
        assert main(["analyze", str(run), "--config", str(tmp_path / "limits.toml"), "--json"]) == code
        document = json.loads(capsys.readouterr().out)
        assert document["verdict"] == verdict
        by_name = {one["name"]: one for one in document["limits"]}
        assert by_name["lock_in_rate_dps"]["limit"] == limit
        assert by_name["lock_in_rate_dps"]["value"] == document["lock_in_rate_dps"]
        assert by_name["tilt_deg"]["passed"] is True
    assert main(["report", str(run), "--config", str(tmp_path / "limits.toml")]) == 0
    page = (run.parent / "report.html").read_text(encoding="utf-8")
    assert "FAIL · " in page
    assert "deg/s, at most 0.005 deg/s" in page
    assert main(["analyze", str(run), "--config", str(tmp_path / "limits.toml")]) == 1
    assert "FAIL lock-in rate: " in capsys.readouterr().out


@pytest.mark.slow
def test_a_measurement_beyond_its_limit_ends_with_one(tmp_path: Path, gyrolock) -> None:
    (tmp_path / "my.toml").write_text(
        "[limits]\nlock_in_rate_dps = 0.001\n[measurement]\nrecords = 2\nrates_over_lock_in = [8]\n"
    )
    done = gyrolock(
        "measure", "--config", "my.toml", "--unit", "SN <7> & Co", "--operator", "Ada", "--note", "a\\b"
    )
    assert done.code == 1, done.err
    assert "FAIL lock-in rate: " in done.out
    (run,) = (tmp_path / "runs").iterdir()
    page = (run / "report.html").read_text(encoding="utf-8")
    assert page.index("SN &lt;7&gt; &amp; Co") < page.index("<section")
    found = json.loads(gyrolock("analyze", run, "--json").out)
    assert (found["unit"], found["operator"], found["note"]) == ("SN <7> & Co", "Ada", "a\\b")
    assert found["verdict"] == "FAIL"


MANY = (
    "[measurement]\nrecords = 12\ntilt_records = 2\nrates_over_lock_in = [4.0, 9.0]\nboth_senses = true\n"
    + CLEAN_TOML
)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL")
@pytest.mark.parametrize("number", ["SIGKILL", pytest.param("SIGINT", marks=pytest.mark.slow)])
def test_a_measurement_cut_short_goes_on_to_its_full_count(
    number: str, tmp_path: Path, gyrolock, cut_gyrolock
) -> None:
    (tmp_path / "many.toml").write_text(MANY)
    ended = cut_gyrolock(number, 4 + 17, "measure", "--config", "many.toml", "--seed", 3, "--no-report")
    assert ended.code == (130 if number == "SIGINT" else -getattr(signal, number))
    (run,) = (tmp_path / "runs").glob("*/run.sqlite")
    cut = open_run(run)
    there = {record.key: record.payload for record in cut.records}
    assert len(cut.taken_for("measure")) == 17
    done = gyrolock("measure", "--resume", run.parent, "--unit", "SN 9", "--json", "--no-report", timeout=100)
    assert done.code == 0, done.err
    found, whole = done.document, open_run(run)
    assert found["records"] == 48
    assert found["outcome"] == "complete"
    assert found["unit"] == "SN 9"
    assert len(found["resumed_at"]) == 1
    assert [rate["records"] for rate in found["several_rates"]["rates"]] == [12, 12, 12, 12]
    assert abs(found["lock_in_rate_dps"] - 0.01) < 5 * found["lock_in_rate_u_dps"]
    # what was there is what it was, and no record is there twice
    assert there.items() <= {record.key: record.payload for record in whole.records}.items()
    assert len({record.payload for record in whole.records}) == len(whole.records)
    assert "17 records are saved already" in done.err
    again = gyrolock("measure", "--resume", run.parent)
    assert again.code == 2
    assert "is finished" in again.err


def test_what_may_not_change_when_a_run_goes_on(tmp_path: Path, gyrolock) -> None:
    run = saved("single", tmp_path)
    with closing(sqlite3.connect(run)) as db, db:
        db.execute("DELETE FROM run WHERE name IN ('outcome', 'ended_at')")
        db.execute("DELETE FROM record WHERE number = (SELECT max(number) FROM record)")
    (tmp_path / "other.toml").write_text(
        "[measurement]\nrecords = 7\n[gyro]\nexpected_lock_in_rate_dps = 0.02\n[limits]\ntilt_deg = 89\n"
    )
    refused = gyrolock("measure", "--resume", run, "--config", "other.toml", "--json")
    assert refused.code == 2
    message = refused.document["error"]["message"]
    assert "measurement.records is 6 in the run, not 7" in message
    assert "gyro.expected_lock_in_rate_dps is 0.01 in the run, not 0.02" in message
    assert "limits" not in message
    assert "simulation.seed is 7" in gyrolock("measure", "--resume", run, "--seed", 8).err
    (tmp_path / "limits.toml").write_text("[limits]\ntilt_deg = 80.0\n")
    done = gyrolock("measure", "--resume", run, "--config", "limits.toml", "--json", "--no-report")
    assert done.code == 1, done.err
    assert done.document["records"] == 6
    assert done.document["verdict"] == "FAIL"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("measure", "--resume", "fog_eps"), "is a run of `gyrolock fog eps`, not of `gyrolock measure`"),
        (("fog", "table", "--resume", "single"), "is a run of `gyrolock measure`, not of `gyrolock fog table`"),
        (("fog", "eps", "single"), "is a run of `gyrolock measure`, not of `gyrolock fog eps`"),
        (("measure", "--resume", "single"), "is finished"),
        (("acquire", "--resume", "nowhere"), "no such file"),
        (("analyze", "fog_eps", "--relation", "paper-13"), "--relation means nothing"),
        (("analyze", "fog_eps", "--scale-factor", "3"), "--scale-factor means nothing"),
        (("analyze", "strange"), "is a run of 'spin test', which this gyrolock does not know"),
        (("report", "newer"), "was written by a newer gyrolock"),
        (
            ("measure", "--config", "limit.toml"),
            "limits.lock_in_rate (line 2): no such setting; did you mean lock_in",
        ),
        (("measure", "--config", "wild.toml"), "limits.x (line 3): no such setting; there are lock_in_rate_dps, "),
        (
            ("fog", "eps", "--config", "limit.toml"),
            "limits.lock_in_rate (line 2): no such setting; there are nominal_",
        ),
        (
            ("measure", "--config", "typo.toml"),
            "measurement.rekords (line 3): no such setting; did you mean records?",
        ),
        (("mesure",), "Did you mean 'measure'?"),
        (("fog", "tabel"), "Did you mean 'table'?"),
        (("measure", "--rekords", "3"), "--records"),
    ],
)
def test_bad_input_is_one_clear_line(
    tmp_path: Path, monkeypatch, capsys, arguments: tuple[str, ...], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("single", "fog_eps"):
        saved(name, tmp_path)
    for name, statement in (
        ("strange", """INSERT OR REPLACE INTO run VALUES ('command', '"spin test"')"""),
        ("newer", "PRAGMA user_version = 99"),
    ):
        shutil.copytree(tmp_path / "single", tmp_path / name)
        with closing(sqlite3.connect(tmp_path / name / "run.sqlite")) as db, db:
            db.execute(statement)
    (tmp_path / "limit.toml").write_text("[limits]\nlock_in_rate = 3\n")
    (tmp_path / "wild.toml").write_text("[limits]\ntilt_deg = 3\nx = 3\n")
    (tmp_path / "typo.toml").write_text("# a remark\n[measurement]\nrekords = 3\n")
    assert main([*arguments, "--json"]) == 2
    told = capsys.readouterr()
    (line,) = told.err.splitlines()
    assert line.startswith("gyrolock: ")
    assert said in line
    assert json.loads(told.out)["error" if "error" in told.out[:10] else "file"]
    assert not (tmp_path / "runs").exists()


def test_every_measurement_of_the_list_is_there() -> None:
    for name in MEASUREMENTS:
        kind = measurement(name)
        assert kind.name == name
        assert re.fullmatch(r"gyrolock( fog)? \w+( --dither on)?", kind.command)


@pytest.mark.parametrize("name", ["default", "fog_selfcal"])
def test_nothing_that_is_drawn_ends_a_command(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def draw(*_: object, **__: object) -> None:
        raise ZeroDivisionError("float division by zero")

    run = saved(name, tmp_path)
    monkeypatch.setattr("station.report.figure._drawn", draw)
    assert main(["report", str(run)]) == 0
    said = capsys.readouterr()
    page = Path(said.out.strip()).read_text(encoding="utf-8")
    assert "The pictures cannot be drawn (ZeroDivisionError: float division by zero)" in page
    assert "the pictures cannot be drawn" in said.err
    assert "95 %" in page or "K_self" in page  # the numbers stand there


def test_a_report_is_html_or_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = saved("single", tmp_path)
    assert main(["report", str(run), "--output", str(tmp_path / "one.pdf")]) == 2
    assert ".html" in capsys.readouterr().err
    assert not (tmp_path / "one.pdf").exists()
