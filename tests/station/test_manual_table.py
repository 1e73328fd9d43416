"""A table that an operator sets by hand: asked on a terminal, and nowhere else."""

import math
import os
import select
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from instrument import ManualRateTable
from instrument.simulated import VirtualClock
from station.dead_band.take import DEAD_BAND, take_on as sweep_on
from station.errors import UsageError
from station.live.events import Progress
from station.lock_in.settings import load_settings
from station.lock_in.take import take_on
from station.ring_laser.instruments import SimulatedInstruments, build_instruments
from station.ring_laser.records import Bench
from station.runs.acquisition import Acquisition, facts_of, take
from station.runs.store import SavedRun, open_run
from station.scope.tools import open_scope, serve
from station.settings import load
from station.terminal import operator_table
from tests.ideal_bench import ideal_bench

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs a pseudo-terminal for the operator")


def test_without_a_terminal_it_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with open(os.devnull) as nobody:
        monkeypatch.setattr(sys, "stdin", nobody)
        with pytest.raises(UsageError, match="terminal"):
            operator_table()


@dataclass(frozen=True)
class Led:
    """A measurement that an operator led: rates asked for, deg/s, all that was said, exit code, and the run."""

    asked: list[float]
    said: str
    code: int
    run: SavedRun


def led_by_an_operator(folder: Path, measurement: str, **simulated: float) -> Led:
    """Measure as `gyrolock measure` does; the operator turns the simulated table by what the prompts say."""
    bench = ideal_bench(simulation=dict(simulated))
    instruments = build_instruments(load_settings(overrides=bench), VirtualClock())
    with serve(instruments.scope, "tcp") as resource:
        text = f'[scope]\nresource = "{resource}"\n[table]\nkind = "manual"\nsettle_s = 0\n'
        text += f"[gyro]\nscale_factor_pulses_per_deg = 2000.0\n[measurement]\n{measurement}\n"
        (folder / "my.toml").write_text(text)
        terminal, keyboard = os.openpty()
        command = [sys.executable, "-m", "station.cli", "measure", "--config", "my.toml", "--no-report"]
        with subprocess.Popen(
            command, cwd=folder, stdin=keyboard, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        ) as process:
            assert process.stderr is not None
            asked, said, answered = [], "", 0
            deadline = time.monotonic() + 300
            while time.monotonic() < deadline:
                if not select.select([process.stderr], [], [], 0.2)[0]:
                    continue
                more = os.read(process.stderr.fileno(), 4096).decode()
                if not more:
                    break
                said += more
                if "Press Enter" in said[answered:] and said.rstrip().endswith("deg/s:"):
                    rate = float(said[answered:].split("rate table to ")[1].split(" deg/s")[0])
                    asked.append(rate)
                    answered = len(said)
                    instruments.table.set_rate(rate)
                    os.write(terminal, b"\n")
            code = process.wait(10)
        os.close(terminal)
        os.close(keyboard)
    (path,) = (folder / "runs").glob("*/run.sqlite")
    return Led(asked, said, code, open_run(path))


@pytest.mark.slow
def test_an_operator_leads_the_table_through_the_measurement(tmp_path: Path) -> None:
    led = led_by_an_operator(tmp_path, "records = 3\nrates_over_lock_in = [8.0]")
    assert led.code == 0, led.said
    assert led.asked[:2] == [50.0, -50.0]
    assert led.asked[2] == pytest.approx(3.507, abs=0.02)
    assert f"still turns at {led.asked[2]:+.6g} deg/s" in " ".join(led.said.split())
    run = led.run
    assert run.facts["outcome"] == "complete", led.said
    assert len(run.taken_for("measure")) == 3
    assert run.results is not None
    assert run.results["lock_in_rate_dps"] == pytest.approx(0.01, rel=0.02)
    # without an azimuth the earth rate stays in the rate by the table: up to 13.25 deg/h of 0.08 deg/s
    check = run.results["table_check"]
    assert check["beat_over_table"] == pytest.approx(1.0, abs=0.06)
    assert 0.02 < check["lock_in_rate_u_dps"] / 0.01 < 0.06


