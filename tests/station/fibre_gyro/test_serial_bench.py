"""The real bench's code on a gyro that is served on a serial line, with frames, counter, checksum and faults."""

import tomllib
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from instrument.fibre_gyro import FibreGyroLink, Recording, parse_frame_format
from instrument.simulated.fibre_gyro import GyroFault, GyroFaults, TcpGyroServer
from station.fibre_gyro import eps, figures, response, selfcal, sensitivity, table, temperature, threshold
from station.fibre_gyro.bench import SerialFogBench, ServedGyro
from station.fibre_gyro.segments import PlannedSegment
from station.fibre_gyro.selfcal import numbers_for
from station.fibre_gyro.sniff import read_frame_format
from station.settings import shipped_settings
from station.shell.finish import Evaluated

GYRO = {"counts_per_code": 256.0, "output_resolution": 1.0}
SPEED = 20.0


class TableUnderTheGyro:
    """A rate table that turns the served gyro; `reaches` is the rate over the one that was asked for."""

    def __init__(self, gyro: ServedGyro, reaches: float = 1.0) -> None:
        self._gyro, self._reaches, self._rate = gyro, reaches, 0.0

    def set_rate(self, rate_dps: float) -> None:
        self._rate = rate_dps * self._reaches
        self._gyro.rate_dps = self._rate

    def rate(self) -> float:
        return self._rate

    def azimuth(self) -> float:
        return 0.0

    def close(self) -> None:
        self.set_rate(0.0)


class ServedBench:
    """Server, link and bench of one test, and what the operator was asked."""

    def __init__(
        self,
        settings: Any,
        stack: ExitStack,
        *,
        faults: GyroFaults | None = None,
        reaches: float = 1.0,
        step_scale: int = 16384,
    ) -> None:
        values = tomllib.loads(shipped_settings("fibre_gyro_frames").read_text())["formats"]["binary_open_loop"]
        values["commands"]["step_scale"] = step_scale
        values["output_rate_hz"] = (
            50.0  # so few that a busy machine makes and reads them at twenty times the speed
        )
        self.layout = parse_frame_format(values, where="test")
        self.gyro = ServedGyro(settings, self.layout.interval_s)
        self.server = stack.enter_context(TcpGyroServer(self.gyro, self.layout, speed=SPEED, faults=faults))
        self.link = stack.enter_context(FibreGyroLink(self.server.port, self.layout, speed=SPEED))
        self.asked: list[str] = []
        self.table = TableUnderTheGyro(self.gyro, reaches)
        self.bench = SerialFogBench(self.link, self.table, self._answer)

    def _answer(self, question: str) -> str:
        self.asked.append(question)
        return ""


@pytest.fixture
def result_of(taken_on):
    """Take a plan on a served bench, leave it as it was, and evaluate the run."""

    def take(command: str, settings: Any, served: ServedBench, plan: list[Any]) -> Evaluated:
        try:
            return taken_on(command, settings, served.bench, plan, simulated=False)
        finally:
            served.bench.leave()

    return take


@pytest.fixture
def served(fog_settings):
    with ExitStack() as stack:
        yield lambda settings, **how: ServedBench(settings, stack, **how)


def test_a_table_run_over_the_link(served, fog_settings, result_of) -> None:
    settings = fog_settings(
        gyro=GYRO,
        table={"axes": ["Z"], "rates_dps": [60.0, 66.0], "turns": 2, "settle_s": 0.5, "both_ends_up": False},
        simulation={"angle_random_walk": 1e-3},
    )
    bench = served(settings)
    result = result_of("table", settings, bench, table.plan(settings))
    (axis,) = result.document()["axes"]
    assert abs(axis["nominal_difference_ppm"]) < 5 * axis["scale_factor_u_ppm"] < 10
    assert result.document()["left_out"] == []
    assert bench.asked == ["Bring axis Z of the gyro to the table's axis, up.\nPress Enter when done: "]
    assert bench.gyro.rate_dps == 0.0


@pytest.mark.slow
def test_the_response_over_the_link_is_that_of_the_steps(served, fog_settings, result_of) -> None:
    """Commands go out while it records; when they arrive nobody knows to an output."""
    settings = fog_settings(gyro=GYRO, response={"half_period_s": 12.0, "periods": 2, "settle_s": 0.2})
    bench = served(settings)
    found = result_of("response", settings, bench, response.plan(settings)).document()
    assert found["left_out"] == [] and found["delay_s"] is None
    # a command that is answered late is sent again
    assert len([one for one, _ in groupby(bench.server.commands) if one[0] == "inject"]) == 6
    assert abs(abs(found["gain"]) - 1) < 0.01 and found["bandwidth_hz"] > 10
    assert bench.server.commands[-1] == ("inject", 0.0)


