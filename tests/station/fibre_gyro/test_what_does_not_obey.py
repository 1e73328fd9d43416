"""Gyros, tables and logs that do not do what the test expects: each is named, and the result is doubtful."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.fibre_gyro.settings import load_fog_settings
from tests.station.fibre_gyro.test_logs_as_they_come import VERTICAL, Logs

K = load_fog_settings().nominal_scale_factor
RATES = (5.0, -5.0, 10.0, -10.0, 20.0, -20.0, 40.0, -40.0)
SECONDS = 90


def table(folder: Path, spoil: Any = lambda number, rate, words: words, rates: Any = RATES) -> list[str]:
    """What a table run of a gyro says of itself; `spoil` changes the words of a log."""
    logs = Logs(folder, "file,axis,rate_dps")
    for number, rate in enumerate(rates):
        words = K * (rate + VERTICAL) + 0.5 + logs.rng.normal(0, 0.3, 10 * SECONDS)
        add(logs, f"Z,{rate}", np.asarray(spoil(number, rate, words)))
    return said_of(logs.evaluate("table"))


def add(logs: Logs, row: str, words: np.ndarray) -> None:
    name = f"log{len(logs.rows)}.csv"
    times = logs.now + np.arange(words.size) / 10
    logs.now = float(times[-1]) + 1.0
    np.savetxt(logs.folder / name, np.column_stack([times, words]), "%.9g", ",", header="time,counts", comments="")
    logs.rows.append(f"{name},{row}")


def said_of(found: dict[str, Any]) -> list[str]:
    assert (found["standing"] == "doubtful") == bool(found["flags"])
    return list(found["flags"])


def selfcal(folder: Path, spoil: Any = lambda number, step, words: words) -> list[str]:
    logs = Logs(folder, "file,stands_for_dps,number")
    noise = logs.rng.normal
    add(logs, "0,0", 3.0 + noise(0, 0.3, 300))
    for number, rate in enumerate(RATES):
        step = K * rate
        add(logs, f"{rate},{step!r}", np.asarray(spoil(number, step, 3.0 + step + noise(0, 0.3, 300))))
    add(logs, "0,0", 3.0 + noise(0, 0.3, 300))
    return said_of(logs.evaluate("selfcal"))


def late(number: int, _: float, words: np.ndarray) -> np.ndarray:
    """The rate or the step comes ten seconds late."""
    return np.concatenate([np.linspace(3.0, words[0], 100), words[100:]])


def test_a_table_run_that_obeys_has_nothing_to_watch_but_its_repetitions(tmp_path: Path) -> None:
    assert [one for one in table(tmp_path) if "no run repeats another" not in one] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (late, "changes by"),
        (lambda n, rate, words: words * (2 if n == 3 else 1), "lies|off the line| is "),
        (lambda n, rate, words: words * (1 + 1e-4 * (n == 4)), "off the line"),
        (lambda n, rate, words: -words, "opposite sense"),
        (lambda n, rate, words: words * 0.5, "% off"),
        (lambda n, rate, words: np.where(np.arange(words.size) > 400, words[400], words), "stands still"),
    ],
    ids=["spin-up", "one run doubled", "one run 100 ppm off", "sign", "half", "stuck"],
)
def test_what_a_table_run_shows_is_named(tmp_path: Path, spoil: Any, named: str) -> None:
    assert any(re.search(named, one) for one in table(tmp_path, spoil))


def test_rates_in_another_order_are_seen(tmp_path: Path) -> None:
    exchanged = {6: -40.0, 7: 40.0}

    def spoil(number: int, rate: float, words: np.ndarray) -> np.ndarray:
        return words - K * (rate - exchanged.get(number, rate))

    assert any("% off" in one or "scatter by" in one for one in table(tmp_path, spoil))


def test_a_self_calibration_that_obeys_has_nothing_to_watch(tmp_path: Path) -> None:
    assert selfcal(tmp_path) == []


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (lambda n, step, words: words - step / 2, "FAILED.*0.5"),
        (late, "changes by"),
        (lambda n, step, words: np.concatenate([words[:290], 3.0 + words[290:] * 0]), "changes by|FAILED"),
        (lambda n, step, words: words - step * (n == 4), "FAILED"),
        (lambda n, step, words: words + 1e-3 * step, "FAILED"),
        (lambda n, step, words: np.clip(words, -6000, 6000), "FAILED"),
        (lambda n, step, words: (words + 2048) % 4096 - 2048, "FAILED"),
    ],
    ids=["halved", "late", "ends early", "one missing", "1000 ppm", "saturates", "wraps"],
)
def test_a_self_calibration_that_failed_says_so(tmp_path: Path, spoil: Any, named: str) -> None:
    said = selfcal(tmp_path, spoil)
    assert any(re.search(named, one) for one in said), said


def test_the_step_that_is_missing_is_named(tmp_path: Path) -> None:
    said = selfcal(tmp_path, lambda n, step, words: words - step * (n == 4))
    finding = next(one for one in said if "FAILED" in one)
    assert "+20" in finding and "-20" not in finding
