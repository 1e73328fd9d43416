"""Every limit of the settings is given by some test of the fibre gyro, and every test gives what it says."""

from typing import Any

import pytest

from station.fibre_gyro.settings import FIBRE_GYRO
from station.measurements import MEASUREMENTS, measurement

FAMILY = [name for name, module in MEASUREMENTS.items() if ".fibre_gyro." in module]
SMALL: dict[str, Any] = {
    "table": {"axes": ["X", "Z"], "turns": 2},
    "selfcal": {"step_s": 5.0, "static_s": 5.0},
    "eps": {"record_s": 0.2},
    "figures": {"runs": 2, "rates_dps": [10.0, 50.0, 100.0], "temperatures_c": [60.0], "turn_on_rate_dps": 20.0},
    "witness": {"records": 1},
    "sensitivity": {"record_s": 20.0},
}


def test_every_limit_is_given_by_one_test() -> None:
    given = [name for command in FAMILY for name in measurement(command).gives]
    assert sorted(given) == sorted(FIBRE_GYRO.model.model_fields["limits"].annotation.model_fields)


@pytest.mark.parametrize("command", FAMILY)
def test_a_test_gives_the_numbers_that_it_says(taken, command: str) -> None:
    result, _ = taken(command, **SMALL)
    given, possible = {one.quantity.limit_name for one in result.result.measured}, set(measurement(command).gives)
    elsewhere = {"correlated_noise_dph", "tumble_bias_dph"}  # of noise that is correlated, and of six positions
    assert given | (elsewhere & possible) == possible
    assert result.not_tested == []


def test_a_limit_that_the_run_gives_no_number_for_is_said(taken_on, fog_settings) -> None:
    from station.fibre_gyro.bench import SimulatedFogBench
    from station.fibre_gyro.selfcal import numbers_for, plan

    settings = fog_settings(
        selfcal={"numbers": "nominal", "step_s": 5.0, "static_s": 5.0}, limits={"self_minus_table_ppm": 5.0}
    )
    planned, _ = plan(settings, numbers_for(settings, None))
    result = taken_on("selfcal", settings, SimulatedFogBench(settings), planned, simulated=True)
    assert result.verdict is None
    assert result.not_tested == ["limits.self_minus_table_ppm is not tested: this run gives no such number"]
