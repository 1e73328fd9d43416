"""Limits on what two numbers of a test make, and steps that are due only where an earlier one failed."""

import json
import subprocess
import sys
import time
import tracemalloc
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

import gyrolock
from station.campaign.conduct import conduct
from station.campaign.file import read_campaign
from station.campaign.journal import CampaignOutcome, read_journal
from station.campaign.messages import sentences
from station.campaign.record import verify, write_record
from station.cli import main
from station.errors import SettingsError, UsageError
from station.live.events import Progress
from station.lock_in import take as lock_in_take
from station.program import ProgramSection, run_program
from station.results.quantity import Quantity, QuantityGroup
from station.results.verdict import budgeted_values, derived
from station.runs.store import RunWriter

Write = Callable[..., Path]

RATE = Quantity("lock_in_rate", "dps", u=True, limit=True, headline=True)
AXIS = Quantity("scale_factor", "counts_per_dps", u=True, limit=True, headline=True)
DECLARED = (QuantityGroup((RATE,)), QuantityGroup((AXIS,), "axes", "axis"))


def line(name: str, slope: float, u: float, value: float = 1.0, unit: str = "x") -> dict[str, Any]:
    return {"name": name, "unit": unit, "value": value, "sensitivity_dps_per_unit": slope, "u": u}


def document(rate: float, own: float, *inputs: dict[str, Any], unit: str = "A") -> dict[str, Any]:
    parts = [one["sensitivity_dps_per_unit"] * one["u"] for one in inputs]
    u = float(np.sqrt(own**2 + sum(part**2 for part in parts)))
    budget = {"inputs": [line("noise", 1.0, own), *inputs]}
    return {
        "lock_in_rate_dps": rate,
        "lock_in_rate_u_dps": u,
        "unit": unit,
        "instrument": {"serial": "C1"},
        "budget": budget,
    }


@pytest.mark.parametrize("form", ["less", "over"])
def test_what_both_share_counts_once(form: Literal["less", "over"]) -> None:
    """Against draws of the inputs themselves: K and time base are one draw for both runs, noise is not."""
    rng = np.random.default_rng(5)
    true = np.array([0.0100, 0.0103])
    own, k_slope, t_slope = np.array([1e-5, 2e-5]), np.array([-8e-3, -7e-3]), np.array([3e-3, -3e-3])
    k, t = rng.normal(0, 4e-3, (2, 40_000))
    drawn = true[:, np.newaxis] + rng.normal(0, 1, (2, k.size)) * own[:, np.newaxis]
    drawn += np.outer(k_slope, k) + np.outer(t_slope, t)
    found = drawn[0] - drawn[1] if form == "less" else drawn[0] / drawn[1]
    first, second = (
        document(
            true[one], own[one], line("scale_factor", k_slope[one], 4e-3), line("time_base", t_slope[one], 4e-3)
        )
        for one in (0, 1)
    )
    a, b = (next(budgeted_values(one, DECLARED, "lock_in_rate_dps")) for one in (first, second))
    together = derived(form, a, b)
    assert together.value == pytest.approx(true[0] - true[1] if form == "less" else true[0] / true[1])
    assert together.u == pytest.approx(found.std(), rel=0.02)
    apart = np.hypot(a.value.u, b.value.u) * (1 if form == "less" else 1 / true[1])
    assert together.u != pytest.approx(apart, rel=0.1)
    assert together.unit == ("deg/s" if form == "less" else "")


@pytest.mark.parametrize("known", [0.01, 0.2, 0.4, 0.6])
def test_the_interval_of_a_ratio_to_what_is_hardly_known(known: float) -> None:
    """Against draws, also where the interval is far from symmetric; where b may be 0 there is none."""
    rng = np.random.default_rng(8)
    true_a, true_b, own, shared = 3.0, 2.0, 0.1, 0.05
    covered, bounded = [], 0
    for _ in range(1500):
        common = shared * rng.normal()
        a = document(true_a + own * rng.normal() + 3 * common, own, line("time_base", 3.0, shared))
        drawn = true_b + known * true_b * rng.normal() + common
        b = document(drawn, known * true_b, line("time_base", 1.0, shared))
        first, second = (next(budgeted_values(one, DECLARED, "lock_in_rate_dps")) for one in (a, b))
        found = derived("over", first, second)
        bounded += found.uncertain
        assert found.uncertain or abs(second.value.value) < 1.97 * second.value.u
        covered.append(not found.uncertain or found.low_95 <= true_a / true_b <= found.high_95)
    assert 0.93 < np.mean(covered) < 0.98  # where nothing is bounded nothing is missed
    assert (bounded > 1490) == (known < 0.3)


