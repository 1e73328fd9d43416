"""gyrolock.Station, and the examples for OpenHTF and pytest against the real packages."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import gyrolock
from station.errors import SettingsError
from tests.small_campaign import write_campaign

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    given = {"capture_output": True, "text": True, "timeout": 300, "check": False}
    return subprocess.run([sys.executable, *arguments], env={**os.environ, **environment}, **given)  # type: ignore[call-overload,no-any-return]


@pytest.mark.slow
def test_a_bad_unit_fails_in_an_openhtf_test(tmp_path: Path) -> None:
    done = run(str(EXAMPLES / "with_openhtf.py"), str(write_campaign(tmp_path)), "BAD")
    assert done.returncode == 1, done.stderr
    assert re.search(r"^01 lock-in rate: lock_in_rate_dps 0\.01[12]\d* FAIL$", done.stdout, re.MULTILINE)
    assert re.search(r"^01 lock-in rate: noise_rms_v 0\.003\d* PASS$", done.stdout, re.MULTILINE)
    assert done.stdout.splitlines()[-1] == "FAIL"


@pytest.mark.slow
def test_a_good_unit_passes_in_pytest(tmp_path: Path) -> None:
    campaign, junit = write_campaign(tmp_path), tmp_path / "result.xml"
    example = ["-m", "pytest", "-c", os.devnull, "--rootdir", str(tmp_path), "-p", "no:cacheprovider", "-q"]
    given = {"GYROLOCK_CAMPAIGN": str(campaign), "GYROLOCK_UNIT": "SN1"}
    done = run(*example, str(EXAMPLES / "test_unit.py"), f"--junitxml={junit}", **given)
    assert done.returncode == 0, done.stdout
    assert "4 passed" in done.stdout
    assert "01 lock-in rate: lock_in_rate_dps" in junit.read_text(encoding="utf-8")


def test_the_limits_are_known_before_anything_moves(tmp_path: Path) -> None:
    station = gyrolock.Station(write_campaign(tmp_path), quiet=True)
    limits = station.limits("SN1")
    assert list(limits) == ["01 lock-in rate: lock_in_rate_dps", "01 lock-in rate: noise_rms_v"]
    assert limits["01 lock-in rate: lock_in_rate_dps"].at_most == 0.011
    assert not (tmp_path / "tests").exists()


def test_a_mistake_in_the_campaign_is_told_before_anything_moves(tmp_path: Path) -> None:
    campaign = write_campaign(tmp_path, "[[step.limit]]\nnumber = 'lock_in_rat_dps'\nat_most = 1\n")
    with pytest.raises(SettingsError, match="lock_in_rate_dps"):
        gyrolock.Station(campaign).test("SN1")
    assert not (tmp_path / "tests").exists()
