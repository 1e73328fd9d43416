"""What pyproject.toml says of versions can be installed exactly: `make test-lowest` does so."""

import re
import runpy
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_each_requirement_states_one_lowest_version() -> None:
    lowest = runpy.run_path(str(ROOT / "tests/house/lowest_versions.py"))["lowest_versions"]()
    assert len(lowest) > 10
    assert [text for text in lowest if not re.fullmatch(r"[a-z-]+==[0-9]+(\.[0-9]+)+", text)] == []


def test_a_package_has_one_lowest_version_wherever_it_is_named() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    named = project["dependencies"] + [text for extra in project["optional-dependencies"].values() for text in extra]
    assert len({re.split(r"[>=\[]", text)[0] for text in named if text != "gyrolock[test]"}) == len(
        set(named) - {"gyrolock[test]"}
    )
