"""Work by the workers of a Dask scheduler: the same bits as here, also where a worker is killed."""

import dataclasses
import json
import os
import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.cli import main
from station.datasets.data_set import export, sources_of
from station.datasets.rows import MissingPackage
from station.errors import RunError, UsageError
from station.lock_in.estimate import Gathered, Piece, estimate_pieces, together
from station.sources import open_source
from station.sources.workers import Cluster, ThisProcess

from .conftest import GOLDEN

distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
pytest.importorskip("pyarrow", reason="the extra `cluster` is not installed")
# a worker that is killed leaves its sockets to the garbage collection of Dask
pytestmark = pytest.mark.filterwarnings(
    "ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"
)


@pytest.fixture(scope="module")
def pieces(tmp_path_factory: pytest.TempPathFactory) -> list[list[Piece]]:
    """Two runs in a data set of parts, cut anywhere."""
    folder = tmp_path_factory.mktemp("parts")
    export([open_source(GOLDEN / f"{name}.sqlite") for name in ("single", "turning")], f"{folder}/parts/")
    return [
        [Piece(source, range(first, first + 2), {})]
        for source in sources_of(folder / "parts")
        for first in range(1, len(source) + 1, 2)
    ]


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    with Cluster("local", 2) as opened:
        yield opened


def bits(found: list[Gathered]) -> list[bytes]:
    """Everything that was found, as bytes."""
    each = [together(found[:5]), together(found[5:])]
    arrays: list[Any] = []
    for one in each:
        assert one.each is not None
        fields = [getattr(one.each, field.name) for field in dataclasses.fields(one.each)]
        arrays += [value for value in fields if isinstance(value, np.ndarray)]
        arrays += [one.numbers, one.places, *one.columns.values()]
    return [array.tobytes() for array in arrays] + [repr([one.labels for one in each]).encode()]


@pytest.mark.slow
def test_the_same_bits_as_in_this_process(cluster: Cluster, pieces: list[list[Piece]]) -> None:
    here = [one for (one,) in ThisProcess().map(estimate_pieces, pieces)]
    assert cluster.count == 2
    assert bits([one for (one,) in cluster.map(estimate_pieces, pieces)]) == bits(here)
    assert sum(len(one) for one in here) == 9
    workers = cluster._client.run(os.getpid)
    found = []
    for number, (one,) in enumerate(cluster.map(estimate_pieces, pieces)):
        found.append(one)
        if number == 1:
            os.kill(next(iter(workers.values())), signal.SIGKILL)
    assert bits(found) == bits(here)


@pytest.mark.slow
def test_analyze_gives_the_same_document(
    cluster: Cluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    address, places = cluster._client.scheduler.address, [f"{tmp_path}/parts/", f"{tmp_path}/again.h5"]
    runs = [GOLDEN / f"{name}.sqlite" for name in ("turning", "fog_witness")]
    for place in places:
        export([open_source(run) for run in runs], place)
    assert main(["analyze", *map(str, runs), "--json"]) == 0
    expected = without_place(capsys.readouterr().out)
    for arguments in ([places[0], "--cluster", address], [places[1]]):
        assert main(["analyze", *arguments, "--json"]) == 0
        assert without_place(capsys.readouterr().out) == expected
    assert main(["analyze", places[0], "--cluster", "tcp://127.0.0.1:1"]) == 2
    assert "no Dask scheduler answers there" in capsys.readouterr().err


def without_place(text: str) -> list[dict[str, Any]]:
    found = json.loads(text)["results"]
    return [{name: value for name, value in one.items() if name != "run"} for one in found]


def test_an_error_of_the_work_is_as_it_was(cluster: Cluster) -> None:
    with pytest.raises(ZeroDivisionError):
        list(cluster.map(divmod_by_zero, [1]))


def divmod_by_zero(number: int) -> tuple[int, int]:
    return divmod(number, 0)


@pytest.mark.slow
def test_a_scheduler_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("station.sources.workers._PATIENCE_S", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        free = listening.getsockname()[1]
    for address, reason in (
        (
            f"tcp://127.0.0.1:{free}",
            "no Dask scheduler answers there .*refused.*: start one with `dask scheduler`",
        ),
        ("udp://127.0.0.1:1", "no Dask scheduler answers there"),
    ):
        with pytest.raises(RunError, match=reason), Cluster(address):
            pass
    with pytest.raises(UsageError, match="is no scheduler: write tcp://HOST:8786, or local"), Cluster("8786"):
        pass


def test_a_scheduler_without_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("station.sources.workers._PATIENCE_S", 1.0)
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address="127.0.0.1:0") as nobody,
        pytest.raises(RunError, match="the scheduler has no worker: start some with `dask worker"),
        Cluster(nobody.scheduler_address),
    ):
        pass


def test_other_versions_on_a_worker(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("station.sources.workers.version", lambda name: "0.0.1")
    address = cluster._client.scheduler.address
    with (
        pytest.raises(RunError, match=r"this worker has gyrolock .*, here is 0\.0\.1: install the same"),
        Cluster(address),
    ):
        pass


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingPackage, match=r"pip install 'gyrolock\[cluster\]'"), Cluster("local"):
        pass
