"""The modulator staircase on the oscilloscope: what its records give, and which are left out."""

import math
import sqlite3
from contextlib import closing
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from staircases import counter_voltage, write_csv

from instrument import Preamble, Waveform
from instrument.simulated import SimulatedTDS2014, TcpServer, VirtualClock
from instrument.simulated.fibre_gyro import TcpGyroServer
from station.errors import NoUsableSignal, UsageError
from station.fibre_gyro.bench import ServedGyro
from station.fibre_gyro.settings import FIBRE_GYRO
from station.fibre_gyro.sniff import read_frame_format
from station.fibre_gyro.witness import evaluate, modulator_voltage
from station.live.events import Progress
from station.measurements import measurement
from station.report.show import render_report
from station.runs.database import RunFacts
from station.runs.store import open_run
from station.settings import saved_settings
from station.shell.finish import evaluate_run, resume_run, save_outcome, start_run

QUIET = Progress()
WITNESS = measurement("witness")
DT = 0.2e-6


def scoped(settings):
    done = start_run(WITNESS, settings, QUIET)
    assert done.failure is None, done.failure
    return open_run(done.path)


def from_files(settings, *paths: Path):
    return open_run(start_run(WITNESS, settings, QUIET, paths=paths).path)


def record(rng, step: int, *, span_v: float = 6.4, step_s: float = 4.8967e-6, n: int = 2500):
    volts = counter_voltage(step, span_v=span_v, step_s=step_s)(rng.uniform(0, 1e-3) + DT * np.arange(n))
    return volts + rng.normal(0, 0.02, n)


@pytest.mark.slow
@pytest.mark.parametrize("step", [5001.0, -3333.0])
def test_the_simulated_scope_finds_the_modulator(fog_settings, step: float) -> None:
    settings = fog_settings(
        witness={"records": 4, "step_codes": step, "channel": "CH3", "probe": 10},
        simulation={"two_pi_error": 0.02, "half_wave_v": 3.1, "seed": 7},
    )
    run = scoped(settings)
    found = evaluate(run, settings, {})
    span = 2 * 3.1 * 1.02
    assert found.two_pi_voltage.value == pytest.approx(span, abs=4 * found.two_pi_voltage_record_u)
    assert found.two_pi_voltage_record_u < 5e-4 * span
    assert found.two_pi_voltage.u == pytest.approx(0.0173 * span, rel=0.01)
    assert found.two_pi_error.value == pytest.approx(0.02, abs=1.5e-3)
    assert found.step_codes.value == pytest.approx(step, abs=4 * found.step_codes.u)
    assert found.step_height.value == pytest.approx(step / 65536 * span, abs=4 * 1.5e-4)
    assert found.reset_height.value == pytest.approx((1 - abs(step) / 65536) * span, abs=8e-3)
    assert found.bias_height.value == pytest.approx(span / 4, abs=6e-3)
    # n L / c by hand: 1.468 * 1000 / 299792458
    assert found.step_time.value == pytest.approx(4.896721e-6, rel=1e-4)
    assert found.flags == ()
    assert {saved.conditions["channel"] for saved in run.records} == {"CH3"}


def test_the_simulated_staircase_goes_on_for_ever(fog_settings) -> None:
    settings = fog_settings(simulation={"half_wave_v": 3.0}, witness={"step_codes": 2401.0})
    voltage = modulator_voltage(settings)
    number = np.arange(400_000, 403_000)
    levels = voltage((number + 0.9) * settings.coil.transit_time)
    rise = (levels[2:] - levels[:-2]) / 6.0 * 65536  # of equal bias
    np.testing.assert_allclose(np.mod(rise - 2 * 2401 + 100, 65536), 100, atol=1e-6)
    bias = np.mod(np.diff(levels) / 6.0 * 65536 - 2401 + 100, 65536) - 100
    np.testing.assert_allclose(np.sort(np.unique(np.round(bias))), [16384, 3 * 16384])
    assert levels.min() >= 0 and levels.max() <= 6.0 * 1.25


def test_an_error_of_the_gain_is_in_every_volt_and_in_no_ratio(fog_settings) -> None:
    settings = fog_settings(witness={"records": 3}, simulation={"scope_gain_error": 0.03})
    found = evaluate(scoped(settings), settings, {})
    assert found.two_pi_voltage.value == pytest.approx(8 * 1.03, rel=1e-3)
    assert found.step_codes.value == pytest.approx(5001, abs=4 * found.step_codes.u)
    assert abs(found.two_pi_error.value) < 2 * found.two_pi_error.u  # 3 % are within what is told
    assert abs(found.two_pi_error.value) > 20 * found.two_pi_voltage_record_u / 8


