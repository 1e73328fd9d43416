"""--noise: the noise model of another run, of its JSON or of a data sheet, in table run and self-calibration."""

import json
import math
from pathlib import Path

import pytest

from station.errors import UsageError
from station.fibre_gyro.allan import NOISE, noise_facts, noise_of
from station.fibre_gyro.segments import begins_of, segments_of
from station.shell.finish import evaluate_run

SHORT = {"table": {"axes": ["Z"], "turns": 8, "rates_dps": [20.0, 40.0, 60.0]}, "selfcal": {"step_s": 5.0}}


@pytest.fixture
def sheet(tmp_path: Path) -> Path:
    path = tmp_path / "sheet.json"
    path.write_text(json.dumps({"angle_random_walk_deg_per_sqrt_h": 0.005, "bias_instability_dph": 3.0}))
    return path


@pytest.fixture(scope="module")
def budget_adds_up():
    def check(budget) -> None:
        total = math.sqrt(sum(line["contribution_ppm"] ** 2 for line in budget["inputs"]))
        assert total == pytest.approx(budget["combined_u_ppm"], rel=1e-3)
        assert sum(line["share_of_variance"] for line in budget["inputs"]) == pytest.approx(1.0)
        assert all(line["note"] for line in budget["inputs"])

    return check


def test_a_table_run_counts_the_noise_model(taken, sheet: Path, budget_adds_up) -> None:
    before, run = taken("table", **SHORT)
    after = evaluate_run(run, choices=noise_facts(sheet))
    plain, counted = (one.document()["axes"][0] for one in (before, after))
    assert counted["scale_factor_u_ppm"] > 3 * plain["scale_factor_u_ppm"]
    assert counted["noise_model"] == str(sheet)
    for axis in (plain, counted):
        budget_adds_up(axis["budget"])
    lines = {line["name"]: line for line in counted["budget"]["inputs"]}
    assert counted["budget"]["largest_part"] == "slow noise"
    assert lines["noise"]["note"] == "0.005 deg/√h, by the noise model"
    assert any("the noise model rules" in said for said in after.result.sentences)
    assert "slow noise" in plain["budget"]["not_stated"]
    assert plain["linearity"]["terms"] == [] and counted["linearity"]["nonlinearity_rms_low_95_ppm"] == 0


def test_a_self_calibration_counts_it_too(taken, sheet: Path, budget_adds_up) -> None:
    before, run = taken("selfcal", **SHORT)
    after = evaluate_run(run, choices=noise_facts(sheet))
    assert after.document()["self_minus_numbers_u_ppm"] > 2 * before.document()["self_minus_numbers_u_ppm"]
    for one in (before, after):
        budget_adds_up(one.document()["budget"])


def test_a_noise_model_comes_from_a_run_or_its_json(taken, tmp_path: Path) -> None:
    found, run = taken("allan", allan={"record_s": 120.0})
    of_run = noise_facts(run.path)[NOISE]["gyros"][""]
    walk = found.document()["angle_random_walk_deg_per_sqrt_h"]
    assert 60 * of_run["angle_random_walk"] == pytest.approx(walk)
    path = tmp_path / "allan.json"
    path.write_text(json.dumps(found.document()))
    assert noise_facts(path)[NOISE]["gyros"][""] == pytest.approx(of_run)
    model = noise_of(run, noise_facts(path), "Z")
    assert model is not None and model.source == str(path)
    assert noise_of(run, {}, "Z") is None and noise_facts(None) == {}
    begins = begins_of(segments_of(run, "allan"))
    assert len(begins) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("no json", "neither a run of `gyrolock fog allan` nor its JSON"),
        ("[1]", "neither a run of `gyrolock fog allan` nor its JSON"),
        ('{"a": 1}', "holds no noise model; it has numbers under the names quantization_deg"),
        ('{"bias_instability_dph": -1}', "bias_instability_dph: -1 is no number of deg/h, 0 or more"),
    ],
)
def test_what_is_no_noise_model_is_told(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "noise.json"
    path.write_text(text)
    with pytest.raises(UsageError, match=said):
        noise_facts(path)


@pytest.mark.slow
def test_another_run_is_no_noise_model(taken) -> None:
    _, run = taken("eps", eps={"record_s": 0.5})
    with pytest.raises(UsageError, match="a noise model comes from `gyrolock fog allan`"):
        noise_facts(run.path)
