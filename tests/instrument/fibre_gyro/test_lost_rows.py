"""Logs whose time stamps stand on a grid, and whose rows are lost, doubled or written without their sign."""

import numpy as np
import pytest
from log_text import parse_gyro_log

from instrument.errors import FileFormatError
from instrument.fibre_gyro.log_clock import find_clock


def stamps(rng, rate, count, lost, step):
    """Time stamps on whole multiples of `step`, and how many rows are missing between the first and the last."""
    kept = np.flatnonzero(rng.random(count) >= lost)
    times = np.floor(kept / rate / step + 1e-6) * step
    return times - times[0], int(kept[-1] - kept[0]) + 1 - kept.size


@pytest.mark.parametrize("rate", [1, 10, 100, 2000])
@pytest.mark.parametrize("lost", [0.001, 0.01, 0.05, 0.2])
def test_stamps_that_are_multiples_of_the_interval_count_every_row_that_is_lost(rate, lost):
    times, missing = stamps(np.random.default_rng(5), rate, 3600, lost, 1 / rate)
    clock = find_clock(times, None)
    assert clock.interval_s == pytest.approx(1 / rate, rel=1e-9)
    assert clock.places[-1] + 1 - times.size == missing


@pytest.mark.parametrize(("interval", "step"), [(1.003, 1.0), (0.0101, 0.01)])
def test_an_interval_a_little_longer_than_the_grid_loses_no_rows(interval, step):
    times = np.floor(np.arange(4000) * interval / step) * step
    clock = find_clock(times, None)
    assert clock.interval_s == pytest.approx(interval, rel=1e-4)
    assert clock.places[-1] == 3999


@pytest.mark.slow
def test_where_the_stamps_do_not_tell_it_is_said():
    times, _ = stamps(np.random.default_rng(6), 2000, 3600, 0.05, 1e-3)
    with pytest.raises(FileFormatError, match="output_rate_hz"):
        find_clock(times, None)
    # what is asked for helps
    clock = find_clock(times, 1 / 2000)
    assert clock.interval_s == 1 / 2000
    assert abs(clock.places[-1] / 2000 - times[-1]) < 2e-3 and np.all(np.diff(clock.places) >= 1)


def test_doubled_rows_are_named_however_many_they_are():
    rng = np.random.default_rng(7)
    rows = [f"{0.01 * i:.2f},{rng.integers(-99, 99)}" for i in range(900)]
    doubled = [row for i, row in enumerate(rows) for _ in range(2 if i % 30 == 7 else 1)]
    with pytest.raises(FileFormatError, match=r"line 10: .*doubled"):
        parse_gyro_log("\n".join(["time,counts", *doubled]))


@pytest.mark.parametrize("bits", [16, 24, 32])
def test_words_without_their_sign_are_told(bits):
    words = np.random.default_rng(8).integers(-20, 20, 200) % 2**bits
    text = "\n".join(["time,counts", *(f"{i / 100:.2f},{word}" for i, word in enumerate(words))])
    with pytest.raises(FileFormatError, match=f"words of {bits} bits were written without their sign"):
        parse_gyro_log(text)


@pytest.mark.parametrize(("unit", "scale"), [("s", 1.0), ("ms", 1e3), ("us", 1e6)])
def test_time_stamps_that_count_from_1970_tell_their_unit(unit, scale):
    stamps = (1.76e9 + np.arange(100) * 0.01) * scale
    text = "\n".join(["time,counts", *(f"{stamp:.3f},{i % 7}" for i, stamp in enumerate(stamps))])
    assert parse_gyro_log(text).interval_s == pytest.approx(0.01, rel=1e-4)