@pytest.mark.slow
def test_by_default_the_operator_is_asked_for_five_rates_in_both_senses(tmp_path: Path) -> None:
    led = led_by_an_operator(tmp_path, "records = 2\ntilt_records = 1")
    assert led.code == 0, led.said
    # the rate on the axis: cos(88.693 deg) of the table's, and the vertical part of the earth rate
    cosine = math.cos(math.radians(88.693))
    vertical = 15.041 / 3600 * math.sin(math.radians(28.2)) * cosine
    over_lock_in = [(one * cosine + vertical) / 0.01 for one in led.asked[2:]]
    assert over_lock_in == pytest.approx([30, 17, 9.5, 5.3, 3, -3, -5.3, -9.5, -17, -30], rel=0.01)
    assert led.run.results is not None
    result = led.run.results
    assert result["lock_in_rate_low_95_dps"] < 0.01 < result["lock_in_rate_high_95_dps"]
    assert result["several_rates"]["by_beat"] is not None


@pytest.mark.slow
def test_a_rate_at_which_the_gyro_is_locked_is_told_and_the_others_go_on(tmp_path: Path) -> None:
    """Lock-in at 0.04 deg/s, the operator expects 0.01: at 3 times that the gyro stands still in the light."""
    led = led_by_an_operator(
        tmp_path,
        "records = 2\ntilt_records = 1\nrates_over_lock_in = [8.0, 3.0]\nboth_senses = true",
        lock_in_rate_dps=0.04,
    )
    assert led.code == 0, led.said
    assert "no record at +3 expected lock-in rates:" in led.said
    told = led.run.facts["rates_without_beat"]
    assert [one.split(" expected")[0] for one in told] == ["+3", "-3"]
    assert all(one in " ".join(led.said.split()) for one in told)
    taken = led.run.taken_for("measure")
    assert [record.conditions["over_lock_in"] for record in taken] == 4 * [8.0]
    assert [record.conditions["table_rate_dps"] > 0 for record in taken] == [True, True, False, False]
    result = led.run.results
    assert result is not None and result["lock_in_rate_u_dps"] < 0.04 * 0.08  # one rate leaves the laser open
    assert result["lock_in_rate_low_95_dps"] < 0.04 < result["lock_in_rate_high_95_dps"]


@pytest.mark.slow
def test_a_tilt_that_only_a_wrong_rate_gives_is_refused(tmp_path: Path) -> None:
    """An axis at 89.8 deg sees 0.3 % of the table's rate: no slow rate is asked for, unless the tilt is stated."""
    led = led_by_an_operator(tmp_path, "records = 2\ntilt_records = 1", tilt_deg=89.8)
    assert led.code == 4
    assert "tilt of 89.8" in led.said and "known_tilt_deg" in led.said
    assert led.asked == [50.0, -50.0]


@pytest.mark.slow
def test_a_rate_far_above_the_fast_run_is_refused_unless_it_is_stated(tmp_path: Path) -> None:
    """At 89.4 deg 400 lock-in rates of 0.01 deg/s are 382 deg/s of the table, 600 are 573."""
    told = "records = 1\ntilt_records = 1\nboth_senses = false\nrates_over_lock_in = [400, 600]"
    led = led_by_an_operator(tmp_path, told, tilt_deg=89.4)
    assert len(led.asked) == 3 and led.asked[2] == pytest.approx(382, rel=0.01)
    assert "far above the fast run" in led.said and "table.highest_rate_dps" in led.said


class Careless:
    """An operator who turns the simulated table, half as fast as was asked at the first slow rate."""

    def __init__(self, instruments: SimulatedInstruments, insists: bool = False) -> None:
        self._instruments, self._insists = instruments, insists
        self.questions: list[str] = []
        self._asked = 0.0

    def __call__(self, question: str) -> str:
        self.questions.append(question)
        if "does not fit" in question:
            if self._insists:
                return "ok"
            self._instruments.table.set_rate(self._asked)
            return ""
        self._asked = float(question.split("rate table to ")[1].split(" deg/s")[0])
        wrong = abs(self._asked) < 10 and not any("does not fit" in one for one in self.questions)
        self._instruments.table.set_rate(self._asked / 2 if wrong else self._asked)
        return ""


