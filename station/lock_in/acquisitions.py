"""The records of a run, those of one acquisition together."""

from __future__ import annotations

from dataclasses import dataclass

from station.runs.store import SavedRecord, SavedRun


@dataclass(frozen=True)
class Acquisition:
    """What was recorded at one time.

    Attributes
    ----------
    name : str
        Its number among the acquisitions at the slow rates, from 1.
    sine : SavedRecord
        The channel of the measurement.
    cosine : SavedRecord or None
        The second photodiode, where there is one.
    """

    name: str
    sine: SavedRecord
    cosine: SavedRecord | None

    @property
    def intact(self) -> bool:
        """Whether everything in it is what was once saved."""
        return self.sine.intact and (self.cosine is None or self.cosine.intact)


def acquisitions_of(run: SavedRun) -> list[Acquisition]:
    """Return the acquisitions at the slow rates of a run; fast ones are left out.

    Parameters
    ----------
    run : SavedRun

    Returns
    -------
    list of Acquisition
        In the order in which they were taken.
    """
    found: list[Acquisition] = []
    for record in run.records:
        if record.purpose == "measure":
            found.append(Acquisition(str(len(found) + 1), record, None))
        elif record.purpose == "quadrature" and found:
            # saved in one commit with the sine before it
            found[-1] = Acquisition(found[-1].name, found[-1].sine, record)
    return found
