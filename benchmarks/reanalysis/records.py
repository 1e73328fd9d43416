"""Saved runs of any length, made quickly: some thousands of records of a beat, again and again."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

SAMPLES, INTERVAL, SCALE_FACTOR = 2500, 2e-5, 2000.0
PER_RUN = 100
DIFFERENT = 2000
HEADER = (
    '1;8;BIN;RI;MSB;2500;"Ch1, DC coupling, 5.0E-1 V/div, 5.0E-3 s/div, 2500 points, Sample mode";Y;2.0E-5;0;'
    '-2.5E-2;"s";2.0E-2;0.0E0;0.0E0;"Volts"'
)


def codes_of_beats(count: int, seed: int) -> np.ndarray:
    """Codes (count, 2500) of beats with the noise of a scope; 200 waveforms, each time with other noise."""
    from analysis import beat_signal

    rng = np.random.default_rng(seed)
    times = np.arange(SAMPLES) * INTERVAL
    beats = np.array(
        [
            beat_signal(
                times,
                scale_factor=SCALE_FACTOR,
                input_rate=0.3 * (1 + 0.01 * rng.random()),
                lock_in_rate=0.02 * (1 + 0.05 * rng.standard_normal()),
                initial_phase=2 * math.pi * rng.random(),
            )
            for _ in range(200)
        ]
    )
    noise = 1.2 * rng.standard_normal((count, SAMPLES), dtype=np.float32)
    return np.rint(90 * beats[rng.integers(0, len(beats), count)] + noise).astype(np.int8)


def make_runs(folder: Path, records: int, per_run: int) -> None:
    """Save so many records as runs of the lock-in measurement."""
    from station.lock_in.settings import RING_LASER
    from station.runs.store import NewRecord, RunWriter
    from station.settings.load import load

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
                            f"measure, {n}", "measure", HEADER, payloads[n % len(payloads)], {"channel": "CH1"}
                        )
                        for n in numbers
                    ]
                )