@pytest.mark.parametrize(
    "other",
    [
        document(0.01, 1e-5, line("scale_factor", -5.0, 1e-4), unit="B"),  # K of another unit
        document(0.01, 1e-5, line("scale_factor", -5.0, 1e-4, value=1.1)),  # another K
        document(0.01, 1e-5, line("distortion", -5.0, 1e-4)),  # goes with the size of the beat
        {
            **document(0.01, 1e-5, line("time_base", -5.0, 1e-4)),
            "instrument": {"serial": "0"},
        },  # that of every TDS
    ],
)
def test_what_may_differ_is_not_shared(other: dict[str, Any]) -> None:
    names = ("scale_factor", "distortion", "time_base")
    mine = document(0.01, 1e-5, *(line(name, -5.0, 1e-4) for name in names))
    mine["instrument"] = other["instrument"]
    a, b = (next(budgeted_values(one, DECLARED, "lock_in_rate_dps")) for one in (mine, other))
    assert derived("less", a, b).u == pytest.approx(np.hypot(a.value.u, b.value.u))


def outcome_of(file: Path, unit: str, **more: Any) -> CampaignOutcome:
    return conduct(read_campaign(file, unit), Progress(), **more)


WARM = """
[[step]]
name = "warm"
measurement = "measure"
[step.settings.simulation]
lock_in_rate_dps = 0.0092
[[step.limit]]
number = "lock_in_rate_dps"
less = "first"
at_most = {0}
[[step.limit]]
number = "lock_in_rate_dps"
over = "first: lock_in_rate_dps"
at_least = 1.0
at_most = {1}
"""


@pytest.mark.slow
def test_a_limit_on_the_difference_of_two_steps(campaign: Write) -> None:
    more = WARM.format(0.00050, 1.06)
    outcome = outcome_of(campaign(("u_ppm = 2000.0", "u_ppm = 20000.0"), steps=1, more=more), "GOOD")
    less, over = outcome.steps[1].limits
    assert (less.verdict, over.verdict) == ("PASS", "PASS"), less.sentence
    assert abs(less.measured.value - 2e-4) < 3 * less.measured.u
    assert abs(over.measured.value - 0.0092 / 0.009) < 3 * over.measured.u
    # K is known to 2 % only: each rate by itself is known to 1.8e-4
    assert outcome.steps[0].limits[0].measured.u > 1.8e-4 > 2 * less.measured.u
    assert "lock-in rate less that of first" in less.sentence
    files = write_record(outcome)
    assert all(one.holds for one in verify(outcome.directory)), verify(outcome.directory)
    assert "lock_in_rate_dps less first: lock_in_rate_dps" in files.limits.read_text()
    assert "lock-in rate over that of first" in files.page.read_text()
    assert [one.limits for one in read_journal(outcome.directory).outcome().steps] == [
        one.limits for one in outcome.steps
    ]
    # the verdict is computed from the runs again, whatever the record says
    record = json.loads(files.json.read_text())
    record["steps"][1]["limits"][0]["at_most"] = 1e-4
    files.json.write_text(json.dumps(record))
    assert any("judged again" in one.sentence for one in verify(outcome.directory) if not one.holds)


@pytest.mark.parametrize(
    ("standing", "reasons", "verdict"),
    [
        ("stands", [], "PASS"),
        ("doubtful", ["clipped"], "MARGINAL"),
        ("fails", ["no beat"], "ERROR"),
        (None, [], "ERROR"),
    ],
)
def test_a_difference_holds_as_far_as_both_do(standing: str | None, reasons: list[str], verdict: str) -> None:
    from station.results.result import Result
    from station.results.verdict import Limit, judged

    here, there = (
        document(0.0101, 1e-6),
        {**document(0.0100, 1e-6), "standing": standing, "standing_reasons": reasons},
    )
    limit = Limit("lock_in_rate_dps", None, 2e-4, less="cold: lock_in_rate_dps")
    steps = {} if standing is None else {"cold": (there, DECLARED)}
    (found,) = judged(Result("x", "1", here, DECLARED), here, [limit], steps=steps)
    assert found.verdict == verdict
    assert all(f"cold: {reason}" in found.sentence for reason in reasons)
    # of one result alone
    (own,) = judged(
        Result("x", "1", here, DECLARED), here, [Limit("lock_in_rate_dps", 0.9, 1.1, over="lock_in_rate_dps")]
    )
    assert own.measured.value == 1.0


