"""From all records of a run to one result: groups of a rate, pairs of photodiodes, the fit, the budget."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.arrays import NORMAL_95, Complexes, Floats, Indices, NoFit, OneRateOnly, OutsideResponse
from analysis.beam_swings import BeamsFlag
from analysis.budget import (
    CORNERS,
    BenchKnowledge,
    Bounded,
    Budget,
    BudgetInput,
    Distribution,
    OperatingPoint,
    Reference as RateReference,
    ResponseCorner,
    TableGeometry,
    bounded,
    lock_in_budget,
    operating_point,
    separated_input,
    stated_inputs,
)
from analysis.channel import ChannelResponse
from analysis.combine import as_at_one_rate, combine_estimates, without_copies
from analysis.flags import FATAL, Flag
from analysis.frequency_method import FrequencyFit, fit_frequencies
from analysis.harmonics import fit_harmonics
from analysis.lock_in_run.records import (
    Method,
    RecordArrays,
    RunArrays,
    RunKnowledge,
    at_known_rates,
    by_themselves,
    estimate_records,
    joined,
    only_beats,
    third_order_limit,
    without_channel_model,
)
from analysis.lock_in_run.table import (
    AxisRates,
    ByTable,
    TableCheck,
    Tilt,
    axis_rate_is_known,
    axis_rates,
    check_by_table,
    fast_estimates,
    find_tilt,
)
from analysis.lockin_equation import lock_in_from_beat, lock_in_from_rate
from analysis.lockin_rate import LockInEstimate, size_interval
from analysis.quadratures import QuadratureEstimate, QuadratureFlag, estimate_quadratures
from analysis.rotation import earth_rate_on_axis
from analysis.several_rates import COUNTED, Model, RatesFit, RatesFlag, Reference, fit_again, fit_rates, prior_of
from analysis.single_beams import BeamsFit, fit_beams

CANCEL_IN_THE_CHECK = ("noise", "scale_factor", "time_base")
"""Inputs of the budget that the check by the table has counted already, or that the tilt absorbs in it."""


def evaluate(
    run: RunArrays,
    knowledge: RunKnowledge | None,
    method: Method,
    estimated: LockInEstimate | None = None,
    axis: AxisRates | None = None,
) -> LockInRun:
    """Evaluate the records that a run took at its slow rate, or at its slow rates."""
    # 1. every record by itself, as before the channel
    each, quadratures = _each_record(
        run.slow, method, None if knowledge is None else knowledge.response, estimated
    )
    each = without_copies(each)
    if knowledge is None:
        knowledge = RunKnowledge(method.scale_factor, latitude_deg=math.nan)
    # 2. the table: tilt, and the rate on the axis
    tilt = None
    if axis is None and axis_rate_is_known(run, knowledge):
        with np.errstate(divide="ignore", invalid="ignore"):  # noise may leave a lock-in rate of zero
            relative = np.where(each.usable, each.lock_in_rate_u / each.lock_in_rate, np.nan)
        tilt = find_tilt(
            run.fast,
            knowledge,
            (float(each.lock_in_rate[np.nanargmin(relative)]) if np.isfinite(relative).any() else math.nan),
        )
        axis = axis_rates(run.slow, tilt, knowledge)
    # 3. the mean of all records, or each rate alone and then one fit
    several = None
    if axis is not None and np.unique(run.slow.table_rate).size > 1:
        several = evaluate_rates(run, each, axis, knowledge)
    rates = None if axis is None else axis.rates
    combined = combine_estimates(each, rates) if several is None else combined_estimate(several)
    unknown = np.broadcast_to(math.nan, each.flags.shape)
    found = LockInRun(method, each, combined, unknown, tilt, rates, several=several, quadratures=quadratures)
    # 4. the same by the table
    if axis is not None and tilt is not None:
        found = _checked_by_table(found, run, axis, knowledge)
    # 5. what all inputs make of the uncertainty
    if not found.usable:
        return found
    bench = known_of_bench(found, run.slow, knowledge)
    budget = run_budget(found, run.slow, bench)
    check = found.table_check
    if check is not None:
        others = [line.contribution for line in budget.inputs if line.name not in CANCEL_IN_THE_CHECK]
        check = check.beside_budget(found.lock_in_rate, math.hypot(*others))
    us = record_uncertainties(found, run.slow, bench)
    return replace(found, budget=budget, record_u=us, table_check=check)


def _each_record(
    slow: RecordArrays, method: Method, response: ChannelResponse | None, estimated: LockInEstimate | None
) -> tuple[LockInEstimate, QuadratureResult | None]:
    """Estimate the records, with the help of the second photodiode where there is one."""
    if slow.n_channels == 2:
        pairs = estimate_pairs(slow, method, response)
        return only_beats(pairs.estimate), mean_of_pairs(pairs)
    if estimated is None:
        return by_themselves(estimate_records(slow, method), response), None
    return (estimated if response is None else estimated.described(without_channel_model(estimated))), None


def _checked_by_table(found: LockInRun, run: RunArrays, axis: AxisRates, knowledge: RunKnowledge) -> LockInRun:
    """The same with the check by the table, and its flags on the result; as it is where nothing can be checked."""
    by_table = _one_rate_by_table(found, axis) if found.several is None else rates_by_table(found.several)
    if by_table is None or found.tilt is None or not found.usable:
        return found
    beams = None if found.several is None else found.several.beams
    each = without_push(found.each, axis, beams), fast_estimates(run.fast, knowledge)
    check = check_by_table(run, each, found.combined, by_table, axis, found.tilt, knowledge)
    flags = int(found.combined.flags)
    flags |= int(Flag.TABLE_MISMATCH) if check.mismatch else 0
    flags |= int(Flag.SCALE_FACTOR_MISMATCH) if check.scale_factor_mismatch else 0
    return replace(found, table_check=check, combined=replace(found.combined, flags=np.asarray(flags)))


def _one_rate_by_table(found: LockInRun, axis: AxisRates) -> ByTable | None:
    if found.method.input_rate is not None:
        return None
    by_table = combine_estimates(at_known_rates(found.each, axis.rates))
    if not np.isfinite(by_table.lock_in_rate):
        return None
    return ByTable(
        float(by_table.lock_in_rate),
        float(by_table.lock_in_rate_u),
        float(np.mean(axis.rates)),
        float(found.combined.beat_frequency),
    )


# --------------------
# Records of one run at several rates: each rate by itself, and one fit to all of them


@dataclass(frozen=True, eq=False)
class RateGroup:
    """The records at one rate of the table."""

    table_rate: float  # deg/s, signed
    input_rate: float  # mean rate on the gyro's axis by the table, deg/s, signed
    over_lock_in: float | None  # what was asked for, in expected lock-in rates
    rows: Indices  # which of the records they are
    combined: LockInEstimate  # fields of shape (): what this rate says alone


@dataclass(frozen=True)
class SeveralRates:
    """What records at several rates, or in both senses, say together."""

    groups: tuple[RateGroup, ...]  # from the fastest in the positive sense to the fastest in the negative one
    # fit with the beat frequency, and with the table, as reference; ``None`` where it is not possible
    by_beat: RatesFit | None
    by_table: RatesFit | None
    # the other route: beat frequency against rate, without harmonics, scale factor free
    by_frequency: FrequencyFit | None = None
    problem: str = ""  # why there is no fit by the beat
    beams: BeamsFit | None = None  # the fit with the single beams, whose lock-in rate is then that of `by_beat`
    beams_problem: str = ""  # why there is none although something was asked of them, and what was seen of them
    beams_flags: int = 0

    @property
    def reference_group(self) -> RateGroup:
        """The rate that determines the lock-in rate best; it stands for all where one value is asked for."""

        def relative_u(group: RateGroup) -> float:
            one = group.combined
            relative = float(one.lock_in_rate_u) / max(float(one.lock_in_rate), 1e-300)
            return relative if math.isfinite(relative) else math.inf

        return min(self.groups, key=relative_u)


def evaluate_rates(run: RunArrays, each: LockInEstimate, axis: AxisRates, knowledge: RunKnowledge) -> SeveralRates:
    """Combine the records at each rate, and fit all of them."""
    slow, receiver = run.slow, knowledge.bench
    if each.rate_given or each.relation != "exact":
        raise OneRateOnly(
            "this run has several rates: they are fitted with the exact relation and their own rates"
        )
    rates, counts = np.unique(slow.table_rate, return_counts=True)
    place = np.searchsorted(rates, slow.table_rate)
    groups = []
    for index in range(rates.size)[::-1]:
        rows = np.flatnonzero(place == index)
        asked = float(slow.over_lock_in[rows[0]])
        group = RateGroup(
            table_rate=float(rates[index]),
            input_rate=float(np.mean(axis.rates[rows])),
            over_lock_in=asked if math.isfinite(asked) else None,
            rows=rows,
            combined=combine_estimates(each[rows], axis.rates[rows]),
        )
        groups.append(group)
    # shared by the records at one rate: their mean is no better than one of them
    rates_u = axis.azimuth_u * np.sqrt(counts[place])
    by_beat, problem = _fit(each, axis, rates_u, "beat", receiver)
    by_table, _ = _fit(each, axis, rates_u, "rate", receiver, by_beat)
    beams, no_beams = None, ""
    if run.beams is None and math.isfinite(knowledge.beams.dead_band):
        no_beams = "none were recorded, and beams.dead_band_dps is compared beside them only"
    if run.beams is not None and by_beat is not None:
        try:
            beams = fit_beams(by_beat, run.beams, knowledge.beams, receiver)
            by_beat = with_beams(by_beat, beams)
        except NoFit as reason:
            no_beams = str(reason)
    by_frequency = _frequencies(without_push(each, axis, beams), axis, rates_u)
    seen = 0 if run.beams is None else run.beams.flags
    return SeveralRates(tuple(groups), by_beat, by_table, by_frequency, problem, beams, no_beams, seen)


def with_beams(fit: RatesFit, beams: BeamsFit) -> RatesFit:
    """A fit of the beat alone, with what the single beams have settled of it."""
    told = BeamsFlag.MISFIT, BeamsFlag.SEVERAL_SOLUTIONS, BeamsFlag.NOT_SIGNIFICANT
    flags = fit.flags & ~_SETTLED | sum(RatesFlag[str(one.name)] for one in told if one & beams.flags)
    beside = dict(beams.beside)
    lag, lag_u = beside.pop("lag")
    found: dict[str, Any] = {name: getattr(beams, name) for name in _OF_BEAMS}
    found |= {name: value for name, (value, _) in beside.items()}
    found |= {f"{name}_u": u for name, (_, u) in beside.items()}
    gain_time, gain_u = 1 / beams.gain_rate, math.log(beams.gain_rate_high_95 / beams.gain_rate) / NORMAL_95
    return replace(
        fit,
        alternatives=(),
        counted=fit.counted | set(COUNTED),
        **found,
        lag_square=lag * abs(lag),
        lag_square_u=math.hypot(2 * lag * lag_u, lag_u**2),
        gain_time=gain_time,
        gain_time_u=min(gain_u, 10.0) * gain_time,
        flags=int(flags),
    )


_OF_BEAMS = {
    *("lock_in_rate", "lock_in_rate_u", "lock_in_rate_low_95", "lock_in_rate_high_95"),
    *("distortion", "distortion_u", "backscatter_phase", "backscatter_phase_u"),
    *("chi_square", "degrees_of_freedom", "p_value"),
}
_SETTLED = int(
    RatesFlag.NOT_SIGNIFICANT
    | RatesFlag.RATES_TOO_CLOSE
    | RatesFlag.NOT_DETERMINED
    | RatesFlag.NOT_TESTED
    | RatesFlag.MISFIT
    | RatesFlag.ONE_RATE_DISAGREES
    | RatesFlag.RATE_AND_BEAT_DISAGREE
    | RatesFlag.SEVERAL_SOLUTIONS
    | RatesFlag.STATED_LIMITS_EXCEEDED
)
"""What is said of the beat alone, and no longer holds beside the beams."""


def without_push(each: LockInEstimate, axis: AxisRates, beams: BeamsFit | None) -> LockInEstimate:
    """The records with the beats that they would have without the push of the beams' difference."""
    if beams is None:
        return each

    def freed(some: LockInEstimate, rows: slice) -> LockInEstimate:
        push = beams.push_at(axis.rates[rows], some.beat_frequency)
        return replace(some, beat_frequency=some.beat_frequency / (1 + push))

    return each.changed(freed)


