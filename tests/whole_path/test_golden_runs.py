"""Saved runs of every kind, written by an early version, still give what they gave then.

``tests/golden`` holds the runs' SQLite files and the JSON that was printed for them at that time. Keys may be
added; what was there keeps its name and its value.
"""

import json
import math
import shutil
from pathlib import Path
from typing import Any

import pytest

GOLDEN = Path(__file__).parent.parent / "golden"
# kind of run: command that reads it
FOG = {"table": "table", "logs": "table", "selfcal": "selfcal", "selfcal_by_table": "selfcal", "eps": "eps"}
FOG |= {"figures": "figures", "witness": "witness"}
RING_LASER = ("single", "several", "quadrature", "channel", "turning", "acquired")
PLACES = ("run", "report", "file")  # where something lies differs from machine to machine

# differences of nearly equal numbers show the rounding of each release of NumPy and SciPy
DIFFERENCES = {"deviation_in_u": 1e-6, "residual_ppm": 1e-8, "share_of_variance": 1e-8}


def differences(then: Any, now: Any, place: str = "") -> list[str]:
    """Say where `now` lacks or changes something of `then`."""
    if isinstance(then, dict):
        if not isinstance(now, dict):
            return [f"{place}: {then!r} became {now!r}"]
        found = []
        for key, value in then.items():
            if key in PLACES:
                continue
            if key not in now:
                found.append(f"{place}.{key} is missing")
            else:
                found += differences(value, now[key], f"{place}.{key}")
        return found
    if isinstance(then, list):
        if not isinstance(now, list) or len(now) != len(then):
            return [f"{place}: {then!r} became {now!r}"]
        return [text for i, one in enumerate(then) for text in differences(one, now[i], f"{place}[{i}]")]
    if isinstance(then, float) and isinstance(now, int | float):
        least = next((small for end, small in DIFFERENCES.items() if place.endswith(end)), 1e-15)
        same = math.isclose(then, now, rel_tol=1e-9, abs_tol=least)
    else:
        same = then == now
    return [] if same else [f"{place}: {then!r} became {now!r}"]


def saved(name: str, tmp_path: Path) -> Path:
    """Copy a golden run: what is computed from it must not be written into the checkout."""
    return Path(shutil.copy(GOLDEN / f"{name}.sqlite", tmp_path / f"{name}.sqlite"))


@pytest.mark.parametrize("name", RING_LASER)
def test_a_ring_laser_run_gives_what_it_gave(name: str, tmp_path: Path, gyrolock) -> None:
    now = gyrolock("analyze", saved(name, tmp_path), "--json").document
    assert differences(json.loads((GOLDEN / f"{name}.json").read_text()), now) == []


@pytest.mark.parametrize("name", RING_LASER)
def test_its_records_give_what_they_gave(name: str, tmp_path: Path, gyrolock) -> None:
    now = gyrolock("analyze", saved(name, tmp_path), "--jsonl").out.splitlines()
    then = (GOLDEN / f"{name}.jsonl").read_text().splitlines()
    assert differences([json.loads(line) for line in then], [json.loads(line) for line in now]) == []


@pytest.mark.parametrize("choice", ["--relation=paper-13", "--input-rate=0.08", "--scale-factor=1990"])
def test_with_other_choices_too(choice: str, tmp_path: Path, gyrolock) -> None:
    short = {"--relation": "paper13", "--input-rate": "rate", "--scale-factor": "k1990"}[choice.split("=")[0]]
    now = gyrolock("analyze", saved("single", tmp_path), choice, "--json").document
    assert differences(json.loads((GOLDEN / f"single.{short}.json").read_text()), now) == []


@pytest.mark.parametrize("name", FOG)
def test_a_fibre_gyro_run_gives_what_it_gave(name: str, tmp_path: Path, gyrolock) -> None:
    now = gyrolock("fog", FOG[name], saved(f"fog_{name}", tmp_path), "--json", "--no-report").document
    assert differences(json.loads((GOLDEN / f"fog_{name}.json").read_text()), now) == []


def test_a_locked_gyro_still_gives_no_number(tmp_path: Path, gyrolock) -> None:
    done = gyrolock("analyze", saved("locked", tmp_path), "--json")
    assert done.code == 2
    assert "no record at the slow rate" in done.document["error"]["message"]


def test_the_comparison_can_fail() -> None:
    assert differences({"a": [1.0, {"b": "x"}]}, {"a": [1.0, {"b": "x", "c": 2}], "d": 1}) == []
    assert differences({"a": 1.0}, {"a": 1.0 + 1e-8})
    assert differences({"a": 1.0}, {})
    assert differences({"a": [1, 2]}, {"a": [1]})
    assert differences({"a": None}, {"a": 0.0})
