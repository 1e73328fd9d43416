"""A scope that goes away in the middle of a measurement and comes back: the run goes on by itself."""

import os

import pytest

from benchmarks import outages

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and serial terminals are those of POSIX")


@pytest.mark.parametrize(
    ("outage", "reconnected", "set_again"),
    [
        ("server killed", True, True),
        pytest.param("serial line gone", True, True, marks=pytest.mark.slow),
        pytest.param("cable pulled", False, False, marks=pytest.mark.slow),
        pytest.param("hang", False, False, marks=pytest.mark.slow),
    ],
)
def test_the_run_goes_on(outage: str, reconnected: bool, set_again: bool) -> None:
    ended = outages.measure(outage, 1.0, records=14)
    assert ended.exit_code == 0, ended.said
    assert ended.complete
    assert ended.intact
    assert ended.records == 14
    # a scope that was switched off has forgotten time base, scale, position and trigger level
    assert (ended.link.reconnected > 0) >= reconnected
    assert (ended.link.set_again > 0) >= set_again
    assert ended.link.repeated > 0
    assert "Traceback" not in ended.said
