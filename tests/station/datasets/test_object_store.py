"""Data sets in an object store: fsspec's store in the memory stands for S3 and its like."""

from collections.abc import Iterator
from typing import Any

import pytest

import gyrolock
from station.cli import main
from station.datasets.data_set import export, sources_of, whole
from station.errors import RunError, UsageError
from station.runs.store import open_run
from station.sources import open_source

from .conftest import GOLDEN

fsspec = pytest.importorskip("fsspec", reason="the extra `cluster` is not installed")
pytest.importorskip("pyarrow", reason="the extra `data` is not installed")


@pytest.fixture
def store() -> Iterator[Any]:
    system = fsspec.filesystem("memory")
    system.store.clear()
    yield system
    system.store.clear()


def test_one_object_and_a_folder_of_parts(store: Any) -> None:
    runs = [GOLDEN / f"{name}.sqlite" for name in ("turning", "fog_witness")]
    for place in ("memory://bucket/records.parquet", "memory://bucket/parts/"):
        done = export([open_source(run) for run in runs], place)
        assert done.records == 5
        sources = sources_of(place)
        for source, run in zip(sources, runs, strict=True):
            assert list(whole(source).records) == list(open_run(run).records)
    assert sorted(store.store) == ["/bucket/parts/part-00000.parquet", "/bucket/records.parquet"]
    with pytest.raises(RunError, match="holds no part of a data set"):
        sources_of("memory://bucket/empty/")


def test_commands_take_a_url(store: Any, capsys: pytest.CaptureFixture[str]) -> None:
    url = "memory://bucket/records.parquet"
    assert main(["export", str(GOLDEN / "turning.sqlite"), "--to", url]) == 0
    assert gyrolock.read(url).result().records == 3
    assert main(["export", url, "--to", url.replace("records", "again")]) == 0
    assert capsys.readouterr().out.count("saved") == 2


def test_a_store_that_nobody_knows() -> None:
    with pytest.raises(UsageError, match=r"nowhere://x/y\.parquet: cannot be opened"):
        sources_of("nowhere://x/y.parquet")
    with pytest.raises(RunError, match=r"missing\.parquet: there is no such file"):
        sources_of("memory://bucket/missing.parquet")
