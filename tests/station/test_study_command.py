"""`gyrolock study` as a user meets it."""

import csv
import json
from pathlib import Path

import pytest

from station.cli import main


@pytest.mark.slow
def test_study_writes_everything(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "study"
    assert main(["study", "--json", "--out", str(out)]) == 0
    document = json.loads(capsys.readouterr().out)
    assert sorted(document["figures"]) == ["2", "3", "4", "5", "6"]
    saved = json.loads((out / "study.json").read_text())
    assert saved["figures"] == document["figures"]
    assert sorted(str(path) for path in out.iterdir()) == sorted(document["files"])
    for name in ("figure2", "figure3", "figure4", "figure5", "figure6", "bias", "causes"):
        assert (out / f"{name}.svg").stat().st_size > 5000
    with (out / "bias.csv").open() as file:
        rows = list(csv.reader(file))
    assert float(rows[9][2]) == pytest.approx(-5.53, abs=0.001)  # x = 0.5, equation (13)
    at_20 = next(p for p in document["causes"] if (p["input_rate_dps"], p["lock_in_rate_dps"]) == (1.0, 0.05))
    assert at_20["formula_percent"] == pytest.approx(-0.0624, abs=1e-3)
    assert at_20["peak_percent"]["boxcar"] > 50
    assert any("5 %" in text for text in document["conclusions"])


@pytest.mark.slow
def test_one_figure_only(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "--figure", "2", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document["figures"]) == ["2"]
    assert "bias" not in document
    second = document["figures"]["2"]
    assert second["beat_frequency_hz"] == pytest.approx(1732.0508, abs=1e-3)
    assert second["lock_in_rate_by_least_squares_dps"] == pytest.approx(0.5, rel=1e-6)
    assert main(["study", "--figure", "4"]) == 0
    text = capsys.readouterr().out
    assert "Fig. 4" in text
    assert "Hann" in text


@pytest.mark.parametrize("options", [("--figure", "7"), ("--format", "doc"), ("--config", "no-such-file.toml")])
def test_study_refuses(options: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "--json", *options]) == 2
    assert json.loads(capsys.readouterr().out)["error"]["exit_code"] == 2


def test_out_must_be_a_directory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("x")
    assert main(["study", "--json", "--figure", "2", "--out", str(tmp_path / "file")]) == 2
    assert json.loads(capsys.readouterr().out)["error"]["kind"] == "file"
