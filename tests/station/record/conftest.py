"""One tested unit for all tests of its record."""

from pathlib import Path

import pytest

from station.notebook.measure import Station, TestedUnit
from tests.small_campaign import write_campaign


@pytest.fixture(scope="session")
def tested(tmp_path_factory: pytest.TempPathFactory) -> TestedUnit:
    campaign = write_campaign(tmp_path_factory.mktemp("record"))
    return Station(campaign, quiet=True).test("SN <7> & Söhne", operator="B. Bauer", note="after the move")


@pytest.fixture
def copied(tested: TestedUnit, tmp_path: Path) -> Path:
    """The folder of the test, somewhere else."""
    import shutil

    return Path(shutil.copytree(tested.outcome.directory, tmp_path / "elsewhere"))
