"""The exercise: a new test of the fibre gyro is one file, one line, one section of TOML; a new number two lines.

Done on a copy of the program, and run as a user would: all that is common to measurements follows by itself.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("instrument", "analysis", "station", "gyrolock", "config", "docs")

DROOP = '''"""The droop of the output at rest: its last third less its first."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from analysis.fibre_gyro import WindowMean, mean_at_rest
from station.fibre_gyro.logs import gyro_measurement, listed_logs, planned_segments
from station.fibre_gyro.segments import PlannedSegment, checked, segments_of
from station.fibre_gyro.settings import FogSettings, TestSettings
from station.results.quantity import Quantity, QuantityGroup, document
from station.results.result import Result, Section, with_uncertainty
from station.runs.store import SavedRun
from station.settings import Positive

DROOP = (
    Quantity("droop", "counts", lambda found: found.last.mean - found.first.mean,
             lambda found: (found.last.mean_u**2 + found.first.mean_u**2) ** 0.5, limit=True, headline=True),
)
QUANTITIES = (QuantityGroup(DROOP),)


class DroopSettings(TestSettings):
    """Length of the output."""

    record_s: Positive


@dataclass(frozen=True)
class DroopEvaluation:
    """Means of the first and of the last third."""

    first: WindowMean
    last: WindowMean


def plan(settings: FogSettings) -> list[PlannedSegment]:
    """List the one segment: rest."""
    conditions = {"purpose": "droop", "rate_dps": 0.0, "axis": "Z", "end_up": 1}
    return [PlannedSegment("rest", DroopSettings.of(settings).record_s, 0.0, conditions)]


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> DroopEvaluation:
    """Take the means of both thirds."""
    recording = checked(segments_of(run, "droop")[0])
    third = recording.counts.size // 3
    parts = recording.counts[:third], recording.counts[-third:]
    return DroopEvaluation(*(mean_at_rest(part, recording.interval_s) for part in parts))


def result(found: DroopEvaluation, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers what was found."""
    made = document(found, DROOP)
    value = with_uncertainty(made["droop_counts"], made["droop_u_counts"], "counts")
    return Result("droop", value, made, quantities=QUANTITIES)


def sections(found: DroopEvaluation, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the one section of the report."""
    return [Section("Droop", sentences=(result.value,))]


MEASUREMENT = gyro_measurement(
    "droop", "Droop of the output", take=planned_segments(plan),
    take_files=listed_logs("droop", (), lambda rows, settings: [("rest", {}) for _ in rows], whole=True),
    evaluate=evaluate, result=result, sections=sections, quantities=QUANTITIES, plan=plan, section=DroopSettings,
)
'''

FIELD = """    @property
    def reduced(self) -> float:
        return self.chi_square / self.degrees_of_freedom"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program with a new test and a new number."""
    tree = tmp_path_factory.mktemp("house")
    for name in PACKAGES:
        shutil.copytree(
            ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__", "*.ipynb", "images")
        )
    (tree / "station/fibre_gyro/droop.py").write_text(DROOP, encoding="utf-8")
    add(
        tree / "station/measurements.py",
        "FIBRE_GYRO_TESTS = {\n",
        '    "droop": "Droop of the output at rest.",\n',
    )
    add(tree / "config/fibre_gyro.toml", "[simulation]\n", "[droop]\nrecord_s = 3.0\n\n", before=True)
    # the number: its field where it is computed, and its declaration
    computed = tree / "analysis/fibre_gyro/injection.py"
    text = computed.read_text(encoding="utf-8")
    end = text.index("\n\n\n", text.index("class TwoPiError"))
    computed.write_text(f"{text[:end]}\n\n{FIELD}{text[end:]}", encoding="utf-8")
    declared = '    Quantity("misfit", of="error.reduced", limit=True, doc="chi-square per degree of freedom"),\n'
    add(tree / "station/fibre_gyro/eps.py", "NUMBERS = (\n", declared)
    return tree


def add(path: Path, beside: str, text: str, *, before: bool = False) -> None:
    """Write a text beside a line of a file, which stands there once."""
    known = path.read_text(encoding="utf-8")
    assert known.count(beside) == 1
    path.write_text(known.replace(beside, text + beside if before else beside + text), encoding="utf-8")


def gyrolock(tree: Path, *arguments: str, code: int = 0) -> str:
    environment = os.environ | {"PYTHONPATH": str(tree), "COLUMNS": "120"}
    command = [sys.executable, "-m", "station.cli", *arguments]
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == code, done.stderr[-2000:]
    return done.stdout


@pytest.mark.slow
def test_a_new_test_of_the_fibre_gyro_is_one_file(copy: Path) -> None:
    (copy / "limits.toml").write_text("[limits]\ndroop_counts = 1e9\n", encoding="utf-8")
    assert "Droop of the output at rest." in gyrolock(copy, "fog", "--help")
    taken = json.loads(gyrolock(copy, "fog", "droop", "--config=limits.toml", "--json", "--quiet"))
    assert taken["verdict"] == "PASS" and taken["droop_u_counts"] > 0
    assert Path(copy, taken["report"]).exists()
    again = json.loads(gyrolock(copy, "analyze", taken["run"], "--json"))
    assert again["droop_counts"] == taken["droop_counts"]
    (listed,) = [one for one in json.loads(gyrolock(copy, "runs", "--json"))["runs"] if one["run"] == taken["run"]]
    assert listed["values"][0]["value"] == taken["droop_counts"]
    (copy / "campaign.toml").write_text(
        '[campaign]\nname = "x"\nunit_type = "x"\nstation = "x"\n[[step]]\nname = "droop"\nmeasurement = "droop"\n'
        '[[step.limit]]\nnumber = "droop_counts"\nat_most = 1e9\n',
        encoding="utf-8",
    )
    tested = json.loads(gyrolock(copy, "station", "campaign.toml", "--unit=A", "--json", "--quiet"))
    assert tested["verdict"] == "PASS"


def test_a_new_number_is_its_field_and_its_declaration(copy: Path) -> None:
    (copy / "misfit.toml").write_text("[limits]\nmisfit = 1e9\n[eps]\nrecord_s = 0.2\n", encoding="utf-8")
    found = json.loads(gyrolock(copy, "fog", "eps", "--config=misfit.toml", "--json", "--quiet", "--no-report"))
    assert found["misfit"] == pytest.approx(found["chi_square"] / found["degrees_of_freedom"])
    (limit,) = found["limits"]
    assert (limit["name"], limit["value"], limit["passed"]) == ("misfit", found["misfit"], True)
