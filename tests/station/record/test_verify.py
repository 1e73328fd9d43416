"""`gyrolock verify`: what it proves, and everything that it must see."""

import json
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from station.campaign.record import CONTENT, RECORD_FILE, content_sha256, verify
from station.cli import main


def not_holding(folder: Path) -> list[str]:
    return [one.sentence for one in verify(folder) if not one.holds]


def rewritten(folder: Path, change: Callable[[Any], None], *, sums_too: bool) -> None:
    path = folder / RECORD_FILE
    record = json.loads(path.read_text(encoding="utf-8"))
    change(record)
    if sums_too:
        record[CONTENT] = content_sha256(record)
    path.write_text(json.dumps(record), encoding="utf-8")


def test_a_record_holds_wherever_its_folder_lies(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(copied / RECORD_FILE), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["holds"]
    assert any("computed again, the result is the same" in one["sentence"] for one in told["records"][0]["checks"])


def test_a_result_computed_again_and_saved_changes_nothing(copied: Path) -> None:
    [run] = copied.glob("runs/*/*/run.sqlite")
    with sqlite3.connect(run) as db:
        db.execute("INSERT INTO result (computed_at, value) SELECT computed_at, value FROM result LIMIT 1")
    assert not_holding(copied) == []
    assert any("was written to since" in one.sentence for one in verify(copied))


def test_raw_records_of_another_run_show(copied: Path) -> None:
    [run] = copied.glob("runs/*/*/run.sqlite")
    with sqlite3.connect(run) as db:
        [payload] = db.execute("SELECT payload FROM record ORDER BY number DESC LIMIT 1").fetchone()
        changed = bytes([payload[0] ^ 1]) + payload[1:]
        db.execute("UPDATE record SET payload = ? WHERE payload = ?", (changed, payload))
    said = not_holding(copied)
    assert any("the raw records" in one and "are others" in one for one in said)
    assert any("damaged" in one for one in said)


def raised(record: Any) -> None:
    record["steps"][0]["result"]["lock_in_rate_dps"] *= 1.00001


def another_verdict(record: Any) -> None:
    record["steps"][0]["limits"][0]["verdict"] = record["steps"][0]["verdict"] = "FAIL"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "sums_too", "said"),
    [
        (raised, False, "its content was changed"),
        (raised, True, "computed again, lock_in_rate_dps was"),
        (another_verdict, True, "judged again, lock_in_rate_dps was FAIL and is PASS"),
        (lambda record: record["outcome"].update(verdict="FAIL"), True, "its verdict is FAIL"),
        (lambda record: record["steps"][0].pop("run"), True, "not laid out as a record"),
    ],
)
def test_a_record_that_was_changed_shows(
    copied: Path, change: Callable[[Any], None], sums_too: bool, said: str
) -> None:
    rewritten(copied, change, sums_too=sums_too)
    assert any(said in one for one in not_holding(copied))


def test_a_run_that_has_gone_shows_and_ends_in_1(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    [run] = copied.glob("runs/*/*/run.sqlite")
    run.unlink()
    assert main(["verify", str(copied)]) == 1
    assert "its run is not there" in capsys.readouterr().out


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"schema": {"name": "gyrolock measure", "version": 2}}', "{" * 99999]
)
def test_what_is_no_record_is_told_in_one_line(
    tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / RECORD_FILE).write_text(text)
    assert main(["verify", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
