"""A campaign carried out: three units, faults of the bench, a killed program, and what is left of each."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from instrument import LinkError
from station.campaign import journal
from station.campaign.bench import bench_in_use
from station.campaign.conduct import conduct
from station.campaign.file import read_campaign
from station.campaign.journal import JOURNAL, CampaignOutcome, Journal, read_journal
from station.cli import main
from station.controllers import served_controllers
from station.errors import CannotWrite, UsageError
from station.live.events import Progress
from station.lock_in import take as lock_in_take
from station.lock_in.served import scope_on_table
from station.lock_in.settings import load_settings
from station.plan import predict
from station.runs.store import RunWriter, open_run
from station.scope.tools import serve
from tests.ideal_bench import ideal_bench

Write = Callable[..., Path]


def outcome_of(file: Path, unit: str, **more: Any) -> CampaignOutcome:
    return conduct(read_campaign(file, unit), Progress(), operator="Li", **more)


UNITS = [("GOOD", 0.009, "PASS", 0), ("LIMIT", 0.010, "MARGINAL", 6), ("BAD", 0.011, "FAIL", 1)]


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "lock_in_rate", "verdict", "code"), UNITS)
def test_good_at_the_limit_and_bad(
    campaign: Write, unit: str, lock_in_rate: float, verdict: str, code: int
) -> None:
    file = campaign(steps=1)
    outcome = outcome_of(file, unit)
    assert (outcome.verdict, outcome.exit_code) == (verdict, code)
    first = outcome.steps[0]
    (limit,) = first.limits
    assert limit.measured.value == pytest.approx(lock_in_rate, rel=0.01)
    # what the dry run predicts of a unit with the expected lock-in rate
    half = (limit.measured.high_95 - limit.measured.low_95) / 2
    assert half == pytest.approx(predict("measure", first.step.settings).u95, rel=0.5)
    assert first.run is not None
    run = open_run(first.run)
    assert run.facts.complete and run.facts.labels == {"unit": unit, "operator": "Li"}
    again = read_journal(outcome.directory).outcome()
    assert again.plan == outcome.plan
    assert [one.limits for one in again.steps] == [one.limits for one in outcome.steps]
    assert (again.verdict, again.exit_code) == (verdict, code)
    assert outcome_of(file, unit, resumed=outcome.directory) == again  # nothing is taken again


class Cable:
    """Records of the oscilloscope over a cable that is pulled at some of them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *pulled: int) -> None:
        self._take, self._pulled, self.count = lock_in_take.take_record, pulled, 0
        monkeypatch.setattr(lock_in_take, "take_record", self)

    def __call__(self, *arguments: Any) -> Any:
        self.count += 1
        if self.count in self._pulled or not self._pulled:
            raise LinkError("the cable was pulled")
        return self._take(*arguments)


@pytest.mark.slow
def test_a_step_that_the_bench_ends_is_gone_on_with(campaign: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    cable = Cable(monkeypatch, 4, 5)
    outcome = outcome_of(campaign(steps=1), "BAD")
    assert (outcome.verdict, outcome.exit_code) == ("FAIL", 1)
    first = outcome.steps[0]
    assert first.attempts == 3
    failed = [f"attempt {number} of 3 has failed" for number in (1, 2)]
    assert [remark.split(":")[0] for remark in first.remarks[:2]] == failed
    assert first.run is not None
    # two fast runs and two records a step; none of them is taken twice
    assert cable.count == 4 + 2
    assert len(open_run(first.run).records) == 4


def test_steps_behind_a_failure_are_left_out_as_the_campaign_says(campaign: Write) -> None:
    file = campaign()
    file.write_text(file.read_text().replace("[campaign]\n", "[campaign]\nstop_after_failure = true\n"))
    outcome = outcome_of(file, "BAD")
    assert (outcome.verdict, outcome.exit_code) == ("FAIL", 1)
    assert [step.verdict for step in outcome.steps] == ["FAIL"] and len(outcome.plan.steps) == 2
    assert read_journal(outcome.directory).left == ()  # `--resume` does not take what was left out on purpose


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("{python} -c 'import shutil, sys; shutil.copy(sys.argv[1], \"sent.json\")' {record}", ""),
        ("{python} -c 'import sys; sys.exit(\"no server\")'", "ended with 1: no server"),
        ("there-is-no-such-program {record}", "cannot be run"),
        ("send 'it", "cannot be run"),
        ("{python} -c 'import time; time.sleep(60)'", "timed out"),
        ("  ", ""),
    ],
)
def test_the_record_is_handed_on(
    campaign: Write, line: str, told: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = campaign(steps=1)
    monkeypatch.chdir(file.parent)
    monkeypatch.setattr("station.commands.station._HOOK_S", 5.0)
    hook = json.dumps(line.replace("{python}", sys.executable))
    file.write_text(file.read_text().replace("[campaign]\n", f"[campaign]\non_record = {hook}\n"))
    assert main(["station", str(file), "--unit", "GOOD", "--quiet", "--json"]) == 0
    captured = capsys.readouterr()
    record = Path(json.loads(captured.out)["record"])
    assert told in captured.err and ("on_record" in captured.err) == bool(told)
    if "sent.json" in line:
        assert (file.parent / "sent.json").read_bytes() == record.read_bytes()


LOOP = b"GOOD\nBAD\n\n"


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="needs a pseudo-terminal")
def test_one_unit_after_the_other_by_bar_code(campaign: Write) -> None:
    """A scanner types, and ends with a line; a campaign that does not go does not keep the next unit waiting."""
    file = campaign(steps=1)
    terminal, keyboard = os.openpty()
    os.write(terminal, LOOP)
    command = [sys.executable, "-m", "station.cli", "station", str(file), "--loop", "--quiet"]
    done = subprocess.run(command, stdin=keyboard, capture_output=True, text=True, timeout=120, check=False)
    os.close(terminal)
    os.close(keyboard)
    assert done.returncode == 1, done.stderr
    good, bad = done.stdout.splitlines()
    assert good.startswith("GOOD; PASS; tests") and bad.startswith("BAD; FAIL: first: FAIL lock-in rate: 0.01")
    assert main(["station", str(file), "--loop", "--unit", "GOOD"]) == 2


