"""`gyrolock measure` at several rates and with two photodiodes: saved, fitted, told, kept when it ends early."""

import re
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from station.live.events import Progress
from station.lock_in.measurement import MEASUREMENT
from station.lock_in.settings import load_settings
from station.report.show import render_report
from station.runs.database import RunFacts
from station.runs.store import SavedRun, open_run
from station.shell.finish import evaluate_run, start_run
from tests.ideal_bench import CLEAN, Interrupting, ideal_bench

PLAN = "[measurement]\nrates_over_lock_in = [4, 15]\nboth_senses = true\nrecords = 2\ntilt_records = 2\n"
SPOILT = "[simulation.contaminants]\n" + "".join(
    f"{name} = {value}\n" for name, value in (CLEAN | {"second_harmonic_dbc": -46.0}).items()
)


def taken(folder: Path, progress: Progress | None = None, **sections: dict[str, Any]) -> SavedRun:
    overrides = ideal_bench(
        simulation={"seed": 5, "link": "tcp"} | sections.pop("simulation", {}),
        output={"directory": str(folder)},
        measurement={"records": 2, "tilt_records": 2} | sections.pop("measurement", {}),
        **sections,
    )
    settings = load_settings(overrides=overrides)
    return open_run(start_run(MEASUREMENT, settings, progress or Progress()).path)


@pytest.mark.slow
def test_no_harmonic_of_a_beat_is_measured_beside_the_mains(gyrolock, tmp_path: Path) -> None:
    # the slowest beats of this bench lie by 49 to 64 and by 97 to 112 Hz
    (tmp_path / "my.toml").write_text("[site]\nmains_hz = 50.0\n[measurement]\nrecords = 1\n")
    done = gyrolock("measure", "--config", "my.toml", "--seed", 2, "--json", "--no-report")
    run = open_run(tmp_path / done.document["run"])
    assert len(run.facts["rates"]) == 10
    assert any(abs(one["scope_setting"]["beat_frequency"]) < 60 for one in run.facts["rates"])
    for rate in run.facts["rates"]:
        knobs = rate["scope_setting"]
        for harmonic in (1, 2, 3):
            apart = min(abs(harmonic * knobs["beat_frequency"] - 50 * order) for order in range(1, 7))
            assert apart * 10 * knobs["seconds_per_division"] > 2.5  # aimed at 3, before the rate was gone to