@pytest.mark.slow
def test_more_records_do_not_take_the_rounding_away(fog_settings, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    for n in range(24):
        write_csv(tmp_path / f"{n}.csv", record(rng, 4500), interval_s=DT, volts_per_division=1.0)
    settings = fog_settings()
    paths = [tmp_path / f"{n}.csv" for n in range(24)]
    few, many = (evaluate(from_files(settings, *some), settings, {}) for some in (paths[:4], paths))
    one = float(np.median([each.found.two_pi_voltage_u for each in many.records]))
    assert 0.4 * one < many.two_pi_voltage_record_u < few.two_pi_voltage_record_u < one
    assert many.two_pi_voltage.value == pytest.approx(6.4, abs=4 * many.two_pi_voltage_record_u)
    assert math.isnan(many.two_pi_error.value)  # nobody has said the half-wave voltage


def test_records_that_cannot_be_used_are_left_out_by_name(fog_settings, tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    good = record(rng, 4500)
    write_csv(tmp_path / "good.csv", good, interval_s=DT, volts_per_division=1.0)
    write_csv(tmp_path / "clipped.csv", good, interval_s=DT, volts_per_division=0.5)
    write_csv(tmp_path / "peaks.csv", good, interval_s=DT, volts_per_division=1.0, point_format="ENV")
    sine = 3 * np.sin(2 * np.pi * 40e3 * DT * np.arange(2500))
    write_csv(tmp_path / "sine.csv", sine, interval_s=DT, volts_per_division=1.0)
    write_csv(tmp_path / "spoilt.csv", good, interval_s=DT, volts_per_division=1.0)
    settings = fog_settings()
    names = ("good", "clipped", "peaks", "sine", "spoilt")
    run = from_files(settings, *(tmp_path / f"{name}.csv" for name in names))
    with closing(sqlite3.connect(run.path)) as db, db:
        db.execute("UPDATE record SET payload = zeroblob(2500) WHERE number = 5")
    db.close()
    result = evaluate_run(open_run(run.path))
    reasons = {one["name"]: one["reason"] for one in result.document()["left_out"]}
    assert set(reasons) == {"clipped.csv", "peaks.csv", "sine.csv", "spoilt.csv"}
    assert "clipped" in reasons["clipped.csv"]
    assert "Peak Detect" in reasons["peaks.csv"]
    assert "not what was once saved" in reasons["spoilt.csv"]
    assert [one["name"] for one in result.document()["records"]] == ["good.csv"]
    assert sum("is left out" in flag for flag in result.result.flags) == 4
    with pytest.raises(NoUsableSignal, match="no record shows the staircase"):
        evaluate(from_files(settings, tmp_path / "sine.csv"), settings, {})


def test_without_a_reset_no_two_pi_voltage_is_given(fog_settings, tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    volts = 0.4 * np.floor(np.arange(2500) / 180.3) + rng.normal(0, 0.02, 2500)
    write_csv(tmp_path / "slow.csv", volts, interval_s=DT, volts_per_division=1.0)
    settings = fog_settings(limits={"witness_two_pi_error_ppm": 1e5}, witness={"half_wave_v": 3.2})
    run = from_files(settings, tmp_path / "slow.csv")
    result = evaluate_run(run)
    assert result.document()["two_pi_voltage_v"] is None
    assert result.document()["two_pi_error"] is None
    assert result.document()["step_height_v"] == pytest.approx(0.4, abs=4e-3)
    assert result.verdict == "ERROR"  # a limit that nothing can be said about
    assert any("No reset is in the record" in flag for flag in result.result.flags)
    assert "V_2π unknown" in render_report(result)


def test_a_limit_finer_than_the_gain_is_said_to_prove_nothing(fog_settings, tmp_path: Path) -> None:
    settings = fog_settings(limits={"witness_two_pi_error_ppm": 5000.0}, witness={"records": 1})
    run = scoped(settings)
    result = evaluate_run(run)
    assert result.verdict == "MARGINAL"
    assert "the limit lies within the 95 % interval" in result.tested[0].sentence
    better = tmp_path / "better.toml"
    better.write_text("[limits]\nwitness_two_pi_error_ppm = 5000.0\n[witness]\ngain_u = 0.001\n")
    assert "the limit lies within" not in evaluate_run(run, config=better).tested[0].sentence


def test_the_gyro_on_its_port_is_injected_and_left_as_it_was(fog_settings) -> None:
    base = fog_settings(gyro={"counts_per_code": 256.0}, link={"frame_format": "binary_frames", "speed": 20.0})
    layout = read_frame_format(base)
    voltage = counter_voltage(5001, span_v=7.7, step_s=4.8967e-6, bias=True, offset_v=-4.0)
    scope = SimulatedTDS2014({2: voltage}, clock=VirtualClock(), seed=3)
    gyro = TcpGyroServer(ServedGyro(base, layout.interval_s), layout, speed=20.0)
    server = TcpServer(scope)
    try:
        with gyro:
            settings = fog_settings(
                gyro={"counts_per_code": 256.0},
                link={"frame_format": "binary_frames", "speed": 20.0, "port": gyro.port},
                witness={"resource": server.resource_name, "channel": "CH2", "records": 2, "half_wave_v": 3.85},
            )
            run = scoped(settings)
            sent = [one for one, _ in groupby(gyro.commands)]  # what is answered late is sent again
    finally:
        server.close()
    assert sent == [("hold_feedback", 0.0), ("inject", 5001.0), ("inject", 0.0), ("close_loop", 0.0)]
    assert run.facts["injected"]["step_codes"] == 5001.0
    assert not run.facts["simulated"]
    assert "truth" not in run.facts
    result = evaluate_run(run)
    assert result.document()["two_pi_voltage_v"] == pytest.approx(7.7, rel=6e-4)
    assert result.document()["two_pi_error"] == pytest.approx(0.0, abs=6e-4)
    assert "5001 were injected" in " ".join(result.result.sentences)


@pytest.mark.parametrize(
    ("sections", "said"),
    [
        ({"link": {"port": "/dev/ttyUSB7"}}, "witness.resource no oscilloscope"),
        ({"witness": {"step_codes": 40000.0}}, "witness.step_codes: "),
        ({"witness": {"step_codes": 0.0}}, "without a step there is no staircase"),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_moves(fog_settings, tmp_path: Path, sections, said) -> None:
    with pytest.raises(UsageError, match=said):
        start_run(WITNESS, fog_settings(**sections), QUIET)
    assert list(tmp_path.iterdir()) == []


def test_runs_of_a_version_without_the_witness_can_still_be_read(taken, fog_settings) -> None:
    result, run = taken("eps", eps={"record_s": 0.2})
    settings = dict(run.facts["settings"])
    del settings["witness"]
    del settings["simulation"]["half_wave_v"]
    old = replace(run, facts=RunFacts({**run.facts, "settings": settings}))
    assert saved_settings(FIBRE_GYRO, settings, "old").witness == fog_settings().witness
    assert evaluate_run(old).document()["two_pi_error"] == result.document()["two_pi_error"]


class InterruptedProgress(Progress):
    """Ctrl-C after so many records."""

    def __init__(self, after: int) -> None:
        super().__init__()
        self._after = after

    def advance(self) -> None:
        super().advance()
        self._after -= 1
        if not self._after:
            raise KeyboardInterrupt


@pytest.mark.slow
def test_a_run_cut_short_takes_the_records_that_are_missing_with_the_same_setting(fog_settings) -> None:
    settings = fog_settings(witness={"records": 4}, simulation={"half_wave_v": 3.1, "seed": 5})
    done = start_run(WITNESS, settings, InterruptedProgress(2))
    assert done.failure is not None
    assert done.failure.exit_code == 130
    before = open_run(done.path)
    assert [record.key for record in before.records] == ["record 1", "record 2"]
    known = {"witness": {"half_wave_v": 3.1, "records": 4}}
    with pytest.raises(UsageError, match=r"witness\.step_codes is 5001\.0 in the run, not 2001\.0"):
        resume_run(done.path, QUIET, kind=WITNESS, overrides={"witness": {"step_codes": 2001.0}})
    assert resume_run(done.path, InterruptedProgress(1), kind=WITNESS).failure is not None
    assert resume_run(done.path, QUIET, kind=WITNESS, overrides=known).failure is None
    after = open_run(done.path)
    assert [record.key for record in after.records] == [f"record {number}" for number in range(1, 5)]
    assert [one.taken_at for one in after.records[:2]] == [one.taken_at for one in before.records]
    scales = {Waveform(one.codes, Preamble.parse(one.preamble)).preamble for one in after.records}
    assert len({(one.ymult, one.yoff, one.xincr) for one in scales}) == 1
    # each time the noise is another one: the first record after an interruption is no copy of the last such
    assert len({one.payload for one in after.records}) == 4
    assert len(after.facts.resumed_at) == 2
    found = evaluate(after, settings, {})
    assert found.two_pi_voltage.value == pytest.approx(6.2, abs=4 * found.two_pi_voltage_record_u)
    save_outcome(open_run(done.path), None)
    with pytest.raises(UsageError, match="is finished, there is nothing to go on with"):
        resume_run(done.path, QUIET, kind=WITNESS)
