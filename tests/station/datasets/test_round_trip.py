"""What was exported is read back as what it was, bit for bit, in every format."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import gyrolock
from station.cli import main
from station.datasets.data_set import export, sources_of, whole
from station.runs.store import SavedRun, open_run
from station.shell.finish import evaluate_run
from station.sources import find_sources, open_source
from tests.gyrolock.test_files import write_isf

from .conftest import GOLDEN, PLACES, RUNS

pytest.importorskip("pyarrow", reason="the extra `data` is not installed")
pytest.importorskip("h5py", reason="the extra `data` is not installed")


def content(run: SavedRun) -> tuple[object, ...]:
    return (list(run.records), dict(run.facts), run.unusable, run.protected, run.damaged)


def without_place(document: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in document.items() if name != "run"}


@pytest.mark.parametrize("place", PLACES)
def test_every_record_and_fact_of_every_kind_of_run(place: str, exported: dict[str, str]) -> None:
    sources = sources_of(exported[place])
    assert [Path(source.name).stem for source in sources] == list(RUNS)
    for source in sources:
        was = open_source(Path(source.name))
        assert content(whole(source)) == content(open_run(Path(source.name)))
        assert (source.sha256, source.is_run, len(source)) == (was.sha256, was.is_run, len(was))
        assert [one.number for one in source.records(range(2, 4))] == [
            one.number for one in was.records(range(2, 4))
        ]


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
def test_the_same_result_to_the_last_bit(place: str, exported: dict[str, str]) -> None:
    for name in ("single", "fog_table", "fog_witness") if place == "all.parquet" else ("fog_table",):
        run = gyrolock.read(exported[place], run=f"{name}.sqlite")
        was = evaluate_run(open_run(GOLDEN / f"{name}.sqlite")).document()
        assert without_place(run.result().document) == without_place(was)


def test_a_damaged_record_stays_damaged(tmp_path: Path) -> None:
    file = shutil.copyfile(GOLDEN / "single.sqlite", tmp_path / "single.sqlite")
    record = open_run(file).records[-1]
    data = file.read_bytes()
    place = data.index(record.payload[:100])
    file.write_bytes(data[:place] + bytes(100) + data[place + 100 :])
    for name in ("a.parquet", "a.csv"):
        export([open_source(file)], f"{tmp_path}/{name}")
        again = whole(sources_of(tmp_path / name)[0])
        assert again.damaged == open_run(file).damaged
        assert len(again.damaged) == 1
        assert evaluate_run(again).document()["damaged"]


@pytest.mark.parametrize("place", ["card.parquet", "card.h5", "card.npz", "card.csv"])
def test_a_memory_card(place: str, tmp_path: Path) -> None:
    for number in range(3):
        write_isf(tmp_path / "card" / f"ALL{number:04d}" / f"F{number:04d}CH1.ISF", number)
    was = gyrolock.read(tmp_path / "card", scale_factor=2000)
    export((open_source(one) for one in find_sources([tmp_path / "card"])), f"{tmp_path}/{place}")
    run = gyrolock.read(tmp_path / place, scale_factor=2000)
    assert [record.name for record in run] == [record.name for record in was]
    assert np.array_equal(run.volts, was.volts)
    assert run.result().document == was.result().document
    again = tmp_path / f"again_{place.replace('card', 'all')}"
    export(sources_of(tmp_path / place), str(again))
    assert gyrolock.read(again, scale_factor=2000).result().document == was.result().document


def test_records_of_other_lengths_and_wider_codes(tmp_path: Path) -> None:
    path = write_isf(tmp_path / "card" / "a.isf", 0)
    text = path.read_bytes().replace(b"NR_PT 2500", b"NR_PT 1250").replace(b"2500 points", b"1250 points")
    (tmp_path / "card" / "b.isf").write_bytes(text.replace(b"#42500", b"#41250")[:-1250])
    wide = path.read_bytes().replace(b"BYT_NR 1;BIT_NR 8", b"BYT_NR 2;BIT_NR 16").replace(b"#42500", b"#45000")
    codes = np.arange(2500, dtype=">i2").tobytes()
    (tmp_path / "card" / "c.isf").write_bytes(wide[:-2500] + codes)
    was = gyrolock.read(tmp_path / "card")
    assert [record.codes.dtype for record in was] == [np.int8, np.int8, np.int16]
    for place in ("all.parquet", "all.h5", "all.npz", "all.csv"):
        export((open_source(one) for one in find_sources([tmp_path / "card"])), f"{tmp_path}/{place}")
        run = gyrolock.read(tmp_path / place)
        assert all(np.array_equal(new.volts, old.volts) for new, old in zip(run, was, strict=True))
        assert [record.codes.dtype for record in run] == [record.codes.dtype for record in was]


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "runs").mkdir()
    for name in ("single", "turning", "locked"):
        shutil.copyfile(GOLDEN / f"{name}.sqlite", tmp_path / "runs" / f"{name}.sqlite")
    target = f"{tmp_path}/out.parquet"
    assert main(["export", f"{tmp_path}/runs", "--to", target, "--json"]) == 0  # one holds no record
    document = json.loads(capsys.readouterr().out)
    assert (document["records"], document["sources"], document["files"]) == (13, 2, [target])
    assert document["left_out"] == [f"{tmp_path}/runs/locked.sqlite: holds no record"]
    assert main(["export", target, "--to", f"{tmp_path}/again.h5"]) == 0
    assert "13 records of 2 sources" in capsys.readouterr().out
    assert len(gyrolock.read_runs(tmp_path / "again.h5")) == 2
    assert main(["export", f"{tmp_path}/runs/single.sqlite", "--to", target]) == 2
    assert "is there already" in capsys.readouterr().err
    assert main(["export", f"{tmp_path}/runs/single.sqlite", "--to", target, "--replace"]) == 0
    assert len(gyrolock.read(target)) == 6
    parts = f"{tmp_path}/parts/"
    assert main(["export", f"{tmp_path}/runs", "--to", parts, "--part-records", "5"]) == 0
    assert len(gyrolock.read_runs(parts)) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["again.h5", "out.parquet", "parts", "runs"]
