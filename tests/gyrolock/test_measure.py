"""The main job as a call, on the simulated bench."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import gyrolock
from station.cli import main
from station.errors import NoUsableSignal, SettingsError, UsageError
from tests.ideal_bench import ideal_bench

QUICK = {"table": {"kind": "none"}, "measurement": {"records": 2}}


def test_it_gives_the_document_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = gyrolock.measure(ideal_bench(), records=2, seed=3, out=tmp_path, unit="7", note="a < b")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "records 2/2" in captured.err
    assert main(["analyze", str(result.run), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert result.document == {**document, "report": str(result.run.path.parent / "report.html")}
    assert Path(result.report).is_file()
    assert (len(result), result.records, result.unit) == (2, 2, "7")
    assert abs(result.lock_in_rate_dps - result.truth["lock_in_rate_dps"]) < 5 * result.lock_in_rate_u_dps
    assert "a &lt; b" in result._repr_html_()


def test_settings_from_a_file_from_mappings_and_by_name(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    file.write_text('[gyro]\nname = "of the file"\n[measurement]\nrecords = 3\n[table]\nkind = "none"\n')
    quiet = {"out": tmp_path, "quiet": True, "report": False}
    of_file = gyrolock.measure(file, **quiet)
    assert (of_file.gyro, len(of_file)) == ("of the file", 3)
    named = gyrolock.measure(str(file), records=2, gyro={"name": "by name"}, **quiet)
    assert (named.gyro, len(named)) == ("by name", 2)
    of_mapping = gyrolock.measure(QUICK, gyro={"name": "by name"}, limits={"lock_in_rate_dps": 0.001}, **quiet)
    assert (of_mapping.gyro, len(of_mapping), of_mapping.verdict) == ("by name", 2, "FAIL")
    assert QUICK == {"table": {"kind": "none"}, "measurement": {"records": 2}}
    again = gyrolock.measure(of_mapping.run.settings, **quiet)
    assert again.lock_in_rate_dps == of_mapping.lock_in_rate_dps


def test_a_quiet_call_says_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gyrolock.measure(QUICK, out=tmp_path, quiet=True, report=False)
    assert capsys.readouterr() == ("", "")


def test_mistakes_are_named_before_anything_moves(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"has no option 'recrods'; it has .* records,"):
        gyrolock.measure(recrods=3, out=tmp_path)
    with pytest.raises(SettingsError, match=r"measurement\.recrods.*did you mean records\?"):
        gyrolock.measure(measurement={"recrods": 3}, out=tmp_path)
    with pytest.raises(UsageError, match="seed belongs to a simulated bench"):
        gyrolock.measure(resource="GPIB0::1::INSTR", seed=3, out=tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_gyro_that_stays_locked_raises_and_says_where_the_run_is(tmp_path: Path) -> None:
    locked = {"table": {"kind": "none"}, "simulation": {"lock_in_rate_dps": 100.0}}
    with pytest.raises(NoUsableSignal) as caught:
        gyrolock.measure(locked, out=tmp_path, quiet=True)
    (directory,) = tmp_path.iterdir()
    assert f"gyrolock.measure(resume={str(directory)!r}) goes on" in caught.value.__notes__[0]


STOPPED = """
import itertools, os, signal, sys
import gyrolock
from station.runs.store import RunWriter
commit, commits = RunWriter.save_records, itertools.count(1)
def save_records(writer, records):
    commit(writer, records)
    if next(commits) == 12:  # eight of the fast run and four more
        os.kill(os.getpid(), signal.SIGINT)
RunWriter.save_records = save_records
gyrolock.measure(rates=8, records=20, seed=3, out=sys.argv[1], report=False)
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="no SIGINT for another process")
def test_an_interrupted_call_keeps_its_records_and_goes_on(tmp_path: Path) -> None:
    stopped = subprocess.run([sys.executable, "-c", STOPPED, str(tmp_path)], capture_output=True, text=True)
    told = stopped.stderr
    runs = list(tmp_path.glob("*/run.sqlite"))
    assert "KeyboardInterrupt" in told
    assert f"gyrolock.measure(resume={str(runs[0].parent)!r}) goes on." in told
    kept = gyrolock.open_run(runs[0])
    assert kept.outcome == "interrupted by the operator"
    assert len(kept) == 4
    with pytest.raises(UsageError, match=r"measurement\.records is 20 in the run, not 2"):
        gyrolock.measure(resume=kept, records=2)
    done = gyrolock.measure(resume=kept, quiet=True, report=False, operator="the next")
    assert (len(done), done.outcome, done.operator) == (20, "complete", "the next")
    assert len(done.resumed_at) == 1
