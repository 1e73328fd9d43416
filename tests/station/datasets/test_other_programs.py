"""What other programs read in the files that are exported."""

import csv
import json
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from station.datasets.rows import COLUMNS, NUMBERS, OUTPUTS, SCHEMA, TEXT, WHOLE
from station.fibre_gyro.segments import segments_of
from station.runs.store import SavedRecord, open_run

from .conftest import GOLDEN, RUNS


@pytest.fixture(scope="module")
def single() -> tuple[SavedRecord, ...]:
    return open_run(GOLDEN / "single.sqlite").records


SCALE_FACTOR = "scale_factor_pulses_per_deg"
COUNT = sum(len(open_run(GOLDEN / f"{name}.sqlite").records) for name in RUNS)


def test_parquet_has_lists_of_codes_flat_columns_and_its_schema(exported: dict[str, str]) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra `data` is not installed")
    schema = parquet.read_schema(exported["all.parquet"])
    said = ["unit", "operator", SCALE_FACTOR, "taken"]
    assert schema.names == [*COLUMNS, *said, "codes", "payload", *OUTPUTS]
    assert [str(schema.field(name).type) for name in said[1:]] == ["string", "double", "timestamp[ms, tz=UTC]"]
    assert {str(schema.field(name).type) for name in OUTPUTS} == {"list<element: double>"}
    assert {str(schema.field(name).type) for name in TEXT} == {"string"}
    assert {str(schema.field(name).type) for name in WHOLE} == {"int64"}
    assert {str(schema.field(name).type) for name in NUMBERS} == {"double"}
    assert str(schema.field("codes").type) == "list<element: int8>"
    assert json.loads(schema.metadata[b"gyrolock"]) == {"schema": SCHEMA}
    assert [path.name for path in sorted(Path(exported["parts/"]).iterdir())] == ["part-00000.parquet"]


def test_duckdb_chooses_and_takes_volts(exported: dict[str, str], single: tuple[SavedRecord, ...]) -> None:
    duckdb = pytest.importorskip("duckdb", reason="DuckDB is not installed")
    with duckdb.connect() as db:
        rows = db.execute(
            "SELECT number, codes, volts_per_level, table_rate_dps, scale_factor_pulses_per_deg, taken "
            "FROM read_parquet(?) WHERE source LIKE '%single.sqlite' AND purpose = 'measure' ORDER BY number",
            [exported["all.parquet"]],
        ).fetchall()
        (counted,) = db.execute(
            "SELECT count(*) FROM read_parquet(?)", [exported["parts/"] + "*.parquet"]
        ).fetchone()
        (rate,) = db.execute(
            "SELECT count(table_rate_dps) FROM read_parquet(?)", [exported["all.parquet"]]
        ).fetchone()
    assert counted == COUNT
    assert 0 < rate < counted  # what nobody knows is null
    slow = [record for record in single if record.purpose == "measure"]
    assert [(row[0], row[1]) for row in rows] == [(one.number, one.codes.tolist()) for one in slow]
    assert [row[3] for row in rows] == [one.conditions["table_rate_dps"] for one in slow]
    assert {row[2] for row in rows} == {float(one.header.split(";")[12]) for one in slow}
    assert {row[4] for row in rows} == {open_run(GOLDEN / "single.sqlite").facts.settings["gyro"][SCALE_FACTOR]}
    assert [row[5] for row in rows] == [datetime.fromisoformat(one.taken_at) for one in slow]


@pytest.mark.slow
def test_polars_makes_an_array_of_the_codes(exported: dict[str, str], single: tuple[SavedRecord, ...]) -> None:
    polars = pytest.importorskip("polars", reason="polars is not installed")
    frame = polars.scan_parquet(exported["all.parquet"])
    found = frame.filter(polars.col("source").str.ends_with("single.sqlite")).select("codes", "samples").collect()
    codes = found["codes"].list.to_array(found["samples"][0]).to_numpy()
    assert codes.dtype == np.int8
    assert np.array_equal(codes, [record.codes for record in single])
    assert len(frame.collect()) == COUNT