def _fit(
    each: LockInEstimate,
    axis: AxisRates,
    rates_u: Floats,
    reference: Reference,
    receiver: BenchKnowledge,
    other: RatesFit | None = None,
) -> tuple[RatesFit | None, str]:
    try:
        fit = fit_rates(
            each,
            input_rate=axis.rates,
            input_rate_u=rates_u,
            reference=reference,
            receiver=receiver,
            in_order=True,
            other=other,
        )
        return fit, ""
    except NoFit as reason:
        return None, str(reason)


def _frequencies(each: LockInEstimate, axis: AxisRates, rates_u: Floats) -> FrequencyFit | None:
    """Fit the beat frequencies; with one sense alone a bias rate cannot be told from the rest."""
    usable = each.usable
    both = np.unique(np.sign(axis.rates[usable])).size == 2
    frequency = np.where(usable, each.beat_frequency, np.nan)
    try:
        return fit_frequencies(axis.rates, frequency, each.beat_frequency_u, input_rate_u=rates_u, bias=both)
    except NoFit:
        return None


def combined_estimate(several: SeveralRates) -> LockInEstimate:
    """The result of the fit in the form that a result at one rate has."""
    one, fit = several.reference_group.combined, several.by_beat
    rejected = sum(int(group.combined.records_rejected) for group in several.groups)
    total = sum(len(group.rows) for group in several.groups)
    counts: dict[str, Any] = {"records": np.asarray(total - rejected), "records_rejected": np.asarray(rejected)}
    if fit is None:
        nothing: dict[str, Any] = dict.fromkeys(
            ("lock_in_rate", "lock_in_rate_u", "lock_in_rate_low_95", "lock_in_rate_high_95"), np.asarray(np.nan)
        )
        return replace(one, **nothing, **counts)
    return replace(
        one,
        lock_in_rate=np.asarray(fit.lock_in_rate),
        lock_in_rate_u=np.asarray(fit.lock_in_rate_u),
        lock_in_rate_low_95=np.asarray(fit.lock_in_rate_low_95),
        lock_in_rate_high_95=np.asarray(fit.lock_in_rate_high_95),
        backscatter_phase=np.asarray(fit.backscatter_phase),
        flags=np.asarray(_flags(several, fit)),
        noise_model=fit.noise_model,
        **counts,
    )