def test_rates_are_saved_fitted_and_told(gyrolock, tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text(PLAN + SPOILT)
    done = gyrolock("measure", "--config", "my.toml", "--json")
    assert done.code == 0, done.err
    result = done.document
    assert abs(result["lock_in_rate_dps"] - 0.01) < 4 * result["lock_in_rate_u_dps"]
    assert result["records"] == 8
    several = result["several_rates"]
    assert [rate["over_expected_lock_in"] for rate in several["rates"]] == [15, 4, 4, 15]
    assert [rate["table_rate_dps"] > 0 for rate in several["rates"]] == [True, True, False, False]
    for rate in several["rates"]:
        assert rate["records"] == 2
        size = rate["over_expected_lock_in"] * 0.01
        assert abs(rate["input_rate_by_table_dps"]) == pytest.approx(size, abs=0.0045)
        # one rate alone is wrong by some of 2 W/WL times the distortion, the other way in the other sense
        error = rate["lock_in_rate_dps"] / 0.01 - 1
        assert 0.5 < abs(error) / (2 * size / 0.01 * 0.005) < 1.1
        assert (error < 0) == (rate["table_rate_dps"] > 0)
    for fit in (several["by_beat"], several["by_table"]):
        assert abs(fit["lock_in_rate_dps"] - 0.01) < 4 * fit["lock_in_rate_u_dps"]
        assert fit["distortion_dbc"] == pytest.approx(-46.0, abs=0.5)
        assert 4 <= fit["degrees_of_freedom"] <= 12
        assert len(fit["left_out"]) >= 2
    # f^2 = K^2 [(W - W0)^2 - WL^2]: no harmonic in it, so no distortion either
    other = several["by_frequency"]
    assert abs(other["lock_in_rate_dps"] - 0.01) < max(4 * other["lock_in_rate_u_dps"], 2e-5)
    assert other["scale_factor_pulses_per_deg"] == pytest.approx(2000, rel=5e-4)
    assert result["lock_in_rate_dps"] == several["by_beat"]["lock_in_rate_dps"]
    assert "distortion" in result["method"]
    names = [line["name"] for line in result["budget"]["inputs"] if line["contribution_dps"] > 0]
    assert names[0] == "noise"
    assert {"scale_factor", "time_base", "separation"} <= set(names)
    assert result["budget"]["combined_u_dps"] == result["lock_in_rate_u_dps"] > result["lock_in_rate_noise_u_dps"]
    # one rate's own values are none of the run's
    for name in ("ratio", "beat_frequency_hz", "input_rate_dps"):
        assert result[name] is None and result["truth"][name] is None
        assert all(rate[name] for rate in several["rates"])
    again = gyrolock("analyze", result["run"], "--json").document
    assert again["several_rates"] == several
    page = (tmp_path / result["report"]).read_text()
    for text in (
        "Several rates",
        "Does the model hold?",
        "Uncertainty budget",
        several["by_beat"]["sentences"][1],
    ):
        assert text in page
    refused = gyrolock("analyze", result["run"], "--input-rate", 0.08, "--json")
    assert refused.code == 2
    assert "several rates" in refused.document["error"]["message"]


@pytest.mark.slow
@pytest.mark.parametrize(("after", "groups"), [(1, 0), (3, 2), (5, 3)])
def test_a_campaign_that_is_interrupted_gives_what_it_has(tmp_path: Path, after: int, groups: int) -> None:
    plan = {"rates_over_lock_in": [6.0, 15.0], "both_senses": True}
    run = taken(tmp_path, Interrupting(after), measurement=plan)
    assert run.facts["outcome"]["exit_code"] == 130
    assert len(run.taken_for("measure")) == after + 1
    evaluation = evaluate_run(run).found
    assert (0 if evaluation.several is None else len(evaluation.several.groups)) == groups
    assert evaluation.usable
    assert abs(float(evaluation.combined.lock_in_rate) - 0.01) < 5 * float(evaluation.combined.lock_in_rate_u)


@pytest.mark.slow
def test_a_rate_inside_lock_in_is_told_and_does_not_end_the_campaign(tmp_path: Path) -> None:
    plan = {"rates_over_lock_in": [2.0, 4.5, 9.0], "both_senses": False}
    run = taken(tmp_path, measurement=plan, simulation={"lock_in_rate_dps": 0.026})
    evaluation = evaluate_run(run).found
    assert evaluation.several is not None
    assert len(evaluation.several.groups) == 2
    (missing,) = evaluation.without_beat
    assert missing.startswith("+2 ")
    assert abs(float(evaluation.combined.lock_in_rate) - 0.026) < 4 * float(evaluation.combined.lock_in_rate_u)
    document = evaluate_run(run).document()
    assert document["several_rates"]["rates_without_beat"] == [missing]
    assert "No record at +2" in render_report(evaluate_run(run))


@pytest.mark.slow
def test_two_photodiodes_are_one_acquisition(tmp_path: Path) -> None:
    run = taken(tmp_path, scope={"quadrature_channel": "CH2"}, measurement={"records": 3})
    purposes = [record.purpose for record in run.records if record.purpose != "tilt"]
    assert purposes == ["measure", "quadrature"] * 3
    assert [record.conditions["channel"] for record in run.records[-2:]] == ["CH1", "CH2"]
    evaluation = evaluate_run(run).found
    assert evaluation.quadratures is not None
    assert evaluation.quadratures.records == 3
    document = evaluate_run(run).document()
    assert document["records"] == 3
    assert document["quadratures"]["sense"] == 1
    assert "Sine and cosine" in render_report(evaluate_run(run))
    # one byte of a cosine record changes: its acquisition is left out, the others stay
    with closing(sqlite3.connect(run.path)) as db, db:
        (number,) = db.execute("SELECT max(number) FROM record").fetchone()
        (blob,) = db.execute("SELECT payload FROM record WHERE number = ?", (number,)).fetchone()
        changed = bytes([blob[0] ^ 1]) + blob[1:]
        db.execute("UPDATE record SET payload = ? WHERE number = ?", (changed, number))
    damaged = evaluate_run(open_run(run.path)).found
    assert damaged.damaged == ("3",)
    assert damaged.quadratures is not None
    assert damaged.quadratures.records == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[table]\nkind = "none"\n[measurement]\nrates_over_lock_in = [3, 8]\n', "needs? a table"),
        ('[scope]\nquadrature_channel = "CH1"\n', "quadrature_channel"),
        ("[measurement]\nrates_over_lock_in = [0.5, 3]\n", "rates_over_lock_in"),
        ('[front_end]\nresponse_file = "absent.csv"\n', "cannot be read"),
        ('[front_end]\nresponse_file = "bad.csv"\n', "line 3"),
        ("[front_end]\nresponse = [[100, 1.0, 0.0]]\n", "two frequencies"),
        ("[front_end]\nresponse = [[200, 1.0, 0.0], [100, 1.0, 0.0]]\n", "must rise"),
        ("[simulation.contaminants]\nsecond_harmonic_dbc = 3\n", "second_harmonic_dbc"),
    ],
)
def test_mistakes_in_the_settings(gyrolock, tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "my.toml").write_text(text)
    (tmp_path / "bad.csv").write_text("frequency_hz,gain,phase_deg\n100,1,0\n200,many,0\n")
    done = gyrolock("measure", "--config", "my.toml", "--json")
    assert done.code == 2
    assert re.search(said, done.document["error"]["message"])
    assert not (tmp_path / "runs").exists()


