"""Which samples of records count. Few records have any that do not, and only of those the samples are kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Bools, Floats, Indices, Samples


@dataclass(frozen=True)
class Masks:
    """Masks of (R,) records.

    place : (R,) of a record in `known`, -1 where all its samples count
    known : (M, N) 1 where a sample counts, 0 where it is left out; in the precision of the samples
    """

    place: Indices
    known: Samples

    @staticmethod
    def of(values: Samples, weights: Samples | None) -> Masks:
        """Of (R, N) records all of which have a mask (R, N), or none."""
        if weights is None:
            return Masks(np.full(len(values), -1), np.empty((0, values.shape[1]), dtype=values.dtype))
        return Masks(np.arange(len(values)), weights)

    def changed(self, rows: Indices, masks: Samples) -> Masks:
        """With other masks (r, N) of some records (r,)."""
        place = self.place.copy()
        place[rows] = len(self.known) + np.arange(rows.size)
        return Masks(place, np.concatenate([self.known, masks]))

    def of_one(self, row: int) -> Samples | None:
        """Mask (N,) of a record, None where all samples count."""
        place = self.place[row]
        return None if place < 0 else np.asarray(self.known[place])

    def of_all(self, rows: Indices) -> Samples:
        """Masks (r, N) of records of which some may have none."""
        masks: Samples = np.ones((rows.size, self.known.shape[1]), dtype=self.known.dtype)
        place = self.place[rows]
        masks[place >= 0] = self.known[place[place >= 0]]
        return masks

    def of_any(self, rows: Indices) -> Samples | None:
        """The same, None where none of them has one."""
        return self.of_all(rows) if np.any(self.place[rows] >= 0) else None

    def whole(self, rows: Indices) -> Bools:
        """Whether all samples of each of these records count, (r,)."""
        place = self.place[rows]
        whole = place < 0
        whole[~whole] = self.known[place[~whole]].all(axis=-1)
        return whole

    def clear(self, samples: Samples, rows: slice | Indices) -> None:
        """Set what does not count to 0 in samples (r, N) of these records."""
        place = self.place[rows]
        masked = np.flatnonzero(place >= 0)
        if masked.size:
            samples[masked] *= self.known[place[masked]]

    def counted(self, count: Floats) -> Floats:
        """How many samples of each record count, (R,): `count` where all of them do."""
        masked = np.flatnonzero(self.place >= 0)
        found = count.copy()
        found[masked] = self.known[self.place[masked]].sum(axis=-1, dtype=np.float64)
        return found