def _flags(several: SeveralRates, fit: RatesFit) -> int:
    """Flags of the records, except those that the fit answers better than a record can."""
    answered = int(Flag.MISFIT | Flag.RATIO_NOT_SIGNIFICANT | Flag.PHASE_TURNS | Flag.MAINS_BESIDE | FATAL)
    flags = 0
    for group in several.groups:
        flags |= int(group.combined.flags) & ~answered
    if fit.flags & (RatesFlag.MISFIT | RatesFlag.ONE_RATE_DISAGREES):
        flags |= Flag.MISFIT
    if fit.flags & (RatesFlag.NOT_SIGNIFICANT | RatesFlag.NOT_DETERMINED | RatesFlag.RATES_TOO_CLOSE):
        flags |= Flag.RATIO_NOT_SIGNIFICANT
    return int(flags)


def rates_by_table(several: SeveralRates) -> ByTable | None:
    """What the fit with the table's rate as reference says; ``None`` if there is none by the table or the beat."""
    fit, group = several.by_table, several.reference_group
    if fit is None or several.by_beat is None:
        return None
    return ByTable(fit.lock_in_rate, fit.lock_in_rate_u, group.input_rate, float(group.combined.beat_frequency))


# --------------------
# Sine and cosine photodiodes of one acquisition: records corrected with each other, and what that shows


