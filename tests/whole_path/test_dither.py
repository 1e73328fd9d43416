"""`gyrolock measure --dither on`: planned, taken, gone on with, read again, refused, compared."""

import contextlib
import io
import json
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from analysis.ring_laser import Dither, DitheredFringe, Gyro, Winking
from benchmarks.dithered import hour_of_counts
from station.cli import main
from station.lock_in.settings import load_settings
from station.plan import predict
from station.runs.store import open_run


def gyrolock(folder: Path, words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "station.cli", *words.split()]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def told(folder: Path, words: str) -> dict[str, Any]:
    """The JSON of a command, run in this process."""
    out = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out):
        main([*words.split(), "--json"])
    return dict(json.loads(out.getvalue()))


RECORDS = 6


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dither")
    (folder / "my.toml").write_text(
        "[simulation]\nlock_in_rate_dps = 0.03\n[budget]\nscale_factor_u_ppm = 5000.0\n"
    )
    done = gyrolock(folder, f"measure --dither on --config my.toml --records {RECORDS} --seed 6 --json")
    assert done.returncode == 0, done.stderr
    (folder / "said.json").write_text(done.stdout)
    return folder


@pytest.mark.slow
def test_a_dithered_gyro_is_measured(taken: Path) -> None:
    said = json.loads((taken / "said.json").read_text())
    assert said["command"] == "dither"
    assert (said["lock_in_rate_low_95_dps"], said["lock_in_rate_high_95_dps"]) == pytest.approx(
        (said["lock_in_rate_dps"], said["lock_in_rate_dps"]), abs=2.2 * said["lock_in_rate_u_dps"]
    )
    assert abs(said["lock_in_rate_dps"] - 0.03) < 3 * said["lock_in_rate_u_dps"] < 0.009
    # what all records share is added to what their noise makes
    shared = 0.005 * said["lock_in_rate_dps"]
    assert said["lock_in_rate_u_dps"] == pytest.approx(
        np.hypot(said["lock_in_rate_noise_u_dps"], shared), rel=1e-3
    )
    assert said["dither_rate_dps"] == pytest.approx(100, rel=0.02)
    assert said["dither_frequency_hz"] == pytest.approx(403, rel=0.01)
    per_walk = np.sqrt(2 * np.pi * 2000 * said["dither_rate_dps"])  # (2.13)
    assert 60 * said["lock_in_rate_dps"] / per_walk == pytest.approx(said["random_walk_deg_per_sqrt_h"], rel=1e-6)
    report = (taken / said["report"]).read_text()
    assert "dither turns over" in report and report.count("<svg") == 2