@pytest.mark.parametrize(("form", "sign"), [("less", 1), ("over", 1), ("over", -1)])
@pytest.mark.parametrize("correlation", [-1.0, 0.0, 1.0])
def test_two_numbers_of_one_result_may_go_together_in_any_way(
    form: Literal["less", "over"], sign: int, correlation: float
) -> None:
    rng = np.random.default_rng(2)
    one, other = rng.normal(size=(2, 50_000))
    other = correlation * one + np.sqrt(1 - correlation**2) * other
    a, b = 3 + 0.01 * one, sign * (2 + 0.02 * other)
    drawn = a - b if form == "less" else a / b
    values = (document(3.0, 0.01), document(sign * 2.0, 0.02))
    first, second = (next(budgeted_values(value, DECLARED, "lock_in_rate_dps")) for value in values)
    u = derived(form, first, second, of_one=True).u
    assert u > 0.99 * drawn.std()
    if correlation == -1.0 and sign == 1:
        assert u == pytest.approx(drawn.std(), rel=0.02)


ONLY_IF = 'only_if = {{ step = "{}", verdict = ["{}"] }}'
LONGER = """
[[step]]
name = "longer"
measurement = "measure"
only_if = { step = "first", verdict = ["MARGINAL"], instead = true }
[[step.limit]]
number = "lock_in_rate_dps"
at_most = 0.011
[[step]]
name = "why"
measurement = "measure"
only_if = { step = "first", verdict = ["FAIL", "ERROR"] }
"""


SECOND = '\n[[step]]\nname = "second"\nmeasurement = "measure"\n'


@pytest.mark.slow
@pytest.mark.parametrize(
    ("unit", "begun", "verdict"),
    [
        ("GOOD", ["first"], "PASS"),
        ("LIMIT", ["first", "longer"], "PASS"),  # the longer one decides
        ("BAD", ["first", "why"], "FAIL"),
    ],
)
def test_a_step_may_depend_on_how_an_earlier_one_ended(
    campaign: Write, unit: str, begun: list[str], verdict: str
) -> None:
    file = campaign(steps=1, more=LONGER)
    outcome = outcome_of(file, unit)
    assert [one.step.name for one in outcome.steps] == begun
    assert outcome.verdict == verdict
    files = write_record(outcome)
    root = ElementTree.parse(files.junit).getroot()
    assert root.get("failures") == ("0" if verdict == "PASS" else "1")  # the MARGINAL that does not count is none
    if begun[-1] == "longer":  # who reads a PASS beside a MARGINAL is told why
        said = "02 longer: its verdict counts in the place of that of first"
        assert said in files.page.read_text() and said in sentences(outcome)
    assert all(one.holds for one in verify(outcome.directory)), verify(outcome.directory)
    assert len(files.document["not_begun"]) == 3 - len(begun)
    with pytest.raises(UsageError, match="has come to its end"):
        outcome_of(file, unit, resumed=outcome.directory)


@pytest.mark.slow
def test_what_an_unlucky_step_asks_for_is_not_left_out(campaign: Write) -> None:
    """`stop_after_failure` leaves out what comes behind a FAIL, but not what is there to tell why."""
    file = campaign(("attempts = 3", "attempts = 3\nstop_after_failure = true"), steps=1, more=f"{LONGER}{SECOND}")
    outcome = outcome_of(file, "BAD")
    assert [one.step.name for one in outcome.steps] == ["first", "why"]
    assert (
        outcome_of(file, "BAD", resumed=outcome.directory).steps == read_journal(outcome.directory).outcome().steps
    )
    assert [one.step.name for one in outcome_of(file, "GOOD").steps] == ["first", "second"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('less = "first"', 'less = "frist"', "'frist' is no number that the step 'warm' gives"),
        ('less = "first"', 'less = "warm: lock_in_rate_dps"', "no step before is 'warm': there are first"),
        ('over = "first: lock_in_rate_dps"', 'over = "first: lock_in_rat_dps"', "did you mean lock_in_rate_dps?"),
        ('less = "first"', 'less = "first"\nover = "first"', "not on both"),
        (
            'less = "first"',
            'less = "first: noise_rms_v"',
            "is in V, and lock_in_rate_dps in deg/s: only over goes",
        ),
        (
            'name = "warm"',
            'name = "warm"\nonly_if = { step = "last", verdict = ["FAIL"] }',
            "no step before is 'last'",
        ),
        ('name = "warm"', 'name = "warm"\nonly_if = { step = "first", verdict = ["BAD"] }', "only_if.verdict"),
    ],
)
def test_a_step_that_is_not_there_is_told(campaign: Write, old: str, new: str, said: str) -> None:
    file = campaign(steps=1, more=WARM.format(0.00026, 1.03).replace(old, new))
    with pytest.raises(SettingsError) as told:
        read_campaign(file, "GOOD")
    assert said in str(told.value) and "(line " in str(told.value)