def test_the_operator_is_asked_for_each_value_of_a_stimulus_and_for_each_position(
    served, fog_settings, result_of
) -> None:
    ladder = {"values": [0.0, 2.0, 0.0], "rate_dps": 0.0, "record_s": 1.0, "settle_s": 0.1}
    settings = fog_settings(gyro=GYRO, sensitivity=ladder)
    bench = served(settings)
    assert result_of("sensitivity", settings, bench, sensitivity.plan(settings)).document()["left_out"] == []
    assert [question.splitlines()[1] for question in bench.asked] == [
        f"Set the magnetic field to {value} mT." for value in (0, 2, 0)
    ]
    settings = fog_settings(gyro=GYRO, sensitivity={"tumble": True, "record_s": 1.0, "settle_s": 0.1})
    bench.asked.clear()
    result_of("sensitivity", settings, bench, sensitivity.plan(settings))
    assert [question.splitlines()[0] for question in bench.asked] == [
        f"Input axis of the gyro along {position} of the fixture." for position in sensitivity.POSITIONS
    ]


@pytest.mark.slow
def test_a_lost_frame_is_told_and_a_slow_table_leaves_points_out(served, fog_settings, result_of) -> None:
    settings = fog_settings(
        gyro=GYRO, table={"axes": ["Z"], "rates_dps": [60.0, 66.0, 70.0], "turns": 1, "settle_s": 0.0}
    )
    faults = GyroFaults()
    bench = served(settings, faults=faults)
    record = bench.bench.record

    def record_with_a_fault(planned: PlannedSegment, progress: Callable[[float], None]) -> Recording:
        """One frame is lost after 2 s of the first segment."""

        def watch(seconds: float) -> None:
            if seconds > 2.0 and planned.key == "Z +60" and not faults.happened:
                faults.add(GyroFault("lost frame"))
            progress(seconds)

        return record(planned, watch)

    bench.bench.record = record_with_a_fault
    result = result_of("table", settings, bench, table.plan(settings))
    assert result.document()["left_out"] == []
    points = {point["name"]: point for point in result.document()["axes"][0]["points"]}
    assert {name for name, point in points.items() if point["missing"]} == {"Z +60"}
    assert any(flag.startswith("Z +60: ") and "missing" in flag for flag in result.result.flags)
    slow = served(settings, reaches=0.999)
    with pytest.raises(Exception, match="instead of"):
        result_of("table", settings, slow, table.plan(settings))


def test_a_self_calibration_over_the_link(served, fog_settings, result_of) -> None:
    settings = fog_settings(
        gyro=GYRO,
        selfcal={"numbers": "nominal", "rates_dps": [1.0, 20.0, 140.0], "step_s": 4.0, "static_s": 4.0},
        simulation={"angle_random_walk": 1e-3, "two_pi_error": 1e-3, "scale_change_ppm": 300.0},
    )
    bench = served(settings)
    plan, _ = selfcal.plan(settings, numbers_for(settings, None))
    result = result_of("selfcal", settings, bench, plan)
    found = result.document()
    # neither the 2 pi error nor the coil's change is seen
    assert abs(found["self_minus_numbers_ppm"]) < 5 * found["self_minus_numbers_u_ppm"] < 10
    assert abs(found["self_minus_design_ppm"]) < 10
    assert found["compared_with"] == "design"
    assert bench.server.commands[-1] == ("inject", 0.0)
    steps = [step for name, step in bench.server.commands if name == "inject"]
    # what the link sends has the resolution of the format, 2^-14 codes
    assert all(step * 16384 == round(step * 16384) for step in steps)


def test_the_number_is_the_step_that_was_really_sent(served, fog_settings, result_of) -> None:
    """A format with steps of 1/4 code: 1 deg/s is 246.25 codes on the line, 395 ppm more than wanted."""
    settings = fog_settings(
        gyro=GYRO,
        selfcal={"numbers": "nominal", "rates_dps": [1.0, 2.0], "step_s": 1.5, "static_s": 1.5, "settle_s": 0.1},
        # u is the scatter of four steps, and which noise they meet is a matter of time
        simulation={"angle_random_walk": 2e-4},
    )
    bench = served(settings, step_scale=4)
    plan, _ = selfcal.plan(settings, numbers_for(settings, None))
    found = result_of("selfcal", settings, bench, plan).document()
    given = {point["name"]: point["number_counts"] / 256 for point in found["points"]}
    assert given["inject +1"] == 246.25
    assert abs(found["self_minus_numbers_ppm"]) < 5 * found["self_minus_numbers_u_ppm"] < 100


