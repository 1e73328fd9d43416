"""Saved runs of any length, made quickly: some thousands of records of a beat, again and again."""

from __future__ import annotations

import contextlib
import io
import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from station.sources.batches import Source

SAMPLES, INTERVAL, SCALE_FACTOR = 2500, 2e-5, 2000.0
PER_RUN = 100
DIFFERENT = 2000
LOCK_IN, TILT_DEG = 0.02, 60.0
BENCH_RUNS = 5
RATES = tuple(sense * LOCK_IN * multiple for multiple in (4, 8, 15, 30) for sense in (1, -1))
"""On the gyro's axis, deg/s, of a run at several rates."""
FAST_TABLE_RATE, FAST_INTERVAL, FAST_RECORDS = 50.0, 2e-7, 4


def header(interval: float) -> str:
    """What the scope says of a record with so many seconds between its samples."""
    return (
        '1;8;BIN;RI;MSB;2500;"Ch1, DC coupling, 5.0E-1 V/div, 5.0E-3 s/div, 2500 points, Sample mode";Y;'
        f'{interval:.1E};0;{-SAMPLES / 2 * interval:.2E};"s";2.0E-2;0.0E0;0.0E0;"Volts"'
    )


def codes_of_beats(
    count: int, seed: int, *, rate: float = 0.3, interval: float = INTERVAL, spread: float = 0.05, beats: int = 200
) -> np.ndarray:
    """Codes (count, 2500) of beats with the noise of a scope; some waveforms, each time with other noise.

    `spread`: of the lock-in rates, relative; the rates lie within a fifth of it.
    """
    from analysis import beat_signal

    rng = np.random.default_rng(seed)
    times = np.arange(SAMPLES) * interval
    made = np.array(
        [
            beat_signal(
                times,
                scale_factor=SCALE_FACTOR,
                input_rate=rate * (1 + spread / 5 * rng.random()),
                lock_in_rate=LOCK_IN * (1 + spread * rng.standard_normal()),
                initial_phase=2 * math.pi * rng.random(),
            )
            for _ in range(beats)
        ]
    )
    noise = 1.2 * rng.standard_normal((count, SAMPLES), dtype=np.float32)
    return np.rint(90 * made[rng.integers(0, len(made), count)] + noise).astype(np.int8)


def make_runs(folder: Path, records: int, per_run: int) -> None:
    """Save so many records as runs of the lock-in measurement."""
    from station.lock_in.settings import RING_LASER
    from station.runs.store import NewRecord, RunWriter
    from station.settings import load

    settings = load(RING_LASER, overrides={"gyro": {"scale_factor_pulses_per_deg": SCALE_FACTOR}})
    facts = {"command": "measure", "settings": settings.model_dump(mode="json"), "unit": "SN 1", "simulated": True}
    payloads = [one.tobytes() for one in codes_of_beats(min(records, DIFFERENT), 1)]
    for first in range(0, records, per_run):
        with RunWriter.create(folder, facts) as writer:
            for begin in range(first, min(first + per_run, records), 2000):
                numbers = range(begin, min(begin + 2000, first + per_run, records))
                writer.save_records(
                    [
                        NewRecord(
                            f"measure, {n}",
                            "measure",
                            header(INTERVAL),
                            payloads[n % len(payloads)],
                            {"channel": "CH1"},
                        )
                        for n in numbers
                    ]
                )


def make_runs_at_rates(folder: Path, records: int, per_run: int) -> None:
    """Save so many records at several rates: one run that goes through all of them, or runs at one rate each.

    The rates on the axis of the runs stand in ``rates.csv`` beside the folder.
    """
    from analysis.rotation import rate_on_axis
    from station.lock_in.settings import RING_LASER
    from station.runs.store import NewRecord, RunWriter
    from station.settings import load

    settings = load(RING_LASER, overrides={"gyro": {"scale_factor_pulses_per_deg": SCALE_FACTOR}})
    facts = {"command": "measure", "settings": settings.model_dump(mode="json"), "unit": "SN 1", "simulated": True}

    def on_axis(table_rate: float) -> float:
        """By a table that nobody has turned to the north: with the vertical part of the earth rate."""
        return float(rate_on_axis(table_rate, TILT_DEG, settings.site.latitude_deg, 90.0))

    def record(key: str, purpose: str, codes: bytes, interval: float, table_rate: float) -> NewRecord:
        return NewRecord(key, purpose, header(interval), codes, {"channel": "CH1", "table_rate_dps": table_rate})

    fast = [
        record(f"tilt, {sense} {number}", "tilt", codes.tobytes(), FAST_INTERVAL, sense * FAST_TABLE_RATE)
        for sense in (1, -1)
        for number, codes in enumerate(
            codes_of_beats(
                FAST_RECORDS, 2, rate=on_axis(sense * FAST_TABLE_RATE), interval=FAST_INTERVAL, spread=0, beats=4
            )
        )
    ]
    table_rates = [(rate - on_axis(0.0)) / math.cos(math.radians(TILT_DEG)) for rate in RATES]
    payloads = [
        [
            codes.tobytes()
            for codes in codes_of_beats(DIFFERENT // len(RATES), place, rate=rate, spread=0, beats=50)
        ]
        for place, rate in enumerate(RATES)
    ]
    stated = ["file,input_rate_dps,input_rate_u_dps"]
    for run, first in enumerate(range(0, records, per_run)):
        with RunWriter.create(folder, facts) as writer:
            writer.save_records(fast)
            for begin in range(first, min(first + per_run, records), 2000):
                new = []
                for n in range(begin, min(begin + 2000, first + per_run, records)):
                    place = run % len(RATES) if per_run < records else n * len(RATES) // records
                    codes = payloads[place][n % len(payloads[place])]
                    new.append(record(f"measure, {n}", "measure", codes, INTERVAL, table_rates[place]))
                writer.save_records(new)
        stated.append(f"{writer.path.relative_to(folder).as_posix()},{RATES[run % len(RATES)]},1e-7")
    (folder.parent / "rates.csv").write_text("\n".join([*stated, ""]), "utf-8")


def default_runs(folder: Path, count: int) -> list[Source]:
    """Take so many runs of the default bench."""
    from station.cli import main as gyrolock
    from station.sources.find import open_source

    for seed in range(count):
        with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
            gyrolock(["measure", "--seed", str(seed), "--out", str(folder), "--no-report", "--quiet"])
    return [open_source(path) for path in sorted(folder.rglob("run.sqlite"))]


def make_runs_of_bench(folder: Path, records: int, per_run: int) -> None:
    """Save so many records of the default bench, those of some of its runs again and again; some of them move."""
    from station.runs.store import NewRecord, RunWriter, SavedRecord

    with tempfile.TemporaryDirectory() as place:
        runs = default_runs(Path(place), BENCH_RUNS)
        taken = [one for run in runs for one in run.records()]
        facts = {name: getattr(runs[0].facts, name) for name in ("command", "settings", "simulated")}
    fast, slow = ([one for one in taken if one.purpose == purpose] for purpose in ("tilt", "measure"))

    def again(key: str, one: SavedRecord) -> NewRecord:
        return NewRecord(key, one.purpose, one.header, one.payload, one.conditions)

    for first in range(0, records, per_run):
        with RunWriter.create(folder, facts) as writer:
            writer.save_records([again(f"tilt, {number}", one) for number, one in enumerate(fast[:8])])
            for begin in range(first, min(first + per_run, records), 2000):
                numbers = range(begin, min(begin + 2000, first + per_run, records))
                writer.save_records([again(f"measure, {n}", slow[n % len(slow)]) for n in numbers])
