"""Tables of pandas and xarray, which are an extra."""

import sys
from pathlib import Path

import numpy as np
import pytest

import gyrolock

GOLDEN = Path(__file__).parent.parent / "golden"
EVERY = [path.stem for path in sorted(GOLDEN.glob("*.sqlite"))]


def opened(name: str) -> gyrolock.Run:
    return gyrolock.open_run(GOLDEN / f"{name}.sqlite")


@pytest.mark.parametrize("package", ["pandas", "xarray"])
def test_without_the_extra_the_error_says_how_to_get_it(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    run = opened("single")
    with pytest.raises(ImportError, match=rf"{package} is not installed: pip install 'gyrolock\[data\]'"):
        _ = run.to_dataframe() if package == "pandas" else run.to_xarray()


def test_a_row_for_each_record() -> None:
    pytest.importorskip("pandas", reason="the extra `data` is not installed")
    run = opened("single")
    taken, found = run.to_dataframe(), run.result().to_dataframe()
    assert list(taken.record) == list(found.record) == ["1", "2", "3", "4", "5", "6"]
    assert list(taken.channel) == ["CH1"] * 6
    assert taken["truth.lock_in_rate_dps"].tolist() == [0.01] * 6
    assert np.array_equal(found.lock_in_rate_dps, run.estimates.lock_in_rate)


def test_a_fibre_gyro_gives_its_stretches_and_its_numbers() -> None:
    pytest.importorskip("pandas", reason="the extra `data` is not installed")
    run = opened("fog_table")
    assert list(run.to_dataframe().outputs) == [len(record) for record in run]
    numbers = run.result().to_dataframe().set_index(["name", "of"])
    assert numbers.loc[("scale_factor_u_ppm", "Z"), "unit"] == "ppm"


@pytest.mark.parametrize("name", EVERY)
def test_every_run_as_a_labelled_array(name: str) -> None:
    pytest.importorskip("xarray", reason="the extra `data` is not installed")
    run = opened(name)
    data = run.to_xarray()
    assert data.sizes["record"] == len(run)
    assert data.attrs["command"] == run.command
    if "volts" in data:
        assert np.array_equal(data.volts, run.volts)
        assert data.codes.dtype == np.int8
    else:
        assert [int(one.count()) for one in data.counts] == [len(record) for record in run]
    assert [str(one) for one in data.record.values] == [record.name for record in run] if len(run) else True