def test_the_injection_is_taken_away_after_an_interrupt(served, fog_settings) -> None:
    settings = fog_settings(gyro=GYRO, selfcal={"numbers": "nominal"})
    bench = served(settings)
    plan, _ = selfcal.plan(settings, numbers_for(settings, None))
    bench.bench.prepare(plan[3])
    assert bench.server.commands[-1][1] > 200
    bench.bench.leave()
    assert bench.server.commands[-1] == ("inject", 0.0)


def test_steps_that_the_format_cannot_send_are_named(served, fog_settings, result_of) -> None:
    settings = fog_settings(
        gyro=GYRO, selfcal={"numbers": "nominal", "rates_dps": [1.0, 2.0, 100.0], "step_s": 1.0, "static_s": 1.0}
    )
    bench = served(settings)
    lowest, highest = bench.layout.step_range
    plan, _ = selfcal.plan(settings, numbers_for(settings, None))
    result = result_of("selfcal", settings, bench, plan)
    step = 100 * settings.nominal_scale_factor / 256
    beyond = not lowest <= step <= highest
    assert [one["name"] for one in result.document()["left_out"]] == (
        ["inject +100", "inject -100"] if beyond else []
    )
    assert len(result.document()["points"]) == (4 if beyond else 6)


def test_the_two_pi_error_over_the_link(served, fog_settings, result_of) -> None:
    settings = fog_settings(
        gyro=GYRO,
        eps={"record_s": 4.0, "settle_s": 0.1, "steps_codes": [2001.0, 5001.0]},
        simulation={"two_pi_error": 2e-3},
    )
    bench = served(settings)
    result = result_of("eps", settings, bench, eps.plan(settings))
    found = result.document()
    assert abs(found["two_pi_error"] - 2e-3) < 5 * found["two_pi_error_u"] < 1e-4
    assert {name for name, _ in bench.server.commands} == {"inject", "hold_feedback", "close_loop"}
    assert bench.server.commands[-1][0] == "close_loop"


@pytest.mark.slow
def test_the_operator_is_asked_for_every_run_and_temperature(served, fog_settings, result_of) -> None:
    settings = fog_settings(
        gyro=GYRO,
        figures={"rates_dps": [90.0, 100.0], "runs": 2, "temperatures_c": [60.0], "seconds": 3.6, "static_s": 1.0,
                 "settle_s": 0.0, "turn_on_s": 0.0},
        simulation={"angle_random_walk": 1e-3},
    )  # fmt: skip
    bench = served(settings)
    result = result_of("figures", settings, bench, figures.plan(settings))
    assert [question.splitlines()[1] for question in bench.asked] == [
        "For run 1: switch the gyro off, let it take 20 deg C, switch it on.",
        "For run 2: switch the gyro off, let it take 20 deg C, switch it on.",
        "For run at +60 deg C: switch the gyro off, let it take 60 deg C, switch it on.",
    ]
    assert len(result.document()["runs"]) == 2


def test_frame_formats_are_found_by_name(fog_settings, tmp_path: Path) -> None:
    from station.errors import SettingsError

    assert read_frame_format(fog_settings()).kind == "ascii"
    with pytest.raises(
        SettingsError, match=r"there is no \[formats.mine\]; link.frame_format can be: ascii_lines"
    ):
        read_frame_format(fog_settings(link={"frame_format": "mine"}))
    with pytest.raises(SettingsError, match="cannot be read"):
        read_frame_format(fog_settings(link={"frame_format_file": str(tmp_path / "no.toml")}))


def test_a_threshold_over_the_link(served, fog_settings, result_of) -> None:
    settings = fog_settings(
        gyro=GYRO,
        threshold={"lowest_dps": 0.01, "highest_dps": 0.1, "per_decade": 2, "resolution_at_dps": 0.0,
                   "shortest_s": 3.0, "settle_s": 0.2, "angle_random_walk": 1e-3},
        simulation={"angle_random_walk": 1e-3, "dead_zone_dps": 0.02},
    )  # fmt: skip
    bench = served(settings)
    found = result_of("threshold", settings, bench, threshold.plan(settings, 1e-3)).document()
    assert 0.01 <= found["threshold_low_95_dps"] < 0.02 < found["threshold_high_95_dps"] < 0.035
    assert 0.02 < found["dead_zone_low_95_dps"] < 0.04 < found["dead_zone_high_95_dps"]
    assert bench.gyro.rate_dps == 0.0


class Chamber(SerialFogBench):
    """Warms the served gyro as the plan wants it; its bias does not change."""

    served: ServedGyro

    def prepare(self, planned: PlannedSegment) -> dict[str, Any]:
        self.served.temperature_c = planned.conditions["planned_temperature_c"]
        return super().prepare(planned)


