"""Sweeps on the simulated bench, in this process."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from station.dead_band.measurement import MEASUREMENT
from station.live.events import Progress
from station.runs.store import SavedRun, open_run
from station.settings import load
from station.shell.finish import start_run

Sweep = Callable[..., SavedRun]


def settings_of(folder: Path, **sections: dict[str, Any]) -> Any:
    overrides: dict[str, dict[str, Any]] = {
        "simulation": {"seed": 5, "link": "tcp"},
        "sweep": {"steps": 6},
        "output": {"directory": str(folder)},
    }
    for section, names in sections.items():
        overrides[section] = overrides.get(section, {}) | names
    return load(MEASUREMENT.kind, None, overrides)


@pytest.fixture(scope="session")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Sweep:
    """Take a sweep, or give the one that was taken with the same settings."""
    taken: dict[str, SavedRun] = {}

    def take(**sections: dict[str, Any]) -> SavedRun:
        if (name := repr(sections)) not in taken:
            settings = settings_of(tmp_path_factory.mktemp("sweep"), **sections)
            done = start_run(MEASUREMENT, settings, Progress())
            assert done.failure is None
            taken[name] = open_run(done.path)
        return taken[name]

    return take
