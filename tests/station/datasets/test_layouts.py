"""Every layout of a data set that was ever written: its schema, and a small file of that time that is still read.

A new version of the layout gets a folder of its own beside ``records-1``; what lies there is never written again.
"""

import json
from pathlib import Path

import pytest

from station.datasets.data_set import sources_of, whole
from station.datasets.rows import COLUMNS, NUMBERS, OUTPUTS, SCHEMA, TEXT
from station.runs.store import open_run

from .conftest import GOLDEN

pytest.importorskip("pyarrow", reason="the extra `data` is not installed")
pytest.importorskip("h5py", reason="the extra `data` is not installed")
LAYOUTS = Path(__file__).parents[2] / "layouts"
OLD = sorted(path for path in LAYOUTS.glob("records-*/records.*") if path.suffix != ".json")


def test_there_is_an_old_file_of_every_version_and_format() -> None:
    versions = {path.parent.name for path in OLD}
    assert versions == {f"records-{version}" for version in range(1, SCHEMA["version"] + 1)}
    assert len(OLD) == 4 * len(versions)


@pytest.mark.parametrize("file", OLD, ids=lambda path: f"{path.parent.name}{path.suffix}")
def test_an_old_file_is_read_as_what_it_was(file: Path) -> None:
    sources = sources_of(file)
    fibre_gyro = {"records-1": "fog_witness"}.get(file.parent.name, "fog_eps")
    assert [source.name for source in sources] == ["runs/turning.sqlite", f"runs/{fibre_gyro}.sqlite"]
    for source in sources:
        was, now = open_run(GOLDEN / Path(source.name).name), whole(source)
        assert list(now.records) == list(was.records)
        assert dict(now.facts) == dict(was.facts)


def test_the_schema_is_what_it_was() -> None:
    written = json.loads((LAYOUTS / f"records-{SCHEMA['version']}" / "schema.json").read_text())
    kinds = {name: "text" if name in TEXT else "float64" if name in NUMBERS else "int64" for name in COLUMNS}
    further = {"codes": "int8 (n_samples)", "payload": "bytes", **dict.fromkeys(OUTPUTS, "float64 (n_outputs)")}
    today = {"schema": SCHEMA, "columns": {**kinds, **further}}
    assert today == written, "a column that changes is a new version of the layout"
