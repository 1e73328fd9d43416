"""From saved records to the result: always computed again, never remembered."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import fmean

import numpy as np

from analysis import FATAL, LockInEstimate, combine_estimates, flag_names
from analysis.budget import Budget
from analysis.channel import ChannelResponse
from instrument import Waveform
from station.errors import RunError, UsageError
from station.lock_in.acquisitions import Acquisition, acquisitions_of
from station.lock_in.estimates import Method, at_known_rates, estimate_records, saved_waveform
from station.lock_in.front_end import channel_response, without_channel
from station.lock_in.quadratures import QuadratureResult, estimate_pairs, quadrature_result
from station.lock_in.run_budget import run_budget
from station.lock_in.several_rates import (
    SeveralRates,
    at_several_rates,
    combined_estimate,
    evaluate_rates,
    rates_table_check,
)
from station.lock_in.table_check import TableCheck, axis_rates, fast_run_is_whole, table_check
from station.lock_in.tilt import Tilt, evaluate_tilt
from station.runs.store import SavedRecord, SavedRun
from station.settings.load import Settings

__all__ = ["Evaluation", "Method", "evaluate_run", "evaluate_waveforms", "saved_settings", "saved_waveform"]


@dataclass(frozen=True)
class Evaluation:
    """What the records of a run say.

    Attributes
    ----------
    method : Method
    names : tuple of str
        What each record is called: its number in the run, or its file.
    waveforms : tuple of Waveform
    each : LockInEstimate
        Fields of shape (n_records,).
    combined : LockInEstimate
        Fields of shape ().
    damaged : tuple of str
        Records that were left out because they are not what was once saved.
    tilt, table_check : Tilt, TableCheck or None
        Where a table with known rate was used.
    truth : dict or None
        The true values of a simulated run.
    several : SeveralRates or None
        Where records were taken at several rates or in both senses.
    quadratures : QuadratureResult or None
        Where a second photodiode was recorded.
    budget : Budget or None
        Of a usable result of a run.
    """

    method: Method
    names: tuple[str, ...]
    waveforms: tuple[Waveform, ...]
    each: LockInEstimate
    combined: LockInEstimate
    damaged: tuple[str, ...] = ()
    tilt: Tilt | None = None
    table_check: TableCheck | None = None
    truth: dict[str, float] | None = None
    several: SeveralRates | None = None
    quadratures: QuadratureResult | None = None
    budget: Budget | None = None

    @property
    def usable(self) -> bool:
        """Whether a lock-in rate can be given at all."""
        return bool(np.isfinite(self.combined.lock_in_rate)) and not int(self.combined.flags) & int(FATAL)

    @property
    def method_text(self) -> str:
        """Describe in words how the lock-in rate was found."""
        text = f"{self.method.text}, sine and cosine channel" if self.quadratures is not None else self.method.text
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


def evaluate_run(run: SavedRun, method: Method | None = None, known: Settings | None = None) -> Evaluation:
    """Evaluate the records that a run took at its slow rate, or at its slow rates.

    Parameters
    ----------
    run : SavedRun
    method : Method, optional
        By default the run's own scale factor, exact, self-referenced.
    known : Settings, optional
        What is known of channel and bench now, ``front_end`` and ``budget``, instead of what was known then.

    Returns
    -------
    Evaluation

    Raises
    ------
    RunError
        If the run holds no such record.
    UsageError
        If the method is one for a single rate, and the run has several.
    """
    settings = saved_settings(run)
    if known is not None:
        settings = settings.model_copy(update={"front_end": known.front_end, "budget": known.budget})
    method = method or Method(settings.gyro.scale_factor_pulses_per_deg)
    acquisitions = acquisitions_of(run)
    if not any(taken.intact for taken in acquisitions):
        what = "only damaged records" if acquisitions else "no record at the slow rate"
        raise RunError(f"{run.path}: the run holds {what}")
    damaged = tuple(taken.name for taken in acquisitions if not taken.intact)
    intact = [taken for taken in acquisitions if taken.intact]
    records = [taken.sine for taken in intact]
    waveforms = tuple(saved_waveform(record, run) for record in records)
    response = channel_response(settings.front_end)
    each, quadratures = _estimates(intact, waveforms, run, method, response)
    names = tuple(taken.name for taken in intact)
    combined = combine_estimates(each)
    tilt = None
    if fast_run_is_whole(run, settings):
        tilt = evaluate_tilt(run.taken_for("tilt"), settings, _best_shown(each))
    one = Evaluation(method, names, waveforms, each, combined, damaged, tilt, quadratures=quadratures)
    if tilt is not None and at_several_rates(records):
        whole = _with_rates(one, records, settings, tuple(run.facts.get("rates_without_beat", ())))
    else:
        whole = _with_table(one, records, settings)
    return replace(whole, budget=run_budget(whole, settings))


def _estimates(
    acquisitions: Sequence[Acquisition],
    waveforms: Sequence[Waveform],
    run: SavedRun,
    method: Method,
    response: ChannelResponse | None,
) -> tuple[LockInEstimate, QuadratureResult | None]:
    """Estimate the records as before the channel, with the help of the second photodiode where there is one."""
    seconds = [taken.cosine for taken in acquisitions if taken.cosine is not None]
    if len(seconds) < len(acquisitions):
        each = estimate_records(waveforms, method)
        return each if response is None else without_channel(each, response), None
    cosines = [saved_waveform(record, run) for record in seconds]
    each, pairs = estimate_pairs(waveforms, cosines, method, response)
    return each, quadrature_result(pairs)


def _best_shown(each: LockInEstimate) -> float:
    """Lock-in rate, deg/s, of the record that shows it best (at several rates a slow one); nan if none does."""
    relative = np.where(each.usable, each.lock_in_rate_u / each.lock_in_rate, np.nan)
    return float(each.lock_in_rate[np.nanargmin(relative)]) if np.isfinite(relative).any() else math.nan


def _with_table(one: Evaluation, records: Sequence[SavedRecord], settings: Settings) -> Evaluation:
    """Add what the rate of the table says, where it is known."""
    check = None
    if one.tilt is not None and one.method.input_rate is None:
        axis = axis_rates(records, one.tilt, settings)
        by_table = combine_estimates(at_known_rates(one.each, axis.rates))
        check = table_check(one.combined, by_table, axis)
    return replace(one, table_check=check, truth=_mean_truth(records))


def _with_rates(
    one: Evaluation, records: Sequence[SavedRecord], settings: Settings, without_beat: tuple[str, ...]
) -> Evaluation:
    """Fit all rates of the run."""
    assert one.tilt is not None  # the caller has looked
    if one.method.input_rate is not None or one.method.relation != "exact":
        raise UsageError("this run has several rates: they are fitted with the exact relation and their own rates")
    axis = axis_rates(records, one.tilt, settings)
    several = evaluate_rates(records, one.each, axis, without_beat)
    return replace(
        one,
        combined=combined_estimate(several),
        table_check=rates_table_check(several, axis),
        truth=_mean_truth([records[row] for row in several.reference_group.rows]),
        several=several,
    )


def evaluate_waveforms(waveforms: Sequence[Waveform], names: Sequence[str], method: Method) -> Evaluation:
    """Evaluate records that come from files.

    Parameters
    ----------
    waveforms : sequence of Waveform
        At least one.
    names : sequence of str
    method : Method

    Returns
    -------
    Evaluation
    """
    each = estimate_records(waveforms, method)
    return Evaluation(method, tuple(names), tuple(waveforms), each, combine_estimates(each))


def saved_settings(run: SavedRun) -> Settings:
    """Return the settings that a run was taken with.

    Raises
    ------
    RunError
        If the run holds none that this version understands.
    """
    if run.facts.get("command") == "witness":
        raise RunError(f"{run.path}: shows a fibre gyro's modulator: `gyrolock fog witness` evaluates it")
    try:
        return Settings.model_validate(run.facts["settings"])
    except (KeyError, ValueError):
        raise RunError(f"{run.path}: the settings of this run cannot be read") from None


def _mean_truth(records: Sequence[SavedRecord]) -> dict[str, float] | None:
    truths = [record.conditions["truth"] for record in records if record.conditions.get("truth")]
    if not truths:
        return None
    return {name: fmean(truth[name] for truth in truths) for name in truths[0]}