@pytest.mark.slow
def test_it_is_evaluated_again_and_beside_a_random_walk(taken: Path) -> None:
    said = json.loads((taken / "said.json").read_text())
    again = told(taken, f"analyze {said['run']}")
    assert again["lock_in_rate_dps"] == said["lock_in_rate_dps"]
    half = told(taken, f"analyze {said['run']} --scale-factor 1000")
    assert half["lock_in_rate_dps"] == pytest.approx(2 * said["lock_in_rate_dps"], rel=1e-6)
    assert (said["flags"], half["flags"]) == ([], ["dither_larger"])
    for share, flagged, known in ((1.3, False, 0.02), (0.2, True, 0.02), (0.2, True, 0.0), (0.9, False, 0.0)):
        walk = share * said["random_walk_deg_per_sqrt_h"]
        (taken / "walk.toml").write_text(
            f"[dither]\nrandom_walk_deg_per_sqrt_h = {walk}\nrandom_walk_u_deg_per_sqrt_h = {known * walk}\n"
        )
        beside = told(taken, f"analyze {said['run']} --config walk.toml")
        assert beside["by_random_walk"]["lock_in_rate_dps"] == pytest.approx(
            share * said["lock_in_rate_dps"], rel=1e-6
        )
        assert ("walk_too_small" in beside["flags"]) == flagged
        assert (beside["standing"] == "doubtful") == flagged
    # the counts tell it themselves; what they are not, they do not tell
    counts = hour_of_counts(np.random.default_rng(3), 2000.0, said["lock_in_rate_dps"], 100.0, 1000)
    swing = np.diff(np.rint(80 * np.sin(2 * np.pi * np.random.default_rng(4).uniform(size=1001)))).astype(int)
    for told_counts, flagged in ((counts, False), (counts + swing, True)):
        (taken / "counts.csv").write_text("counts\n" + "\n".join(map(str, told_counts)) + "\n")
        (taken / "counts.toml").write_text('[dither]\ncounts = "counts.csv"\n')
        beside = told(taken, f"analyze {said['run']} --config counts.toml")
        assert ("counts_do_not_walk" in beside["flags"]) == (beside["by_random_walk"] is None) == flagged
        assert beside["standing"] == "stands"
        if not flagged:
            low, high = (beside["by_random_walk"][f"lock_in_rate_{end}_95_dps"] for end in ("low", "high"))
            assert low < said["lock_in_rate_dps"] < high < 1.5 * low
    (taken / "counts.csv").write_text("3\n" * 300)
    still = told(taken, f"analyze {said['run']} --config counts.toml")
    assert (still["flags"], still["by_random_walk"], still["standing"]) == (["walk_not_seen"], None, "stands")
    for text, why in (("1\n2\n3.5\n", "line 3: not a whole number"), ("1\n" * 150, "150 gates")):
        (taken / "counts.csv").write_text(text)
        refused = gyrolock(taken, f"analyze {said['run']} --config counts.toml")
        assert refused.returncode == 2 and why in refused.stderr
    # another dither than the one that was there is no number
    (taken / "wrong.toml").write_text("[dither]\nfrequency_hz = 520.0\n")
    wrong = gyrolock(taken, f"analyze {said['run']} --config wrong.toml")
    assert wrong.returncode == 4 and "no record of the dithered gyro can be used" in wrong.stderr


@pytest.mark.slow
def test_it_is_planned(taken: Path) -> None:
    """The bound of Cramér and Rao is what a run gives, and the records planned are those that it takes."""
    said = json.loads((taken / "said.json").read_text())
    plan = told(taken, "plan --dither on --lock-in-rate 0.03 --wanted 3 --config my.toml")
    row = next(row for row in plan["time_bases"] if row["dither_periods"] == pytest.approx(2, rel=0.05))
    u = 0.03 * row["u_percent_of_one_record"] / 100
    assert said["lock_in_rate_noise_u_dps"] == pytest.approx(u / np.sqrt(RECORDS), rel=0.4)
    left = np.sqrt(9 - plan["floor_u_percent"] ** 2)
    assert row["records"] == np.ceil((row["u_percent_of_one_record"] / left) ** 2)
    assert plan["best"] in plan["time_bases"] and plan["reached"] and plan["floor_u_percent"] < 1
    assert not told(taken, "plan --dither on --wanted 0.01 --config my.toml")["reached"]
    settings = load_settings(taken / "my.toml")
    known = settings.gyro.model_copy(update={"expected_lock_in_rate_dps": 0.03})
    predicted = predict("dither", settings.model_copy(update={"gyro": known}).model_dump(mode="json"))
    assert predicted.u == pytest.approx(u / np.sqrt(settings.dither.records), rel=0.05)
    assert predict("measure", settings.model_dump(mode="json")).u < predicted.u
    for option in ("--plot plan.png", "--rates best", "--both-senses", "--tilt 3"):
        refused = gyrolock(taken, f"plan --dither on {option}")
        assert refused.returncode == 2 and option.split()[0] in refused.stderr


