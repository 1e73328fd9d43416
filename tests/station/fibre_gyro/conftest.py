"""A run of `gyrolock fog` in this process, which spares the time to start another."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from station.fibre_gyro.results import FogResult, evaluate_fog_run
from station.fibre_gyro.session import start_run
from station.fibre_gyro.settings import FogSettings, load_fog_settings
from station.fibre_gyro.store import FogRun, open_fog_run
from station.runs.progress import Progress

sys.path.insert(0, str(Path(__file__).parent))  # staircases.py

Settings = Callable[..., FogSettings]
Taken = Callable[..., tuple[FogResult, FogRun]]

EXACT = {"table": {"irreproducibility_ppm": 0.0}, "simulation": {"misalignment_mrad": 0.0}}
"""A table and a mounting without errors: what is left is the noise of the gyro."""


@pytest.fixture
def fog_settings(tmp_path: Path) -> Settings:
    """Settings with overrides by section, runs in the test's directory."""

    def make(**sections: dict[str, Any]) -> FogSettings:
        merged = {name: {**EXACT.get(name, {}), **sections.get(name, {})} for name in {*EXACT, *sections}}
        return load_fog_settings(overrides={**merged, "output": {"directory": str(tmp_path)}})

    return make


@pytest.fixture
def taken(fog_settings: Settings) -> Taken:
    """Take a whole simulated run and evaluate it."""

    def take(command: str, **sections: dict[str, Any]) -> tuple[FogResult, FogRun]:
        campaign = start_run(command, fog_settings(**sections), Progress(quiet=True))
        assert campaign.failure is None
        run = open_fog_run(campaign.path)
        return evaluate_fog_run(run), run

    return take
