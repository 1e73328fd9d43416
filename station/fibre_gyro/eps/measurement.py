"""The 2 pi error by injection in open loop: its plan, and what its segments say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import TwoPiError, estimate_two_pi_error, steps_beyond_dac
from station.errors import NoUsableSignal
from station.fibre_gyro.campaign import PlannedSegment
from station.fibre_gyro.segments import LeftOut, checked
from station.fibre_gyro.selfcal.measurement import beyond_words
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.store import FogRun, Segment

PURPOSE = "eps"
NORMAL, RESET = "normal_error", "reset_error"


@dataclass(frozen=True)
class EpsEvaluation:
    """Result of the open-loop measurement.

    Attributes
    ----------
    keys : tuple of str
        Segments in the result, one for each element of the arrays.
    step_codes : ndarray, shape (n,)
    normal, normal_u, reset, reset_u : ndarray, shape (n,)
        Mean demodulated error of the sample pairs without and with a reset, counts of the detector's converter.
    result : TwoPiError
    left_out : tuple of LeftOut
    """

    keys: tuple[str, ...]
    step_codes: NDArray[np.float64]
    normal: NDArray[np.float64]
    normal_u: NDArray[np.float64]
    reset: NDArray[np.float64]
    reset_u: NDArray[np.float64]
    result: TwoPiError
    left_out: tuple[LeftOut, ...]


def plan_eps(settings: FogSettings) -> tuple[list[PlannedSegment], list[LeftOut]]:
    """List the segments: every step in both senses; steps beyond the converter are left out by name."""
    chosen, plan, left_out = settings.eps, [], []
    for size in chosen.steps_codes:
        for step in (size, -size):
            key = f"open loop {step:+.10g}"
            if steps_beyond_dac(step, settings.gyro.dac_bits):
                left_out.append(LeftOut(key, beyond_words(step, settings.gyro.dac_bits)))
                continue
            conditions = {"purpose": PURPOSE, "loop": "held", "step_codes": step, "rate_dps": 0.0}
            plan.append(PlannedSegment(key, chosen.record_s, chosen.settle_s, conditions))
    return plan, left_out


def evaluate_eps(run: FogRun, settings: FogSettings) -> EpsEvaluation:
    """Evaluate the open-loop segments of a run.

    Raises
    ------
    NoUsableSignal
        Fewer than two steps are left.
    """
    rows, left_out = [], [LeftOut(**entry) for entry in run.facts.get("left_out_of_plan", [])]
    for segment in run.taken_for(PURPOSE):
        try:
            normal, reset = (_mean_of(segment, name) for name in (NORMAL, RESET))
        except ValueError as error:
            left_out.append(LeftOut(segment.key, str(error)))
            continue
        rows.append((segment.key, float(segment.conditions["step_codes"]), *normal, *reset))
    if len(rows) < 2:
        reasons = "; ".join(one.sentence for one in left_out)
        raise NoUsableSignal(f"the 2 pi error needs two injected steps, there are {len(rows)}: {reasons}")
    step, normal, normal_u, reset, reset_u = np.array([row[1:] for row in rows], dtype=np.float64).T
    try:
        result = estimate_two_pi_error(step, normal, reset, normal_u, reset_u, dac_bits=settings.gyro.dac_bits)
    except ValueError as error:
        raise NoUsableSignal(f"the injected steps give no 2 pi error: {error}") from None
    keys = tuple(row[0] for row in rows)
    return EpsEvaluation(keys, step, normal, normal_u, reset, reset_u, result, tuple(left_out))


def _mean_of(segment: Segment, name: str) -> tuple[float, float]:
    """Mean of a column and its standard uncertainty."""
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
    return float(values.mean()), float(max(np.std(values, ddof=1) / np.sqrt(values.size), 1e-12))
