"""What all records of one run say together: arrays in, one result out."""

from analysis.lock_in_run.estimates import Method, by_themselves, joined, only_beats, without_channel
from analysis.lock_in_run.evaluation import evaluate
from analysis.lock_in_run.groups import RateGroup, SeveralRates
from analysis.lock_in_run.pairs import QuadratureResult
from analysis.lock_in_run.records import Batch, RecordArrays, RunArrays, RunKnowledge, rows_of_batches
from analysis.lock_in_run.result import LockInRun
from analysis.lock_in_run.seen import LockInSeen, lock_in_seen
from analysis.lock_in_run.table_check import ScaleFactorCheck, TableCheck
from analysis.lock_in_run.table_rate import AxisRates, Tilt, fast_estimates, find_tilt

__all__ = [
    "AxisRates",
    "Batch",
    "LockInRun",
    "LockInSeen",
    "Method",
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
    "lock_in_seen",
    "only_beats",
    "rows_of_batches",
    "without_channel",
]
