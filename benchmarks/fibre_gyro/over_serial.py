"""The independent gyro on a serial line: real frames over a pseudo-terminal, damaged ones among them.

The link and the bench of the product record them as they would a real gyro, but as fast as they come: thousands of
seconds of output in some seconds.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from contextlib import nullcontext
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.fibre_gyro.independent_gyro import HORIZONTAL, LATITUDE, VERTICAL, Gyro, K
from instrument.fibre_gyro import FibreGyroLink, parse_frame_format
from instrument.simulated.fibre_gyro import GyroFault, GyroFaults, PtyGyroServer
from station.fibre_gyro import selfcal, table
from station.fibre_gyro.bench import SerialFogBench
from station.fibre_gyro.segments import take_segments
from station.fibre_gyro.selfcal import numbers_for
from station.fibre_gyro.settings import load_fog_settings
from station.live.events import Progress
from station.runs.acquisition import Acquisition, facts_of, take
from station.runs.store import open_run
from station.settings import shipped_settings
from station.shell.finish import evaluate_run

Floats = NDArray[np.float64]

PER_CODE = 256.0  # counts of the output word for one code: what the frames hold is whole counts
NORMAL_95 = 1.959964
_SETTLE_S = 500.0
"""Left out after each change: frames of before it wait in the line, as fast as they are made."""


class GyroOnTheLine:
    """What the server asks for output words; turned by the table, stepped by commands."""

    def __init__(self, gyro: Gyro, seed: int) -> None:
        self.gyro, self.rng = gyro, np.random.default_rng(seed)
        self.scale = K * PER_CODE
        self._rate, self._turning, self._step, self._angle, self._place = 0.0, 0.0, 0.0, 0.0, 0

    # the table

    def set_rate(self, rate_dps: float) -> None:
        """Turn the table; it reads what it was asked for, and turns at what it does."""
        self._rate = rate_dps
        self._turning = rate_dps * (1 + self.gyro.irreproducible * self.rng.normal())

    def rate(self) -> float:
        """Reading of the table, deg/s."""
        return self._rate

    def azimuth(self) -> float:
        """Nobody reads it."""
        return 0.0

    def close(self) -> None:
        """Stop."""
        self.set_rate(0.0)

    # the gyro

    def samples(self, count: int) -> Mapping[str, Floats]:
        """The next output words, counts."""
        gyro, interval, turning = self.gyro, 1 / self.gyro.output_hz, self._turning
        angle = self._angle + np.deg2rad(turning) * interval * np.arange(count + 1)
        self._angle = float(angle[-1])
        north = np.diff(np.sin(angle)) / np.diff(angle) if turning else np.full(count, np.cos(self._angle))
        omega = np.cos(gyro.tilt) * (turning + VERTICAL) + np.sin(gyro.tilt) * HORIZONTAL * north
        drift = gyro.drift_dph_per_h / 3600 * (self._place + np.arange(count)) * interval / 3600
        self._place += count
        noise = self.rng.normal(0, gyro.walk / 60 / np.sqrt(interval), count)
        counts = self.scale * (omega + noise + drift) + PER_CODE * self._step
        zero = np.zeros(count)
        return {"counts": np.round(counts), "temperature": zero, "normal_error": zero, "reset_error": zero}

    def command(self, name: str, step: float) -> None:
        """Inject a step."""
        if name == "inject":
            self._step = step


def serial_case(gyro: Gyro, seed: int, folder: Path, command: str) -> dict[str, bool]:
    """K and tilt of a table run, or K_self of a self-calibration, over the line."""
    values = tomllib.loads(shipped_settings("fibre_gyro_frames").read_text("utf-8"))["formats"]["binary_open_loop"]
    layout = parse_frame_format({**values, "output_rate_hz": gyro.output_hz}, where="benchmark")
    settings = load_fog_settings(
        overrides={
            "output": {"directory": str(folder)},
            "site": {"latitude_deg": LATITUDE},
            "gyro": {"counts_per_code": PER_CODE, "output_resolution": 1.0},
            "table": {
                "axes": ["Z"],
                "rates_dps": list(gyro.rates),
                "turns": gyro.turns,
                "settle_s": _SETTLE_S,
                "kind": "manual",
            },
            "selfcal": {"numbers": "nominal", "step_s": 30.0, "static_s": 30.0, "settle_s": _SETTLE_S},
            "link": {"port": "pty"},
        }
    )
    model = GyroOnTheLine(gyro, seed)
    faults = GyroFaults(*(GyroFault(kind, probability=1e-3) for kind in ("lost frame", "flipped bit")), seed=seed)
    plan = table.plan(settings) if command == "table" else selfcal.plan(settings, numbers_for(settings, None))[0]
    with (
        PtyGyroServer(model, layout, speed=inf, faults=faults) as server,
        FibreGyroLink(server.port, layout, speed=inf) as link,
    ):
        bench = SerialFogBench(link, model, lambda question: "")
        facts = facts_of(command, settings.model_dump(mode="json"), simulated=False)
        done = take(
            Acquisition(facts, folder, Progress()),
            lambda session: take_segments(settings, session, nullcontext(bench), [lambda run: plan], {}),
        )
        bench.leave()
    if done.failure is not None:
        raise RuntimeError(str(done.failure))
    found = evaluate_run(open_run(done.path)).document()
    if command == "selfcal":
        off, u = found["self_minus_numbers_ppm"], found["self_minus_numbers_u_ppm"]
        return {"K_self/numbers": abs(off) <= NORMAL_95 * u}
    (axis,) = found["axes"]
    scale = model.scale * np.cos(gyro.tilt)
    off, u = axis["scale_factor_counts_per_dps"] - scale, axis["scale_factor_u_counts_per_dps"]
    low, high = axis["input_axis_tilt_low_95_mrad"], axis["input_axis_tilt_high_95_mrad"]
    held = {"K": abs(off) <= NORMAL_95 * u, "tilt": low <= 1e3 * gyro.tilt <= high}
    for one in axis["differences"]:
        off = one["number_counts"] - scale * one["delta_dps"]
        held[f"N({one['delta_dps']:g})"] = abs(off) <= NORMAL_95 * one["number_u_counts"]
    return held