@pytest.mark.slow
@pytest.mark.parametrize("insists", [False, True])
def test_a_rate_that_does_not_fit_the_beat_is_asked_again(tmp_path: Path, insists: bool) -> None:
    bench = ideal_bench(measurement={"records": 2, "tilt_records": 1})
    settings = load_settings(overrides=bench)
    instruments = build_instruments(settings, VirtualClock())
    operator = Careless(instruments, insists)
    facts = facts_of("measure", settings.model_dump(mode="json"), simulated=True)
    session = Acquisition(facts, tmp_path, Progress())
    with serve(instruments.scope, "tcp") as resource, open_scope(resource, simulated=True) as scope:
        turned = Bench(scope, ManualRateTable(ask=operator), sleep=instruments.clock.sleep)
        taken = take(session, lambda of: take_on(turned, settings, of))
    assert taken.failure is None
    doubts = [question for question in operator.questions if "does not fit" in question]
    # 8 times 0.01 deg/s on the axis: 160 Hz at 2000 pulses/deg, and half of it by the careless hand
    assert len(doubts) == 1
    assert 70 < float(doubts[0].split("it has ")[1].split(" Hz")[0]) < 90
    first = operator.questions[0]
    assert "anticlockwise" in first and "finds the angle between gyro axis and table axis" in first
    assert "clockwise, - on the display" in operator.questions[1]
    seen = [one.conditions["table_rate_dps"] for one in taken.run().taken_for("measure")]
    assert seen == pytest.approx(2 * [3.507], abs=0.02)


class Sweeping:
    """An operator who sets some rates of a sweep wrong, and mends them when asked again, or insists."""

    def __init__(self, instruments: SimulatedInstruments, wrong: dict[int, float], insists: bool) -> None:
        self._instruments, self._wrong, self._insists = instruments, wrong, insists
        self.doubts: list[str] = []
        self._asked, self._rates = 0.0, 0

    def __call__(self, question: str) -> str:
        factor = 1.0
        if "does not fit" in question:
            self.doubts.append(question)
            if self._insists:
                return "ok"
        else:
            self._asked = float(question.split("rate table to ")[1].split(" deg/s")[0])
            self._rates += 1
            factor = self._wrong.get(self._rates, 1.0)
        self._instruments.table.set_rate(factor * self._asked)
        return ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "insists", "said"),
    [
        ({1: 0.4}, False, "rate of -0.08 deg/s: it has"),  # the first rate, beyond lock-in: too slow shows
        ({5: 5.0}, False, "Hz at most"),  # a later one: too fast shows
        ({1: 5.0, 6: 5.0}, True, "rate of -0.08 deg/s: it has"),  # one who insists is asked once
    ],
)
def test_the_rates_of_a_sweep_are_checked_against_the_beat(
    tmp_path: Path, wrong: dict[int, float], insists: bool, said: str
) -> None:
    overrides = {
        "simulation": {"seed": 5, "tilt_deg": 60.0, "lock_in_rate_dps": 0.01},
        "gyro": {"scale_factor_pulses_per_deg": 2000.0, "expected_lock_in_rate_dps": 0.01},
        "table": {"tilt_deg": 60.0, "settle_s": 0.0},
        "sweep": {"rates_over_lock_in": [0.5, 2.0, 4.0], "records": 1},
    }
    settings = load(DEAD_BAND, None, overrides)
    instruments = build_instruments(settings, VirtualClock())
    operator = Sweeping(instruments, wrong, insists)
    facts = facts_of("deadband", settings.model_dump(mode="json"), simulated=True)
    session = Acquisition(facts, tmp_path, Progress())
    with serve(instruments.scope, "tcp") as resource, open_scope(resource, simulated=True) as scope:
        clock = instruments.clock
        turned = Bench(scope, ManualRateTable(ask=operator), sleep=clock.sleep, now=clock.now)
        taken = take(session, lambda of: sweep_on(turned, settings, of))
    assert taken.failure is None, taken.failure
    assert len(operator.doubts) == 1
    assert said in operator.doubts[0]
    records = taken.run().taken_for("deadband")
    assert len(records) == 11