_HARMONICS = 5
_BY_CHANCE = 0.05  # what so few of many records show may be chance


@dataclass(frozen=True)
class QuadratureResult:
    """What two channels say of each other; means over the records that could be used."""

    records: int  # that the means rest on
    sense: int  # +1, -1, or 0 where the records differ or it cannot be told
    gain_ratio: float  # amplitude of the sine over that of the cosine
    gain_ratio_u: float
    phase_error: float  # rad, beyond a right angle
    phase_error_u: float
    # second harmonic that the receivers of sine and cosine make, over the fundamental
    distortion: tuple[float, float]
    distortion_u: tuple[float, float]
    # image of the first harmonic before the correction, of the second and third after it, over the first
    images: tuple[float, float, float]
    sine_alone: float  # lock-in rate that each channel alone would give, deg/s: mean over the records
    cosine_alone: float
    flags: tuple[str, ...]  # names of `QuadratureFlag`, lower case


def estimate_pairs(
    records: RecordArrays, method: Method, response: ChannelResponse | None = None
) -> QuadratureEstimate:
    """Estimate records of two channels, each pair corrected for distortion."""
    parts, rows = [], []
    for batch in records.batches:
        sine, cosine = batch.volts
        if response is not None:
            sine, cosine = (equalised(volts, batch.sample_interval, response) for volts in batch.volts)
        pairs = estimate_quadratures(
            sine,
            cosine,
            batch.sample_interval,
            scale_factor=method.scale_factor,
            input_rate=method.input_rate,
            relation=method.relation,
            clipped=(batch.clipped[0], batch.clipped[1]),
            nan_policy="omit",
        )
        parts.append(pairs)
        rows.append(batch.rows)
    whole = joined(parts, rows)
    if response is None:
        return whole
    return replace(whole, estimate=replace(whole.estimate, noise_model=without_channel_model(whole.estimate)))


