"""Interval and missing rows of logs with time stamps as recorders write them."""

import time

import numpy as np
import pytest
from log_text import parse_gyro_log

from instrument import FileFormatError
from instrument.fibre_gyro import LogChoices, read_gyro_log, read_log
from instrument.fibre_gyro.log_clock import clock_of_counter, find_clock

LOST = [500, 501, 502, 2000, 3500, 3501, 4000]


@pytest.mark.parametrize("lost", [[], LOST])
@pytest.mark.parametrize(
    ("rate_hz", "step_s"), [(400, 1e-3), (96, 1e-2), (99, 1e-2), (100, 1e-2), (250, 1e-3), (10, 0.1), (97.53, 0)]
)
def test_rounded_stamps_give_interval_and_missing_rows(rate_hz: float, step_s: float, lost: list[int]) -> None:
    kept = np.setdiff1d(np.arange(6000), lost)
    times = kept / rate_hz + 36_000.37
    if step_s:
        times = np.floor(times / step_s + 1e-4) * step_s
    clock = find_clock(times - times[0], None)
    assert clock.interval_s * rate_hz == pytest.approx(1, abs=2e-5)
    assert np.array_equal(clock.places, kept)


def test_a_host_that_is_late_now_and_then_loses_no_row() -> None:
    rng = np.random.default_rng(1)
    kept = np.setdiff1d(np.arange(6000), LOST)
    late = 16e-3 * rng.exponential(size=kept.size) * (rng.random(kept.size) < 0.05)
    times = np.maximum.accumulate(kept / 100 + late)
    clock = find_clock(times - times[0], None)
    # a late row in front of a missing one, or at the end, may be placed one further
    assert np.count_nonzero(clock.places != kept) <= 3
    assert clock.interval_s == pytest.approx(0.01, rel=2e-5)


def test_a_counter_tells_what_is_missing_and_the_stamps_how_long_an_interval_is() -> None:
    kept = np.setdiff1d(np.arange(1000), LOST)
    rows = "".join(f"{np.floor(n * 1.025) / 100:.2f},{n % 128},{n}\n" for n in kept)
    log = parse_gyro_log("time_s,counter,counts\n" + rows)
    assert log.clock == "counter"
    assert [(gap.after, gap.missing) for gap in log.gaps] == [(499, 3)]
    # 100 a second by the data sheet, and 2.5 % slow
    assert log.interval_s == pytest.approx(0.01025, rel=1e-4)
    assert clock_of_counter(np.array([65534.0, 65535.0, 0.0, 2.0])).tolist() == [0, 1, 2, 4]
    with pytest.raises(FileFormatError, match="line 3: the counter stands still"):
        parse_gyro_log("time_s,counter,counts\n0,5,1\n1,5,2\n")


def test_no_time_at_all_takes_the_rate_that_is_named() -> None:
    log = parse_gyro_log("5\n6\n7\n", interval_s=0.01)
    assert (log.counts.tolist(), log.clock) == ([5, 6, 7], "frames")
    assert log.times.tolist() == pytest.approx([0, 0.01, 0.02])
    with pytest.raises(FileFormatError, match="output_rate_hz"):
        parse_gyro_log("5\n6\n7\n")


def test_three_axes_with_units_and_text_above_them(tmp_path) -> None:
    path = tmp_path / "imu.txt"
    path.write_text(
        "FOG unit 7\nSerial;1234\nTime;Gyro X (deg/h);Gyro Y (deg/h);Gyro Z (deg/h);state\n"
        "12:00:00.0;36,0;72,0;7,2;1\n12:00:00.1;36,0;72,0;7,2;1\n12:00:00.2;36,0;72,0;7,2;1\n"
    )
    log = read_log(path)
    assert (log.unit, list(log.outputs), log.begin_s) == ("deg/h", ["counts_x", "counts_y", "counts_z"], 43_200.0)
    turned = log.recording("y", counts_per_dps=100.0)
    assert turned.counts.tolist() == pytest.approx([2.0] * 3)
    assert turned.extra["counts_z"].tolist() == pytest.approx([0.2] * 3)
    with pytest.raises(FileFormatError, match="name the axis"):
        log.recording(counts_per_dps=100.0)
    with pytest.raises(FileFormatError, match="deg/h: say how many counts"):
        read_gyro_log(path, axis="X")
    named = read_log(path, LogChoices(columns=("time", "", "counts", "", ""), units="counts"))
    assert named.recording().counts.tolist() == [72.0] * 3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time,counts [V]\n0,1\n1,2\n", "the unit of counts is 'v'"),
        ("time,x [deg/s],y [deg/h]\n0,1,2\n1,2,3\n", "the outputs stand in deg/h and deg/s"),
        ("time,counts,counts\n0,1,2\n1,2,3\n", "must be one column 'counts'"),
        ("time,counts,state\n0,1,ok\n1,2,ok\n", "line 2: the state is 'ok', no number"),
    ],
)
def test_what_is_not_clear_is_asked(text: str, said: str) -> None:
    with pytest.raises(FileFormatError) as caught:
        parse_gyro_log(text)
    assert said in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("of_rows", [0.3, 0.5, -0.5, 1.3, 2.5])
@pytest.mark.parametrize("jitter", [0.005, 0.05])
def test_a_clock_that_was_set_is_told_and_taken_out(of_rows: float, jitter: float) -> None:
    rng, interval, rows = np.random.default_rng(6), 0.02, 5000
    at = interval * (np.arange(rows) + of_rows * (np.arange(rows) >= 3100) + jitter * rng.standard_normal(rows))
    log = parse_gyro_log("time,counts\n" + "\n".join(f"{one:.5f},{n % 7}" for n, one in enumerate(at)))
    assert abs(log.interval_s / interval - 1) < 1e-5
    (doubt,) = log.doubts
    assert "the clock of its stamps was set" in doubt
    assert abs(int(doubt.split()[2]) - 3102) < 30
    assert sum(gap.missing for gap in log.gaps) == max(round(of_rows - 0.01), 0)


def test_rows_that_come_late_for_a_while_are_no_set_clock() -> None:
    rng, interval, rows = np.random.default_rng(7), 0.02, 5000
    late = np.zeros(rows)
    late[2000:2080] = np.linspace(8, 0, 80)  # a host that stood still, and caught up
    at = np.maximum.accumulate(interval * (np.arange(rows) + late + 0.05 * rng.random(rows)))
    log = parse_gyro_log("time,counts\n" + "\n".join(f"{one:.5f},{n % 7}" for n, one in enumerate(at)))
    assert log.doubts == ()


def test_a_pause_between_stamps_that_are_coarse_ends_soon() -> None:
    """Its rows were looked for one after the other."""
    rng = np.random.default_rng(3)
    at = np.round(np.sort(0.005 * np.arange(200) + np.where(np.arange(200) > 90, 2837.0, 0.0)), 2)
    text = "time,counts\n" + "\n".join(f"{one:.2f},{rng.normal():.3f}" for one in at)
    before = time.process_time()
    log = parse_gyro_log(text, interval_s=0.005)
    assert time.process_time() - before < 2
    assert sum(gap.missing for gap in log.gaps) == pytest.approx(2837 / 0.005, rel=0.01)
