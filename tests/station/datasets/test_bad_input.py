"""What cannot be read or written is one line that says what is wrong and what to do."""

import json
import shutil
import sys
from pathlib import Path

import pytest

import gyrolock
from station.cli import main
from station.datasets.data_set import export, sources_of, whole
from station.datasets.rows import MissingPackage
from station.errors import RunError, UsageError
from station.sources import open_source

from .conftest import GOLDEN

pytest.importorskip("pyarrow", reason="the extra `data` is not installed")
pytest.importorskip("h5py", reason="the extra `data` is not installed")
OLD = Path(__file__).parents[2] / "layouts" / "records-1"
ENDINGS = ("parquet", "h5", "npz", "csv")


def said(capsys: pytest.CaptureFixture[str]) -> str:
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("exporting")]
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.97])
def test_a_truncated_file(ending: str, share: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = (OLD / f"records.{ending}").read_bytes()
    file = tmp_path / f"cut.{ending}"
    file.write_bytes(content[: int(share * len(content))])
    assert main(["export", str(file), "--to", f"{tmp_path}/new.csv"]) == 2
    line = said(capsys)
    assert str(file) in line
    assert not (tmp_path / "new.csv").exists()
    if ending != "csv":
        assert "damaged" in line


@pytest.mark.parametrize("ending", ENDINGS)
def test_bytes_that_changed_make_no_other_record(ending: str, tmp_path: Path) -> None:
    content = bytearray((OLD / f"records.{ending}").read_bytes())
    was = [record for source in sources_of(OLD / f"records.{ending}") for record in source.records()]
    for place in range(500, len(content), len(content) // 12):
        file = tmp_path / f"{place}.{ending}"
        file.write_bytes(content[:place] + bytes([content[place] ^ 0x11]) + content[place + 1 :])
        try:
            found = [record for source in sources_of(file) for record in whole(source).records]
        except RunError:
            continue
        assert all(record in was for record in found if record.intact)


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_future_schema(ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / f"new.{ending}"
    newer = {"name": "gyrolock records", "version": 4}
    monkeypatch.setattr("station.datasets.backends.SCHEMA", newer)
    monkeypatch.setattr("station.datasets.backends._MARK", "gyrolock records 4")
    export([open_source(GOLDEN / "turning.sqlite")], str(file))
    with pytest.raises(RunError, match=r"written by a newer gyrolock \(records 4\): update this one"):
        sources_of(file)


def test_files_of_other_programs(tmp_path: Path) -> None:
    import h5py
    import numpy as np
    import pyarrow
    import pyarrow.parquet

    pyarrow.parquet.write_table(pyarrow.table({"a": [1]}), tmp_path / "other.parquet")
    np.savez(tmp_path / "other.npz", schema=np.array("{}"), codes=np.zeros(3))
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["a"] = 1
    for file in tmp_path.iterdir():
        with pytest.raises(RunError, match="is no data set of gyrolock"):
            sources_of(file)


def test_a_part_that_is_missing(tmp_path: Path) -> None:
    sources = [open_source(GOLDEN / f"{name}.sqlite") for name in ("single", "turning")]
    export(sources, f"{tmp_path}/parts/")
    shutil.copyfile(tmp_path / "parts" / "part-00000.parquet", tmp_path / "parts" / "part-00001.parquet")
    export([open_source(GOLDEN / "several.sqlite")], f"{tmp_path}/all.npz")
    (source,) = sources_of(tmp_path / "all.npz")
    table, rows = source._stretches[0]
    source._stretches[0] = table, rows[:-1]  # as if the rest stood in a file that is not there
    with pytest.raises(RunError, match=r"holds 21 of 22 records of .*several\.sqlite: a part is missing"):
        whole(source)


def test_what_holds_several_runs_or_runs_and_files(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="holds 2 runs: name one as run, or take all by gyrolock"):
        gyrolock.read(OLD / "records.parquet")
    with pytest.raises(UsageError, match="holds 0 runs called nobody"):
        gyrolock.read(OLD / "records.parquet", run="nobody")
    assert gyrolock.read(OLD / "records.parquet", run="turning.sqlite").command == "gyrolock measure"


def test_what_cannot_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = str(GOLDEN / "turning.sqlite")
    for target, reason in (
        ("x.xlsx", "a data set's name ends with .parquet"),
        ("s3://bucket/x.h5", "to an object store Parquet is written"),
        (f"{tmp_path}/no/x.npz", "cannot be written"),
    ):
        assert main(["export", run, "--to", target]) in (2, 5)
        assert reason in said(capsys)
    assert main(["export", str(GOLDEN / "locked.sqlite"), "--to", f"{tmp_path}/x.csv"]) == 2
    assert "there is no record to export" in said(capsys)
    (tmp_path / "there.h5").write_text("mine")
    assert main(["export", run, "--to", f"{tmp_path}/there.h5"]) == 2
    assert (tmp_path / "there.h5").read_text() == "mine"
    assert "--replace" in said(capsys)
    assert main(["export", run, "--to", "nowhere://bucket/x.parquet", "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["error"]["message"].startswith("nowhere://")
    assert [path.name for path in tmp_path.iterdir()] == ["there.h5"]


@pytest.mark.parametrize(("ending", "name"), [("parquet", "pyarrow"), ("h5", "h5py")])
def test_without_the_extra(ending: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for one in (name, f"{name}.parquet"):
        monkeypatch.setitem(sys.modules, one, None)
    told = rf"{name} is not installed: pip install 'gyrolock\[data\]'"
    with pytest.raises(MissingPackage, match=told):
        export([open_source(GOLDEN / "turning.sqlite")], f"{tmp_path}/x.{ending}")
    with pytest.raises(MissingPackage, match=told):
        sources_of(OLD / f"records.{ending}")
    assert not list(tmp_path.iterdir())