def equalised(volts: Floats, sample_interval: float, response: ChannelResponse) -> Floats:
    """Give the harmonics of records the size and phase that they had before the channel; noise stays as it is."""
    # For two channels that are corrected with each other: distortion arises before the filters, and is a real
    # share of the beat only there.
    # Shapes: volts (n_records, n_samples).
    fit = fit_harmonics(volts, sample_interval, harmonics=_HARMONICS, nan_policy="omit")
    beating = np.isfinite(fit.frequency)
    frequency = np.where(beating, fit.frequency, 1.0)
    times, restored = np.arange(volts.shape[-1]) * sample_interval, volts.copy()
    for order in range(1, _HARMONICS + 1):
        inside = beating & response.reach(order * frequency)
        if order <= 2 and not np.all(inside | ~beating):
            raise OutsideResponse(f"{order * frequency[beating & ~inside][0]:.6g} Hz lies outside the table")
        gain = np.ones(frequency.shape, dtype=np.complex128)
        gain[inside] = response.at(order * frequency[inside])
        change = np.where(inside, fit.amplitudes[..., order - 1] * (1 / gain - 1), 0.0)
        turns = 2 * np.pi * order * frequency[:, np.newaxis] * times
        restored += (change[:, np.newaxis] * np.exp(1j * turns)).real
    return restored


def mean_of_pairs(pairs: QuadratureEstimate) -> QuadratureResult | None:
    """Summarise what two channels say of each other in records (n,); ``None`` if no record can be used."""
    used = pairs.estimate.usable & np.isfinite(pairs.gain_ratio)
    if not used.any():
        return None
    count = int(used.sum())
    senses = set(pairs.sense[used].tolist())
    seen = [flag for flag in QuadratureFlag if np.mean((pairs.flags[used] & flag) != 0) > _BY_CHANCE]
    first, second, third = pairs.images[used].mean(axis=0).tolist()
    by_sine, by_cosine = pairs.distortion[used].mean(axis=0).tolist()
    by_sine_u, by_cosine_u = np.sqrt(np.mean(pairs.distortion_u[used] ** 2, axis=0) / count).tolist()
    return QuadratureResult(
        records=count,
        sense=senses.pop() if len(senses) == 1 else 0,
        gain_ratio=float(pairs.gain_ratio[used].mean()),
        gain_ratio_u=_mean_u(pairs.gain_ratio_u[used]),
        phase_error=float(pairs.phase_error[used].mean()),
        phase_error_u=_mean_u(pairs.phase_error_u[used]),
        distortion=(by_sine, by_cosine),
        distortion_u=(by_sine_u, by_cosine_u),
        images=(first, second, third),
        sine_alone=float(np.nanmean(pairs.sine.lock_in_rate[used])),
        cosine_alone=float(np.nanmean(pairs.cosine.lock_in_rate[used])),
        flags=tuple(str(flag.name).lower() for flag in seen),
    )


def _mean_u(us: Floats) -> float:
    return float(np.sqrt(np.sum(us**2)) / us.size)


# --------------------
# What the records of one run say together


