"""What is counted is the whole run, and a link that is down is told when it is."""

import json
from pathlib import Path

import pytest

from instrument.simulated import VirtualClock
from instrument.simulated.faults import Fault
from station.cli import main
from station.live.events import Progress
from station.lock_in.settings import load_settings
from station.lock_in.take import take_on
from station.ring_laser.instruments import build_instruments
from station.ring_laser.records import Bench
from station.runs.acquisition import Acquisition, facts_of, take
from station.scope.tools import open_scope, serve
from tests.ideal_bench import ideal_bench


def events_of(path: Path, kind: str) -> list[dict[str, object]]:
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    return [one for one in lines if one["event"] == kind]


@pytest.mark.slow
def test_records_are_counted_over_all_rates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two rates in both senses are four parts of one count of eight, with the time left of all."""
    monkeypatch.chdir(tmp_path)
    told = tmp_path / "events.ndjson"
    arguments = ["measure", "--rates", "3,8", "--records", "2", "--no-report", "--quiet", "--seed", "5"]
    assert main([*arguments, "--events", str(told)]) == 0
    counted = [one for one in events_of(told, "counted") if one["what"] == "records"]
    assert [one["done"] for one in counted] == [1, 2] * 4
    assert [one["all_done"] for one in counted] == list(range(1, 9))
    assert {one["all_total"] for one in counted} == {8}
    assert counted[-1]["all_left_s"] == 0.0 and counted[0]["all_left_s"] > 0.0  # type: ignore[operator]


def test_the_whole_count_goes_on_where_the_plan_changes() -> None:
    progress, seen = Progress(), []
    progress.events.read_by(lambda event: seen.append(event.facts) if event.kind == "counted" else None)
    progress.of_all(10, 4)
    for parts, total in ((2, 10), (1, 7)):
        progress.of_all(total, 99)
        progress.start("records", parts)
        for _ in range(parts):
            progress.advance()
    assert [(one["all_done"], one["all_total"]) for one in seen] == [(5, 10), (6, 10), (7, 7)]
    assert seen[-1]["all_left_s"] == 0.0


def test_a_second_run_of_one_program_has_its_own_count(tmp_path: Path) -> None:
    """As the steps of a campaign: what the first counted is no part of the second, of whatever kind."""
    settings = load_settings(overrides=ideal_bench(measurement={"records": 2}, table={"kind": "none"}))
    seen: list[dict[str, object]] = []
    progress = Progress()
    progress.events.read_by(lambda event: seen.append(dict(event.facts)) if event.kind == "counted" else None)
    for _ in range(2):
        instruments = build_instruments(settings, VirtualClock())
        facts = facts_of("measure", settings.model_dump(mode="json"), simulated=True)
        session = Acquisition(facts, tmp_path, progress)
        with serve(instruments.scope, "tcp") as resource, open_scope(resource, simulated=True) as scope:
            bench = Bench(scope, None, sleep=instruments.clock.sleep)
            assert take(session, lambda of, bench=bench: take_on(bench, settings, of)).failure is None
    assert [(one["all_done"], one["all_total"]) for one in seen] == [(1, 2), (2, 2)] * 2


def test_a_link_that_is_lost_is_told_at_once(tmp_path: Path) -> None:
    settings = load_settings(overrides=ideal_bench(measurement={"records": 3}, table={"kind": "none"}))
    instruments = build_instruments(settings, VirtualClock())
    seen: list[bool] = []
    progress = Progress()
    progress.events.read_by(lambda event: seen.append(bool(event.facts["down"])) if event.kind == "link" else None)
    facts = facts_of("measure", settings.model_dump(mode="json"), simulated=True)
    session = Acquisition(facts, tmp_path, progress)
    with (
        serve(instruments.scope, "tcp") as resource,
        open_scope(resource, simulated=True, tell=session.link_says) as scope,
    ):
        session.watch(scope)
        instruments.scope.faults.add(Fault("link closed", answer=20))
        bench = Bench(scope, None, sleep=instruments.clock.sleep)
        taken = take(session, lambda of: take_on(bench, settings, of))
    assert taken.failure is None
    assert seen[:2] == [True, False]
    assert len(taken.run().taken_for("measure")) == 3
