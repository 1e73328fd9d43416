"""Saved logs in CSV: the same numbers as the run that they were written from, and clear words for a bad list."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from instrument import FileFormatError
from instrument.fibre_gyro import write_gyro_log
from station.errors import UsageError
from station.fibre_gyro.logs import read_list
from station.fibre_gyro.segments import segments_of
from station.live.events import Progress
from station.measurements import measurement
from station.runs.store import SavedRun, open_run
from station.shell.finish import Evaluated, evaluate_run, start_run

QUIET = Progress()
COLUMNS = {
    "table": ("axis", "rate_dps", "end_up"),
    "selfcal": ("stands_for_dps", "number"),
    "eps": ("step_codes",),
    "figures": ("run", "rate_dps", "temperature_c", "since_on_s"),
}


def written(run: SavedRun, command: str, folder: Path) -> Path:
    """Write the segments of a run as logs, and their list."""
    lines = [",".join(("file", *COLUMNS[command]))]
    for number, segment in enumerate(segments_of(run, command)):
        name = f"log{number}.csv"
        write_gyro_log(folder / name, segment.recording)
        lines.append(",".join((name, *(str(segment.conditions.get(column, "")) for column in COLUMNS[command]))))
    (folder / "list.csv").write_text("\n".join(lines) + "\n")
    return folder / "list.csv"


@pytest.fixture
def from_logs(fog_settings):
    def evaluate(command: str, path: Path, **sections: Any) -> Evaluated:
        done = start_run(measurement(command), fog_settings(**sections), QUIET, paths=[path])
        return evaluate_run(open_run(done.path))

    return evaluate


@pytest.mark.slow
@pytest.mark.parametrize("command", ["table", "selfcal", "eps", "figures"])
def test_logs_give_the_numbers_of_their_run(taken, from_logs, tmp_path: Path, command: str) -> None:
    sections: dict[str, Any] = {
        # of two rates no drift of the bias can be seen: logs follow a clock, simulated segments none
        "table": {"axes": ["Z"], "turns": 3, "rates_dps": [20.0, 21.0]},
        "selfcal": {"step_s": 5.0, "numbers": "nominal"},
        "eps": {"record_s": 0.5},
        "figures": {"rates_dps": [10.0, 50.0, 100.0], "runs": 2, "temperatures_c": [60.0]},
    }
    result, run = taken(command, **sections)
    again = from_logs(command, written(run, command, tmp_path), **sections)
    key = {
        "table": lambda d: d["axes"][0]["scale_factor_counts_per_dps"],
        "selfcal": lambda d: d["scale_factor_self_counts_per_dps"],
        "eps": lambda d: d["two_pi_error"],
        "figures": lambda d: (d["scale_factor_counts_per_dps"], d["temperature_coefficient_ppm"]),
    }[command]
    assert key(again.document()) == pytest.approx(key(result.document()), rel=1e-9)
    assert again.document()["simulated"] is False
    assert "truth" not in again.document()
    assert again.document()["left_out"] == []


def test_a_part_of_a_log_must_be_whole_turns(taken, from_logs, tmp_path: Path) -> None:
    _, run = taken("table", table={"axes": ["Z"], "turns": 3})
    path = written(run, "table", tmp_path)
    lines = path.read_text().splitlines()
    # 20.01 deg/s: three turns are 53.97 s, one turn 17.99 s
    windows = {3: "0,36.0", 4: "0,36.0", 5: "0,53.7", 6: "0,53.7"}
    parts = [
        lines[0] + ",start_s,stop_s",
        *(f"{line},{windows.get(n, ',')}" for n, line in enumerate(lines[1:], start=1)),
    ]
    path.write_text("\n".join(parts))
    # 36 s are two turns but for 0.02 s, 53.7 s are three turns of 20.1 deg/s but for 0.03 s: less than one output
    result = from_logs("table", path)
    assert result.document()["left_out"] == []
    turns = {point["name"].split(" (")[0]: point["turns"] for point in result.document()["axes"][0]["points"]}
    assert (turns["Z +20"], turns["Z +20.01"], turns["Z +20.1"]) == (3, 2, 3)
    path.write_text("\n".join(parts).replace("0,36.0", "0,30.0"))
    result = from_logs("table", path)
    reasons = {one["name"]: one["reason"] for one in result.document()["left_out"]}
    assert "30 s at 20.01 deg/s is 1.667 turns, not a whole number: use 1 turns" in reasons["Z +20.01 (log2.csv)"]


def test_missing_rows_of_a_log_are_a_gap(taken, from_logs, tmp_path: Path) -> None:
    _, run = taken("table", table={"axes": ["Z"], "turns": 3})
    path = written(run, "table", tmp_path)
    log = (tmp_path / "log0.csv").read_text().splitlines()
    (tmp_path / "log0.csv").write_text("\n".join(log[:200] + log[205:]))
    result = from_logs("table", path)
    assert result.document()["left_out"] == []
    assert any("5 output words are missing of 540" in flag for flag in result.result.flags)
    whole = [[float(cell) for cell in row.split(",")][1] for row in log[1:]]
    point = result.document()["axes"][0]["points"][0]
    # words that are fitted differ from those that were there by their noise: 1 count each at 0.1 s
    assert abs(point["mean_counts"] - np.mean(whole[:540])) < 5 * 0.3 * np.sqrt(5) / 540
    assert point["missing"] == 5
    (tmp_path / "log0.csv").write_text("\n".join(log[:200] + log[400:]))
    result = from_logs("table", path)
    reasons = {one["name"]: one["reason"] for one in result.document()["left_out"]}
    assert "rows missing: 200 outputs missing" in reasons["Z +20 (log0.csv)"]
    assert set(reasons) == {"Z +20 (log0.csv)", "Z -20 (log1.csv)"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("rate_dps\n20\n", "has no column file"),
        ("file\na.csv\n", "has no column rate_dps"),
        ("file,rate_dps\n", "names no log"),
        ("file,rate_dps,colour\na.csv,1,red\n", "no such column: colour"),
        ("file,rate_dps\na.csv,fast\n", "log 1, rate_dps: 'fast' is not a number"),
        ("file,rate_dps\na.csv,\n", "log 1: rate_dps is missing"),
        ("file,rate_dps,end_up\na.csv,1,2\n", "end_up: 1 or -1, not 2"),
    ],
)
def test_a_bad_list_is_told_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "list.csv"
    path.write_text(text)
    with pytest.raises(UsageError, match=message):
        read_list(path, "table", ("rate_dps",))


def test_a_log_that_is_missing_or_broken_leaves_no_run(from_logs, tmp_path: Path) -> None:
    (tmp_path / "list.csv").write_text("file,rate_dps\nno.csv,20\n")
    with pytest.raises(OSError):
        from_logs("table", tmp_path / "list.csv")
    (tmp_path / "no.csv").write_text("time,counts\n0,1\n1,one\n")
    with pytest.raises(FileFormatError, match=r"no\.csv"):
        from_logs("table", tmp_path / "list.csv")
    assert [path for path in tmp_path.iterdir() if path.is_dir()] == []