@pytest.mark.slow
def test_it_is_gone_on_with(taken: Path) -> None:
    said = json.loads((taken / "said.json").read_text())
    run = open_run(taken / said["run"])
    assert [record.purpose for record in run.records] == ["dither"] * RECORDS
    assert gyrolock(taken, f"measure --resume {said['run']}").returncode == 2  # it is finished
    done = gyrolock(taken, "measure --dither on --records 3 --seed 3 --no-report --out cut")
    assert done.returncode == 0, done.stderr
    cut = next((taken / "cut").iterdir()) / "run.sqlite"
    with closing(sqlite3.connect(cut)) as database, database:
        database.execute("DELETE FROM run WHERE name IN ('outcome', 'ended_at')")
        database.execute("DELETE FROM record WHERE number = (SELECT max(number) FROM record)")
    gone_on = gyrolock(taken, f"measure --resume {cut.parent} --json")
    assert gone_on.returncode == 0, gone_on.stderr
    assert json.loads(gone_on.stdout)["records"] == 3
    assert len(open_run(cut).taken_for("dither")) == 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "options", "says"),
    [
        ("[gyro]\nscale_factor_pulses_per_deg = 2e3\n", "--resource TCPIP::127.0.0.1::1::SOCKET", "is not stated"),
        ("[dither]\nrate_dps = 9000.0\n", "", "no time base shows"),
        ("[dither]\nperiods = 0.2\n", "", "dither.periods"),
        ("", "--rates 3,8", "--rates"),
        ("[dither]\nturns = 2\n", "", "no such setting"),
    ],
)
def test_what_cannot_be_taken_is_refused(tmp_path: Path, settings: str, options: str, says: str) -> None:
    (tmp_path / "my.toml").write_text(settings)
    done = gyrolock(tmp_path, f"measure --dither on --config my.toml {options}")
    assert done.returncode == 2 and says in done.stderr
    assert "Traceback" not in done.stderr and not (tmp_path / "runs").exists()


CAMPAIGN = """
[campaign]
name = "Dither on and off"
unit_type = "RLG-2000"
station = "bench 3"
reports = false
[bench.gyro]
scale_factor_pulses_per_deg = 2000.0
expected_lock_in_rate_dps = 0.03
[bench.simulation]
lock_in_rate_dps = 0.03
[[step]]
name = "at rest"
measurement = "measure"
[step.settings.measurement]
records = 2
[[step]]
name = "dithered"
measurement = "dither"
[step.settings.dither]
records = 6
[[step.limit]]
number = "lock_in_rate_dps"
less = "at rest"
at_least = -0.01
at_most = 0.01
"""


@pytest.mark.slow
def test_a_campaign_compares_dither_on_and_off(tmp_path: Path) -> None:
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    done = gyrolock(tmp_path, "station campaign.toml --unit U1 --quiet")
    assert done.returncode == 0, done.stdout + done.stderr
    record = json.loads(next((tmp_path / "tests").rglob("record.json")).read_text())
    assert [step["verdict"] for step in record["steps"]] == [None, "PASS"]


@pytest.mark.slow
def test_the_simulated_beat_is_the_lock_in_equation() -> None:
    gyro = Gyro(500.0, 0.08, 0.7, 88.0, 28.0, winking=Winking(500.0, 0.08, 4000.0))
    fringe = DitheredFringe(gyro, Dither(60.0, 350.0, 0.03, 4), lambda times: np.full(times.shape, 0.4), 1e9)
    times = 3.0 + np.linspace(0, 6e-3, 4001)
    seen = fringe(times)
    dither = Dither(60.0, 350.0, 0.03, 4)

    def slopes(time: float, state: np.ndarray) -> list[float]:
        rate = float(dither.rate_at(np.array([time]))[0]) + 0.4
        pull = 2 * np.pi * 500.0 * 0.08
        phase, light = state
        corner = 2 * np.pi * 4000.0
        return [2 * np.pi * 500 * rate - pull * np.sin(phase), pull * np.cos(phase) - corner * light]

    begin = [float(np.angle(seen[0])), float(abs(seen[0]) - 1)]
    found = solve_ivp(slopes, (times[0], times[-1]), begin, t_eval=times, rtol=1e-9, atol=1e-10, max_step=2e-5).y
    assert np.max(np.abs(np.angle(seen * np.exp(-1j * found[0])))) < 2e-3
    assert np.max(np.abs(np.abs(seen) - 1 - found[1])) < 1e-3
    assert np.ptp(found[1]) > 0.003
    # what is asked for next goes on from there, and the same times give the same
    later = fringe(times + 6e-3)
    assert abs(np.angle(later[0] / seen[-1])) < 1e-9
    assert np.allclose(fringe(times + 6e-3), later, atol=1e-12)