# --------------------
# Steps that are a program, or a Python function


PROGRAM = """
[[step]]
name = "leak"
measurement = "program"
[step.settings.program]
function = "checks.py:leak"
[step.settings.numbers]
leak_rate = "Pa m3/s"
pressure = "Pa"
[[step.limit]]
number = "leak_rate"
at_most = {0}
[[step]]
name = "again"
measurement = "program"
[step.settings.program]
command = '''"{1}" say.py {{unit}}'''
[step.settings.numbers]
leak_rate = "Pa m3/s"
[[step.limit]]
number = "leak_rate"
over = "leak"
at_most = 2.0
"""
CHECKS = """
def leak(unit):
    print("not an answer")
    return {"leak_rate": {"value": 1.5, "u": 0.1}, "pressure": 3}
"""
SAY = """
import json, sys
assert sys.argv[1] == "RLG 7"
print(json.dumps({"leak_rate": {"value": 1.8, "low_95": 1.7, "high_95": 1.95}}))
"""


@pytest.fixture
def programs(campaign: Write, tmp_path: Path) -> Callable[..., Path]:
    import sys

    def write(limit: float = 2.0, *, checks: str = CHECKS, more: str = "") -> Path:
        (tmp_path / "checks.py").write_text(checks)
        (tmp_path / "say.py").write_text(SAY)
        text = PROGRAM.format(limit, sys.executable)
        head = '[campaign]\nname = "x"\nunit_type = "x"\nstation = "x"\nattempts = 2\nretry_after_s = 0.0\n'
        path = campaign()
        path.write_text(head + text + more)
        return path

    return write


def test_a_step_may_be_a_program_or_a_function(programs: Callable[..., Path], capsys: Any, tmp_path: Path) -> None:
    assert main(["station", str(programs()), "--unit", "RLG 7"]) == 0
    said = capsys.readouterr()
    assert "PASS leak rate: 1.50 [1.30, 1.70] Pa m3/s" in said.out
    assert "PASS leak rate over that of leak: 1.20" in said.out
    assert "not an answer" in said.err
    (folder,) = (tmp_path / "tests").glob("*/*")
    assert main(["verify", str(folder)]) == 0
    assert main(["analyze", str(next(folder.glob("runs/01*/*"))), "--json"]) == 0
    document = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (document["leak_rate"], document["leak_rate_u"], document["pressure"]) == (1.5, 0.1, 3)
    run = gyrolock.read(next(folder.glob("runs/01*/*")))
    assert (len(run), run.result().value, run.result().u) == (0, 1.5, 0.1)
    assert list(run.result().to_dataframe()["name"]) == ["leak_rate", "pressure"]
    with pytest.raises(UsageError, match="no record"):
        run.result().plot()
    assert main(["export", str(folder / "runs"), "--to", str(tmp_path / "all.npz")]) == 0
    assert main(["analyze", str(tmp_path / "all.npz"), "--jsonl"]) == 0
    assert '"leak_rate": 1.5' in capsys.readouterr().out
    assert main(["runs", str(folder)]) == 0
    assert "1.50 ± 0.20 Pa m3/s" in capsys.readouterr().out
    assert main(["station", str(programs(1.4)), "--unit", "RLG 7", "--quiet"]) == 6


