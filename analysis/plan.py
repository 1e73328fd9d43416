"""Rate, time base, vertical scale and number of records for a wanted uncertainty of the lock-in rate."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.arrays import Floats
from analysis.beam_swings import BeamModulation
from analysis.budget import (
    BenchKnowledge,
    Budget,
    BudgetInput,
    RecordShape,
    Reference,
    TableGeometry,
    expected_noise,
    expected_point,
    lock_in_budget,
)
from analysis.lockin_equation import beat_frequency, harmonic_ratio
from analysis.lockin_rate import MAINS_ORDERS
from analysis.several_rates import COUNTED, RatioData, predicted_ratio
from analysis.several_rates.fit import gain_time_is_open, over_gain_times
from analysis.several_rates.laser_fit import GAIN, SATURATION, LaserData, LaserFit, LaserModel, beat_data
from analysis.several_rates.points import UsedRecords, gather, place_in_run, records_of_arrays
from analysis.several_rates.ratio_model import N_PARAMETERS, all_solutions, fit_ratios, prior_of, whitening_factor
from analysis.several_rates.result import answer
from analysis.single_beams import BeamsKnowledge, beams_data

# --------------------
# What somebody who plans a measurement knows and wants


SAFE_ABOVE_LOCK_IN = 1.5
"""The rate stays so far above the largest lock-in rate to be expected: no table turns perfectly steadily."""

FASTEST_OVER_LOCK_IN = 100.0


@dataclass(frozen=True)
class OscilloscopeSteps:
    """What the knobs of an oscilloscope allow."""

    time_bases: Sequence[float]  # s/div, ascending
    vertical_scales: Sequence[float]  # v/div at the input, ascending
    # of a record: its samples, its horizontal divisions, the converter's levels per vertical division
    samples: int = 2500
    divisions: int = 10
    levels_per_division: int = 25

    def time_base(
        self, frequency: float, periods_min: float, samples_per_period_min: float, mains: Sequence[float] = ()
    ) -> float:
        """The fastest step, s/div, that holds so many periods; the next where that is clear of the mains."""
        # Where that would leave too few samples in a period it is the slowest step that leaves enough.
        slowest = self.samples / (self.divisions * frequency * samples_per_period_min)
        sampled = [base for base in self.time_bases if base <= slowest * (1 + 1e-9)] or [self.time_bases[0]]
        enough = periods_min / (self.divisions * frequency)
        slow_enough = [base for base in sampled if base >= enough * (1 - 1e-9)] or sampled[-1:]
        return max(slow_enough[:2], key=lambda base: mains_clearance(frequency, self.divisions * base, mains))

    def vertical_scale(self, amplitude: float, levels: float) -> float:
        """The most sensitive step, V/div, on which an amplitude in V stays within so many levels of the middle."""
        wanted = amplitude * self.levels_per_division / levels
        found = next((scale for scale in self.vertical_scales if scale >= wanted * (1 - 1e-9)), None)
        if found is None:
            highest = self.vertical_scales[-1] * levels / self.levels_per_division
            raise ValueError(
                f"an amplitude of {amplitude:g} V does not fit on the screen, which takes {highest:g} V at most: "
                "use a probe that divides"
            )
        return found


CLEAR_OF_MAINS = 3.0
"""Widths of a line, 1/T, between a harmonic of the beat and one of the mains: from there on hum is itself."""


def mains_clearance(frequency: float, duration: float, mains: Sequence[float]) -> float:
    """How far f, 2f and 3f of a beat (Hz) stay off the harmonics of the mains, in 1/T, `CLEAR_OF_MAINS` at most.

    Hum on the second harmonic passes for lock-in; between one and three widths its foot still does. Where the
    mains may be one of two only 2f is asked for: all three off both would make most records four times as long.
    """
    hums = np.array([hum * order for hum in mains for order in range(1, MAINS_ORDERS + 1)])
    harmonics = np.array([1.0, 2.0, 3.0] if len(mains) == 1 else [2.0])
    apart = np.abs(frequency * harmonics[:, None] - hums) * duration
    return float(np.min(apart, initial=CLEAR_OF_MAINS))


def off_mains(
    beat: float, lock_in_rate: float, scale_factor: float, duration: float, mains: Sequence[float]
) -> float:
    """The least change of the rate, deg/s faster, that brings a beat (Hz) in records so long (s) off the mains."""
    # 0 where none makes it better: up to 16 % faster, and 6 % slower, since a gyro locks where it is slow.
    rate = math.hypot(beat / scale_factor, lock_in_rate)

    def clearance(move: float) -> float:
        squared = (rate * (1 + move)) ** 2 - lock_in_rate**2
        return mains_clearance(scale_factor * math.sqrt(squared), duration, mains) if squared > 0 else 0.0

    return rate * max(sorted((0.02 * step for step in range(-3, 9)), key=abs), key=clearance)


@dataclass(frozen=True)
class PlanRequest:
    """What is wanted, and what is known beforehand."""

    lock_in_rate: float  # as expected, deg/s
    wanted_u: float  # relative standard uncertainty of the lock-in rate that is wanted
    scale_factor: float  # k, pulses per degree
    amplitude: float  # of the beat, and of the white noise in each sample, at the input, V
    noise_rms: float
    oscilloscope: OscilloscopeSteps
    knowledge: BenchKnowledge  # its `table` is made from `table` below
    lock_in_factor: float = 2.0  # it may be this factor larger or smaller
    noise_levels: float = 0.0  # noise of the oscilloscope itself, rms, levels
    reference: Reference = "beat"  # {"beat", "rate"}
    table: TableGeometry | None = None  # its rate is one of 1 deg/s
    rates_over_lock_in: tuple[float, ...] = ()  # w/WL to measure at; empty: the best one is looked for
    both_senses: bool = False  # every rate in both senses of rotation
    phase: float = math.nan  # readout phase less backscatter phase, rad; nan: unknown
    scatter: float = 0.0  # standard deviation of the lock-in rate itself from record to record, relative
    periods_min: float = 15.0  # how a record is to be taken
    samples_per_period_min: float = 20.0
    fill_levels: float = 100.0
    seconds_between_records: float = 0.0  # for the transfer

    def __post_init__(self) -> None:
        for name in ("lock_in_rate", "wanted_u", "scale_factor", "amplitude"):
            if not (getattr(self, name) > 0 and math.isfinite(getattr(self, name))):
                raise ValueError(f"{name} must be a positive number, not {getattr(self, name)!r}")
        if not 1 <= self.lock_in_factor <= FASTEST_OVER_LOCK_IN / 2:
            raise ValueError(f"the lock-in rate can be wrong by a factor of 1 to 50, not {self.lock_in_factor!r}")
        for ratio in self.rates_over_lock_in:
            if not 1.05 <= ratio <= 1000:
                raise ValueError(f"a rate must be 1.05 to 1000 times the lock-in rate, not {ratio:g} times")
        if self.reference == "rate" and self.table is None:
            raise ValueError("with the rate as reference, say how well table rate and tilt are known")

    @property
    def slowest_over_lock_in(self) -> float:
        """W/WL below which the gyro could be locked, WL being known only within its factor."""
        return SAFE_ABOVE_LOCK_IN * self.lock_in_factor

    @property
    def distortion_separated(self) -> bool:
        """Whether the rates can tell distortion from lock-in: two rates, or both senses."""
        return self.both_senses or len(set(self.rates_over_lock_in)) > 1

    @property
    def few_rates(self) -> bool:
        """Whether the rates are too few for the beat alone to tell what laser it is of."""
        return not self.both_senses and 1 < len(set(self.rates_over_lock_in)) < FEW_RATES


MOST_RECORDS = 100_000

FEWEST_RECORDS = 3  # in all: fewer would not show whether they scatter by more than their noise

_FLOOR_SHARE = 3.0
"""Where the wanted uncertainty is out of reach, noise is brought to this fraction of what remains."""

_CLOSE_TO_FLOOR = 1.05
_FALLS = 0.7  # share that four times as many records leave, where it is half by noise alone

_CANDIDATES = 60


@dataclass(frozen=True)
class PlannedRate:
    """One rate of a plan, and how its records are taken."""

    over_lock_in: float  # |W|/WL
    input_rate: float  # deg/s, signed; the second is nan where no table is described
    table_rate: float
    beat_frequency: float  # Hz
    seconds_per_division: float
    volts_per_division: float
    periods: float
    samples_per_period: float
    levels: float  # amplitude of the beat in levels of the converter
    shape: RecordShape  # with the number of records at this rate


@dataclass(frozen=True)
class Plan:
    """What to do, and what will come of it."""

    request: PlanRequest
    rates: tuple[PlannedRate, ...]
    budget: Budget  # predicted, of all records together
    reached: bool  # whether the wanted uncertainty is reached
    floor_u: float  # relative uncertainty that no number of records goes below
    duration_s: float  # of all records with their transfer

    @property
    def records(self) -> int:
        """At each rate."""
        return self.rates[0].shape.records


def plan_measurement(request: PlanRequest) -> Plan:
    """Plan a measurement."""
    # Without rates in the request the rate is the one that needs the fewest records, or, where no number of them
    # is enough, the one with the smallest uncertainty that remains.
    chosen = request.rates_over_lock_in or (_best_rate(request),)
    return _planned(request, chosen)


def plan_of_records(request: PlanRequest, records: int) -> Plan:
    """Say what so many records at each rate of the request give, and how long they take."""
    if not request.rates_over_lock_in:
        raise ValueError("without rates nobody knows what the records give")
    ratios = request.rates_over_lock_in
    rates = _rates(request, ratios, records)
    budget, most = _budget(request, rates), _budget(request, _rates(request, ratios, MOST_RECORDS))
    seconds = sum(rate.shape.records * (rate.shape.duration + request.seconds_between_records) for rate in rates)
    wanted = request.wanted_u * request.lock_in_rate
    return Plan(request, rates, budget, budget.combined_u <= wanted, most.relative_u, seconds)


def predicted_budget(request: PlanRequest, over_lock_in: float, records: int) -> Budget:
    """Budget of so many records at one rate, or at it in both senses."""
    rates = _rates(request, (over_lock_in,), records)
    return _budget(request, rates)


def budget_elsewhere(plan: Plan, lock_in_rate: float) -> Budget:
    """Budget of the same rates and records if the lock-in rate is another than expected, deg/s."""
    ratios = tuple(abs(rate.input_rate) / lock_in_rate for rate in plan.rates)
    request = replace(plan.request, lock_in_rate=lock_in_rate, rates_over_lock_in=ratios)
    return _budget(request, _rates(request, ratios, plan.records))


def _best_rate(request: PlanRequest) -> float:
    slowest = request.slowest_over_lock_in
    candidates = np.geomspace(slowest, max(FASTEST_OVER_LOCK_IN, 2 * slowest), _CANDIDATES)
    plans = [_planned(request, (float(ratio),)) for ratio in candidates]
    reached = [plan for plan in plans if plan.reached]
    if reached:
        best = min(reached, key=lambda plan: (plan.records, plan.budget.relative_u))
    else:
        best = min(plans, key=lambda plan: (float(f"{plan.floor_u:.3g}"), plan.budget.relative_u))
    return best.rates[0].over_lock_in


def _planned(request: PlanRequest, ratios: tuple[float, ...]) -> Plan:
    one = _budget(request, _rates(request, ratios, 1))
    most = _budget(request, _rates(request, ratios, MOST_RECORDS))
    averaging = math.sqrt(max(one.combined_u**2 - most.combined_u**2, 0.0) / (1 - 1 / MOST_RECORDS))
    fixed = math.sqrt(max(most.combined_u**2 - averaging**2 / MOST_RECORDS, 0.0))
    wanted = request.wanted_u * request.lock_in_rate
    room = wanted**2 - fixed**2 if wanted > fixed else (fixed / _FLOOR_SHARE) ** 2
    least = math.ceil(FEWEST_RECORDS / len(_rates(request, ratios, 1)))
    records = min(max(math.ceil(averaging**2 / room * (1 - 1e-9)), least), MOST_RECORDS)
    budget = _budget(request, rates := _rates(request, ratios, records))
    # where what is known beforehand bounds the rest, the variance does not go with the number of records
    more = 1.2
    while budget.combined_u > wanted >= fixed * _CLOSE_TO_FLOOR and records < MOST_RECORDS:
        before, records = (budget.combined_u, records), min(math.ceil(more * records), MOST_RECORDS)
        budget = _budget(request, rates := _rates(request, ratios, records))
        fall = math.log(before[0] / budget.combined_u) / math.log(records / before[1])
        more = min(max((budget.combined_u / wanted) ** (1 / max(fall, 0.1)), 1.05), 4.0)
    seconds = sum(rate.shape.records * (rate.shape.duration + request.seconds_between_records) for rate in rates)
    floor = min(fixed, budget.combined_u) / request.lock_in_rate
    if (first := budget.inputs[0]).name == "separation":
        again = _budget(request, _rates(request, ratios, 4 * records))
        if again.combined_u > _FALLS * budget.combined_u:
            open_ = replace(first, stated=False, note="not stated: bounds of what these rates hardly show")
            budget = Budget(budget.lock_in_rate, budget.reference, (open_, *budget.inputs[1:]))
    return Plan(request, rates, budget, budget.combined_u <= wanted * (1 + 1e-6), floor, seconds)


def _rates(request: PlanRequest, ratios: tuple[float, ...], records: int) -> tuple[PlannedRate, ...]:
    senses = (1, -1) if request.both_senses else (1,)
    return tuple(_rate(request, ratio, sense, records) for ratio in sorted(set(ratios)) for sense in senses)


def _rate(request: PlanRequest, ratio: float, sense: int, records: int) -> PlannedRate:
    scope, rate = request.oscilloscope, sense * ratio * request.lock_in_rate
    frequency = float(beat_frequency(request.scale_factor, rate, request.lock_in_rate))
    base = scope.time_base(frequency, request.periods_min, request.samples_per_period_min)
    scale = scope.vertical_scale(request.amplitude, request.fill_levels)
    spacing = scale / scope.levels_per_division
    shape = RecordShape(
        samples=scope.samples,
        sample_interval=scope.divisions * base / scope.samples,
        amplitude=request.amplitude,
        noise_rms=math.hypot(request.noise_rms, request.noise_levels * spacing),
        level_spacing=spacing,
        records=records,
    )
    return PlannedRate(
        over_lock_in=ratio,
        input_rate=rate,
        table_rate=request.table.for_rate(rate).table_rate if request.table is not None else math.nan,
        beat_frequency=frequency,
        seconds_per_division=base,
        volts_per_division=scale,
        periods=frequency * shape.duration,
        samples_per_period=1 / (frequency * shape.sample_interval),
        levels=request.amplitude / spacing,
        shape=shape,
    )


def _budget(request: PlanRequest, rates: tuple[PlannedRate, ...]) -> Budget:
    """Budget at the slowest rate, where most of what is known comes from, with the noise of all rates."""
    slowest = rates[0]
    point = expected_point(
        slowest.shape,
        scale_factor=request.scale_factor,
        input_rate=slowest.input_rate,
        lock_in_rate=request.lock_in_rate,
        scatter=request.scatter * request.lock_in_rate,
        phase=request.phase,
    )
    knowledge = replace(
        request.knowledge,
        # the records show a third harmonic always; the fit to several rates counts all of it
        separated=frozenset(COUNTED if len(rates) > 1 else {"third_order"}),
        table=request.table.for_rate(slowest.input_rate) if request.table is not None else None,
    )
    if len(rates) == 1:
        return lock_in_budget(point, knowledge, request.reference)
    alone = lock_in_budget(point, knowledge, request.reference)
    own = math.hypot(*(line.contribution for line in alone.inputs if line.name in ("noise", "quantization")))
    noise, joint = (
        expected_joint_u(
            [rate.shape for rate in rates],
            [rate.input_rate for rate in rates],
            request.lock_in_rate,
            request.scale_factor,
            reference=request.reference,
            phase=request.phase,
            receiver=request.knowledge,
            all_else_known=known,
        )
        for known in (True, False)
    )
    point = replace(
        point,
        ratio_u=point.ratio_u * noise / own,
        noise_degrees_of_freedom=point.noise_degrees_of_freedom * len(rates),
        scatter_u=point.scatter_u / math.sqrt(len(rates)),
    )
    budget = lock_in_budget(point, knowledge, request.reference)
    rest = math.sqrt(max(joint**2 - noise**2, 0.0))
    quantity = "noise, by way of distortion, gain corner and bandwidth"
    separation = BudgetInput("separation", quantity, "deg/s", 0.0, rest, "normal", 1.0, note=_SEPARATION_NOTE)
    return Budget(budget.lock_in_rate, budget.reference, (*budget.inputs, separation))


_SEPARATION_NOTE = "they are fitted to the same records, within what is known of them"


# --------------------
# What the same records will say of any laser, by the beat alone or with the single beams beside it


def plan_of_lasers(plan: Plan, beams: int, knowledge: BeamsKnowledge) -> tuple[float, float] | None:
    """Relative u that the records of a plan give with so many beams: half of all lasers less, and nine in ten.

    ``None`` at one rate in one sense, which tells nothing, and without beams at rates that tell the laser.
    """
    request = plan.request
    if not (request.few_rates or (beams and request.distortion_separated)):
        return None
    visits = [rate for rate, _ in run_order([rate.input_rate for rate in plan.rates])]
    shape_of = {rate.input_rate: rate.shape for rate in plan.rates}
    us = expected_lasers_u(
        [replace(shape_of[rate], records=math.ceil(plan.records / visits.count(rate))) for rate in visits],
        visits,
        request.lock_in_rate,
        request.scale_factor,
        beams=beams,
        knowledge=knowledge,
        receiver=request.knowledge,
    )
    fixed = [line.contribution for line in plan.budget.inputs if line.name in ("scale_factor", "time_base")]
    both = np.quantile(us, [0.5, 0.9]) if us.size > _DRAWS / 2 else [math.inf, math.inf]
    half, most = (math.hypot(u, *fixed) / request.lock_in_rate for u in both)
    return half, most


_DRAWS, _MANY, _SEED = 24, 64, 20141231
_RATIOS, _SLOWEST_OVER_CORNER = (0.3, 3.0), (0.01, 3.0)  # of the lasers that are drawn, evenly in logarithms
_SATURATIONS = 0.1, 0.9


def expected_lasers_u(
    shapes: Sequence[RecordShape],
    input_rates: Sequence[float],
    lock_in_rate: float,
    scale_factor: float,
    *,
    beams: int = 2,
    knowledge: BeamsKnowledge | None = None,
    receiver: BenchKnowledge | None = None,
) -> Floats:
    """Standard uncertainty of the lock-in rate that beat and beams will give, deg/s, for lasers that are drawn.

    Nobody knows the laser beforehand: phase sum 0 to 180 degrees, a2/a1 0.3 to 3, the slowest beat at 0.01 to 3
    gain corners. Rising, (n,): its middle is the median. Neither the scale factor nor other solutions count.
    """
    known, receiver = knowledge or BeamsKnowledge(), receiver or BenchKnowledge()
    counts = [min(max(shape.records, 2), _MANY) for shape in shapes]  # more say the same with less noise
    rate = np.repeat(np.asarray(input_rates, dtype=np.float64), counts)
    frequency = beat_frequency(scale_factor, np.abs(rate), lock_in_rate)
    noise = np.repeat(
        [shape.total_noise / shape.amplitude * math.sqrt(2 / shape.samples) for shape in shapes], counts
    )
    noise *= np.sqrt(np.repeat(counts / np.array([shape.records for shape in shapes]), counts))
    size = -np.sign(rate) * harmonic_ratio(lock_in_rate / np.abs(rate))
    records = records_of_arrays(
        rate,
        size,
        noise[:, np.newaxis, np.newaxis] ** 2 * np.eye(2),
        frequency,
        scale_factor=scale_factor,
        third_harmonic_u=noise,
        in_order=True,
    )
    used = UsedRecords(records, np.ones(rate.size, dtype=bool), np.zeros(rate.size), "beat")
    there = np.where(np.arange(2) < beams, noise[:, np.newaxis], np.nan)
    swings = BeamModulation(np.ones(there.shape, dtype=np.complex128), there, noise, np.ones(there.shape), 0)
    points = gather(used)
    data = beams_data(points, swings, known, receiver) if beams else beat_data(points, receiver)
    rng, us = np.random.default_rng(_SEED), list[float]()
    for _ in range(_DRAWS):
        laser = _drawn(rng, data, 2 * np.pi * scale_factor * lock_in_rate)
        ratio, _, swing, _, found = LaserModel(data).predicted(laser[np.newaxis])
        if not found:  # its backscatter is too strong for the slowest rate
            continue
        points = replace(data.points, points=replace(data.points.points, ratio=ratio[0]))
        weight = data.swing_weight / np.maximum(np.abs(swing[0]), 1e-12)
        model = LaserModel(replace(data, points=points, swing=swing[0], swing_weight=weight))
        us.append(LaserFit.at(model, laser).coupling(1.0)[0][1] / (2 * np.pi * scale_factor))
    return np.sort(us)


def _drawn(rng: np.random.Generator, data: LaserData, coupling: float) -> Floats:
    """Parameters of a laser whose |C| is that, rad/s, all else as it is likeliest."""
    ratio, slowness = np.exp(rng.uniform(*np.log([_RATIOS, _SLOWEST_OVER_CORNER]).T))
    turn = np.exp(0.5j * rng.uniform(0, np.pi))
    both = np.array([1 / turn, ratio * turn]) * np.exp(1j * rng.uniform(0, 2 * np.pi))
    both *= coupling / abs(both.sum())
    parameters, corner = data.mean.copy(), data.points.points.angular.min() / slowness
    parameters[:4] = [number for one in both for number in (math.log(abs(one)), np.angle(one))]
    parameters[[GAIN, SATURATION]] = np.log(corner), rng.uniform(*_SATURATIONS)
    return parameters


# --------------------
# What records at several rates or in both senses will say, with all that is unknown fitted too


_PHASES = 12

FEW_RATES = 4  # so many rates in one sense have no second solution; fewer may have one


def expected_joint_u(
    shapes: Sequence[RecordShape],
    input_rates: Sequence[float],
    lock_in_rate: float,
    scale_factor: float,
    *,
    reference: Reference = "beat",
    phase: float = np.nan,
    receiver: BenchKnowledge | None = None,
    all_else_known: bool = False,
) -> float:
    """Standard uncertainty of the lock-in rate that all rates give together, deg/s: that of `fit_rates`."""
    # It counts the noise of the records, and what they do not tell of distortion, bandwidth and gain corner. Few
    # rates in one sense may have a second solution; then it is that of both together.
    phases = np.array([phase]) if np.isfinite(phase) else np.arange(_PHASES) * (2 * np.pi / _PHASES)
    given = np.asarray(input_rates, dtype=np.float64)
    if np.unique(given).size < 2:
        raise ValueError(
            "these rates cannot tell distortion from lock-in: take both senses, or rates that differ by a factor "
            "of two or more"
        )
    rate = np.array([visited for visited, _ in run_order(given.tolist())])
    frequency = beat_frequency(scale_factor, np.abs(rate), lock_in_rate)
    which = [int(np.flatnonzero(given == visited)[0]) for visited in rate]
    fewer = np.sqrt([float(np.sum(rate == visited)) for visited in rate])  # two visits share the records
    noise = [expected_noise(shapes[row], float(harmonic_ratio(lock_in_rate / abs(given[row])))) for row in which]
    along = fewer * np.array([float(each.ratio_u) for each in noise])
    across = fewer * np.array([float(each.across_u) for each in noise])
    z = lock_in_rate * np.exp(-1j * phases)
    truth = np.zeros((phases.size, N_PARAMETERS))
    truth[:, 0], truth[:, 1] = z.real, z.imag
    data = RatioData(
        rate=rate,
        beat_rate=frequency / scale_factor,
        angular=2 * np.pi * frequency,
        ratio=np.zeros(rate.size, dtype=np.complex128),
        whitening=np.zeros((phases.size, rate.size, 2, 2)),
        amplitude=np.ones(rate.size),
        when=place_in_run(rate.size),
        third=np.zeros(rate.size),
        third_weight=1 / along,
        reference=reference,
    )
    rho = predicted_ratio(truth, data)
    unit, squares = rho / np.abs(rho), np.stack([along**2, across**2], axis=-1)
    turn = np.stack([np.stack([unit.real, -unit.imag], -1), np.stack([unit.imag, unit.real], -1)], -2)
    covariance = np.einsum("...ij,...j,...kj->...ik", turn, squares, turn)
    data = replace(data, ratio=rho, whitening=whitening_factor(covariance))
    prior = prior_of(receiver or BenchKnowledge(), float(frequency.min())).seen_by(data)
    if all_else_known:
        prior = replace(prior, sd=np.where(np.isinf(prior.sd), np.inf, 0.0))
    fit = fit_ratios(data, prior, truth)
    settings = np.unique(rate).size
    few = len(set(np.sign(rate))) == 1 and settings < FEW_RATES
    if not all_else_known and (few or gain_time_is_open(fit, data, prior, settings)):
        us = []
        for row in range(0, phases.size, 4):
            one = replace(data, ratio=rho[row], whitening=data.whitening[row : row + 1])
            found = all_solutions(one, prior) if few else fit.take(slice(row, row + 1))
            said = answer(found, 1.0, 0)
            if gain_time_is_open(found, one, prior, settings):
                said = over_gain_times(said, found, one, prior, 1.0)
            us.append(said.u)
        return float(np.sqrt(np.mean(np.square(us))))
    radial = np.stack([np.cos(phases), -np.sin(phases)], axis=-1)
    variance = np.einsum("bi,bij,bj->b", radial, fit.covariance[:, :2, :2], radial)
    return float(np.sqrt(variance.mean()))


# --------------------
# Rates for a gyro of which only the expected lock-in rate is known


SPAN = 10.0
"""The fastest rate over the slowest. The slow rates carry the lock-in rate; distortion shows itself where the
second harmonic of lock-in has become small, bandwidth and gain corner where the beat is fast."""

STEPS = 5
"""So many rates determine lock-in rate, phase, distortion, gain corner and bandwidth, and leave a test of them."""

LEAST_STEP = 1.25
"""One rate over the next: where they cannot go far, more of them still tell whether the beats follow the rates."""

DEFAULT_RECORDS = 3  # at each rate and sense: fewer would not show whether they scatter by more than their noise


def run_order(rates: Sequence[float]) -> tuple[tuple[float, bool], ...]:
    """Signed rates in the order in which a run goes to them, and whether it has been there before."""
    # What drifts evenly over a run must not look like a change with the rate or with the sense. With several rates
    # in both senses the slow ones, which carry the lock-in rate, stand in the middle; with one rate, or in one
    # sense, the run goes the whole way back and ends where it began. Two visits of a rate share its records.
    first = 1.0 if max(rates) > 0 else -1.0
    down = sorted({rate for rate in rates if rate * first > 0}, key=abs, reverse=True)
    up = sorted({rate for rate in rates if rate * first < 0}, key=abs)
    once = [*down, *up]
    back = [] if up and len(down) > 1 else once[-2::-1]
    return (*((rate, False) for rate in once), *((rate, True) for rate in back))


def default_rates(
    expected_lock_in_rate: float,
    scale_factor: float,
    *,
    lock_in_factor: float = 2.0,
    fastest_rate: float = math.inf,
    fastest_beat_hz: float = math.inf,
) -> tuple[float, ...]:
    """Rates to measure at, in expected lock-in rates, each in both senses."""
    # Five rates from 1.5 times the largest lock-in rate that is possible to ten times that, evenly on a
    # logarithmic scale; closer together where table or receiver do not go so far, and fewer where less than a
    # quarter would lie between two.
    for name, value in (("expected_lock_in_rate", expected_lock_in_rate), ("scale_factor", scale_factor)):
        if not (value > 0 and math.isfinite(value)):
            raise ValueError(f"{name} must be a positive number, not {value!r}")
    if not lock_in_factor >= 1:
        raise ValueError(f"the lock-in rate can be wrong by a factor of 1 or more, not {lock_in_factor!r}")
    slowest = SAFE_ABOVE_LOCK_IN * lock_in_factor
    highest = min(fastest_rate, fastest_beat_hz / scale_factor) / expected_lock_in_rate
    if not highest >= slowest:
        raise ValueError(
            f"the gyro may be locked up to {slowest * expected_lock_in_rate:.3g} deg/s, and the bench goes to "
            f"{highest * expected_lock_in_rate:.3g} deg/s only: no rate is safe"
        )
    span = min(SPAN, highest / slowest)
    count = min(STEPS, max(2, 1 + math.floor(math.log(span) / math.log(LEAST_STEP)))) if span > 1 else 1
    steps = [slowest * span ** (step / max(count - 1, 1)) for step in range(count)]
    return tuple(float(f"{ratio:.2g}") for ratio in steps)


# --------------------
# Uncertainty of the lock-in rate against the rate at which it is measured


_POINTS = 24  # of a smooth curve: each takes fits where both senses are planned
_GROUPS: dict[str, tuple[str, ...]] = {
    "noise": ("noise", "quantization", "beat_frequency", "scatter"),
    "distortion": ("distortion", "third_order", "separation"),
    "reference": (
        "input_rate",
        "scale_factor",
        "time_base",
        "table_rate",
        "tilt",
        "latitude",
        "earth_rate",
        "azimuth",
    ),
    "channel": ("bandwidth", "high_pass", "gain_corner", "response"),
}


@dataclass(frozen=True)
class UncertaintyCurve:
    """Relative standard uncertainties, each of shape (n,), for W/WL = `over_lock_in`."""

    over_lock_in: Floats
    total: Floats
    # what noise, distortion, the rate (K and time base, or table), and bandwidth and gain contribute
    noise: Floats
    distortion: Floats
    reference: Floats
    channel: Floats
    records: int  # for which this holds


def uncertainty_curve(request: PlanRequest, records: int, *, fastest: float = 100.0) -> UncertaintyCurve:
    """Predict the uncertainty at rates from close above lock-in to `fastest` times lock-in."""
    single = replace(request, rates_over_lock_in=())
    over = 1 + np.geomspace(0.06, fastest - 1, _POINTS)  # it is steep near lock-in
    budgets = [predicted_budget(single, float(ratio), records) for ratio in over]
    total, parts = np.array([budget.relative_u for budget in budgets]), dict[str, Floats]()
    for part, names in _GROUPS.items():
        lines = ([one.contribution for one in budget.inputs if one.name in names] for budget in budgets)
        parts[part] = np.array([math.hypot(*some) for some in lines]) / [one.lock_in_rate for one in budgets]
    return UncertaintyCurve(over_lock_in=over, total=total, records=records, **parts)
