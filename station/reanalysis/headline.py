"""The first number of what is compared: its lock-in rate with every input counted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument import InstrumentError
from station.errors import StationError
from station.reanalysis.combine import ONE_RATE, combine
from station.runs.progress import Progress
from station.shell.evaluated import evaluate_saved
from station.sources.find import find_sources, is_run
from station.sources.workers import Workers


@dataclass(frozen=True)
class Headline:
    """A lock-in rate as `gyrolock analyze` gives it."""

    rate: float  # deg/s; the combined standard uncertainty
    u: float
    one_rate: bool  # whether it was measured at one rate: several have no one beat and no one ratio


def headline_of(
    place: str, choices: Mapping[str, Any], beats: NDArray[np.float64], workers: Workers
) -> Headline | None:
    """Evaluate a run, or records at one rate, with their budget; ``None`` where they have no one result."""
    quiet = Progress(quiet=True)
    try:
        sources = list(find_sources([place]))
        if len(sources) == 1 and is_run(sources[0]):
            document = evaluate_saved(sources[0], workers, quiet, config=None, choices=choices).result.document
        else:
            known = beats[np.isfinite(beats)]
            if not known.size or np.ptp(known) >= ONE_RATE * known.max():
                return None
            document = combine(sources, choices, workers, quiet).result.document
    except (StationError, InstrumentError):
        return None
    rate, u = (float(document.get(name, math.nan)) for name in ("lock_in_rate_dps", "lock_in_rate_u_dps"))
    return Headline(rate, u, "several_rates" not in document) if math.isfinite(rate + u) else None
