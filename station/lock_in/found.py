"""The result of a run with the records that it was found from, for everything that shows it."""

from __future__ import annotations

from dataclasses import dataclass

from analysis import flag_names
from analysis.lock_in_run import LockInRun, Method
from instrument import Waveform

RELATIONS = {
    "exact": "harmonic ratio, exact relation",
    "paper-13": "harmonic ratio, relation (13) of the paper",
    "paper-10": "harmonic ratio, relation (10) of the paper",
}


@dataclass(frozen=True, kw_only=True)
class LockInFound(LockInRun):
    """What the records of a run say, and the records.

    Attributes
    ----------
    names : tuple of str
        What each record is called: its number in the run, or its file.
    damaged : tuple of str
        Records that were left out because they are not what was once saved.
    truth : dict or None
        The true values of a simulated run.
    without_beat : tuple of str
        Rates of several that gave no record.
    """

    names: tuple[str, ...]
    waveforms: tuple[Waveform, ...]
    damaged: tuple[str, ...] = ()
    truth: dict[str, float] | None = None
    without_beat: tuple[str, ...] = ()

    @property
    def method_text(self) -> str:
        """Describe in words how the lock-in rate was found."""
        text = describe_method(self.method)
        if self.quadratures is not None:
            text = f"{text}, sine and cosine channel"
        if self.several is None:
            return text
        fitted = {"lock-in": "", "distortion": " and distortion", "gain": " and gain corner"}
        fit = self.several.by_beat
        what = "" if fit is None else fitted.get(fit.model, ", distortion and gain corner")
        return f"{text}; lock-in rate{what} fitted to {len(self.several.groups)} rates"

    @property
    def flags(self) -> list[str]:
        """Names of the flags of the combined result, and of the store."""
        names = flag_names(int(self.combined.flags))
        return [*names, "damaged"] if self.damaged and "damaged" not in names else names

    @property
    def records_rejected(self) -> int:
        """Records that do not count in the combined result."""
        return int(self.combined.records_rejected) + len(self.damaged)


def describe_method(method: Method) -> str:
    """Describe in words how single records are turned into a lock-in rate."""
    reference = "self-referenced" if method.input_rate is None else "input rate given"
    return f"{RELATIONS[method.relation]}, {reference}"
