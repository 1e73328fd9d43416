"""The record of a test: JSON by its schema, JUnit by a parser of others, CSV, and a test that was aborted."""

import csv
import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import junitparser
import pytest

from station.campaign.record import (
    SCHEMA_FILE,
    content_sha256,
    file_sha256,
    junit_xml,
    limits_csv,
    record_document,
    write_record,
)
from station.errors import CannotWrite, Failure
from station.notebook.measure import TestedUnit

SCHEMA = json.loads(SCHEMA_FILE.read_text(encoding="utf-8"))
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def test_the_schema_is_one_and_the_record_obeys_it(tested: TestedUnit) -> None:
    VALIDATOR.check_schema(SCHEMA)
    written = json.loads(tested.files.json.read_text(encoding="utf-8"))
    VALIDATOR.validate(written)
    assert written == tested.record


@pytest.mark.parametrize(
    "spoil",
    [
        lambda record: record.pop("operator"),
        lambda record: record["outcome"].update(verdict="GOOD"),
        lambda record: record["steps"][0]["limits"][0].pop("risk"),
        lambda record: record["steps"][0]["run"].update(sha256="0"),
        lambda record: record.update(started_at="yesterday"),
        lambda record: record.update(surprise=1),
    ],
)
def test_the_schema_refuses_what_is_no_record(tested: TestedUnit, spoil: Callable[[Any], None]) -> None:
    record = json.loads(json.dumps(tested.record))
    spoil(record)
    assert not VALIDATOR.is_valid(record)


def test_it_says_everything(tested: TestedUnit) -> None:
    record = tested.record
    assert tested.verdict == record["outcome"]["verdict"] == "PASS"
    assert record["unit"] == {"serial": "SN <7> & Söhne", "type": "RLG-2000", "is_reference": False}
    assert (record["operator"], record["note"], record["station"]["name"]) == (
        "B. Bauer",
        "after the move",
        "bench 3",
    )
    [scope] = record["instruments"]
    assert (scope["serial"], scope["calibration_valid"]) == ("C012345", False)
    assert scope["firmware"] == tested.record["steps"][0]["result"]["instrument"]["firmware"]  # nobody states it
    [step] = record["steps"]
    run = tested.outcome.directory / step["run"]["path"]
    assert step["run"]["sha256"] == file_sha256(run)
    assert step["run"]["records"] == 4 + 2
    assert len(step["records"]) == 2
    assert step["records"][0]["lock_in_rate_dps"] == pytest.approx(0.01, rel=0.1)
    assert step["budget"] == step["result"]["budget"] is not None
    assert step["limits"][0]["low_95"] < 0.01 < step["limits"][0]["high_95"]
    assert step["result"]["instrument"]["model"] == "TDS 2014"
    assert record["campaign"]["settings"]["campaign"]["name"] == "Acceptance"
    assert record["content_sha256"] == content_sha256(record)


def test_junit_is_read_by_another_program(tested: TestedUnit) -> None:
    suites = junitparser.JUnitXml.fromfile(str(tested.files.junit))
    [suite] = suites
    assert (suites.tests, suites.failures, suites.errors, suites.skipped) == (2, 0, 0, 0)
    assert [case.name for case in suite] == ["lock_in_rate_dps", "noise_rms_v"]
    known = {one.name: one.value for one in suite.properties()}
    assert known["unit"] == "SN <7> & Söhne"
    assert known["run_sha256"] == tested.record["steps"][0]["run"]["sha256"]
    limit = tested.record["steps"][0]["limits"][0]
    of_case = {one.name: one.value for one in next(iter(suite)).child(junitparser.Properties)}
    assert float(of_case["value"]) == limit["value"]
    assert (of_case["unit"], of_case["verdict"]) == (limit["unit"], "PASS")
    assert (
        float(of_case["low_95"]) < float(of_case["value"]) < float(of_case["high_95"]) < float(of_case["at_most"])
    )


@pytest.mark.slow
@pytest.mark.parametrize(("verdict", "kind"), [("FAIL", "Failure"), ("MARGINAL", "Failure"), ("ERROR", "Error")])
def test_no_reader_of_junit_takes_another_verdict_for_a_pass(tested: TestedUnit, verdict: str, kind: str) -> None:
    record = json.loads(json.dumps(tested.record))
    record["steps"][0]["limits"][0] |= {"verdict": verdict, "sentence": f"{verdict} \x1b[2J \x00"}
    [suite] = junitparser.JUnitXml.fromstring(junit_xml(record).encode())
    [told] = next(iter(suite)).result
    assert (type(told).__name__, told.type) == (kind, verdict)


def test_a_test_that_was_aborted_is_a_record_too(tested: TestedUnit) -> None:
    outcome = tested.outcome
    later = replace(outcome.plan.steps[0], key="02 not reached", number=2)
    plan = replace(outcome.plan, steps=(*outcome.plan.steps, later))
    aborted = replace(outcome, plan=plan, failure=Failure("terminated", "stopped by SIGTERM", 143))
    record = record_document(aborted, {})
    VALIDATOR.validate(record)
    assert (record["outcome"]["verdict"], record["outcome"]["exit_code"]) == ("ABORTED", 143)
    assert [one["key"] for one in record["not_begun"]] == ["02 not reached"]
    suites = junitparser.JUnitXml.fromstring(junit_xml(record).encode())
    assert (suites.tests, suites.skipped) == (3, 1)


def test_what_programs_read_is_there_before_a_page_is_drawn(
    tested: TestedUnit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> str:
        raise OSError("no space left")

    monkeypatch.setattr("station.campaign.record.render_record", full)
    with pytest.raises(CannotWrite, match="no space left"):
        write_record(replace(tested.outcome, directory=tmp_path), evaluated={})
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "junit.xml", "limits.csv", "record.json", "records.csv"
    ]  # fmt: skip


def test_tables_hold_every_limit_and_every_record(tested: TestedUnit) -> None:
    rows = list(csv.DictReader(io.StringIO(tested.files.limits.read_text(encoding="utf-8"))))
    assert [(row["number"], row["verdict"], row["unit"]) for row in rows] == [
        ("lock_in_rate_dps", "PASS", "deg/s"),
        ("noise_rms_v", "PASS", "V"),
    ]
    assert float(rows[0]["value"]) == tested.record["steps"][0]["limits"][0]["value"]
    assert rows[0]["serial"] == "SN <7> & Söhne"
    sentences = [one["sentence"] for one in tested.record["steps"][0]["limits"]]
    assert [row["message"] for row in rows] == sentences and len(set(sentences)) == 2
    records = list(csv.DictReader(io.StringIO(tested.files.records.read_text(encoding="utf-8"))))
    assert [row["record"] for row in records] == ["1", "2"]


def test_a_spreadsheet_carries_nothing_out(tested: TestedUnit) -> None:
    record = json.loads(json.dumps(tested.record))
    record["unit"]["serial"] = '=HYPERLINK("http://example.invalid")'
    [row, _] = csv.DictReader(io.StringIO(limits_csv(record)))
    assert row["serial"].startswith("'=")
