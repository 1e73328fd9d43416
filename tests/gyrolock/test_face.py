"""What `import gyrolock` offers, and what it costs."""

import subprocess
import sys
from pathlib import Path

import pytest

import gyrolock

HEAVY = (
    "numpy",
    "scipy",
    "pydantic",
    "pyvisa",
    "matplotlib",
    "click",
    "pandas",
    "instrument",
    "analysis",
    "station",
)


def test_import_loads_nothing_heavy() -> None:
    program = f"import sys, gyrolock; dir(gyrolock); print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["beat_signal", "read_waveform"])
def test_a_name_loads_no_more_than_it_needs(name: str) -> None:
    program = (
        f"import sys, gyrolock; gyrolock.{name}; print([n for n in ('pydantic', 'station') if n in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", gyrolock.__all__)
def test_every_name_is_there(name: str) -> None:
    assert name in dir(gyrolock)
    assert getattr(gyrolock, name).__name__ == name


def test_another_name_is_answered_with_those_that_there_are() -> None:
    with pytest.raises(AttributeError, match=r"gyrolock has no 'mesure'; it has .*measure"):
        gyrolock.mesure  # noqa: B018


def test_the_names_are_those_of_the_packages() -> None:
    from analysis import estimate_lock_in
    from instrument import TDS2014

    assert gyrolock.estimate_lock_in is estimate_lock_in
    assert gyrolock.TDS2014 is TDS2014


def test_it_is_typed() -> None:
    assert (Path(gyrolock.__file__).parent / "py.typed").is_file()
