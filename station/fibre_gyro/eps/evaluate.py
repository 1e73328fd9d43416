"""What the open-loop segments of a run say: the 2 pi error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import TwoPiError, WindowMean, estimate_two_pi_error, mean_at_rest, pooled_noise
from station.errors import NoUsableSignal
from station.fibre_gyro.common import not_taken, reasons_of
from station.fibre_gyro.recordings import Segment, segments_of
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.windows import checked
from station.results.result import LeftOut
from station.runs.store import SavedRun

PURPOSE = "eps"
NORMAL, RESET = "normal_error", "reset_error"
_BLOCKS = 10
"""Of a segment, whose means tell the noise: those of both senses are pooled, and long ones hold filtered words."""


@dataclass(frozen=True)
class EpsFound:
    """Result of the open-loop measurement."""

    keys: tuple[str, ...]  # segments in the result, one for each element of the arrays
    step_codes: NDArray[np.float64]  # (n,)
    # (n,): Mean demodulated error of the sample pairs without and with a reset, counts of the detector's converter
    normal: NDArray[np.float64]
    normal_u: NDArray[np.float64]
    reset: NDArray[np.float64]
    reset_u: NDArray[np.float64]
    error: TwoPiError
    left_out: tuple[LeftOut, ...]


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> EpsFound:
    """Evaluate the open-loop segments of a run."""
    rows: list[tuple[str, float, WindowMean, WindowMean]] = []
    left_out = not_taken(run)
    for segment in segments_of(run, PURPOSE):
        try:
            means = _mean_of(segment, NORMAL), _mean_of(segment, RESET)
        except ValueError as error:
            left_out.append(LeftOut(segment.key, str(error)))
            continue
        rows.append((segment.key, float(segment.conditions["step_codes"]), *means))
    if len(rows) < 2:
        raise NoUsableSignal(
            f"the 2 pi error needs two injected steps, there are {len(rows)}: {reasons_of(left_out, '')}"
        )
    keys = tuple(key for key, *_ in rows)
    step = np.array([size for _, size, *_ in rows])
    kinds = [normal for *_, normal, _ in rows], [reset for *_, reset in rows]
    normal, reset = (np.array([one.mean for one in of_kind]) for of_kind in kinds)
    normal_u, reset_u = (_noise(step, of_kind) for of_kind in kinds)
    try:
        found = estimate_two_pi_error(step, normal, reset, normal_u, reset_u, dac_bits=settings.gyro.dac_bits)
    except ValueError as error:
        raise NoUsableSignal(f"the injected steps give no 2 pi error: {error}") from None
    return EpsFound(keys, step, normal, normal_u, reset, reset_u, found, tuple(left_out))


def _noise(step: NDArray[np.float64], means: Sequence[WindowMean]) -> NDArray[np.float64]:
    """Uncertainty of each mean by the noise at its size of the step: a larger one has more resets in each word."""
    u = np.empty(step.size)
    for size in np.unique(np.abs(step)):
        alike = np.abs(step) == size
        u[alike] = pooled_noise([mean for mean, kept in zip(means, alike, strict=True) if kept])
    return np.maximum(u, 1e-12)


def _mean_of(segment: Segment, name: str) -> WindowMean:
    """Mean of a column."""
    recording = checked(segment)
    if name not in recording.extra:
        raise ValueError(
            f"the output has no column {name}: name the demodulated error of the sample pairs "
            f"{NORMAL} and {RESET} in the frame format or in the log"
        )
    values = recording.extra[name]
    values = values[np.isfinite(values)]
    if values.size < 3:
        raise ValueError(f"{name} has {values.size} values: record longer, or inject a larger step")
    return mean_at_rest(values, recording.interval_s, blocks=_BLOCKS)
