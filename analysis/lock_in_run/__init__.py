"""What all records of one run say together: arrays in, one result out."""

from analysis.lock_in_run.evaluation import LockInRun, QuadratureResult, RateGroup, SeveralRates, evaluate
from analysis.lock_in_run.records import (
    Batch,
    Method,
    PreliminaryLockIn,
    RecordArrays,
    RunArrays,
    RunKnowledge,
    by_themselves,
    joined,
    only_beats,
    preliminary_lock_in,
    rows_of_batches,
    without_channel,
)
from analysis.lock_in_run.table import AxisRates, ScaleFactorCheck, TableCheck, Tilt, fast_estimates, find_tilt

__all__ = [
    "AxisRates",
    "Batch",
    "LockInRun",
    "Method",
    "PreliminaryLockIn",
    "QuadratureResult",
    "RateGroup",
    "RecordArrays",
    "RunArrays",
    "RunKnowledge",
    "ScaleFactorCheck",
    "SeveralRates",
    "TableCheck",
    "Tilt",
    "by_themselves",
    "evaluate",
    "fast_estimates",
    "find_tilt",
    "joined",
    "only_beats",
    "preliminary_lock_in",
    "rows_of_batches",
    "without_channel",
]
