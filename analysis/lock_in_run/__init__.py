"""What all records of one run say together: arrays in, one result out."""

from analysis.lock_in_run.evaluation import LockInRun, RateGroup, SeveralRates, evaluate
from analysis.lock_in_run.records import (
    Batch,
    Method,
    PreliminaryLockIn,
    RecordArrays,
    RunArrays,
    RunKnowledge,
    by_themselves,
    joined,
    preliminary_lock_in,
    rows_of_batches,
)
from analysis.lock_in_run.table import AxisRates, ScaleFactorCheck, TableCheck, Tilt, fast_estimates, find_tilt