def test_a_program_killed_behind_its_answer_is_not_run_again(
    programs: Callable[..., Path], tmp_path: Path
) -> None:
    counted = CHECKS.replace("    print(", "    open('runs.txt', 'a').write('x')\n    print(")
    plan = read_campaign(programs(checks=counted), "RLG 7")
    outcome = conduct(plan, Progress())
    journal = outcome.directory / "test.jsonl"
    lines = journal.read_text().splitlines()
    place = next(n for n, line in enumerate(lines) if '"step_ended"' in line)
    journal.write_text("\n".join(lines[:place]) + "\n")  # killed before the journal told it
    run = outcome.steps[0].run
    assert run is not None
    with RunWriter(run) as writer:
        writer.save_facts({"outcome": None, "ended_at": None})
    again = conduct(plan, Progress(), resumed=outcome.directory)
    assert again.verdict == outcome.verdict == "PASS"
    assert again.steps[0].limits == outcome.steps[0].limits
    assert (tmp_path / "runs.txt").read_text() == "x"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("checks", "code", "said"),
    [
        ("def leak(unit):\n    raise ValueError('the pump is off')\n", 3, "ValueError: the pump is off"),
        ("def leak(unit):\n    import os\n    os._exit(7)\n", 3, "ended with code 7: it says nothing"),
        ("def leak(unit):\n    return {'leak_rate': 1.0}\n", 4, "does not say 'pressure'"),
        ("def leak(unit):\n    return [1, 2]\n", 4, "checks.py:leak does not say"),
        (
            "def leak(unit):\n    return {'leak_rate': float('nan'), 'pressure': 1}\n",
            4,
            "nan for the value of leak_rate",
        ),
        (
            "def leak(unit):\n    return {'leak_rate': {'value': 1, 'u': '3'}, 'pressure': 1}\n",
            4,
            "'3' for the u of",
        ),
        ("def leak(unit):\n    return {'leak_rate': True, 'pressure': 1}\n", 4, "True for the value of leak_rate"),
        ("def leak(unit):\n    import time\n    time.sleep(60)\n", 3, "has not ended after 0.5 s"),
        ("def leak(unit):\n    import os\n    os.write(1, b'x' * 2_000_000)\n", 3, "said more than 1000000 bytes"),
    ],
)
def test_a_program_that_fails_is_the_bench(
    programs: Callable[..., Path], capsys: Any, checks: str, code: int, said: str
) -> None:
    file = programs(checks=checks)
    if "sleep" in checks:
        file.write_text(file.read_text().replace('function = "checks', 'timeout_s = 0.5\nfunction = "checks'))
    assert main(["station", str(file), "--unit", "RLG 7"]) == code
    told = capsys.readouterr()
    assert said in told.out and "VERDICT ERROR" in told.out
    assert "Traceback" not in told.out + told.err
    assert "again: PASS" not in told.out  # a ratio to what is not there


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="groups of processes are of POSIX")
def test_a_program_that_never_stops_takes_no_memory_and_leaves_no_process(tmp_path: Path) -> None:
    late = "import time; open('begun', 'w').close(); time.sleep(4); open('late', 'w').close()"
    talk = f"subprocess.Popen([sys.executable, '-c', {late!r}])\nwhile True: print('x' * 9999)\n"
    talk = f"import subprocess, sys\n{talk}"
    (tmp_path / "talk.py").write_text(talk)
    section = ProgramSection(
        command=f"{sys.executable} talk.py", function="", timeout_s=2.0, simulated=True, directory=str(tmp_path)
    )
    tracemalloc.start()
    try:
        with pytest.raises(subprocess.TimeoutExpired):
            run_program(section, "A")
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()
    assert (tmp_path / "begun").exists()
    time.sleep(4.0)
    assert not (tmp_path / "late").exists()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('function = "checks.py:leak"', "", "give either command or function"),
        ('function = "checks.py:leak"', 'function = "check.py:leak"', "is no FILE.py:NAME in its folder"),
        ('function = "checks.py:leak"', 'command = "leek --unit {unit}"', "'leek' is not found on this computer"),
        ("say.py", "'say.py", "No closing quotation"),
        ('number = "leak_rate"', 'number = "leak_rat"', "did you mean leak_rate?"),
        ('pressure = "Pa"', 'pressure_u = "Pa"', "is the name of an uncertainty"),
        ('pressure = "Pa"', 'Pressure = "Pa"', "numbers"),
    ],
)
def test_a_program_that_cannot_be_is_told(programs: Callable[..., Path], old: str, new: str, said: str) -> None:
    file = programs()
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(SettingsError) as told:
        read_campaign(file, "RLG 7")
    assert said in str(told.value)


@pytest.mark.slow
def test_what_a_failure_leaves_out_stays_out_when_the_test_is_gone_on_with(
    campaign: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = campaign(("attempts = 3", "attempts = 1\nstop_after_failure = true"), steps=1, more=f"{SECOND}{LONGER}")
    take = lock_in_take.take_record
    count = 0

    def taken(*arguments: Any) -> Any:
        nonlocal count
        count += 1
        if count > 4:  # the records of the first step: two for the tilt, two at each rate
            raise KeyboardInterrupt
        return take(*arguments)

    monkeypatch.setattr(lock_in_take, "take_record", taken)
    cut = outcome_of(file, "BAD")
    assert [one.step.name for one in cut.steps if one.verdict != "ABORTED"] == ["first"], count
    monkeypatch.setattr(lock_in_take, "take_record", take)
    whole = outcome_of(file, "BAD", resumed=cut.directory)
    assert [one.step.name for one in whole.steps] == ["first", "why"]
