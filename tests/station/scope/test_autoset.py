"""Time base and vertical scale from trial records, on the simulated scope."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from instrument import TDS2014, SettingError
from instrument.scpi import TIME_BASES
from instrument.simulated import SimulatedTDS2014, VirtualClock, resource_manager
from instrument.tds2014.knobs import Knobs
from station.errors import NoUsableSignal
from station.lock_in.settings import default_settings
from station.scope.autoset import find_beat, oscilloscope_steps

SETTINGS = default_settings("simulated")
NAME = "GPIB0::1::INSTR"


def test_time_bases_are_the_steps_of_the_scope() -> None:
    assert len(TIME_BASES) == 33
    assert {0.001, 0.0025, 0.005, 0.01, 0.025, 50.0} <= set(TIME_BASES)


@pytest.mark.parametrize(
    ("frequency", "expected"), [(160.0, 0.01), (151.0, 0.01), (149.0, 0.025), (2281.0, 0.001), (2e6, 1e-6)]
)
def test_the_record_holds_enough_periods(frequency: float, expected: float) -> None:
    assert oscilloscope_steps().time_base(frequency, periods_min=15, samples_per_period_min=20) == expected


def test_sampling_goes_before_periods() -> None:
    # 500 periods in 2500 points would be 5 samples a period
    base = oscilloscope_steps().time_base(1000.0, periods_min=500, samples_per_period_min=20)
    assert 2500 / (10 * base * 1000) >= 20
    assert base == 0.01


@pytest.mark.parametrize(
    ("frequency", "amplitude", "offset"),
    [
        (160.0, 0.38, 0.12),
        (160.0, 8.0, -1.5),
        (37.0, 0.02, 0.3),
        (2281.0, 1.0, 0.0),
        (40e3, 0.2, -0.1),
        (7.3, 1.0, 1.0),
    ],
)
def test_any_beat_ends_up_filling_the_screen(frequency: float, amplitude: float, offset: float) -> None:
    def signal(times: np.ndarray) -> np.ndarray:
        phase = 2 * np.pi * frequency * times
        return offset + amplitude * (np.sin(phase) + 0.06 * np.sin(2 * phase + 1))

    simulated = SimulatedTDS2014({1: signal}, clock=VirtualClock())
    manager = resource_manager(scopes={NAME: simulated})
    with TDS2014(NAME, resource_manager=manager) as scope:
        scope.set_channel(1, probe=1)
        found = find_beat(scope, SETTINGS.scope, SETTINGS.measurement, start=100e3)
        record = scope.acquire(1)
    manager.close()
    assert found.beat_frequency == pytest.approx(frequency, rel=2e-3)
    assert not record.clipped
    assert np.ptp(record.codes.astype(int)) / 2 == pytest.approx(100, abs=16)
    periods = 2500 * record.sample_interval * frequency
    assert 15 <= periods <= 40


def test_no_beat_is_told() -> None:
    simulated = SimulatedTDS2014({1: np.zeros_like}, clock=VirtualClock())
    manager = resource_manager(scopes={NAME: simulated})
    with TDS2014(NAME, resource_manager=manager) as scope:
        scope.set_channel(1, probe=1)
        with pytest.raises(NoUsableSignal, match="no beat"):
            find_beat(scope, SETTINGS.scope, SETTINGS.measurement, start=1000.0)
    manager.close()


def square(times: np.ndarray) -> np.ndarray:
    return 0.25 * np.sign(np.sin(2 * np.pi * 151 * times))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("signals", "words"),
    [
        ({1: np.zeros_like}, ["CH1: flat at"]),
        ({1: square}, ["peak to peak at 151", "odd harmonics only: a logic output?"]),
        ({1: lambda times: 0.3 * np.sin(2 * np.pi * 300e3 * times)}, ["CH1", "at 300 kHz"]),
        ({1: lambda times: 0.3 * np.sin(2 * np.pi * 50 * times)}, ["at 50", "hum of the mains?"]),
        (
            {1: np.zeros_like, 2: lambda times: 0.3 * np.sin(2 * np.pi * 151.5 * times)},
            ["CH1: flat", "CH2", "at 151", "CH2 may be it: --channel CH2"],
        ),
    ],
)
def test_what_stands_there_instead_of_a_beat_is_told(signals: dict[int, Any], words: list[str]) -> None:
    clock = VirtualClock()
    manager = resource_manager(scopes={NAME: SimulatedTDS2014(signals, clock=clock)})
    with TDS2014(NAME, resource_manager=manager) as scope:
        for channel in signals:
            scope.set_channel(channel, probe=1, scale=0.1, displayed=True)
        began = clock.now()
        with pytest.raises(NoUsableSignal, match=r"no .*beat") as told:
            find_beat(scope, SETTINGS.scope, SETTINGS.measurement, start=150.0)
        assert clock.now() - began < 5.0
    manager.close()
    assert [word for word in words if word not in str(told.value)] == []


def beat(frequency: float, depth: float = 0.4) -> Callable[[np.ndarray], np.ndarray]:
    def signal(times: np.ndarray) -> np.ndarray:
        phase = 2 * np.pi * frequency * times
        return 0.12 + depth * (np.sin(phase) + 0.06 * np.sin(2 * phase + 1))

    return signal


@pytest.mark.slow
@pytest.mark.parametrize("frequency", [0.05, 0.28, 1.3, 5.0, 25.0])
@pytest.mark.parametrize("expected_over_true", [0.4, 1.0, 2.5])
def test_a_slow_beat_is_found(frequency: float, expected_over_true: float) -> None:
    simulated = SimulatedTDS2014({1: beat(frequency)}, clock=VirtualClock())
    manager = resource_manager(scopes={NAME: simulated})
    with TDS2014(NAME, resource_manager=manager) as scope:
        scope.set_channel(1, probe=1)
        start = frequency * expected_over_true
        found = find_beat(scope, SETTINGS.scope, SETTINGS.measurement, start=start)
        record = scope.acquire(1)
        source = scope.query(":TRIGGER:MAIN:EDGE:SOURCE?")
    manager.close()
    assert found.beat_frequency == pytest.approx(frequency, rel=5e-3)
    assert not record.clipped
    periods = 2500 * record.sample_interval * frequency
    assert 14 <= periods <= 40
    # where AUTO would roll the trace, a trigger that always comes
    assert ("LINE" in source) == (found.seconds_per_division >= 0.1)


@pytest.mark.slow
@pytest.mark.parametrize("times_as_high", [8.0, 60.0])
def test_a_beat_that_is_much_higher_at_the_next_rate_is_found(times_as_high: float) -> None:
    # as behind an amplifier that is slow for the beat of the fast run
    shown = [beat(15e3, 0.004)]
    simulated = SimulatedTDS2014({1: lambda times: shown[0](times)}, clock=VirtualClock())
    manager = resource_manager(scopes={NAME: simulated})
    with TDS2014(NAME, resource_manager=manager) as scope:
        scope.set_channel(1, probe=1)
        before = find_beat(scope, SETTINGS.scope, SETTINGS.measurement, start=15e3)
        shown[0] = beat(600.0, 0.004 * times_as_high)
        found = find_beat(scope, SETTINGS.scope, SETTINGS.measurement, start=replace(before, beat_frequency=620.0))
        record = scope.acquire(1)
    manager.close()
    assert found.beat_frequency == pytest.approx(600.0, rel=5e-3)
    assert not record.clipped


def test_what_stands_on_the_front_panel_comes_back_after_a_slow_beat() -> None:
    simulated = SimulatedTDS2014({1: beat(1.3)}, clock=VirtualClock())
    manager = resource_manager(scopes={NAME: simulated})
    with TDS2014(NAME, resource_manager=manager) as scope:
        before = scope.query(":TRIGGER?"), scope.query(":HORIZONTAL?")
        find_beat(scope, SETTINGS.scope, SETTINGS.measurement, start=2.0)
    with TDS2014(NAME, resource_manager=manager) as scope:
        assert (scope.query(":TRIGGER?"), scope.query(":HORIZONTAL?")) == before
    manager.close()


def test_a_scope_without_mains_triggers_on_the_beat(monkeypatch: pytest.MonkeyPatch) -> None:
    def without_mains(knobs: Knobs, *, source: str | int | None = None, **others: Any) -> None:
        if source in ("LINE", "AC LINE"):
            raise SettingError("no such source")
        set_trigger(knobs, source=source, **others)

    set_trigger = Knobs.set_trigger
    simulated = SimulatedTDS2014({1: beat(1.3)}, clock=VirtualClock())
    manager = resource_manager(scopes={NAME: simulated})
    with TDS2014(NAME, resource_manager=manager) as scope:
        scope.set_channel(1, probe=1)
        monkeypatch.setattr(scope, "set_trigger", partial(without_mains, scope._knobs))
        found = find_beat(scope, SETTINGS.scope, SETTINGS.measurement, start=1.3)
        assert scope.query(":TRIGGER:MAIN:EDGE:SOURCE?") == "CH1"
    manager.close()
    assert found.beat_frequency == pytest.approx(1.3, rel=5e-3)


@pytest.mark.parametrize("start", [1000.0, 1.0])
@pytest.mark.parametrize("level", [0.0, 0.3])
def test_a_gyro_that_is_locked_ends_the_search(start: float, level: float) -> None:
    simulated = SimulatedTDS2014({1: lambda times: np.full(times.shape, level)}, clock=VirtualClock())
    manager = resource_manager(scopes={NAME: simulated})
    with TDS2014(NAME, resource_manager=manager) as scope:
        scope.set_channel(1, probe=1)
        with pytest.raises(NoUsableSignal, match="no beat"):
            find_beat(scope, SETTINGS.scope, SETTINGS.measurement, start=start)
    manager.close()