@dataclass(frozen=True)
class LockInRun:
    """What the records of a run say."""

    method: Method
    each: LockInEstimate  # fields of shape (n_records,)
    # fields of shape (). Its uncertainty and its interval know the noise of the records only.
    combined: LockInEstimate
    record_u: Floats  # (n_records,): deg/s; standard uncertainty of each record alone, every input counted
    tilt: Tilt | None = None  # where a table with known rate was used
    axis_rates: Floats | None = None  # (n_records,): deg/s, by the table
    table_check: TableCheck | None = None
    several: SeveralRates | None = None  # where records were taken at several rates or in both senses
    quadratures: QuadratureResult | None = None  # where a second photodiode was recorded
    budget: Budget | None = None  # ``None`` without a lock-in rate

    def beats(self, rows: Indices) -> Floats:
        """Beats of some usable records in Hz, as they would be at one rate where their rates are known."""
        beats = self.each.beat_frequency[rows]
        rates = None if self.axis_rates is None else self.axis_rates[rows]
        return beats if rates is None else as_at_one_rate(beats, rates, self.lock_in_rate)

    @property
    def usable(self) -> bool:
        """Whether a lock-in rate can be given at all."""
        return bool(np.isfinite(self.combined.lock_in_rate)) and not int(self.combined.flags) & int(FATAL)

    @property
    def lock_in_rate(self) -> float:
        """deg/s; nan without a result."""
        return float(self.combined.lock_in_rate) if self.usable else math.nan

    @property
    def lock_in_rate_u(self) -> float:
        """Standard uncertainty, every input counted, deg/s."""
        return math.nan if self.budget is None else self.budget.combined_u

    @property
    def record_intervals_95(self) -> tuple[Floats, Floats]:
        """Ends of the 95 % interval of each record alone, every input counted, deg/s, shape (n_records,)."""
        u = self.record_u
        with np.errstate(invalid="ignore", divide="ignore"):
            low, high = size_interval(np.hypot(self.each.lock_in_rate, u) / u)
        return low * u, high * u

    @property
    def noise_u(self) -> float:
        """Standard uncertainty from the noise of the records alone, deg/s."""
        if self.several is None or self.budget is None:
            return float(self.combined.lock_in_rate_u)
        # that of a fit over several rates holds what it takes to know receiver and laser
        return next(line.contribution for line in self.budget.inputs if line.name == "noise")

    @property
    def interval_95(self) -> tuple[float, float]:
        """Ends of the 95 % interval, every input counted, deg/s."""
        if self.budget is None:
            return math.nan, math.nan
        low, high = self.budget.interval_95
        fit = None if self.several is None else self.several.by_beat
        if fit is None:
            return low, high
        # several solutions, or rates that hardly tell, make the fit's own interval wider than its u says
        value, rest = fit.lock_in_rate, math.sqrt(max(self.budget.combined_u**2 - fit.lock_in_rate_u**2, 0.0))
        rest *= self.budget.coverage_factor
        low = min(low, value - math.hypot(value - fit.lock_in_rate_low_95, rest))
        high = max(high, value + math.hypot(fit.lock_in_rate_high_95 - value, rest))
        return max(low, fit.at_least, 0.0), max(high, fit.at_least)


# --------------------
# The uncertainty budget of a run, at one rate or through the fit over several


_RECTANGLE = math.sqrt(3.0)
_SAMPLES_FITTED = 6
_EAST = 90.0
_CORNER_NAMES = {name for name, *_ in CORNERS}
_HARDLY = 0.7
"""Share of its uncertainty beforehand that an unknown of the fit has left, if the records hardly show it."""

_FITTED: dict[Model, str] = {
    "distortion": "distortion",
    "gain": "the gain corner",
    "both": "distortion and the gain corner",
    "all": "distortion, gain corner and bandwidth",
}

OF_EACH_RECORD = ("noise", "quantization", "beat_frequency", "scatter")
"""Lines that are another's in every record; those that remain act on all records of one rate alike."""


def known_of_bench(found: LockInRun, slow: RecordArrays, knowledge: RunKnowledge) -> BenchKnowledge:
    """What was stated of the bench, and what the records themselves say of table and channel."""
    stated = knowledge.bench
    return replace(
        stated,
        table=_table_geometry(found, knowledge),
        third_order_limit=third_order_limit(slow, found.each, stated.third_order_limit),
        separated=stated.separated | ({"distortion"} if found.quadratures is not None else set()),
    )


def run_budget(found: LockInRun, slow: RecordArrays, bench: BenchKnowledge) -> Budget:
    """Make the budget of a run that gave a lock-in rate; what nobody stated counts with its bound."""
    if found.several is not None and found.several.by_beat is not None:
        one, rows = found.several.reference_group.combined, found.several.reference_group.rows
        point = _operating_point(found.each[rows], one, slow)
        return _rates_budget(found.each, found.several.by_beat, point, bench, int(slow.samples.min()))
    return _one_rate_budget(found, found.each, found.combined, slow, bench)


