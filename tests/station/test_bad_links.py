"""Runs over bad links: they complete, nothing in them is wrong, and the front panel is as it was before."""

from pathlib import Path

import pytest

from benchmarks import faults, soak
from instrument import WrongInstrument
from instrument.simulated import TcpServer, VirtualClock
from station.live.events import Progress
from station.lock_in.served import at_slow_rate
from station.lock_in.settings import default_settings
from station.measurements import measurement
from station.ring_laser.instruments import build_instruments
from station.runs.database import TAKEN
from station.runs.store import open_run
from station.shell.finish import resume_run, start_run
from tests.ideal_bench import Interrupting


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Faults are waited out for a tenth of the time: the scope is on this computer."""
    monkeypatch.setattr("instrument.dialogue.link.ANSWER_TIME", 0.3)
    monkeypatch.setattr("instrument.dialogue.link.PAUSE_TIME", 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_run_over_a_link_that_spoils_messages_each_way(quick, seed: int) -> None:
    ended = faults.measure(0.05, records=8, seed=seed)
    assert ended.outcome == TAKEN
    assert ended.right == 8
    assert ended.wrong == 0
    assert ended.spoiled > 3
    assert ended.link.repeated > 0
    assert ended.panel_is_back


def test_a_run_goes_on_with_the_scope_that_it_was_begun_with_only(tmp_path: Path) -> None:
    bench = at_slow_rate(default_settings("simulated"))
    scope = build_instruments(bench, VirtualClock()).scope
    settings = default_settings("bench")
    kind = measurement("measure")
    with TcpServer(scope) as server:
        wanted = {
            "gyro": bench.gyro,
            "scope": settings.scope.model_copy(update={"resource": server.resource_name}),
            "measurement": settings.measurement.model_copy(update={"records": 5}),
            "output": settings.output.model_copy(update={"directory": str(tmp_path)}),
        }
        cut = start_run(kind, settings.model_copy(update=wanted), Interrupting(2))
        facts, panel = dict(open_run(cut.path).facts), faults.front_panel(scope)
        scope.faults.identity = "TEKTRONIX,TDS 2014,0,CF:91.1CT FV:v5.00 TDS2CM:CMV:v1.04"
        with pytest.raises(WrongInstrument, match=r"was begun with 'TEKTRONIX.*v5\.00.*take a new run"):
            resume_run(cut.path, Progress(), kind=kind)
        assert dict(open_run(cut.path).facts) == facts
        assert faults.front_panel(scope) == panel
        scope.faults.identity = None
        resume_run(cut.path, Progress(), kind=kind)
    assert len(open_run(cut.path).taken_for("measure")) == 5


@pytest.mark.slow
def test_three_days_with_a_power_cycle_a_pulled_cable_and_a_kill(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soak, "SHARE", 0.1)
    outcome = soak.soak(90, 3)
    assert outcome.records == 90
    assert outcome.good, outcome
    assert set(outcome.incidents) == set(soak.INCIDENTS)
    assert outcome.resumed >= 1
    assert outcome.faults.total() > 10
    assert outcome.link["repeated"] > 10
    assert outcome.link["reconnected"] > 1


@pytest.mark.slow
def test_the_soak_notices_a_wrong_record(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = soak.RecordingScope.acquisition_of
    monkeypatch.setattr(
        soak.RecordingScope, "acquisition_of", lambda scope, codes, *scales: shown(scope, codes[::-1], *scales)
    )
    assert soak.main(["--records", "3", "--days", "1"]) == 1
