"""Saved runs of every kind and layout, a memory card, and what is exported of them."""

from pathlib import Path

import pytest

from station.datasets.data_set import export
from station.sources import open_source

GOLDEN = Path(__file__).parents[2] / "golden"
RUNS = ("single", "several", "quadrature", "fog_table", "fog_witness", "fog_logs", "cut_short")
"""Of all layouts, with two channels, several rates, output of a fibre gyro, without an end."""
PLACES = ("all.parquet", "all.h5", "all.npz", "all.csv", "parts/")


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The runs in every format, by the name of the format."""
    folder = tmp_path_factory.mktemp("exported")
    for place in PLACES:
        sources = [open_source(GOLDEN / f"{name}.sqlite") for name in RUNS]
        export(sources, f"{folder}/{place}", records_of_part=25)
    return {place: f"{folder}/{place}" for place in PLACES}
