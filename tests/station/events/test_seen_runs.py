"""What is seen of saved runs, record by record, as those who watch would have seen them."""

import json
import math
from pathlib import Path

import pytest

from station.live.preview import Preview
from station.lock_in import measurement
from station.results.result import plain
from station.runs.store import NewRecord, open_run
from station.settings import saved_settings
from station.shell.finish import kind_of

GOLDEN = Path(__file__).parents[2] / "golden"


@pytest.fixture(autouse=True)
def all_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fit the rates together after every record, however fast they come."""
    monkeypatch.setattr(measurement, "_SHARE", math.inf)


def seen(name: str) -> list[Preview]:
    run = open_run(GOLDEN / f"{name}.sqlite")
    kind = kind_of(run)
    assert kind.watch is not None
    see = kind.watch(saved_settings(kind.kind, run.facts.settings, name))
    records = (NewRecord(one.key, one.purpose, one.header, one.payload, one.conditions) for one in run.records)
    found = [see([record]) for record in records]
    return [one for one in found if one is not None]


@pytest.mark.parametrize(
    "name", ["single", "turning", "channel", "quadrature", "locked", "fog_table", "fog_eps", "fog_witness"]
)
def test_every_record_shows_something(name: str) -> None:
    found = seen(name)
    assert len(found) == len(open_run(GOLDEN / f"{name}.sqlite").records)
    for one in found:
        assert one.trace is not None
        assert 2 <= len(one.trace.samples) <= 240
        assert len(one.trace.fit) in (0, len(one.trace.samples))
        assert len(json.dumps(plain(one))) < 8000


def test_at_one_rate_all_so_far_say_what_the_run_says() -> None:
    """The same records by another fit: within the noise that both know of."""
    result = json.loads((GOLDEN / "single.json").read_text(encoding="utf-8"))
    last = seen("single")[-1].so_far[0]
    assert last.records == result["records"]
    assert abs(last.value - result["lock_in_rate_dps"]) < last.u / 2


@pytest.mark.slow
def test_at_several_rates_distortion_is_taken_out() -> None:
    result = json.loads((GOLDEN / "several.json").read_text(encoding="utf-8"))
    found = seen("several")
    so_far = found[-1].so_far[0]
    assert abs(so_far.value - result["lock_in_rate_dps"]) < 3 * so_far.u
    assert so_far.u < 0.03 * so_far.value
    # what each rate says alone is off by far more than its noise
    alone = found[-1].running[0]
    assert abs(alone.value - result["lock_in_rate_dps"]) > 5 * alone.u


def test_a_gyro_that_is_locked_shows_no_beat() -> None:
    assert all(not one.trace.fit or one.values for one in seen("locked") if one.trace is not None)


def test_of_the_staircase_all_so_far_say_what_the_run_says() -> None:
    result = json.loads((GOLDEN / "fog_witness.json").read_text(encoding="utf-8"))
    found = seen("fog_witness")
    so_far = found[-1].so_far[0]
    assert so_far.records == len(result["records"])
    assert abs(so_far.value - result["two_pi_voltage_v"]) < result["two_pi_voltage_u_without_gain_v"]
    assert "V" in so_far.text
    # the even staircase goes through the samples, but for the edges and the bias that the fit has
    trace = found[0].trace
    assert trace is not None
    near = [abs(one - model) < 0.1 for one, model in zip(trace.samples, trace.fit, strict=True)]
    assert sum(near) > 0.9 * len(near)


def test_a_record_without_a_staircase_is_shown_as_it_is() -> None:
    run = open_run(GOLDEN / "fog_witness.sqlite")
    kind = kind_of(run)
    assert kind.watch is not None
    see = kind.watch(saved_settings(kind.kind, run.facts.settings, "fog_witness"))
    one = run.records[0]
    flat = NewRecord(one.key, one.purpose, one.header, bytes(len(one.payload)), one.conditions)
    shown = see([flat])
    assert shown is not None and shown.trace is not None
    assert (shown.values, shown.flags, shown.trace.fit) == ((), ("no_staircase",), [])
