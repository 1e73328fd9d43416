"""What pyproject.toml says of versions can be installed exactly: `make test-lowest` does so."""

import re
import runpy
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_each_requirement_states_one_lowest_version() -> None:
    lowest = runpy.run_path(str(ROOT / "tests/house/lowest_versions.py"))["lowest_versions"]()
    assert [text for text in lowest if not re.fullmatch(r"[a-z0-9-]+==[0-9]+(\.[0-9]+)+", text)] == []
    names = [text.split("==")[0] for text in lowest]
    assert len(set(names)) == len(names) > len(PROJECT["dependencies"])
