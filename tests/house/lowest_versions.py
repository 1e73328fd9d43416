"""Print the lowest versions that pyproject.toml states, as ``name==version``, one a line, for pip."""

import sys
import tomllib
from pathlib import Path

PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"

# a linter's and NumPy's types' own rules change with each release: they are used in their newest version only
NEWEST_ONLY = "dev"


def lowest_versions() -> list[str]:
    """What is built, run and tested with, each pinned to the lowest version that pyproject.toml allows."""
    stated = tomllib.loads(PYPROJECT.read_text())
    extras = stated["project"]["optional-dependencies"]
    requirements = set(stated["build-system"]["requires"] + stated["project"]["dependencies"]).union(
        *(extras[name] for name in extras if name != NEWEST_ONLY)
    )
    return [requirement.replace(">=", "==") for requirement in sorted(requirements)]


if __name__ == "__main__":
    sys.stdout.write("\n".join(lowest_versions()) + "\n")
