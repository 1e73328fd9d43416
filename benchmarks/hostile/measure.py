"""What `estimate_lock_in` says of hostile records, and whether it is true."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis import DOUBTFUL, FATAL, LockInEstimate, estimate_lock_in, flag_names
from benchmarks.estimator.progress import Progress
from benchmarks.hostile.record_class import HostileRecord, RecordClass

WRONG = 5.0
"""Standard uncertainties from the truth beyond which a number is wrong."""


@dataclass(frozen=True)
class Answer:
    """What was said of one record: nan where refused; `z` is the error in standard uncertainties."""

    value: float
    u: float
    z: float
    covered: bool
    flags: int
    truth: float
    error: str = ""

    @property
    def finite(self) -> bool:
        return bool(np.isfinite(self.value))

    @property
    def warned(self) -> bool:
        return bool(self.flags & int(DOUBTFUL))

    @property
    def wrong(self) -> bool:
        return self.finite and not abs(self.z) <= WRONG


@dataclass(frozen=True)
class Outcome:
    """The answers to all records of a class."""

    name: str
    kind: str
    answers: tuple[Answer, ...]

    def count(self, what: str) -> int:
        """How many answers have a property of `Answer`."""
        return sum(bool(getattr(answer, what)) for answer in self.answers)

    @property
    def unwarned_wrong(self) -> int:
        return sum(answer.wrong and not answer.warned for answer in self.answers)

    @property
    def unwarned(self) -> int:
        return sum(answer.finite and not answer.warned for answer in self.answers)

    @property
    def covered(self) -> int:
        return sum(answer.finite and answer.covered for answer in self.answers)

    @property
    def relative_u(self) -> float:
        """Median of u over the lock-in rate, of the finite answers."""
        shares = [answer.u / answer.truth for answer in self.answers if answer.finite]
        return float(np.median(shares)) if shares else float("nan")


def measure(classes: Sequence[RecordClass], n_records: int, seeds: Sequence[int]) -> list[Outcome]:
    """Draw so many records of each class with each seed, and estimate each by itself."""
    outcomes = []
    with Progress("records", len(classes) * n_records * len(seeds)) as progress:
        for one in classes:
            answers = []
            for seed in seeds:
                rng = np.random.default_rng([seed, zlib.crc32(one.name.encode())])
                for _ in range(n_records):
                    answers.append(answer_to(one.make(rng)))
                    progress.done()
            outcomes.append(Outcome(one.name, one.kind, tuple(answers)))
    return outcomes


def answer_to(record: HostileRecord) -> Answer:
    """What the estimator says of one record, the record its own reference; an exception is an answer too."""
    truth = record.lock_in_rate
    try:
        e = estimate_lock_in(record.volts, record.sample_interval, scale_factor=record.scale_factor)
    except Exception as error:  # the benchmark counts what stops a batch
        return Answer(np.nan, np.nan, np.nan, False, 0, truth, repr(error))
    return answer_of(e, truth)


def answer_of(e: LockInEstimate, truth: float) -> Answer:
    """The estimate beside the truth."""
    value, u = float(e.lock_in_rate), float(e.lock_in_rate_u)
    covered = bool(e.lock_in_rate_low_95 <= truth <= e.lock_in_rate_high_95)
    return Answer(value, u, (value - truth) / u if u > 0 else np.inf, covered, int(e.flags), truth)


def common_flags(outcome: Outcome) -> str:
    """The flags that the answers carry, the most frequent first."""
    names = [name for answer in outcome.answers for name in flag_names(answer.flags)]
    counts = sorted({name: names.count(name) for name in names}.items(), key=lambda pair: -pair[1])
    return ", ".join(f"{name} {count}" for name, count in counts[:2])


def refused_with_reason(outcome: Outcome) -> bool:
    """Whether every refused record carries a fatal flag."""
    return all(answer.finite or answer.flags & int(FATAL) for answer in outcome.answers)
