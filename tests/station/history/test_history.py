"""The history of tested units: charts by type and of the bench, its check, the command and its page."""

import csv
import io
import json
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.cli import main
from station.history import course_svg, courses, in_control, read_tests

NOW = datetime(2026, 11, 22, 12, 0, tzinfo=UTC)
STEADY = (0.01 + 1e-5 * np.random.default_rng(5).standard_normal(30)).tolist()
TABLE = {"scale_factors": [{"by": "earth rate", "scale_factor_pulses_per_deg": 2000.0}]}


def write_record(folder: Path, unit: str, at: datetime, value: float, **changed: Any) -> None:
    """A record of a test, as far as histories read it."""
    text = at.isoformat(timespec="milliseconds").replace("+00:00", "Z")
    result = {"lock_in_rate_dps": value, "lock_in_rate_u_dps": 1e-5, "table_check": TABLE}
    step = {
        "name": "lock-in",
        "measurement": "measure",
        "repeat": 1,
        "of_repeats": 1,
        "result": result,
        "limits": [],
    }
    record = {
        "schema": {"name": "gyrolock test record", "version": 1},
        "unit": {"serial": unit, "type": "RLG", "is_reference": unit == "REF"},
        "operator": None,
        "simulated": False,
        "started_at": text,
        "campaign": {"name": "acceptance"},
        "outcome": {"verdict": "PASS", "message": None, **changed},
        "steps": [step],
    }
    path = folder / unit / f"{text.replace(':', '')}" / "record.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(record), encoding="utf-8")


def checked_daily(folder: Path, values: Sequence[float], **changed: Any) -> None:
    """The reference unit, once a day up to an hour ago; `changed` is of the last test."""
    for place, value in enumerate(reversed(values)):
        at = NOW - timedelta(days=place, hours=1)
        write_record(folder, "REF", at, value, **(changed if place == 0 else {}))


def check(folder: Path, now: datetime = NOW) -> Any:
    return in_control(folder, "REF", "RLG", now, 86400.0)


def test_a_trend_of_the_same_units_is_told_with_its_interval(tmp_path: Path, capsys) -> None:
    rng = np.random.default_rng(7)
    for place in range(40):  # four units of different levels, each tested every fourth day
        level = 0.01 + 0.002 * (place % 4)
        value = level + 4e-6 * place + 1e-5 * rng.standard_normal()
        write_record(tmp_path, f"RLG-{place % 4}", NOW - timedelta(days=40 - place), value)
    (chart,) = (one for one in courses(read_tests(tmp_path)[0]) if "lock_in_rate" in one.name)
    found = chart.trend
    assert found is not None
    assert found.low_95 < 4e-6 < found.high_95 < 4.8e-6
    assert any("The same unit drifts by +" in one for one in chart.sentences)
    main(["history", str(tmp_path), "--json", "--no-page"])
    (of_json, *_) = json.loads(capsys.readouterr().out)["charts"]
    assert of_json["trend"]["per_day"] == found.per_day


def test_a_bench_whose_reference_unit_is_as_always_may_test(tmp_path: Path) -> None:
    checked_daily(tmp_path, STEADY)
    assert check(tmp_path).ok
    assert check(tmp_path).sentence == "the bench was checked with REF 1 h ago: PASS, in control"


@pytest.mark.parametrize(
    ("values", "changed", "now", "said"),
    [
        ([], {}, NOW, "was never checked"),
        (STEADY, {}, NOW + timedelta(hours=24), "was 25 h ago, more than 24 h"),
        (STEADY, {}, NOW - timedelta(hours=2), "lies in the future: set the clock"),
        (STEADY, {"verdict": "FAIL", "message": "too high"}, NOW, r"REF was FAIL .* \(too high\)"),
        (STEADY, {"verdict": "ERROR", "message": "no scope"}, NOW, "REF was ERROR"),
        ([*STEADY, 0.0105], {}, NOW, "out of control: REF .* lock-in: lock-in rate beyond 3 sigma"),
        ([*STEADY, *[0.010013] * 8], {}, NOW, "8 in a row on one side"),
    ],
)
def test_a_bench_that_may_not_test_says_why(
    tmp_path: Path, values: Sequence[float], changed: Any, now: datetime, said: str
) -> None:
    import re

    checked_daily(tmp_path, values, **changed)
    told = check(tmp_path, now)
    assert not told.ok
    assert re.search(said, told.sentence)


def test_a_reference_unit_of_a_simulation_says_nothing_of_a_bench(tmp_path: Path) -> None:
    checked_daily(tmp_path, STEADY)
    assert not in_control(tmp_path, "REF", "RLG", NOW, 86400.0, simulated=True).ok
    assert not in_control(tmp_path, "REF", "FOG", NOW, 86400.0).ok


def test_charts_are_by_type_and_what_the_bench_spoilt_does_not_count(tmp_path: Path) -> None:
    checked_daily(tmp_path, STEADY[:9])
    for place, value in enumerate(STEADY[:12]):
        write_record(tmp_path, f"SN{place}", NOW - timedelta(minutes=place), value)
    write_record(tmp_path, "SN99", NOW, 0.5, verdict="ERROR")
    (tmp_path / "SN5").joinpath("record.json").write_text("{")
    tests, unreadable = read_tests(tmp_path)
    assert [path.parent.name for path in unreadable] == ["SN5"]
    found = {(one.of, one.name): one for one in courses(tests)}
    assert {of for of, _ in found} == {"bench, by REF", "RLG"}
    units = found["RLG", "lock-in: lock_in_rate_dps"]
    assert units.chart.values.tolist() == STEADY[:12][::-1]
    assert units.us == (1e-5,) * 12
    assert (
        found["RLG", "lock-in: scale_factor_pulses_per_deg by the earth rate"].chart.values.tolist()
        == [2000.0] * 12
    )