def test_a_ramp_over_the_link(served, fog_settings, result_of) -> None:
    settings = fog_settings(
        gyro=GYRO,
        temperature={"coldest_c": 0.0, "hottest_c": 10.0, "ramp_c_per_min": 100.0, "rate_dps": 0.0, "rest_s": 2.0,
                     "settle_s": 0.2, "block_s": 1.0, "window_s": 3.0},
        simulation={"angle_random_walk": 1e-3},
    )  # fmt: skip
    bench = served(settings)
    Chamber.served = bench.gyro
    bench.bench = Chamber(bench.link, bench.table, bench._answer)
    result = result_of("temperature", settings, bench, temperature.plan(settings))
    bias = result.document()["bias"]
    assert (bias["lowest_c"], bias["highest_c"]) == (pytest.approx(0, abs=2), pytest.approx(10, abs=2))
    assert abs(bias["coefficients_dph"][0] - 0.02) < 5 * bias["coefficients_u_dph"][0]
    assert [question.splitlines()[1] for question in bench.asked] == [
        "Let the chamber go from 0 to 10 deg C, 100 K a minute.",
        "Let the chamber go from 10 to 0 deg C, 100 K a minute.",
    ]


class ThreeGyros:
    """Outputs of three gyros of which the table turns Z, as angles a frame by a clock that is `fast`."""

    def __init__(self, settings: Any, interval_s: float, fast: float) -> None:
        self.rate_dps, self._rng = 0.0, np.random.default_rng(4)
        self._degrees = interval_s / (1 + fast)
        self._mixed = {"counts_x": 0.002, "counts_y": -0.001, "counts_z": 1.0003}

    def samples(self, count: int) -> dict[str, Any]:
        noise = {name: self._rng.normal(0, 2e-4, count) for name in self._mixed}
        angle = {name: k * self.rate_dps + noise[name] for name, k in self._mixed.items()}
        return {name: np.deg2rad(self._degrees * values) for name, values in angle.items()}

    def command(self, name: str, step: float) -> None:
        raise ValueError(name)


class _Doubting:
    """A bench whose recordings show that the frame format may be wrong."""

    def __init__(self, bench: SerialFogBench) -> None:
        self.refuses, self.prepare, self.leave, self._record = (
            bench.refuses,
            bench.prepare,
            bench.leave,
            bench.record,
        )

    def record(self, planned: PlannedSegment, progress: Callable[[float], None]) -> Recording:
        return replace(self._record(planned, progress), doubts=("counts: perhaps data_bits = 7",))


@pytest.mark.slow
def test_three_axes_as_angles_by_a_clock_that_is_fast(fog_settings, result_of) -> None:
    """K of an angle a frame rests on the rate of the frames: by the stated rate it would be 8 % off."""
    settings = fog_settings(
        site={"latitude_deg": 0.0},
        table={"axes": ["Z"], "rates_dps": [90.0, 100.0], "turns": 2, "settle_s": 0.0, "both_ends_up": False},
    )
    values = tomllib.loads(shipped_settings("frames/kvh_1750").read_text())["formats"]["kvh_1750"]
    layout = parse_frame_format(values | {"output_rate_hz": 250.0}, where="test")
    gyro = ThreeGyros(settings, layout.interval_s, 0.08)
    with (
        TcpGyroServer(gyro, layout, speed=5.0, clock_ppm=80_000.0) as server,
        FibreGyroLink(server.port, layout, speed=5.0) as link,
    ):
        table_of = TableUnderTheGyro(gyro)  # type: ignore[arg-type]
        bench = SerialFogBench(link, table_of, lambda asked: "", counts_per_dps=settings.nominal_scale_factor)
        served = SimpleNamespace(bench=_Doubting(bench))
        evaluated = result_of("table", settings, served, table.plan(settings))
    (axis,) = evaluated.document()["axes"]
    off_ppm = axis["nominal_difference_ppm"] - 300
    assert abs(off_ppm) < 3 * axis["scale_factor_u_ppm"] < 75_000
    assert axis["scale_factor_u_ppm"] > 25  # the computer's clock is in it
    clock = evaluated.document()["gyro_clock"]
    assert clock["used"] and abs(clock["difference_ppm"] - 80_000) < 4 * clock["difference_u_ppm"]
    assert any("K rests on that rate" in said for said in evaluated.result.sentences)
    assert [flag for flag in evaluated.result.flags if "data_bits" in flag] == ["counts: perhaps data_bits = 7."]
    x, y, _ = evaluated.document()["matrix"]["scale_factors_counts_per_dps"]
    assert x[0] == pytest.approx(0.002 * settings.nominal_scale_factor, rel=0.05)
    assert y[0] == pytest.approx(-0.001 * settings.nominal_scale_factor, rel=0.05)
    assert bench.refuses(table.plan(settings, ["W"])[0]).endswith("none of axis W")