def test_a_measured_response_travels_with_the_run(tmp_path: Path) -> None:
    (tmp_path / "channel.csv").write_text(
        "# measured with a generator\nfrequency_hz, gain, phase_deg\n50, 1.0, 0\n2000, 1.0, 0\n"
    )
    (tmp_path / "my.toml").write_text('[front_end]\nresponse_file = "channel.csv"\n')
    overrides = ideal_bench(output={"directory": str(tmp_path)}, measurement={"records": 2, "tilt_records": 2})
    settings = load_settings(tmp_path / "my.toml", overrides=overrides)
    run = open_run(start_run(MEASUREMENT, settings, Progress()).path)
    (tmp_path / "channel.csv").unlink()
    evaluation = evaluate_run(run).found
    assert "corrected for the response" in evaluation.combined.noise_model
    assert evaluation.budget is not None
    assert "response" in [line.name for line in evaluation.budget.inputs]


@pytest.mark.slow
def test_a_run_of_an_earlier_version_can_still_be_read(tmp_path: Path) -> None:
    run = taken(tmp_path)
    settings = {section: dict(names) for section, names in run.facts["settings"].items() if names is not None}
    for section in ("front_end", "budget"):
        del settings[section]
    del settings["scope"]["quadrature_channel"], settings["simulation"]["contaminants"]
    del settings["measurement"]["rates_over_lock_in"], settings["measurement"]["both_senses"]
    old = replace(run, facts=RunFacts({**run.facts, "settings": settings}))
    now, then = evaluate_run(run).found, evaluate_run(old).found
    assert float(then.combined.lock_in_rate) == float(now.combined.lock_in_rate)
    assert then.budget is not None
    assert "scale_factor" in {line.name for line in then.budget.not_stated}
    assert "Uncertainty budget" in render_report(evaluate_run(old))