@pytest.mark.slow
def test_a_bench_that_stays_broken_is_an_error_and_the_rest_goes_on(
    campaign: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    Cable(monkeypatch, 1, 2, 3)
    outcome = outcome_of(campaign(), "GOOD")
    assert [step.verdict for step in outcome.steps] == ["ERROR", "PASS"]
    assert (outcome.verdict, outcome.exit_code) == ("ERROR", 3)
    assert outcome.message == "first: the cable was pulled"
    # the bench is mended: the step that it failed is gone on with, the other one stays
    second = outcome.steps[1]
    mended = outcome_of(campaign(), "GOOD", resumed=outcome.directory)
    assert (mended.verdict, mended.exit_code) == ("PASS", 0)
    assert mended.steps[1].run_sha256 == second.run_sha256 and mended.steps[1].ended_at == second.ended_at
    assert len(mended.resumed_at) == 1


@pytest.mark.slow
def test_a_bench_that_cannot_be_opened_is_an_error_of_every_step(campaign: Write) -> None:
    scope = '[bench.scope]\nresource = "TCPIP0::127.0.0.1::1::SOCKET"\nreconnect_s = 0.0\n'
    known = "[bench.gyro]\nscale_factor_pulses_per_deg = 2000.0\n"
    outcome = outcome_of(
        campaign(("[bench.budget]", f"{scope}{known}[bench.budget]"), ("= [8.0]", "= []")), "GOOD"
    )
    assert (outcome.verdict, outcome.exit_code) == ("ERROR", 3)
    assert [(step.attempts, step.run, len(step.remarks)) for step in outcome.steps] == 2 * [(3, None, 2)]
    assert read_journal(outcome.directory).outcome().steps == outcome.steps


def test_an_interrupted_test_is_aborted_and_goes_on(campaign: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    take, count = lock_in_take.take_record, iter(range(100))

    def interrupted(*arguments: Any) -> Any:
        if next(count) == 6:
            raise KeyboardInterrupt
        return take(*arguments)

    monkeypatch.setattr(lock_in_take, "take_record", interrupted)
    outcome = outcome_of(campaign(), "LIMIT")
    assert (outcome.verdict, outcome.exit_code) == ("ABORTED", 130)
    assert [step.verdict for step in outcome.steps] == ["MARGINAL", "ABORTED"]
    mended = outcome_of(campaign(), "LIMIT", resumed=outcome.directory)
    assert (mended.verdict, mended.exit_code) == ("MARGINAL", 6)
    assert len(journal.tests_of(outcome.plan.directory, "LIMIT")) == 1


KILLED = """
import itertools, os, signal, sys
from station.cli import main
from station.controllers import served_controllers
from station.runs.store import RunWriter
commit, commits = RunWriter.save_records, itertools.count(1)
def save_records(writer, records):
    commit(writer, records)
    if next(commits) == int(sys.argv[1]):
        os.kill(os.getpid(), signal.SIGKILL)
RunWriter.save_records = save_records
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_a_killed_test_goes_on_at_the_same_step(campaign: Write, capsys: pytest.CaptureFixture[str]) -> None:
    file = campaign()
    arguments = ["station", str(file), "--unit", "BAD", "--quiet", "--json"]
    killed = subprocess.run([sys.executable, "-c", KILLED, "7", *arguments], capture_output=True, timeout=100)
    assert killed.returncode == -9, killed.stderr
    (directory,) = journal.tests_of(Path("tests"), "BAD")
    cut = read_journal(directory).outcome()
    assert cut.verdict == "ABORTED" and [step.verdict for step in cut.steps] == ["FAIL"]
    with (directory / JOURNAL).open("ab") as lines:
        lines.write(b'{"kind": "step_en')  # what a power failure leaves of a line
    assert main([*arguments, "--resume"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] == "FAIL" and len(document["resumed_at"]) == 1
    assert [step["verdict"] for step in document["steps"]] == ["FAIL", "PASS"]
    assert document["steps"][0]["run"] == str(cut.steps[0].run)
    # what the killed session did of the second step belongs to it
    first, second = json.loads(Path(document["record"]).read_text())["steps"]
    (begun, _) = read_journal(directory).begun[second["key"]]
    assert (first["attempts"], second["attempts"], second["started_at"]) == (1, 2, begun)
    lasted = datetime.fromisoformat(second["ended_at"]) - datetime.fromisoformat(begun)
    assert second["elapsed_s"] == pytest.approx(lasted.total_seconds(), abs=2.0)
    second = open_run(Path(document["steps"][1]["run"]))
    assert len(second.facts.resumed_at) == 1 and len(second.records) == 4
    assert Path(document["record"]).is_file()
    assert main([*arguments, "--resume"]) == 2
    assert "no test of BAD is to be gone on with" in capsys.readouterr().err


@pytest.mark.slow
def test_a_test_that_was_killed_before_its_record_was_written_gets_it(
    campaign: Write, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["station", str(campaign()), "--unit", "BAD", "--json"]
    assert main(arguments) == 1
    document = json.loads(capsys.readouterr().out)
    folder = Path(document["record"]).parent
    files = {
        path: path.read_text() for path in folder.glob("*.*") if path.suffix in (".json", ".xml", ".csv", ".html")
    }
    assert len(files) == 5
    for path in files:
        path.unlink()
    assert main([*arguments, "--resume", "last"]) == 1
    again, times = json.loads(capsys.readouterr().out), dict.fromkeys(("started_at", "ended_at"))
    assert again | times == document | times
    assert {path for path in files if not path.exists()} == set()
    assert (folder / "junit.xml").read_text() == files[folder / "junit.xml"]
    assert main([*arguments, "--resume", folder.name[:4]]) == 2
    assert "has come to its end" in capsys.readouterr().err
    assert main([*arguments, "--resume", "1999"]) == 2
    assert "no tests of BAD" in capsys.readouterr().err


def test_a_test_is_carried_out_by_one_program_and_by_the_campaign_that_began_it(campaign: Write) -> None:
    plan = read_campaign(campaign(), "GOOD")
    begun = Journal.begin(plan, "", "")
    try:
        if os.name == "posix":
            with pytest.raises(UsageError, match="another program carries this test out"):
                Journal(begun.directory).open()
    finally:
        begun.close()
    changed = campaign(("at_most = 0.010", "at_most = 0.012"))
    with pytest.raises(UsageError, match="other steps, settings or limits now"):
        outcome_of(changed, "GOOD", resumed=begun.directory)
    with pytest.raises(UsageError, match="is a test of GOOD, not of BAD"):
        outcome_of(campaign(), "BAD", resumed=begun.directory)


HOLDS = """
import sys, time
from pathlib import Path
from station.campaign.bench import bench_in_use
from station.campaign.file import read_campaign
with bench_in_use(read_campaign(Path("other.toml"), "LIMIT")):
    print("holds", flush=True)
    time.sleep(60)
"""


def test_two_campaigns_on_one_bench_exclude_each_other(campaign: Write, tmp_path: Path) -> None:
    """They share the rate table only; the bench is a real one as far as the campaign knows."""
    table = "TCPIP0::127.0.0.1::1::SOCKET"

    def bench(port: int) -> str:
        return (
            f'[bench.scope]\nresource = "TCPIP0::127.0.0.1::{port}::SOCKET"\n'
            "[bench.gyro]\nscale_factor_pulses_per_deg = 2000.0\n"
            f'[bench.table]\nkind = "controller"\n[bench.controllers.rate_table]\nresource = "{table}"\n'
            "[bench.budget]"
        )

    other = campaign(("[bench.budget]", bench(2)), ('name = "Acceptance"', 'name = "Other"'), steps=1)
    other.rename(tmp_path / "other.toml")
    file = campaign(("[bench.budget]", bench(3)), steps=1)
    with subprocess.Popen(
        [sys.executable, "-c", HOLDS], cwd=tmp_path, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "holds\n"
        told = rf"{table} is in use by process {process.pid} \(campaign Other, unit LIMIT\), since 20"
        with pytest.raises(LinkError, match=told):
            outcome_of(file, "GOOD")
        assert main(["station", str(file), "--unit", "GOOD"]) == 3
        assert not (tmp_path / "tests").exists()
        process.kill()
    with bench_in_use(read_campaign(file, "GOOD")):
        pass  # what was killed holds nothing


SURROUNDED = """
[bench.controllers.chamber]
[bench.controllers.power_supply]
[bench.controllers.rate_table]
"""


def test_conditions_are_brought_about_and_stand_with_every_record(campaign: Write) -> None:
    conditions = 'measurement = "measure"\nconditions = { temperature_degc = 35.0, voltage_v = 24.0 }'
    file = campaign(
        ("[bench.budget]", f'{SURROUNDED}[bench.table]\nkind = "controller"\n[bench.budget]'),
        ("retry_after_s = 0.0", "retry_after_s = 0.0\nswitch_off_afterwards = true"),
        ('measurement = "measure"', conditions),
        steps=1,
    )
    outcome = outcome_of(file, "BAD")
    assert outcome.verdict == "FAIL"
    assert outcome.steps[0].conditions["power_supply_voltage_v"] == 24.0
    run = open_run(outcome.steps[0].run)  # type: ignore[arg-type]
    for record in run.records:
        assert record.conditions["chamber_temperature_degc"] == pytest.approx(35.0, abs=0.5)
        assert record.conditions["power_supply_current_a"] == pytest.approx(0.5)
        # the table was turned and read through the bytes of its controller
        assert record.conditions["azimuth_end_deg"] != record.conditions["azimuth_start_deg"]
    assert outcome.steps[0].limits[0].measured.value == pytest.approx(0.011, rel=0.01)


@pytest.mark.slow
def test_a_bench_that_is_served_is_driven_by_the_campaign_as_a_real_one(campaign: Write) -> None:
    settings = load_settings(overrides=ideal_bench())
    simulated, table = scope_on_table(settings)
    with serve(simulated, "tcp") as resource, served_controllers(table, tcp=True) as others:
        controllers = "".join(f'[bench.controllers.{name}]\nresource = "{others[name]}"\n' for name in others)
        bench = (
            f'[bench.scope]\nresource = "{resource}"\n'
            "[bench.gyro]\nscale_factor_pulses_per_deg = 2000.0\n"
            f'[bench.table]\nkind = "controller"\nsettle_s = 0.0\n{controllers}[bench.budget]'
        )
        file = campaign(("[bench.budget]", bench), steps=1)
        outcome = outcome_of(file, "any")
    # the served gyro has 0.01 deg/s, the limit: the campaign's [unit] says nothing of a real one
    assert (outcome.verdict, outcome.exit_code) == ("MARGINAL", 6), outcome.message
    assert outcome.steps[0].run is not None
    (one, *_) = open_run(outcome.steps[0].run).taken_for("measure")
    assert one.conditions["chamber_temperature_degc"] == 23.0
    assert one.conditions["table_rate_dps"] == pytest.approx(3.507, abs=0.02)


@pytest.mark.slow
def test_a_full_disk_ends_the_test_and_it_goes_on_when_there_is_room(
    campaign: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    save, count = RunWriter.save_records, iter(range(100))

    def full(writer: RunWriter, records: Any) -> None:
        if next(count) == 3:
            raise CannotWrite("there is no room left on the disk")
        save(writer, records)

    monkeypatch.setattr(RunWriter, "save_records", full)
    outcome = outcome_of(campaign(), "GOOD")
    assert (outcome.verdict, outcome.exit_code) == ("ERROR", 5)
    assert outcome.message == "there is no room left on the disk"
    assert outcome.steps == ()  # a second step would not be saved either
    mended = outcome_of(campaign(), "GOOD", resumed=outcome.directory)
    assert (mended.verdict, mended.exit_code) == ("PASS", 0)