def test_the_command_tells_what_is_out_of_control(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    checked_daily(tmp_path, [*STEADY, 0.0105])
    assert main(["history", str(tmp_path), "--number", "lock_in"]) == 1
    told = capsys.readouterr().out
    assert "REF: beyond 3 sigma" in told
    assert (tmp_path / "index.html").read_text(encoding="utf-8").count("<svg") == 1
    assert main(["history", str(tmp_path), "--json", "--no-page", "--number", "scale_factor"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [len(document["tests"]), len(document["charts"]), document["page"]] == [31, 1, None]


def test_a_folder_without_tests_is_a_usage_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["history", str(tmp_path)]) == 2
    assert main(["history", str(tmp_path / "nowhere")]) == 2
    assert "holds no record of a test" in capsys.readouterr().err


def test_a_chart_has_its_limit_its_unit_and_what_it_is_worth(tmp_path: Path) -> None:
    """Cpk by hand; the first verdict of a unit counts for the yield, however often it is tested again."""
    limit = {"number": "lock_in_rate_dps", "name": "lock_in_rate_dps", "unit": "deg/s", "at_least": None}
    for place, value in enumerate(STEADY[:12]):
        at = NOW - timedelta(days=20 - place)
        write_record(tmp_path, f"SN{place}", at, value, verdict="FAIL" if place == 3 else "PASS")
    write_record(tmp_path, "SN3", NOW, STEADY[12])
    for path in tmp_path.rglob("record.json"):
        record = json.loads(path.read_text())
        value = record["steps"][0]["result"]["lock_in_rate_dps"]
        record["steps"][0]["limits"] = [
            {**limit, "value": value, "low_95": value - 2e-5, "high_95": value + 2e-5, "at_most": 0.0101}
        ]
        path.write_text(json.dumps(record))
    assert main(["history", str(tmp_path)]) == 0
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "first-pass yield 11 of 12 (92%)" in page
    of_all = STEADY[:13]
    cpk = (0.0101 - float(np.mean(of_all))) / (3 * float(np.std(of_all, ddof=1)))
    assert f"Cpk {cpk:.2f}." in page
    (course,) = (one for one in courses(read_tests(tmp_path)[0]) if "lock_in" in one.name)
    assert course.numbers[-1].axis == "lock-in rate, deg/s" and course.numbers[-1].limits == (None, 0.0101)
    assert "#a93226" in course_svg(course, "chart")  # the limit, in red
    assert course.unit_at(1).startswith("SN0\n") and course.unit_at(99) == ""


def test_another_campaign_has_a_chart_of_its_own(tmp_path: Path) -> None:
    for place in range(4):
        write_record(tmp_path, f"SN{place}", NOW - timedelta(days=place), STEADY[place])
    for path in sorted(tmp_path.rglob("record.json"))[:2]:
        record = json.loads(path.read_text())
        path.write_text(json.dumps({**record, "campaign": {"name": "two rates"}}))
    found = {one.of: one.chart.values.size for one in courses(read_tests(tmp_path)[0]) if "lock_in" in one.name}
    assert found == {"RLG, acceptance": 2, "RLG, two rates": 2}


def failed(name: str, value: float) -> dict[str, Any]:
    """A limit of a step, as far as histories read it."""
    return {
        "name": name, "number": name, "unit": None, "value": value, "low_95": value - 1, "high_95": value + 1,
        "of": None, "quantity": name, "at_least": 0.0, "at_most": 5.0, "verdict": "FAIL" if value > 5 else "PASS",
    }  # fmt: skip


def test_what_failed_most_and_all_numbers_as_csv(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for place, (first, second) in enumerate([(9.0, 9.0), (9.0, 1.0), (1.0, 1.0), (9.0, 1.0)]):
        write_record(tmp_path, f"=SN{place}", NOW - timedelta(hours=9 - place), 0.01)
        path = next((tmp_path / f"=SN{place}").rglob("record.json"))
        record = json.loads(path.read_text(encoding="utf-8"))
        record["steps"][0]["limits"] = [failed("noise", first), failed("tilt", second)]
        path.write_text(json.dumps(record), encoding="utf-8")
    assert main(["history", str(tmp_path)]) in (0, 1)
    told = capsys.readouterr().out
    assert told.index("FAIL in 3 of 4 tests: lock-in: noise") < told.index("FAIL in 1 of 4 tests: lock-in: tilt")
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "failed most: lock-in: noise (3), lock-in: tilt (1)" in page
    main(["history", str(tmp_path), "--csv", "--no-page"])
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    noise = [row for row in rows if row["number"] == "lock-in: noise"]
    assert [float(row["value"]) for row in noise] == [9.0, 9.0, 1.0, 9.0]
    assert noise[0]["at_most"] == "5.0" and float(noise[0]["u"]) == pytest.approx(2 / 3.92)
    assert {row["number"] for row in rows} >= {"lock-in: noise", "lock-in: tilt", "lock-in: lock_in_rate_dps"}
    assert noise[0]["unit"] == "'=SN0"  # no formula for a spreadsheet
    assert main(["history", str(tmp_path), "--csv", "--json"]) == 2
