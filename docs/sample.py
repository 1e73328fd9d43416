"""Sample data for the command lines of the guides: `make sample` makes the folder `sample`.

Two folders, for the guides have two benches: `ring_laser` (runs, a memory card, results, a test of a station) and
`fibre_gyro` (runs, logs and their list). They are made of the runs that the tests compare the program with.
"""

import contextlib
import io
import os
import shutil
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from instrument.fibre_gyro import write_gyro_log
from station.cli import main
from station.fibre_gyro.segments import segments_of
from station.runs.store import open_run

GOLDEN = Path(__file__).resolve().parents[1] / "tests" / "golden"
RUN, SECOND_RUN, UNIT_TEST = "2026-03-04T101500Z_001", "2026-11-21T060530Z_001", "2026-11-22T112810Z_001"
K = "scale_factor_pulses_per_deg"
NOISE_RUN = "2026-03-04T180000Z_001"


def make(folder: Path) -> None:
    """Make both folders in a new one."""
    _runs(folder / "ring_laser", {RUN: "default", SECOND_RUN: "several", "unit_A": "single", "unit_B": "acquired"})
    _runs(folder / "fibre_gyro", {RUN: "fog_table", NOISE_RUN: "fog_allan"})
    with _inside(folder / "ring_laser"):
        _of_ring_laser()
    with _inside(folder / "fibre_gyro"):
        _of_fibre_gyro()


def _runs(folder: Path, names: dict[str, str]) -> None:
    for name, golden in names.items():
        (folder / "runs" / name).mkdir(parents=True)
        shutil.copy(GOLDEN / f"{golden}.sqlite", folder / "runs" / name / "run.sqlite")


def _of_ring_laser() -> None:
    """A memory card and a file of it, an archive, results of two versions, a test that was carried out."""
    Path("sweeps/unit_A").mkdir(parents=True)
    shutil.copy(GOLDEN / "deadband.sqlite", "sweeps/unit_A/run.sqlite")
    _gyrolock("export", "runs/unit_A", "--tek-csv", "all")
    shutil.move("all/measure", "card")
    shutil.rmtree("all")
    of_card = sorted(Path("card").rglob("F*CH1.CSV"))
    shutil.copy(of_card[0], "F0000CH1.CSV")
    rows = [f"{one.relative_to('card').as_posix()},0.08,0.0001" for one in of_card]
    Path("rates.csv").write_text("\n".join(["file,input_rate_dps,input_rate_u_dps", *rows]) + "\n")
    shutil.copytree("runs/unit_B", "archive/unit_B")
    for name in ("old", "new"):
        _gyrolock("analyze", "archive", "--to", f"{name}.parquet")
    _gyrolock("analyze", "archive", "--to", "results.sqlite")
    for kind in ("bench", "campaign"):
        text = _gyrolock("settings", kind)
        Path(f"{kind}.toml").write_text(text.replace(f"{K} = 0.0", f"{K} = 2000.0"))
    test = GOLDEN / "campaign" / "tests" / "SN1"
    shutil.copytree(next(test.iterdir()), f"tests/RLG-001/{UNIT_TEST}")


def _of_fibre_gyro() -> None:
    """The logs of a rate-table run with their list, a night at rest, a noise sheet."""
    rows = ["file,axis,rate_dps,end_up"]
    for place, one in enumerate(segments_of(open_run(Path("runs") / RUN), "table")):
        name = f"log{place}.csv"
        write_gyro_log(name, one.recording)
        rows.append(
            f"{name},{one.conditions['axis']},{one.conditions['rate_dps']},{one.conditions.get('end_up', 1)}"
        )
    Path("list.csv").write_text("\n".join(rows) + "\n")
    rng = np.random.default_rng(1)
    night = np.column_stack([np.arange(36_000) / 10, 3.0 + rng.normal(0.0, 0.6, 36_000)])
    np.savetxt("night.csv", night, "%.9g", ",", header="time_s,gyro z [deg/h]", comments="")
    (at_rest,) = segments_of(open_run(Path("runs") / NOISE_RUN), "allan")
    warm = replace(at_rest.recording, temperature=25.0 + np.sin(at_rest.recording.times / 300.0))
    write_gyro_log("rest0.csv", warm)
    Path("rest.csv").write_text("file,axis\nrest0.csv,Z\n")
    Path("sheet.json").write_text('{"angle_random_walk_deg_per_sqrt_h": 0.005, "bias_instability_dph": 0.05}\n')


def _gyrolock(*arguments: str) -> str:
    with contextlib.redirect_stdout(io.StringIO()) as printed, contextlib.redirect_stderr(io.StringIO()) as said:
        code = main(list(arguments))
    if code:
        sys.exit(f"gyrolock {' '.join(arguments)}: exit {code}\n{said.getvalue()}")
    return printed.getvalue()


@contextlib.contextmanager
def _inside(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


if __name__ == "__main__":
    if Path("sample").exists():
        sys.exit("sample is there already: remove it to make it anew")
    make(Path("sample"))
