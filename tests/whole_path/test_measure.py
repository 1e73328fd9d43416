"""`gyrolock measure` from the empty directory to the report, through real byte streams."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from station.live.events import Progress
from station.lock_in.measurement import MEASUREMENT
from station.lock_in.settings import load_settings
from station.runs.store import SavedRun, open_run
from station.settings import shipped_settings
from station.shell.finish import evaluate_run, resume_run, start_run
from tests.ideal_bench import IDEAL_TOML, Interrupting, ideal_bench

IDEAL = ("--config", "ideal.toml")
KEYS = {
    "lock_in_rate_dps",
    "lock_in_rate_u_dps",
    "lock_in_rate_low_95_dps",
    "lock_in_rate_high_95_dps",
    "input_rate_dps",
    "beat_frequency_hz",
    "ratio",
    "records",
    "records_rejected",
    "method",
    "flags",
    "run",
    "truth",
}


@pytest.mark.slow
def test_one_command_gives_rate_run_and_report(gyrolock, tmp_path: Path) -> None:
    done = gyrolock("measure", *IDEAL, "--seed", 5, "--json")
    assert done.code == 0, done.err
    result = done.document
    assert result.keys() >= KEYS
    assert result["truth"]["lock_in_rate_dps"] == 0.01
    u = result["lock_in_rate_u_dps"]
    assert 0 < u < 0.005 * 0.01
    assert abs(result["lock_in_rate_dps"] - 0.01) < 4 * u
    assert result["lock_in_rate_low_95_dps"] < result["lock_in_rate_dps"] < result["lock_in_rate_high_95_dps"]
    truth = result["truth"]
    assert result["beat_frequency_hz"] == pytest.approx(truth["beat_frequency_hz"], rel=1e-4)
    assert result["input_rate_dps"] == pytest.approx(truth["input_rate_dps"], rel=1e-4)
    assert result["ratio"] == pytest.approx(truth["ratio"], abs=5 * result["ratio_u"])
    assert result["backscatter_phase_rad"] == pytest.approx(truth["backscatter_phase_rad"], abs=0.01)
    assert result["tilt_deg"] == pytest.approx(88.693, abs=5 * result["tilt_u_deg"])
    assert result["table_check"]["beat_over_table"] == pytest.approx(1.0, abs=3e-4)
    assert (result["records"], result["records_rejected"]) == (20, 0)
    # white noise looks coloured in one record of some hundred
    assert set(result["flags"]) <= {"coloured_noise"}
    run = tmp_path / result["run"]
    assert run.is_file()
    assert (run.parent / "report.html").is_file()
    assert "Traceback" not in done.err


@pytest.mark.slow
def test_the_saved_run_gives_the_same_numbers_again(gyrolock, tmp_path: Path) -> None:
    first = gyrolock("measure", *IDEAL, "--records", 4, "--json", "--no-report").document
    again = gyrolock("analyze", first["run"], "--json")
    assert again.code == 0
    assert again.document["lock_in_rate_dps"] == first["lock_in_rate_dps"]
    run = open_run(tmp_path / first["run"])
    assert run.results is not None
    assert run.results["lock_in_rate_dps"] == first["lock_in_rate_dps"]
    assert not (run.path.parent / "report.html").exists()
    assert run.facts["outcome"] == "complete"
    assert run.facts["identity"]["model"].startswith("TDS")
    assert run.facts["provenance"]["packages"]["numpy"] == np.__version__
    assert len(run.taken_for("tilt")) == 8
    record = run.taken_for("measure")[0]
    assert record.codes.shape == (2500,)
    assert 85 <= np.abs(record.codes.astype(int)).max() <= 110


def measured(folder: Path, seed: int, records: int) -> SavedRun:
    """Take a run in this process, which spares the time to start another."""
    overrides = ideal_bench(
        measurement={"records": records},
        simulation={"seed": seed, "link": "tcp"},
        output={"directory": str(folder)},
    )
    taken = start_run(MEASUREMENT, load_settings(overrides=overrides), Progress())
    assert taken.failure is None
    return open_run(taken.path)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_codes(tmp_path: Path) -> None:
    runs = [measured(tmp_path, seed, records=2) for seed in (3, 3, 4)]
    codes = [np.stack([record.codes for record in run.records]) for run in runs]
    assert np.array_equal(codes[0], codes[1])
    assert not np.array_equal(codes[0], codes[2])


def test_a_person_reads_a_table_and_progress_stays_on_stderr(gyrolock) -> None:
    done = gyrolock("measure", *IDEAL, "--records", 3)
    assert done.code == 0
    assert re.search(r"lock-in rate +0\.0\d+ ± 0\.0\d+ deg/s = 3\d\.\d+ ± 0\.\d+ deg/h \(95 %\)", done.out)
    assert re.search(r"quality +good", done.out)
    assert len(done.out.splitlines()) <= 12
    assert "the truth is 0.01 deg/s" in done.out
    assert "run.sqlite" in done.out
    assert "records 3/3" in done.err
    assert "records 3/3" not in done.out


@pytest.mark.slow
@pytest.mark.parametrize("link", ["tcp", "pty"])
def test_both_links_of_the_simulated_bench(gyrolock, tmp_path: Path, link: str) -> None:
    (tmp_path / "my.toml").write_text(
        f'[simulation]\nlink = "{link}"\n[measurement]\nrecords = 2\nrates_over_lock_in = [8]\n'
    )
    done = gyrolock("measure", "--config", "my.toml", "--json", "--no-report")
    assert done.code == 0, done.err
    assert done.document["records"] == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "lock_in_rate"),
    [
        ("[simulation]\nlock_in_rate_dps = 0.02\n[gyro]\nexpected_lock_in_rate_dps = 0.011\n", 0.02),
        ('[simulation]\nscope_model = "TDS2014C"\n[scope]\nchannel = "CH3"\nprobe = 10\n', 0.01),
        pytest.param(
            "[simulation]\namplitude_v = 0.011\noffset_v = -0.02\ndetector_noise_v = 1e-4\n",
            0.01,
            marks=pytest.mark.slow,
        ),
        ("[simulation]\namplitude_v = 9\noffset_v = 2.5\n", 0.01),
        pytest.param("[simulation]\ntilt_deg = 60.0\n", 0.01, marks=pytest.mark.slow),
        ("[table]\nboth_senses = false\nfast_rate_dps = 80\n[site]\nlatitude_deg = -60\n", 0.01),
        ('[table]\nkind = "none"\n', 0.01),
    ],
)
def test_other_benches(gyrolock, tmp_path: Path, changes: str, lock_in_rate: float) -> None:
    (tmp_path / "my.toml").write_text(IDEAL_TOML + changes)
    done = gyrolock("measure", "--config", "my.toml", "--records", 6, "--json", "--no-report")
    assert done.code == 0, done.err
    result = done.document
    assert result["truth"]["lock_in_rate_dps"] == lock_in_rate
    assert abs(result["lock_in_rate_dps"] - lock_in_rate) < 4 * result["lock_in_rate_u_dps"]
    assert result["lock_in_rate_u_dps"] < 0.02 * lock_in_rate


def test_the_truth_lies_where_the_uncertainty_says(tmp_path: Path) -> None:
    distances = []
    for seed in range(6):
        combined = evaluate_run(measured(tmp_path, seed, records=5)).found.combined
        distances.append((combined.lock_in_rate - 0.01) / combined.lock_in_rate_u)
    assert np.abs(distances).max() < 4
    assert 0.3 < np.sqrt(np.mean(np.square(distances))) < 1.8


@pytest.mark.slow
def test_a_gyro_that_stays_locked_is_no_usable_signal(gyrolock, tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text("[simulation]\nlock_in_rate_dps = 5000.0\n")
    done = gyrolock("measure", "--config", "my.toml", "--json")
    assert done.code == 4, done.err
    assert done.document["error"]["kind"] == "no_usable_signal"
    assert done.document["error"]["exit_code"] == 4
    assert len(done.err.strip().splitlines()[-1]) < 250


def test_acquire_only_saves(gyrolock, tmp_path: Path) -> None:
    done = gyrolock("acquire", *IDEAL, "--records", 2, "--json", "--out", "elsewhere")
    assert done.code == 0
    assert done.document["records"] == 2
    run = open_run(tmp_path / done.document["run"])
    assert run.path.parent.parent == tmp_path / "elsewhere"
    assert run.results is None
    assert evaluate_run(run).found.usable


@pytest.mark.slow
def test_a_real_scope_without_table_is_its_own_reference(gyrolock, serve_scope) -> None:
    scope = serve_scope("--tcp", "0", *IDEAL)
    named = ("--resource", scope.resource, "--scale-factor", "2000")
    done = gyrolock("measure", *named, "--records", 3, "--json")
    assert done.code == 0, done.err
    result = done.document
    assert "truth" not in result
    assert "tilt_deg" not in result
    assert abs(result["lock_in_rate_dps"] - 0.01) < 4 * result["lock_in_rate_u_dps"]
    again = gyrolock("measure", *named, "--records", 1, "--json")
    assert again.code == 0


@pytest.mark.slow
def test_settings_can_be_copied_and_used(gyrolock, tmp_path: Path) -> None:
    printed = gyrolock("settings", "simulated")
    assert printed.out == shipped_settings("simulated").read_text(encoding="utf-8")
    (tmp_path / "copy.toml").write_text(printed.out, encoding="utf-8")
    done = gyrolock("measure", "--config", "copy.toml", "--records", 1, "--json", "--no-report")
    assert done.code == 0
    values = json.loads(gyrolock("settings", "bench", "--json").out)
    assert values["table"]["kind"] == "none"


@pytest.mark.slow
def test_the_shipped_bench_is_a_real_one_and_the_default_sees_what_spoils_it(gyrolock) -> None:
    done = gyrolock("measure", "--seed", 2, "--json", "--no-report", timeout=200)
    assert done.code == 0, done.err
    result = done.document
    assert result["lock_in_rate_low_95_dps"] < 0.01 < result["lock_in_rate_high_95_dps"]
    assert result["lock_in_rate_high_95_dps"] - result["lock_in_rate_low_95_dps"] < 0.02 * 0.01
    assert result["records"] == 40
    fit = result["several_rates"]["by_beat"]
    assert fit["distortion_dbc"] == pytest.approx(-50.0, abs=1.0)
    assert fit["gain_corner_low_95_hz"] < 3000 * 1.02
    assert fit["gain_corner_high_95_hz"] > 3000 * 0.98
    assert "Hz: found and removed" in gyrolock("analyze", result["run"], "--full").out
    # one rate alone would have been wrong
    assert max(abs(rate["lock_in_rate_dps"] / 0.01 - 1) for rate in result["several_rates"]["rates"]) > 0.1


FEW = {"records": 2, "tilt_records": 2}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gyro", "true"),
    [
        ({"expected_lock_in_rate_dps": 0.0005, "scale_factor_pulses_per_deg": 200.0}, 0.0005),  # beats of a second
        pytest.param({"expected_lock_in_rate_dps": 0.2}, 0.01, marks=pytest.mark.slow),  # a guess that is far off
        ({"expected_lock_in_rate_dps": 0.0004}, 0.01),  # so far that the gyro is locked at the fastest rate
    ],
)
def test_any_gyro_is_measured(tmp_path: Path, gyro: dict[str, float], true: float) -> None:
    overrides = ideal_bench(
        gyro=gyro,
        measurement={"rates_over_lock_in": "auto", **FEW},
        simulation={"seed": 3, "link": "tcp", "lock_in_rate_dps": true},
        output={"directory": str(tmp_path)},
    )
    taken = start_run(MEASUREMENT, load_settings(overrides=overrides), Progress())
    assert taken.failure is None
    found = evaluate_run(open_run(taken.path)).found
    assert found.several is not None
    over = [abs(group.input_rate) / true for group in found.several.groups]
    assert 1.5 < min(over) < 15
    assert abs(float(found.combined.lock_in_rate) - true) < 4 * float(found.combined.lock_in_rate_u)


@pytest.mark.slow
def test_a_run_whose_rates_were_chosen_anew_goes_on_with_them(tmp_path: Path) -> None:
    overrides = ideal_bench(
        gyro={"expected_lock_in_rate_dps": 0.05},
        measurement={"rates_over_lock_in": "auto", **FEW},
        simulation={"seed": 3, "link": "tcp"},
        output={"directory": str(tmp_path)},
    )
    settings = load_settings(overrides=overrides)
    whole = open_run(start_run(MEASUREMENT, settings, Progress()).path)
    cut = start_run(MEASUREMENT, settings, Interrupting(after=9))
    assert cut.failure is not None
    resume_run(cut.path, Progress(), kind=MEASUREMENT)
    assert [record.key for record in open_run(cut.path).records] == [record.key for record in whole.records]
    assert open_run(cut.path).facts["plan"] == whole.facts["plan"]
    assert whole.facts["plan"]["changes"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("table", ["simulated", "none"])
def test_a_bench_without_a_signal_has_no_beat(gyrolock, tmp_path: Path, table: str) -> None:
    (tmp_path / "my.toml").write_text(f'[table]\nkind = "{table}"\n[simulation]\namplitude_v = 0.0\n')
    done = gyrolock("measure", "--config", "my.toml", "--json")
    assert done.code == 4
    assert "no beat" in done.document["error"]["message"]