def record_uncertainties(found: LockInRun, slow: RecordArrays, bench: BenchKnowledge) -> Floats:
    """Standard uncertainty of each record alone, every input counted, deg/s; arguments as above."""
    each = found.each
    groups = [(np.arange(each.flags.size), found.combined)]
    if found.several is not None:
        groups = [(group.rows, group.combined) for group in found.several.groups]
    us = np.full(each.flags.size, math.nan)
    for rows, one in groups:
        if np.isfinite(one.lock_in_rate_u) and each[rows].usable.any():
            budget = _one_rate_budget(found, each[rows], one, slow, bench)
            alike = math.hypot(*(line.contribution for line in budget.inputs if line.name not in OF_EACH_RECORD))
            us[rows] = np.hypot(each.lock_in_rate_u[rows], alike)
    return us


def _one_rate_budget(
    found: LockInRun, each: LockInEstimate, one: LockInEstimate, slow: RecordArrays, bench: BenchKnowledge
) -> Budget:
    reference: RateReference = "rate" if one.rate_given else "beat"
    if one.relation == "exact":
        return lock_in_budget(_operating_point(each, one, slow), bench, reference)
    # a formula of the paper: the sensitivities are those of the exact relation, the rest is its error
    r, value = float(one.ratio), float(one.lock_in_rate)
    if one.rate_given:
        exact = float(lock_in_from_rate(r, abs(float(one.input_rate)), "exact"))
    else:
        exact = float(lock_in_from_beat(r, float(one.beat_frequency) / one.scale_factor))
    budget = lock_in_budget(
        _operating_point(each, replace(one, lock_in_rate=np.asarray(exact)), slow), bench, reference
    )
    error = value - exact
    note = f"{error / exact:+.2%} off the exact relation: a limit, not corrected for" if exact else ""
    quantity, u = f"formula {found.method.relation} of the paper", abs(error) / _RECTANGLE
    line = BudgetInput("relation", quantity, "deg/s", error, u, "rectangular", 1.0, note=note, common=True)
    return Budget(value, reference, (*budget.inputs, line))


def _operating_point(each: LockInEstimate, one: LockInEstimate, slow: RecordArrays) -> OperatingPoint:
    return operating_point(
        each, one, samples=int(slow.samples.min()), level_spacing=float(np.mean(slow.level_spacing))
    )


def _table_geometry(found: LockInRun, knowledge: RunKnowledge) -> TableGeometry | None:
    """How the rate on the axis came about; ``None`` where no table with a known rate was used."""
    tilt, check = found.tilt, found.table_check
    if tilt is None or check is None:
        return None
    vertical = float(earth_rate_on_axis(knowledge.latitude_deg, tilt.tilt_deg, _EAST))
    table_rate = (check.input_rate - vertical) / math.cos(math.radians(tilt.tilt_deg))
    return TableGeometry(
        table_rate=table_rate,
        table_rate_u=1e-6 * knowledge.table_rate_u_ppm * abs(table_rate),
        tilt_deg=tilt.tilt_deg,
        tilt_u_deg=tilt.tilt_u_deg,
        latitude_deg=knowledge.latitude_deg,
        latitude_u_deg=knowledge.latitude_u_deg,
    )


def _rates_budget(
    each: LockInEstimate, fit: RatesFit, point: OperatingPoint, bench: BenchKnowledge, samples: int
) -> Budget:
    """Budget of a fit over several rates: what acts on every rate in its own way is put through the fit."""
    bench = replace(bench, separated=bench.separated | fit.counted)
    slowest = float(np.min(each.beat_frequency[fit.used]))
    known = bounded(bench, slowest)
    # what is common stands as at one rate; the channel comes below
    at_one_rate = lock_in_budget(point, bench)
    scale = fit.lock_in_rate / at_one_rate.lock_in_rate if at_one_rate.lock_in_rate else 1.0
    common = [line for line in at_one_rate.inputs if line.common and line.name not in _CORNER_NAMES]
    lines = [replace(line, sensitivity=line.sensitivity * scale) for line in common]
    prior, second = prior_of(bench, slowest).sd, bench.distortion_limit
    unknowns = (
        ("distortion", math.nan if "distortion" in bench.separated else second, fit.distortion_u, prior[2]),
        ("gain corner", bench.gain.hz, fit.gain_time_u, prior[3]),
        ("bandwidth", bench.bandwidth.hz, fit.lag_square_u, prior[4]),
        ("third order", bench.third_order_limit, fit.third_order_u, prior[5]),
    )
    hardly_seen = [name for name, stated, u, before in unknowns if math.isnan(stated) and u > _HARDLY * before]
    lines += [*_from_fit(fit, samples, hardly_seen), *_from_channel(each, fit, known, point, bench)]
    return Budget(fit.lock_in_rate, "beat", tuple(lines))


