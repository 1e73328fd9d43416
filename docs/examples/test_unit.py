"""A unit tested by gyrolock from pytest: one test for each limit of the campaign, the bench once.

GYROLOCK_CAMPAIGN=campaign.toml GYROLOCK_UNIT=RLG-001 pytest test_unit.py --junitxml=result.xml
"""

import os

import pytest

import gyrolock

CAMPAIGN, UNIT = os.environ["GYROLOCK_CAMPAIGN"], os.environ["GYROLOCK_UNIT"]
STATION = gyrolock.Station(CAMPAIGN, quiet=True)


@pytest.fixture(scope="session")
def tested():
    return STATION.test(UNIT)


def test_the_bench_did_its_work(tested):
    assert tested.verdict not in ("ERROR", "ABORTED"), tested.message


@pytest.mark.parametrize("name", STATION.limits(UNIT))
def test_the_unit_keeps_to_its_limit(tested, name):
    assert tested.limits[name].verdict == "PASS", tested.limits[name].sentence


def test_record_and_raw_runs_belong_together(tested):
    assert [check.sentence for check in tested.verify() if not check.holds] == []
