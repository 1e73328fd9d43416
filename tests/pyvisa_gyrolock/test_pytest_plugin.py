"""The fixture `tds2014` in the tests of another project, as `docs/simulated_scope.md` shows them."""

import re
from importlib.metadata import entry_points
from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

ROOT = Path(__file__).parents[2]
INSTALLED = any(entry.name == "tds2014" for entry in entry_points(group="pytest11"))
LOADED = () if INSTALLED else ("-p", "pyvisa_gyrolock.pytest_plugin")
OPTIONS = (*LOADED, "-p", "no:cacheprovider", "-p", "no:xdist", "-W", "error", "--strict-markers")


def test_the_example_of_the_page(pytester, monkeypatch):
    """Their program, and their test of it."""
    page = (ROOT / "docs" / "simulated_scope.md").read_text()
    program, test = re.findall(r"```python\n# (?:test_)?their_scope\.py\n(.*?)```", page, re.DOTALL)
    pytester.makepyfile(their_scope=program, test_their_scope=test)
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}:{pytester.path}")
    result = pytester.runpytest_subprocess(*OPTIONS)
    result.assert_outcomes(passed=test.count("def test_"))


@pytest.mark.slow
def test_marker_and_mistakes(pytester, monkeypatch):
    pytester.makepyfile("""
        import pytest

        @pytest.mark.tds2014(link="visa", model="TDS1002", signals=lambda times: 0.0 * times, noise_levels=0.0)
        def test_in_process(tds2014):
            scope = tds2014.open()
            assert "TDS 1002" in scope.query("*IDN?")
            scope.write("HEADER OFF;:DATA:ENCDG RIBINARY")
            assert set(scope.query_binary_values("CURVE?", datatype="b")) == {0}

        @pytest.mark.tds2014(link="carrier pigeon")
        def test_no_such_link(tds2014):
            pass
    """)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    result = pytester.runpytest_subprocess(*OPTIONS)
    result.assert_outcomes(passed=1, errors=1)
    result.stdout.fnmatch_lines(["*there is no link 'carrier pigeon'; choose one of tcp, hislip, pty, visa*"])