def test_hdf5_numpy_and_csv_without_us(exported: dict[str, str], single: tuple[SavedRecord, ...]) -> None:
    expected = np.array([record.codes for record in single])
    packed = np.load(exported["all.npz"], allow_pickle=False)
    rows = packed["source_index"] == 0
    assert packed["source"][0].decode().endswith("single.sqlite")
    assert np.array_equal(packed["codes"][rows], expected)
    assert packed["sample_interval_s"][rows].tolist() == [float(one.header.split(";")[8]) for one in single]
    with open(exported["all.csv"], newline="") as file:
        lines = [line for line in csv.DictReader(file) if line["source"].endswith("single.sqlite")]
    assert np.array_equal([[int(line[f"code_{n}"]) for n in range(2500)] for line in lines], expected)
    h5py = pytest.importorskip("h5py", reason="the extra `data` is not installed")
    with h5py.File(exported["all.h5"]) as file:
        assert np.array_equal(file["records/codes"][: len(single)], expected)
        assert json.loads(file.attrs["gyrolock"]) == {"schema": SCHEMA}


def test_xarray_opens_the_hdf5_as_netcdf(exported: dict[str, str], single: tuple[SavedRecord, ...]) -> None:
    xarray = pytest.importorskip("xarray", reason="the extra `data` is not installed")
    pytest.importorskip("h5netcdf", reason="h5netcdf is not installed")
    with xarray.open_dataset(exported["all.h5"], group="records") as found:  # a warning would fail
        assert dict(found.sizes) == {"record": COUNT, "sample": 2500}
        assert found["codes"].dims == ("record", "sample")
        assert np.array_equal(found["codes"][: len(single)], [record.codes for record in single])
        assert found["key"][1].item() == single[1].key


def test_output_of_a_fibre_gyro_is_columns_for_others(exported: dict[str, str]) -> None:
    """Times and counts of the stretches of a run, as the program itself has them."""
    duckdb = pytest.importorskip("duckdb", reason="DuckDB is not installed")
    h5py = pytest.importorskip("h5py", reason="the extra `data` is not installed")
    run = open_run(GOLDEN / "fog_table.sqlite")
    stretches = [
        one for purpose in dict.fromkeys(r.purpose for r in run.records) for one in segments_of(run, purpose)
    ]
    expected = {one.key: (one.recording.times, one.recording.counts) for one in stretches}
    with duckdb.connect() as db:
        rows = db.execute(
            "SELECT key, unnest(output_time_s) AS t, unnest(output_counts) AS c FROM read_parquet(?) "
            "WHERE source LIKE '%fog_table.sqlite' ORDER BY number, t",
            [exported["all.parquet"]],
        ).fetchall()
    assert [key for key, _, _ in rows] == [key for key, (times, _) in expected.items() for _ in times]
    for column, wanted in zip(zip(*rows, strict=True), ((), *zip(*expected.values(), strict=True)), strict=True):
        if wanted:
            assert np.array_equal(column, np.concatenate(wanted))
    with h5py.File(exported["all.h5"]) as file, np.load(exported["all.npz"]) as arrays:
        group = file["records"]
        for place, key in enumerate(group["key"].asstr()[:]):
            if key in expected and group["output_counts"][place].size == expected[key][1].size:
                ends = arrays["output_counts_end"]
                flat = arrays["output_counts"][ends[place - 1] : ends[place]]
                assert np.array_equal(group["output_counts"][place], flat)
    with open(exported["all.csv"], newline="", encoding="utf-8") as file:
        written = [row for row in csv.DictReader(file) if row["source"].endswith("fog_table.sqlite")]
    assert len(written) == len(expected)
    for row in written:
        assert np.array_equal(np.array(row["output_counts"].split(), dtype=float), expected[row["key"]][1])
        assert row["payload"] == row["code_0"] == ""
