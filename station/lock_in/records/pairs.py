"""Records of two photodiodes, pair by pair: read when their samples are asked for, none of them kept."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.lock_in_run import Batch, rows_of_batches
from station.lock_in.records.pieces import Gathered
from station.ring_laser.records import saved_waveform
from station.sources.source import Source


@dataclass(frozen=True)
class Pairs:
    """Volts of both channels, batch by batch."""

    source: Source
    gathered: Gathered  # of the whole source; every record has its second one

    def __iter__(self) -> Iterator[Batch]:
        columns = self.gathered.columns
        samples = columns["samples"].astype(np.int64)
        for rows in rows_of_batches(columns["sample_interval_s"], samples):
            numbers = np.concatenate([self.gathered.numbers[rows], self.gathered.seconds[rows]])
            wanted = set(numbers.tolist())
            between = self.source.records(range(int(numbers.min()), int(numbers.max()) + 1))
            waves = {
                record.number: saved_waveform(record, self.source.path)
                for record in between
                if record.number in wanted
            }
            picked = numbers.reshape(2, -1).tolist()
            volts = np.array([[waves[number].volts for number in channel] for channel in picked])
            clipped = np.array([[waves[number].clipped_samples for number in channel] for channel in picked])
            yield Batch(rows, waves[picked[0][0]].sample_interval, volts, clipped)


def whole_pairs(gathered: Gathered) -> Gathered | None:
    """The records of which both are intact; ``None`` where one never had a second.

    What is left out is counted as damaged, with the record that it belongs to.
    """
    if (gathered.seconds == 0).any():
        return None
    lost = gathered.seconds < 0
    kept = np.flatnonzero(~lost)
    return replace(
        gathered,
        numbers=gathered.numbers[kept],
        places=gathered.places[kept],
        seconds=gathered.seconds[kept],
        columns={name: values[kept] for name, values in gathered.columns.items()},
        labels={},
        truth={name: values[kept] for name, values in gathered.truth.items()},
        damaged=tuple(sorted({*gathered.damaged, *_list(gathered.places[lost])})),
    )


def _list(places: NDArray[np.int64]) -> list[int]:
    found: list[int] = places.tolist()
    return found
