"""The sweep on the simulated bench: what is taken, and that it finds the truth."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from instrument import Preamble
from station.dead_band import take as taking
from station.dead_band.measurement import MEASUREMENT
from station.dead_band.take import PURPOSE, SLOWEST_S, SweepStep, sweep, time_base
from station.errors import NoUsableSignal, SettingsError
from station.live.events import Progress
from station.ring_laser.records import Bench
from station.runs.store import SavedRun, open_run
from station.settings import load
from station.shell.finish import evaluate_run, resume_run, start_run
from tests.station.dead_band.conftest import Sweep, settings_of

QUIET = Progress()


def test_the_rates_of_one_sense_lie_between_those_of_the_other(tmp_path: Path) -> None:
    steps = sweep(settings_of(tmp_path, sweep={"steps": 4, "highest_over_lock_in": 2.0}))
    up = [step.rate_dps for step in steps if step.direction == "up"]
    np.testing.assert_allclose(np.diff(up), 0.005)
    assert [step.rate_dps for step in steps if step.direction == "down"] == up[-2::-1]
    positive, negative = ([abs(rate) for rate in up if rate * sense > 0] for sense in (1, -1))
    np.testing.assert_allclose(positive[:4], np.array(negative[::-1]) - 0.0025)


def test_rates_of_ones_own_are_taken_in_both_senses(tmp_path: Path) -> None:
    steps = sweep(settings_of(tmp_path, sweep={"rates_over_lock_in": [0.9, 1.5, 0.9]}))
    rates = [-0.015, -0.009, 0.009, 0.015, 0.009, -0.009, -0.015]
    assert [step.rate_dps for step in steps] == pytest.approx(rates)
    assert len({step.key(1) for step in steps}) == 7


def test_the_time_base_follows_from_the_rate_and_has_a_floor(tmp_path: Path) -> None:
    settings = settings_of(tmp_path, gyro={"scale_factor_pulses_per_deg": 20_000.0})
    fast, slow = (time_base(SweepStep("up", rate), settings) for rate in (0.1, 0.001))
    assert fast == 0.001  # 20 periods at 2000 Hz
    assert slow == time_base(SweepStep("up", 0.01), settings) == 0.01
    assert time_base(SweepStep("up", 0.001), settings_of(tmp_path)) == SLOWEST_S == 0.05


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("latitude", [0.0, 65.0])
def test_the_truth_lies_within_the_stated_uncertainty(sweep: Sweep, seed: int, latitude: float) -> None:
    """Lock-in rates that stand differently between the steps, without a bias and with that of the earth."""
    lock_in = 0.0085 + 0.00113 * seed
    simulation = {"seed": seed, "link": "tcp", "lock_in_rate_dps": lock_in}
    run = sweep(simulation=simulation, site={"latitude_deg": latitude}, sweep={"steps": 8})
    result = evaluate_run(run).document()
    bias = -15.041067 / 3600 * np.sin(np.radians(latitude))
    assert result["truth"]["bias_rate_dps"] == pytest.approx(bias)
    assert result["flags"] == []
    assert result["records"] == 33
    # steps of a quarter of the expected lock-in rate: gap / sqrt 12, of two senses
    assert result["lock_in_rate_u_dps"] == pytest.approx(0.0025 / np.sqrt(24), rel=0.1)
    assert abs(result["lock_in_rate_dps"] - lock_in) < 2.5 * result["lock_in_rate_u_dps"]
    assert abs(result["bias_rate_dps"] - bias) < 2.5 * result["bias_rate_u_dps"]
    assert result["dead_band_dps"] == 2 * result["lock_in_rate_dps"]
    assert result["hysteresis_dps"] == pytest.approx(0, abs=1e-6)
    assert abs(result["bias_drift_dps"]) < 3 * result["bias_drift_u_dps"] < 1.5e-4
    curve = result["hyperbola"]
    assert abs(curve["lock_in_rate_dps"] - lock_in) < 3 * curve["lock_in_rate_u_dps"] < 1e-4 * 3
    assert abs(curve["bias_rate_dps"] - bias) < 3 * curve["bias_rate_u_dps"] < 1e-4 * 3
    assert curve["scale_factor_pulses_per_deg"] == pytest.approx(
        2000, abs=3 * curve["scale_factor_u_pulses_per_deg"]
    )


@pytest.mark.slow
def test_a_tilted_axis_is_turned_faster_and_freed_of_the_horizontal_earth_rate(sweep: Sweep) -> None:
    tilted = {"simulation": {"seed": 3, "link": "tcp", "tilt_deg": 5.0}, "table": {"tilt_deg": 5.0}}
    run = sweep(**tilted, sweep={"rates_over_lock_in": [0.3, 0.7, 1.1, 1.3, 1.6, 2.0]})
    found = evaluate_run(run)
    records = run.taken_for(PURPOSE)
    assert records[0].conditions["table_rate_dps"] == pytest.approx(-0.02 / np.cos(np.radians(5)))
    result = found.document()
    assert abs(result["lock_in_rate_dps"] - 0.01) < 2.5 * result["lock_in_rate_u_dps"]
    curve = result["hyperbola"]
    assert curve["lock_in_rate_dps"] == pytest.approx(0.01, abs=2e-5)
    # an operator's table has no azimuth: what that leaves open is in the uncertainty
    unknown = [one._replace(conditions=without_azimuth(one.conditions)) for one in run.records]
    blind = evaluate_run(replace(run, records=tuple(unknown)))
    part = blind.found.parts["earth_rate"]
    assert part == pytest.approx(
        15.04 / 3600 * np.cos(np.radians(28.2)) * np.sin(np.radians(5)) / np.sqrt(2), rel=1e-3
    )
    assert blind.document()["lock_in_rate_u_dps"] > part
    assert any("azimuth is not known" in said for said in blind.result.to_watch)


def without_azimuth(conditions: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in conditions.items() if not name.startswith("azimuth")}


def test_inside_the_band_a_record_is_taken_as_it_is(sweep: Sweep) -> None:
    run = sweep()
    found = evaluate_run(run).found
    inside = np.abs(found.records.rate + found.earth_rate) < 0.01
    assert (found.records.beat[inside] == 0).all() and (found.records.beat[~inside] > 0).all()
    taken = run.taken_for(PURPOSE)
    assert {len(one.codes) for one in taken} == {2500}
    assert all(Preamble.parse(one.preamble).xunit == "s" for one in taken)
    assert {one.conditions["direction"] for one in taken} == {"up", "down"}
    assert all({"azimuth_start_deg", "truth", "table_rate_dps"} <= one.conditions.keys() for one in taken)


class Interrupting(Progress):
    """An operator who presses Ctrl-C after so many records."""

    def __init__(self, after: int) -> None:
        super().__init__()
        self._left = after

    def advance(self) -> None:
        self._left -= 1
        if self._left == 0:
            raise KeyboardInterrupt


@pytest.mark.slow
@pytest.mark.parametrize(("after", "leg"), [(4, 0), (20, 13)])
def test_a_sweep_cut_short_goes_on_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sweep: Sweep, after: int, leg: int
) -> None:
    """It comes from the end that it came from before: hysteresis remembers that."""
    whole = sweep()
    done = start_run(MEASUREMENT, settings_of(tmp_path), Interrupting(after))
    assert done.failure is not None and done.failure.exit_code == 130
    assert len(open_run(done.path).taken_for(PURPOSE)) == after
    set_to: list[float] = []
    turn = Bench.turn_table
    monkeypatch.setattr(
        Bench, "turn_table", lambda self, rate, *other: set_to.append(rate) or turn(self, rate, *other)
    )
    monkeypatch.setattr(taking, "find_beat", None)  # the knobs are those of the run
    again = resume_run(done.path, QUIET, kind=MEASUREMENT)
    assert again.failure is None
    run = open_run(again.path)
    assert [one.key for one in run.taken_for(PURPOSE)] == [one.key for one in whole.taken_for(PURPOSE)]
    rates = [one.conditions["rate_dps"] for one in whole.taken_for(PURPOSE)]
    assert set_to == pytest.approx([rates[leg], *rates[after:]])
    one, other = (evaluate_run(which).document() for which in (run, whole))
    assert one["lock_in_rate_dps"] == pytest.approx(other["lock_in_rate_dps"], abs=1e-7)
    assert len(one["resumed_at"]) == 1


@pytest.mark.slow
def test_hysteresis_is_found_told_and_paid_for(sweep: Sweep) -> None:
    """Records of two gyros: coming from outside, the beat ends 40 % below the rate at which it begins."""
    plain, early = (
        sweep(simulation={"seed": 5, "link": "tcp", "lock_in_rate_dps": rate}, sweep={"steps": 10})
        for rate in (0.01, 0.006)
    )
    mixed = []
    for one, other in zip(plain.records, early.records, strict=True):
        outward = (one.conditions["direction"] == "up") == (one.conditions["rate_dps"] > 0)
        mixed.append(one if outward else other)
    found = evaluate_run(replace(plain, records=tuple(mixed)))
    result = found.document()
    assert result["flags"][0] == "hysteresis"
    assert result["hysteresis_dps"] == pytest.approx(0.004, abs=0.002)
    assert result["lock_in_rate_dps"] == pytest.approx(0.008, abs=0.001)
    assert result["lock_in_rate_u_dps"] > result["hysteresis_dps"] / 2 / np.sqrt(3)
    assert any("below the rate at which it begins" in said for said in found.result.to_watch)


@pytest.mark.slow
def test_a_damaged_record_is_left_out_by_name(sweep: Sweep) -> None:
    run = sweep()
    first, *others = run.records
    spoilt = replace(run, records=(first._replace(intact=False), *others))
    found = evaluate_run(spoilt)
    assert [one.name for one in found.result.left_out] == [first.key]
    assert found.document()["records"] == len(others)


def only(run: SavedRun, beating: bool) -> SavedRun:
    found = evaluate_run(run).found.records
    kept = [one for one, beat in zip(run.records, found.beat, strict=True) if (beat > 0) == beating]
    return replace(run, records=tuple(kept))


@pytest.mark.slow
def test_without_an_edge_there_is_no_result(sweep: Sweep) -> None:
    with pytest.raises(NoUsableSignal, match="a beat at every rate of the sweep: take smaller"):
        evaluate_run(only(sweep(), True))
    with pytest.raises(NoUsableSignal, match="holds no record of a sweep"):
        evaluate_run(replace(sweep(), records=()))


def test_a_gyro_that_is_locked_at_the_first_rate_is_no_usable_signal(tmp_path: Path) -> None:
    settings = settings_of(tmp_path, simulation={"seed": 1, "link": "tcp", "lock_in_rate_dps": 0.05})
    done = start_run(MEASUREMENT, settings, QUIET)
    assert done.failure is not None and done.failure.exit_code == 4
    assert "first rate of the sweep" in done.failure.message


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[table]\nkind = "manual"\n', "cannot turn a simulated table"),
        ("[sweep]\nrates_over_lock_in = [0.5, 0.9]\n", "must lie beyond lock-in"),
        ('[scope]\nquadrature_channel = "CH2"\n', "one channel only"),
        ("[sweep]\nstep = 3\n", "steps"),
    ],
)
def test_mistakes_in_the_settings_are_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "my.toml").write_text(text)
    with pytest.raises(SettingsError, match=message):
        load(MEASUREMENT.kind, tmp_path / "my.toml")


def test_a_real_scope_has_a_manual_table_and_no_truth() -> None:
    settings = load(MEASUREMENT.kind, None, {"scope": {"resource": "GPIB0::1::INSTR"}})
    assert settings.table.kind == "manual" and settings.simulation is None
