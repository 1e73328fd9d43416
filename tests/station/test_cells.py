"""No text of others acts in a spreadsheet, numbers stay numbers, and what is read back is what was written."""

import csv
import shutil
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from station.cli import main
from station.files import alive, inert
from station.runs.store import RunWriter

GOLDEN = Path(__file__).parents[1] / "golden"
UNIT = '=HYPERLINK("http://example.org";"RLG-7")'
OPERATOR = "+cmd|' /C calc'!A0"


@pytest.mark.slow
@given(st.text(alphabet=st.sampled_from("'=+-@\t\r1.e5naifx "), max_size=9) | st.text())
def test_a_cell_does_nothing_and_gives_its_text_back(text: str) -> None:
    cell = inert(text)
    assert alive(cell) == text
    if cell[:1] in tuple("=+-@\t\r"):
        assert abs(float(cell)) >= 0  # a number, and a finite one


@pytest.mark.parametrize("number", ["-0.5", "+3", "-1e-05", "1850.0"])
def test_numbers_stay_numbers(number: str) -> None:
    assert inert(number) == number


def test_no_command_writes_a_formula(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = Path(shutil.copy(GOLDEN / "single.sqlite", tmp_path / "run.sqlite"))
    with RunWriter(run) as writer:
        writer.save_facts({"unit": UNIT, "operator": OPERATOR, "note": "-1+1"})
    assert main(["runs", ".", "--csv"]) == 0
    listed = capsys.readouterr().out
    assert main(["analyze", "run.sqlite", "--to", "rows.csv"]) == 0
    assert main(["export", "run.sqlite", "--to", "set.csv"]) == 0
    capsys.readouterr()
    for text in (listed, (tmp_path / "rows.csv").read_text(), (tmp_path / "set.csv").read_text()):
        for row in csv.reader(text.splitlines()):
            for cell in row:
                assert cell[:1] not in tuple("=+@\t\r") and (cell[:1] != "-" or float(cell) < 0)
    assert f"'{UNIT}" in next(csv.DictReader(listed.splitlines())).values()
    # read back, the unit is what it was
    for table in ("rows.csv", "set.csv"):
        assert main(["analyze", table, "--to", f"{table}.jsonl"]) in (0, 2)
    capsys.readouterr()
    assert main(["compare", "rows.csv", "run.sqlite", "--json"]) == 0
