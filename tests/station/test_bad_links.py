"""Runs over bad links: they complete, nothing in them is wrong, and the front panel is as it was before."""

import pytest

from benchmarks import faults, soak
from station.runs.facts import TAKEN


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Faults are waited out for a tenth of the time: the scope is on this computer."""
    monkeypatch.setattr("instrument.dialogue.link.ANSWER_TIME", 0.3)
    monkeypatch.setattr("instrument.dialogue.link.PAUSE_TIME", 0.05)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_run_over_a_link_that_spoils_messages_each_way(quick, seed: int) -> None:
    ended = faults.measure(0.05, records=8, seed=seed)
    assert ended.outcome == TAKEN
    assert ended.right == 8
    assert ended.wrong == 0
    assert ended.spoiled > 3
    assert ended.link.repeated > 0
    assert ended.panel_is_back


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


def test_the_soak_notices_a_wrong_record(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = soak.RecordingScope.acquisition_of
    monkeypatch.setattr(
        soak.RecordingScope, "acquisition_of", lambda scope, codes, *scales: shown(scope, codes[::-1], *scales)
    )
    assert soak.main(["--records", "3", "--days", "1"]) == 1
