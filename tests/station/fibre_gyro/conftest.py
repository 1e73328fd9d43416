"""A run of `gyrolock fog` in this process, which spares the time to start another."""

import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from station.fibre_gyro.segments import FogBench, PlannedSegment, take_segments
from station.fibre_gyro.settings import FogSettings, load_fog_settings
from station.live.events import Progress
from station.measurements import measurement
from station.runs.acquisition import Acquisition, facts_of, take
from station.runs.store import SavedRun, open_run
from station.shell.finish import Evaluated, evaluate_run, start_run

sys.path.insert(0, str(Path(__file__).parent))  # staircases.py

QUIET = Progress()
Settings = Callable[..., FogSettings]
Taken = Callable[..., tuple[Evaluated, SavedRun]]
TakenOn = Callable[..., Evaluated]

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

    def run_of(command: str, **sections: dict[str, Any]) -> tuple[Evaluated, SavedRun]:
        done = start_run(measurement(command), fog_settings(**sections), QUIET)
        assert done.failure is None
        run = open_run(done.path)
        return evaluate_run(run), run

    return run_of


@pytest.fixture
def taken_on(tmp_path: Path) -> TakenOn:
    """Take segments on a bench of the test's own and evaluate the run."""

    def run_of(
        command: str, settings: FogSettings, bench: FogBench, plan: Sequence[PlannedSegment], *, simulated: bool
    ) -> Evaluated:
        facts = facts_of(command, settings.model_dump(mode="json"), simulated=simulated)
        done = take(
            Acquisition(facts, tmp_path, QUIET),
            lambda session: take_segments(settings, session, nullcontext(bench), [lambda run: plan], {}),
        )
        assert done.failure is None, done.failure
        return evaluate_run(open_run(done.path))

    return run_of
