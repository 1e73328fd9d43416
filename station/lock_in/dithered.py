"""`gyrolock measure --dither on`: the lock-in rate of a gyro whose body dithers, from the steps in its phase.

The oscilloscope takes one to three dither periods a record, at rest or at any steady rate. The mathematics is
`analysis.dithered`; settings are those of `gyrolock measure`, of which `[dither]` says what to take.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.arrays import NORMAL_95, NoFit
from analysis.budget import SCALE_FACTOR_LIMIT, TIME_BASE_LIMIT_PPM
from analysis.dithered import (
    LONGEST_STEP,
    DitheredEstimate,
    DitherFlag,
    combine_dithered,
    dithered_bound,
    estimate_dithered,
    lock_in_of_random_walk,
    walk_of_counts,
)
from instrument.scpi import DIVISIONS, POINTS, TIME_BASES
from station.errors import NoUsableSignal, UsageError
from station.lock_in.settings import RING_LASER, Settings, check_scale_factor
from station.measurements import Measurement
from station.report.figure import ACCENT, HALF, INK, SOFT, legend_above, svg_element
from station.results.numbers import LOCK_IN_RATE, LOCK_IN_RATE_NOISE_U, NOISE_RMS, SCALE_FACTOR
from station.results.quantity import Quantity, QuantityGroup, document, within
from station.results.result import (
    Excluded,
    FactTable,
    PlacedFigure,
    Result,
    Section,
    TextTable,
    with_prefix,
    with_uncertainty,
)
from station.ring_laser.bench import examine, open_for
from station.ring_laser.records import Bench, acquisition_records, saved_waveform, set_up, take_record
from station.runs.acquisition import Acquisition
from station.runs.store import SavedRun
from station.scope.autoset import KnobPositions, ScreenShape, fit_channel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from analysis.plan import PlanRequest
    from instrument import Waveform


# --------------------
# What a run says


@dataclass(frozen=True)
class DitheredEvaluation:
    """The records of a dithered gyro, and what they say together."""

    lock_in_rate: float  # deg/s
    lock_in_rate_u: float  # with scale factor and time base
    lock_in_rate_low_95: float
    lock_in_rate_high_95: float
    lock_in_rate_noise_u: float
    dither_rate: float  # deg/s, peak
    dither_frequency: float  # Hz
    random_walk: float  # deg/sqrt(h), that this lock-in rate gives the dithered counts, (2.13)
    by_random_walk: float  # deg/s, the lock-in rate by the random walk that was stated; nan: none was
    by_random_walk_u: float
    by_random_walk_low_95: float
    by_random_walk_high_95: float
    noise_rms: float
    scale_factor: float
    each: DitheredEstimate
    names: tuple[str, ...]
    first: Waveform
    left_out: tuple[Excluded, ...]
    flags: tuple[str, ...]


def evaluate(run: SavedRun, settings: Settings, choices: Mapping[str, Any]) -> DitheredEvaluation:
    """Evaluate the records of a dithered gyro."""
    taken = run.taken_for(PURPOSE)
    intact = [one for one in taken if one.intact]
    if not intact:
        raise NoUsableSignal(f"{run.path}: the run holds no record of a dithered gyro")
    waves = [saved_waveform(one, run.path) for one in intact]
    interval = waves[0].sample_interval
    if any((wave.sample_interval, len(wave)) != (interval, len(waves[0])) for wave in waves):
        raise NoUsableSignal(f"{run.path}: the records of a dithered gyro need one time base")
    factor = float(choices.get("scale_factor") or settings.gyro.scale_factor_pulses_per_deg)
    each = estimate_dithered(
        np.array([wave.volts for wave in waves]),
        interval,
        scale_factor=factor,
        dither_frequency=_frequency(settings),
        clipped=np.array([wave.clipped_samples for wave in waves]),
    )
    names = tuple(one.key for one in intact)
    damaged = [Excluded(one.key, _DAMAGED) for one in taken if not one.intact]
    spoilt = [
        Excluded(name, " and ".join(_WHY[flag] for flag in DitherFlag if flag & int(flags) and flag in _WHY))
        for name, flags in zip(names, each.flags, strict=True)
        if int(flags) & ~int(DitherFlag.NOT_SIGNIFICANT)
    ]
    try:
        made = combine_dithered(each)
    except NoFit:
        raise NoUsableSignal(f"no record of the dithered gyro can be used: {spoilt[0].reason}") from None
    value, noise_u = float(made.lock_in_rate[0]), float(made.lock_in_rate_u[0])
    share = common_share(settings)
    low, high = (float(end[0]) for end in (made.lock_in_rate_low_95, made.lock_in_rate_high_95))
    wider = NORMAL_95 * share * value
    seen = float(made.dither_rate[0])  # nan where no record holds a whole period
    rate = seen if math.isfinite(seen) else settings.dither.rate_dps
    per_walk = lock_in_of_random_walk(1 / 60, scale_factor=factor, dither_rate=rate)
    walk, amiss = _random_walk(settings, factor)
    found = DitheredEvaluation(
        lock_in_rate=value,
        lock_in_rate_u=math.hypot(noise_u, share * value),
        lock_in_rate_low_95=max(value - math.hypot(value - low, wider), 0.0),
        lock_in_rate_high_95=value + math.hypot(high - value, wider),
        lock_in_rate_noise_u=noise_u,
        dither_rate=rate,
        dither_frequency=float(made.dither_frequency[0]),
        random_walk=value / per_walk,
        **{name: per_walk * value for name, value in zip(_BY_WALK, walk, strict=True)},
        noise_rms=float(made.noise_rms[0]),
        scale_factor=factor,
        each=each,
        names=names,
        first=waves[0],
        left_out=(*damaged, *spoilt),
        flags=(),
    )
    flags = [str(flag.name).lower() for flag in DitherFlag if flag & int(made.flags[0])]
    if 2 * len(spoilt) > len(names):
        flags.append("few_usable")
    flags += [amiss] if amiss else []
    below = found.lock_in_rate - found.by_random_walk
    if below > NORMAL_95 * math.hypot(found.lock_in_rate_u, found.by_random_walk_u):
        flags.append("walk_too_small")
    if seen > _LARGER * settings.dither.rate_dps:
        flags.append("dither_larger")
    return replace(found, flags=tuple(flags))


_OF_COUNTS = "walk_not_seen", "counts_do_not_walk"
_BY_WALK = "by_random_walk", "by_random_walk_u", "by_random_walk_low_95", "by_random_walk_high_95"


def _random_walk(settings: Settings, factor: float) -> tuple[tuple[float, ...], str]:
    """Random walk of the counts by themselves or as stated, deg/sqrt(h): value, u, 95 %; what is amiss."""
    dither = settings.dither
    if dither.counts and not isinstance(dither.counts, str):
        try:
            found = walk_of_counts(dither.counts, dither.gate_s, scale_factor=factor)
        except NoFit:
            return (math.nan,) * 4, "walk_not_seen"
        if not found.walks:
            return (math.nan,) * 4, "counts_do_not_walk"
        value, u = 60 * found.random_walk, 60 * found.random_walk_u
        whole = math.hypot(u, common_share(settings) * value)
        wider = (found.random_walk_high_95 / found.random_walk) ** (whole / u)
        return (value, whole, value / wider, value * wider), ""
    value = dither.random_walk_deg_per_sqrt_h or math.nan
    u = dither.random_walk_u_deg_per_sqrt_h or _WALK_U * value
    return (value, u, max(value - NORMAL_95 * u, 0.0), value + NORMAL_95 * u), ""


def common_share(settings: Settings) -> float:
    """Standard uncertainty of scale factor and time base, which all records share, as a share of the result."""
    stated = settings.budget
    factor_u = 1e-6 * stated.scale_factor_u_ppm if stated is not None else 0.0
    clock = stated.time_base_limit_ppm if stated is not None else TIME_BASE_LIMIT_PPM
    return math.hypot(factor_u or SCALE_FACTOR_LIMIT / math.sqrt(3), 1e-6 * clock / math.sqrt(3))


_LARGER = 1.1  # than stated, by K: a dither is not known better
_WALK_U = 0.1  # of a random walk whose uncertainty is not stated
_DAMAGED = "its checksum is not that of the saved record"
_WHY = {
    DitherFlag.TOO_SHORT: "it holds less than half a dither period",
    DitherFlag.NOT_FOLLOWED: "its phase cannot be followed: no beat, or another dither than [dither] states",
    DitherFlag.ALIASED: "the fastest beats have fewer than two samples: take fewer dither.periods",
    DitherFlag.MISFIT: "the fit leaves more than noise: vibration, or a dither that is no sinusoid",
    DitherFlag.GAPS: "it is clipped",
}

QUANTITIES = (
    QuantityGroup(
        (
            replace(LOCK_IN_RATE, interval=True, limit=True, headline=True, trend=True),
            Quantity("lock_in_rate_u", "dps", limit=True),
            LOCK_IN_RATE_NOISE_U,
            Quantity("dither_rate", "dps", doc="peak"),
            Quantity("dither_frequency", "hz"),
            Quantity("random_walk", "deg_per_sqrt_h", doc="that this lock-in rate gives the dithered counts"),
            NOISE_RMS,
            SCALE_FACTOR,
        )
    ),
    QuantityGroup((Quantity("lock_in_rate", "dps", "by_random_walk", u=True, interval=True),), "by_random_walk"),
)


def result(found: DitheredEvaluation, run: SavedRun, settings: Settings) -> Result:
    """Put into numbers and sentences what was found."""
    value, low, high = found.lock_in_rate, found.lock_in_rate_low_95, found.lock_in_rate_high_95
    hourly = within(3600 * value, 3600 * low, 3600 * high, "deg/h")
    used = f"{len(found.names) - len(found.left_out)} of {len(found.names)} used"
    rows = [
        ("dither", f"{found.dither_rate:.4g} deg/s peak at {found.dither_frequency:.4g} Hz"),
        ("random walk", f"{found.random_walk:.3g} deg/√h by lock-in alone"),
    ]
    by_walk = with_uncertainty(found.by_random_walk, found.by_random_walk_u, "deg/s")
    if math.isfinite(found.by_random_walk):
        rows.append(("by random walk", f"{by_walk}, an upper bound: other noise walks too"))
    texts = {
        "misfit": "The records differ by more than their noise: the coupling may have moved. u is enlarged.",
        "not_significant": "The lock-in rate does not stand out of its uncertainty: take more records.",
        "few_usable": "More than half of the records cannot be used; the reason stands with each.",
        "dither_larger": f"By K the dither is {found.dither_rate:.4g} deg/s, more than stated: one is wrong.",
        "walk_not_seen": "The counts walk less than a hundredth of a count a gate: take longer gates.",
        "counts_do_not_walk": "The counts hold more than a random walk, such as the swing of the dither, and tell "
        "nothing: take gates of whole dither periods.",
        "walk_too_small": f"The random walk of the counts allows {by_walk}, less than the records show: one is "
        "wrong.",
    }
    rows += [("by random walk", texts[flag]) for flag in found.flags if flag in _OF_COUNTS]
    damaged = [one.sentence for one in found.left_out if one.reason == _DAMAGED]
    truth, beside = run.facts.truth, document(found, QUANTITIES[1].quantities)
    return Result(
        name="lock-in rate",
        value=f"{within(value, low, high, 'deg/s')} = {hourly} (95 %)",
        document={
            **document(found, QUANTITIES[0].quantities),
            "by_random_walk": beside if math.isfinite(found.by_random_walk) else None,
            "records": len(found.names),
            "left_out": found.left_out,
        },
        quantities=QUANTITIES,
        lines=(f"Scale factor and time base are included; records: {used}.",),
        summary=[*rows, ("records", used)],
        sentences=_SENTENCES,
        to_watch=(*(texts[flag] for flag in found.flags), *damaged),
        # what the counts cannot tell rules nothing
        doubts=(*(texts[flag] for flag in found.flags if flag not in _OF_COUNTS), *damaged),
        flags=found.flags,
        left_out=found.left_out,
        truth="" if truth is None else f"the truth is {truth[LOCK_IN_RATE.key()]:g} deg/s",
    )


_SENTENCES = (
    "Where the dither turns over, the rate passes zero and the coupling shifts the phase of the beat by a step of "
    "some hundredths of a radian; size and phase of these steps give the lock-in rate.",
    "The random walk is what this lock-in rate makes of the dithered counts, N = WL/sqrt(2 pi K W_D), where every "
    "turning point finds another phase; other noise adds to it.",
    "Not seen: a coupling that moves within the run by less than the scatter of the records shows.",
)


# --------------------
# The report


def sections(found: DitheredEvaluation, run: SavedRun, settings: Settings, made: Result) -> list[Section]:
    """Return the sections of the report."""
    each, shown = found.each, range(min(len(found.names), _RECORDS_SHOWN))
    rows = tuple(
        (
            found.names[row],
            _or_none(each.lock_in_rate[row], with_uncertainty(each.lock_in_rate[row], each.lock_in_rate_u[row])),
            _or_none(each.lock_in_rate[row], f"{np.degrees(np.angle(each.coupling[row])):+.0f}°"),
            _or_none(each.dither_rate[row], f"{each.dither_rate[row]:.4g}"),
            ", ".join(str(flag.name).lower() for flag in DitherFlag if flag & int(each.flags[row])),
        )
        for row in shown
    )
    header = ("record", "lock-in rate, deg/s", "coupling phase", "dither, deg/s", "flags")
    figures = (
        PlacedFigure(svg_element("dithered", HALF, lambda figure: _draw_record(found, figure)), _CAPTIONS[0]),
        PlacedFigure(svg_element("values", HALF, lambda figure: _draw_values(found, figure)), _CAPTIONS[1]),
    )
    return [
        Section("What this result shows, and what it cannot", sentences=made.sentences),
        Section("A record, and all of them", figures=figures),
        Section("Records", table=TextTable(header, rows)),
    ]


def _or_none(value: float, words: str) -> str:
    return words if math.isfinite(value) else "none"


_RECORDS_SHOWN = 100
_CAPTIONS = (
    "The first record. The beat is fast where the body swings fast, and stands still where the dither turns over: "
    "there lock-in acts.",
    "The lock-in rate of every record with its own u, and all of them together (95 %, all uncertainties).",
)


def _draw_record(found: DitheredEvaluation, figure: Figure) -> None:
    axes, wave = figure.add_subplot(), found.first
    milli = 1e3 * wave.sample_interval * np.arange(len(wave))
    axes.plot(milli, wave.volts, color=INK, linewidth=0.4)
    axes.set(xlabel="time, ms", ylabel="beat, V", xlim=(0, milli[-1]))


def _draw_values(found: DitheredEvaluation, figure: Figure) -> None:
    axes, each = figure.add_subplot(), found.each
    usable = (each.flags & ~int(DitherFlag.NOT_SIGNIFICANT)) == 0
    number, ends = np.arange(1, len(found.names) + 1), (found.lock_in_rate_low_95, found.lock_in_rate_high_95)
    axes.axhspan(*ends, color=ACCENT, alpha=0.16, label="all records, 95 %")
    axes.axhline(found.lock_in_rate, color=ACCENT, linewidth=1.1)
    for chosen, colour, label in ((usable, INK, "record, ±1 u of its noise"), (~usable, SOFT, "left out")):
        near = chosen & (each.lock_in_rate < 5 * found.lock_in_rate + 10 * found.lock_in_rate_u)
        if near.any():
            shown = number[near], each.lock_in_rate[near], each.lock_in_rate_u[near]
            axes.errorbar(*shown, fmt="o", ms=4, color=colour, label=label)
    axes.set(xlabel="record", ylabel="lock-in rate, deg/s", xlim=(0.5, number[-1] + 0.5))
    axes.set_ylim(bottom=0)
    axes.locator_params(axis="x", integer=True)
    legend_above(axes)


def facts(found: DitheredEvaluation, run: SavedRun, settings: Settings) -> list[FactTable]:
    """Return how the records were taken."""
    wave, identity = found.first, run.facts.get("identity", {})
    periods = len(wave) * wave.sample_interval * found.dither_frequency
    rows = [
        ("instrument", identity.get("text", "not known")),
        ("resource", settings.scope.resource or "simulated bench"),
        ("record", f"{with_prefix(len(wave) * wave.sample_interval, 's')}, {periods:.3g} dither periods"),
        ("dither as stated", f"{settings.dither.rate_dps:g} deg/s at {_frequency(settings):g} Hz"),
        ("scale factor K", f"{found.scale_factor:g} pulses/deg"),
    ]
    return [FactTable("Records", rows)]


# --------------------
# Taking it


PURPOSE = "dither"
_SPARE, _FILL_LEVELS = 1.08, 100.0  # of the dither's rate, for what it swings more than stated; of 127
_LEAST_PERIODS, _MOST_PERIODS = 0.6, 20.0
_MORE = 1.25  # than asked for, where the steps of the time base want it
_DRAWN = 8  # phases of beat, dither and coupling: another in every record


def take(settings: Settings, session: Acquisition) -> None:
    """Take the records and save them; of a run that was cut short, what is missing."""
    check_scale_factor(settings)
    dithered = settings.model_copy(update={"dither": settings.dither.model_copy(update={"on": True})})
    base = time_base(dithered)
    take_on(open_for(session, dithered), dithered, session, base)


def take_on(bench: Bench, settings: Settings, session: Acquisition, base: float) -> None:
    """Take them on a bench that is open already."""
    channel, scope = settings.scope.channel, bench.scope
    set_up(bench, settings.scope, [channel])
    simulation = settings.simulation
    truth = {} if simulation is None else {"truth": {LOCK_IN_RATE.key(): simulation.lock_in_rate_dps}}
    writer = session.begin({"identity": asdict(scope.identity), **truth})
    session.progress.note(f"{scope.identity.model} ({settings.scope.resource or 'simulated'}), run {writer.path}")
    there = {record.key for record in session.so_far().taken_for(PURPOSE)}
    missing = [f"record {n}" for n in range(1, settings.dither.records + 1) if f"record {n}" not in there]
    session.progress.start("records", len(missing))
    if not missing:
        return
    scope.set_timebase(base, position=0.0)
    # a trigger that comes by itself: a record may begin at any phase of the dither
    scope.set_trigger(source=channel, level=0.0, slope="RISE", mode="AUTO")
    begin = KnobPositions(base, float(settings.scope.probe), 0.0, 0.0, 0.0)
    vertical = fit_channel(scope, channel, settings.scope, ScreenShape(_FILL_LEVELS), begin)
    scope.set_trigger(source=channel, level=-vertical.position * vertical.scale, slope="RISE", mode="AUTO")
    for key in missing:
        waveforms, conditions = take_record(bench, (channel,))
        conditions.pop("truth", None)  # of a steady beat
        writer.save_records(acquisition_records(PURPOSE, key, waveforms, (channel,), conditions))
        session.progress.advance()


def time_base(settings: Settings) -> float:
    """Return the time base, s/div: about the dither periods asked for, if the fastest beat lets them.

    Raises
    ------
    UsageError
        The dither's frequency is not stated, or no time base shows half a period of it without aliases.
    """
    return time_bases(settings, _MORE * settings.dither.periods)[-1]


def time_bases(settings: Settings, most_periods: float = _MOST_PERIODS) -> list[float]:
    """Return the time bases that show up to so many dither periods without aliases; errors as `time_base`."""
    frequency, factor = _frequency(settings), settings.gyro.scale_factor_pulses_per_deg
    fastest = factor * _SPARE * settings.dither.rate_dps
    longest = min(most_periods / frequency, POINTS * LONGEST_STEP / fastest)
    fitting = [base for base in TIME_BASES if _LEAST_PERIODS / frequency <= base * DIVISIONS <= longest]
    if not fitting:
        raise UsageError(
            f"a beat of up to {fastest:.3g} Hz and a dither of {frequency:g} Hz: no time base shows "
            f"{_LEAST_PERIODS:g} dither periods with two samples a beat (dither.rate_dps, dither.periods)"
        )
    return fitting


def predicted_u(settings: Settings, base: float, request: PlanRequest) -> tuple[float, float]:
    """Dither periods in a record, and the u (deg/s) that noise leaves of it, rounding to codes included."""
    frequency, draws = _frequency(settings), np.random.default_rng(0).uniform(size=(_DRAWN, 3))
    levels = math.hypot(request.noise_levels, 12**-0.5) / _FILL_LEVELS
    each = [
        dithered_bound(
            request.lock_in_rate * np.exp(2j * np.pi * own),
            settings.dither.rate_dps * np.exp(2j * np.pi * turn),
            start=2 * np.pi * start,
            scale_factor=request.scale_factor,
            dither_frequency=frequency,
            sample_interval=base * DIVISIONS / POINTS,
            n_samples=POINTS,
            noise=math.hypot(request.noise_rms / request.amplitude, levels),
        )
        for own, turn, start in draws
    ]
    return base * DIVISIONS * frequency, math.sqrt(np.mean(np.square(each)))


def _frequency(settings: Settings) -> float:
    """Frequency of the dither in Hz, as it is stated or simulated."""
    if settings.dither.frequency_hz:
        return settings.dither.frequency_hz
    if settings.simulation is None:
        raise UsageError("dither.frequency_hz is not stated: the frequency of the dither, to 3 % ([dither])")
    return settings.simulation.dither.frequency_hz


MEASUREMENT = Measurement(
    name=PURPOSE,
    command="gyrolock measure --dither on",
    title="Lock-in rate of a dithered gyro",
    kind=RING_LASER,
    take=take,
    evaluate=lambda run, settings, choices, workers, progress: evaluate(run, settings, choices),
    choices=("scale_factor",),
    quantities=QUANTITIES,
    result=result,
    sections=sections,
    facts=facts,
    seconds=lambda settings: settings.dither.records * DIVISIONS * time_base(settings),
    examine=lambda settings: examine(settings, settings.table.fast_rate_dps),
)
