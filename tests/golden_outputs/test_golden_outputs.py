"""Saved runs of every kind give what they gave: as JSON, on the terminal, as page, CSV and JUnit.

``stored`` holds what this version prints (``make golden`` writes it again); ``tests/golden/*.json`` what an early
one printed: keys may be added to it, what was there keeps its name and its value.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from instrument import Waveform
from station.lock_in import estimate
from tests.golden_outputs import outputs
from tests.golden_outputs.differences import differences, differences_of_output, differences_of_text
from tests.golden_outputs.outputs import FOG, GROUPS, commands, without_pictures, write_outputs

GOLDEN = Path(__file__).parents[1] / "golden"
STORED = Path(__file__).parent / "stored"
SLOW = "pages", "files"
EARLY = {
    f"analyze_{name}_{kind}.out": GOLDEN / f"{name}.{kind}"
    for name in ("single", "several", "quadrature", "channel", "turning", "acquired")
    for kind in ("json", "jsonl")
}
EARLY |= {f"single_{way}_json.out": GOLDEN / f"single.{way}.json" for way in ("paper13", "rate", "k1990")}
EARLY |= {f"fog_{name}.out": path for name in FOG if (path := GOLDEN / f"fog_{name}.json").exists()}


def check(told: dict[str, str]) -> list[str]:
    """Say where outputs differ from those that are stored, and from what an early version printed."""
    found = []
    for name, text in told.items():
        if name.endswith(".svg"):
            assert "<svg" in text
            continue
        then = (STORED / name).read_text(encoding="utf-8")
        found += differences_of_output(name, then, without_pictures(text))
        if name in EARLY:
            found += differences_of_output(name, EARLY[name].read_text(encoding="utf-8"), text)
    return found


@pytest.mark.parametrize(
    "group",
    [pytest.param(group, marks=pytest.mark.slow if group in SLOW else pytest.mark.long) for group in GROUPS],
)
def test_what_is_printed_and_written_is_what_is_stored(group: str, tmp_path: Path) -> None:
    told = write_outputs(tmp_path, [group])
    assert len(told) > 40
    assert check(told) == []


def test_nothing_is_stored_that_no_command_gives() -> None:
    given = {command.name for group in GROUPS for command in commands(group)}
    assert {path.name.split(".")[0] for path in STORED.iterdir()} <= given
    assert set(EARLY) <= {f"{name}.out" for name in given}


@pytest.mark.slow
def test_a_processor_with_fewer_instructions_changes_nothing(tmp_path: Path) -> None:
    """NumPy and BLAS as an old processor runs them: no number moves by a thousandth of its uncertainty."""
    found = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    old = {
        "NPY_DISABLE_CPU_FEATURES": " ".join(found),
        "OPENBLAS_CORETYPE": "Nehalem",
        "OPENBLAS_NUM_THREADS": "1",
    }
    program = [sys.executable, str(Path(outputs.__file__)), str(tmp_path / "told"), "ring_laser", "json"]
    where = {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run(program, env=os.environ | old | where, check=True, capture_output=True)
    told = {path.name: path.read_text(encoding="utf-8") for path in (tmp_path / "told").iterdir()}
    assert len(told) > 20
    assert check(told) == []


@pytest.mark.slow
def test_rounding_as_of_another_processor_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Volts changed by 1e-12 of themselves: no number moves by a thousandth of its uncertainty."""
    shaken = []

    def shake(volts: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(len(shaken))
        shaken.append(volts.size)
        return volts * (1 + 1e-12 * rng.standard_normal(volts.shape))

    plain = estimate.batch_arrays

    def batch_arrays(batch, room=None):
        arrays = plain(batch, room)
        arrays.volts[...] = shake(arrays.volts)
        return arrays

    volts = Waveform.volts
    monkeypatch.setattr(estimate, "batch_arrays", batch_arrays)
    monkeypatch.setattr(Waveform, "volts", property(lambda wave: shake(volts.__get__(wave))))
    told = write_outputs(tmp_path, ["ring_laser"], only="json")
    assert sum(shaken) > 2500 * 100
    assert check(told) == []


def test_the_comparison_can_fail() -> None:
    assert differences({"a": [1.0, {"b": "x"}]}, {"a": [1.0, {"b": "x", "c": 2}], "d": 1}) == []
    assert differences({"a": 1.0}, {"a": 1.0 + 2e-6})
    assert differences({"a": 1.0}, {})
    assert differences({"a": [1, 2]}, {"a": [1]})
    assert differences({"a": None}, {"a": 0.0})
    assert differences({"a_dps": 1.0, "a_u_dps": 0.1}, {"a_dps": 1.00005, "a_u_dps": 0.10005}) == []
    assert differences({"a_dps": 1.0, "a_u_dps": 0.1}, {"a_dps": 1.0002, "a_u_dps": 0.1})
    assert differences({"a_dps": 1.0, "a_u_dps": 0.1}, {"a_dps": 1.0, "a_u_dps": 0.1002})
    assert differences(
        {"a_ppm": [1.0, 2.0], "a_u_ppm": [0.1, 0.1]}, {"a_ppm": [1.0, 2.001], "a_u_ppm": [0.1, 0.1]}
    )
    assert differences_of_text("t", "WL 0.0100(12) deg/s", "WL 0.0101(12) deg/s") == []
    assert differences_of_text("t", "WL 0.0100(12) deg/s", "WL 0.0102(12) deg/s")
    assert differences({"chi_square": 4.0}, {"chi_square": 4.01}) and differences(
        {"p_value": 0.5}, {"p_value": 0.501}
    )
    assert differences({"b_hz": 9.0, "b_low_95_hz": 5.0}, {"b_hz": 9.001, "b_low_95_hz": 5.0}) == []
    assert differences({"b_hz": 9.0, "b_low_95_hz": 5.0}, {"b_hz": 9.003, "b_low_95_hz": 5.0})
    assert differences({"a": "WL is 0.10 deg/s"}, {"a": "WL is 0.11 deg/s"}) == []
    assert differences({"a": "WL is 0.10 deg/s"}, {"a": "WL is 0.12 deg/s"})
    assert differences_of_text("t", "PASS 3", "FAIL 3")
