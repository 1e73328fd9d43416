"""`gyrolock measure` with photodiodes on the single beams: saved beside the beat, fitted with it, told."""

import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from station.runs.store import open_run

PLAN = "[measurement]\nrates_over_lock_in = [3, 6, 20]\nboth_senses = true\nrecords = 3\ntilt_records = 2\n"
LASER = (
    "[simulation.contaminants]\nbackscatter_phase_sum_deg = 70.0\nbackscatter_ratio = 1.7\n"
    "gain_corner_hz = 300.0\nbeam_imbalance = 0.06\ngain_dispersion = -0.01\n"
    "[simulation.beams]\ncrosstalk_db = -50.0\n"
)
BAND = "dead_band_dps = 0.012\ndead_band_u_dps = 0.0002\n"
BEAMS = '[beams]\nchannels = ["CH2", "CH3"]\n'


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with beams; the folder that it was taken in."""
    import subprocess
    import sys

    folder = tmp_path_factory.mktemp("beams")
    (folder / "my.toml").write_text(PLAN + LASER + BEAMS)
    command = [sys.executable, "-m", "station.cli", "measure", "--config", "my.toml", "--seed", "4", "--json"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (folder / "measured.json").write_text(done.stdout)
    return folder


def document(folder: Path) -> dict:
    return json.loads((folder / "measured.json").read_text())


@pytest.mark.slow
def test_beams_are_saved_with_their_beat_and_told(taken: Path) -> None:
    said = document(taken)
    run = open_run(taken / said["run"])
    purposes = [record.purpose for record in run.records if record.purpose != "tilt"]
    assert purposes == ["measure", "beam 1", "beam 2"] * 18
    assert [record.conditions["channel"] for record in run.records[-3:]] == ["CH1", "CH2", "CH3"]
    assert run.facts["beam_levels_v"] == pytest.approx([1.0, 0.8], rel=0.03)
    # the truth of the simulated laser: WL = |a1 (1 - i h) e^(-i eps/2) + a2 (1 + i h) e^(i eps/2)|/(2 pi K)
    together = abs(complex(1, 0.01) + 1.7 * complex(1, -0.01) * complex(0.3420201433, 0.9396926208))
    beams = said["beams"]
    assert abs(beams["backscatter_1_hz"] - 20 / together) < 4 * beams["backscatter_1_u_hz"]
    assert abs(beams["backscatter_2_hz"] - 34 / together) < 4 * beams["backscatter_2_u_hz"]
    assert abs(beams["backscatter_phase_sum_rad"] - 1.2217) < 4 * beams["backscatter_phase_sum_u_rad"]
    assert abs(beams["gain_corner_hz"] / 300 - 1) < 0.01
    assert abs(said["lock_in_rate_dps"] - 0.01) < 3 * said["lock_in_rate_u_dps"]
    assert [route["route"] for route in said["routes"]] == ["harmonics", "beams", "frequencies"]
    harmonics = said["routes"][0]
    assert said["lock_in_rate_u_dps"] < 0.5 * harmonics["lock_in_rate_u_dps"]
    assert said["several_rates"]["by_beat"]["lock_in_rate_dps"] == beams["lock_in_rate_dps"]
    assert "table_mismatch" not in said["flags"]
    report = (taken / said["report"]).read_text()
    assert "Single beams" in report
    assert "all together" in report


@pytest.mark.slow
def test_analysis_again_gives_the_same(gyrolock, taken: Path) -> None:
    run = taken / document(taken)["run"]
    again = gyrolock("analyze", run, "--json").document
    for name in ("lock_in_rate_dps", "lock_in_rate_u_dps", "beams", "routes"):
        assert again[name] == document(taken)[name]
    # a level that was measured better
    Path(run.parent / "known.toml").write_text("[beams]\nlevel_v = [1.0, 0.8]\nlevel_u_percent = 0.2\n" + BAND)
    better = gyrolock("analyze", run, "--config", run.parent / "known.toml", "--json").document
    assert better["lock_in_rate_u_dps"] <= again["lock_in_rate_u_dps"] * 1.01
    assert abs(better["lock_in_rate_dps"] - 0.01) < 3 * better["lock_in_rate_u_dps"]
    # the dead band is a route beside the others, and one that lies apart is told
    assert better["routes"][-1] == {
        "route": "dead band", "lock_in_rate_dps": 0.012, "lock_in_rate_u_dps": 0.0002,
        "lock_in_rate_low_95_dps": pytest.approx(0.011608, abs=1e-6),
        "lock_in_rate_high_95_dps": pytest.approx(0.012392, abs=1e-6),
    }  # fmt: skip
    assert better["beams"]["routes_chi_square"] > again["beams"]["routes_chi_square"] + 50
    assert "routes_differ" in better["beams"]["flags"]
    # these beams differ by 12 % in the laser
    Path(run.parent / "equal.toml").write_text("[beams]\nunequal_limit_percent = 0.1\n")
    equal = gyrolock("analyze", run, "--config", run.parent / "equal.toml", "--json").document
    assert "misfit" in equal["beams"]["flags"] and "misfit" not in again["beams"]["flags"]


def test_a_dead_band_that_stands_beside_no_beams_is_not_passed_over(gyrolock, tmp_path: Path) -> None:
    run = Path(shutil.copy(Path(__file__).parents[1] / "golden" / "several.sqlite", tmp_path / "run.sqlite"))
    (tmp_path / "my.toml").write_text("[beams]\n" + BAND)
    assert "dead_band_dps is compared beside them only" in gyrolock("analyze", run, "--config", "my.toml").out
    assert "dead_band_dps" not in gyrolock("analyze", run).out


@pytest.mark.slow
def test_a_damaged_beam_costs_itself(gyrolock, taken: Path, tmp_path: Path) -> None:
    run = tmp_path / "run.sqlite"
    run.write_bytes((taken / document(taken)["run"]).read_bytes())
    with closing(sqlite3.connect(run)) as db, db:
        numbers = [n for (n,) in db.execute("SELECT number FROM record WHERE purpose = 'beam 2'")]
        blob = db.execute("SELECT payload FROM record WHERE number = ?", (numbers[4],)).fetchone()[0]
        changed = bytes([blob[0] ^ 1]) + blob[1:]
        db.execute("UPDATE record SET payload = ? WHERE number = ?", (changed, numbers[4]))
    done = gyrolock("analyze", run, "--json")
    assert done.document["records"] == 18
    assert done.document["beams"]["lock_in_rate_dps"] != document(taken)["beams"]["lock_in_rate_dps"]
    assert abs(done.document["lock_in_rate_dps"] - 0.01) < 3 * done.document["lock_in_rate_u_dps"]


@pytest.mark.slow
def test_files_of_a_memory_card_hold_beams_too(gyrolock, taken: Path, tmp_path: Path) -> None:
    done = gyrolock("export", taken / document(taken)["run"], "--tek-csv", tmp_path / "card", "--json")
    assert done.code == 0
    folder = tmp_path / "card" / "measure"
    assert sorted(path.name for path in (folder / "ALL0000").iterdir()) == [
        "F0000CH1.CSV", "F0000CH2.CSV", "F0000CH3.CSV",
    ]  # fmt: skip
    beats = sorted(folder.glob("*/F*CH1.CSV"))
    run = open_run(taken / document(taken)["run"])
    rates = [record.conditions["table_rate_dps"] for record in run.taken_for("measure")]
    share = 0.0228093  # cosine of the tilt
    lines = [f"{path},{rate * share!r}" for path, rate in zip(beats, rates, strict=True)]
    (tmp_path / "rates.csv").write_text("file,input_rate_dps\n" + "\n".join(lines) + "\n")
    (tmp_path / "my.toml").write_text(BEAMS + "level_v = [1.0, 0.8]\n")
    options = ["--combine", "--scale-factor", 2000, "--rates-from", "rates.csv", "--config", "my.toml", "--json"]
    done = gyrolock("analyze", folder, *options)
    assert done.code == 0, done.err
    beams = done.document["beams"]
    assert abs(beams["backscatter_phase_sum_rad"] - 1.2217) < 4 * beams["backscatter_phase_sum_u_rad"]
    assert abs(done.document["lock_in_rate_dps"] - 0.01) < 3 * done.document["lock_in_rate_u_dps"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("beams", "said"),
    [
        ('channels = ["CH2"]\n', "single beams"),
        ('channels = ["CH3"]\nlevel_v = [0.001]\n', "exchanged"),
        ('channels = ["CH4", "CH2"]\nlevel_v = [1.0, 1.0]\ncoupling = "DC"\n', "single beams"),
    ],
)
def test_what_is_left_of_odd_beams(gyrolock, tmp_path: Path, beams: str, said: str) -> None:
    (tmp_path / "my.toml").write_text(PLAN.replace("records = 3", "records = 2") + LASER + "[beams]\n" + beams)
    done = gyrolock("measure", "--config", "my.toml", "--full", "--no-report")
    assert done.code == 0, done.err
    assert said in done.out
    assert "the truth is 0.01 deg/s" in done.out


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[beams]\nchannels = ["CH1"]\n', "beams.channels"),
        ('[beams]\nchannels = ["CH2", "CH2"]\n', "beams.channels"),
        ('[beams]\nchannels = ["CH2", "CH3", "CH4"]\n', "channels"),
        ('[beams]\nchannels = ["CH5"]\n', "channels"),
        ('[beams]\nchannels = ["CH2"]\nlevel_v = [1.0, 2.0]\n', "beams.level_v"),
        ('[beams]\nchannels = ["CH2"]\nlevel_v = [-1.0]\n', "level_v"),
        ('[scope]\nquadrature_channel = "CH2"\n[beams]\nchannels = ["CH3"]\n', "not both"),
        ('[simulation]\nscope_model = "TDS2002"\n[beams]\nchannels = ["CH3"]\n', "CH3"),
    ],
)
def test_mistakes_in_the_settings_of_beams(gyrolock, tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "my.toml").write_text(text)
    done = gyrolock("measure", "--config", "my.toml", "--json")
    assert done.code in (2, 3)
    assert said in done.document["error"]["message"]