def _from_fit(fit: RatesFit, samples: int, hardly_seen: list[str]) -> Iterator[BudgetInput]:
    """Noise of the records, and what it costs to find distortion and the like from the same records."""
    scattered = bool(fit.flags & RatesFlag.MISFIT)
    freedom = float(fit.degrees_of_freedom if scattered else fit.used.sum() * (samples - _SAMPLES_FITTED))
    # without what rules the interval beside the records: other solutions, coupling of the beams
    noise_u = min(math.sqrt(float(fit.covariance[0, 0])), fit.lock_in_rate_u) / max(fit.cost, 1.0)
    note = "enlarged to the scatter between records" if scattered else "from what the fit leaves of the records"
    yield BudgetInput(
        "noise", "noise of the records", "deg/s", fit.lock_in_rate, noise_u, "normal", 1.0, freedom, note
    )
    if fit.model != "lock-in":
        rest = math.sqrt(max(fit.lock_in_rate_u**2 - noise_u**2, 0.0))
        quantity = f"noise, by way of {_FITTED[fit.model]}"
        note = f"{_FITTED[fit.model]} fitted to the same records"
        if hardly_seen:
            note = f"not stated: bound of {', '.join(hardly_seen)}, which these rates hardly show"
        yield BudgetInput(
            "separation", quantity, "deg/s", 0.0, rest, "normal", 1.0, freedom, note, stated=not hardly_seen
        )


def _from_channel(
    each: LockInEstimate, fit: RatesFit, known: Bounded, point: OperatingPoint, receiver: BenchKnowledge
) -> Iterator[BudgetInput]:
    """Filters of channel and laser: the fit again with the ratios that would be seen without them."""
    plain: list[RatesFit] = []

    def shift(factor: Callable[[Floats], Complexes]) -> float:
        """Change of the lock-in rate, deg/s, if the ratios were multiplied by a factor of their frequency."""
        try:
            if not plain:
                plain.append(fit_again(fit, factor=np.ones_like, receiver=receiver))
            after = fit_again(fit, factor=factor, receiver=receiver)
        except NoFit:
            # as at the rate that determines the result best
            place = int(np.nanargmin(np.abs(each.beat_frequency - point.beat_frequency)))
            return fit.lock_in_rate * float(np.abs(factor(each.beat_frequency[place : place + 1])[0]) - 1)
        return after.lock_in_rate - plain[0].lock_in_rate

    for name, field, quantity, factor in CORNERS:
        corner: ResponseCorner = getattr(known.knowledge, field)
        if name in known.knowledge.separated:
            yield separated_input(name, quantity)
        elif corner.hz in (0.0, math.inf):
            yield BudgetInput(name, quantity, "Hz", corner.hz, 0.0, "rectangular", 0.0, note="none")
        elif corner.corrected:
            wider = replace(corner, hz=corner.hz + corner.u_hz)
            u = abs(shift(_without(factor, wider, corner)))
            yield _line(name, quantity, corner, u, "normal", "corrected for")
        else:
            u = abs(shift(_without(factor, corner))) / _RECTANGLE
            line = _line(name, quantity, corner, u, "rectangular", "not corrected for")
            bound = f"{corner.hz:.4g} Hz; the fit repeated with its effect"
            yield replace(line, note=known.note(name, bound, line.note), stated=name not in known.assumed)
    yield from stated_inputs(known.knowledge, fit.lock_in_rate, shift)


def _line(
    name: str, quantity: str, corner: ResponseCorner, u: float, kind: Distribution, what: str
) -> BudgetInput:
    note = f"corner {corner.hz:g} Hz, {what}: the fit repeated with its effect"
    return BudgetInput(name, f"{quantity}: shift of the fit", "deg/s", 0.0, u, kind, 1.0, note=note)


def _without(
    factor: Callable[[Floats, float], Complexes], corner: ResponseCorner, corrected: ResponseCorner | None = None
) -> Callable[[Floats], Complexes]:
    """What takes a filter out of the ratios, by their beat frequencies; `corrected`: what has been taken out."""

    def of(frequency: Floats) -> Complexes:
        seen = factor(frequency, corner.hz)
        return np.asarray(1 / (seen if corrected is None else seen / factor(frequency, corrected.hz)))

    return of
