"""The dead band of a ring laser gyro: evaluation, result and report of a sweep."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis import (
    FATAL,
    DeadBand,
    FrequencyFit,
    beat_frequency,
    earth_rate_on_axis,
    estimate_lock_in,
    find_dead_band,
    fit_frequencies,
)
from analysis.dead_band import COUNTED_U, DeadBandFlag
from analysis.lock_in_run import rows_of_batches
from instrument import Waveform
from station.dead_band.take import DEAD_BAND, PURPOSE, DeadBandSettings, fastest_table_rate, seconds, take, watch
from station.errors import NoUsableSignal
from station.measurements import Measurement
from station.report.figure import ACCENT, INK, LINE, SECOND, SOFT, legend_above, svg_element
from station.results.numbers import BEAT_FREQUENCY, BIAS_RATE, DEAD_BAND_WIDTH, LOCK_IN_RATE, SCALE_FACTOR
from station.results.quantity import Quantity, QuantityGroup, document
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
from station.ring_laser.bench import examine
from station.ring_laser.records import saved_waveform
from station.runs.store import SavedRecord, SavedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# --------------------
# What the records of a sweep say: a beat or none at each rate, and from that the dead band


Array = NDArray[np.float64]

_SMOOTHED = 5  # samples; a slip of the phase lasts longer, noise does not
_TURNS_FROM = 0.5  # of the swing of a whole turn: a locked phase only trembles
_TURNS_TO_FIT = 2.0  # with fewer in a record, the uncertainty of a frequency tells too little


@dataclass(frozen=True)
class SweepRecords:
    """The records of a sweep in the order in which they were taken, one element for each."""

    direction: tuple[str, ...]  # ``"up"`` or ``"down"``
    table_rate: Array  # (n,): deg/s, signed: of the table, and on the axis without the vertical earth rate
    rate: Array
    duration: Array  # (n,): s
    # (n,): Hz, not negative: 0 of a gyro that is locked, nan where there is less than a beat that could be fitted
    beat: Array
    beat_u: Array
    swing: Array  # (n,): V, largest less smallest
    clock: Array  # (n,): s, from any beginning; the number of the record where nobody wrote down the time
    azimuth_known: bool  # whether the horizontal earth rate is in the rates

    @property
    def turns(self) -> Array:
        """Periods of the beat in each record; one where it turns, but cannot be fitted."""
        return np.where(np.isnan(self.beat), 1.0, np.maximum(self.beat * self.duration, 1.0 * (self.beat > 0)))

    @property
    def step(self) -> NDArray[np.int64]:
        """Number of the step that each record was taken at, from 0."""
        before = [(None, math.nan), *zip(self.direction, self.table_rate, strict=True)]
        changed = [now != then for now, then in zip(before[1:], before[:-1], strict=True)]
        return np.cumsum(changed, dtype=np.int64) - 1


@dataclass(frozen=True)
class DeadBandEvaluation:
    """What a sweep says."""

    records: SweepRecords
    band: DeadBand  # edges, lock-in rate and bias with what steps, hysteresis and noise leave open
    lock_in_rate_u: float  # deg/s, with everything that is known to spoil them
    bias_rate_u: float
    parts: dict[str, float]  # standard uncertainties that ``lock_in_rate_u`` is made of, deg/s, by name
    hyperbola: FrequencyFit | None  # beat frequency against rate; ``None`` where too few rates gave a beat
    earth_rate: float  # deg/s: the vertical earth rate on the axis
    scale_factor: float  # pulses per degree, as used
    left_out: tuple[Excluded, ...]


def evaluate(run: SavedRun, settings: DeadBandSettings, choices: Mapping[str, Any]) -> DeadBandEvaluation:
    """Evaluate the records of a sweep."""
    taken = run.taken_for(PURPOSE)
    damaged = [one.key for one in taken if not one.intact]
    intact = [one for one in taken if one.intact]
    if not intact:
        raise NoUsableSignal(f"{run.path}: the run holds no record of a sweep")
    scale_factor = float(choices.get("scale_factor", settings.gyro.scale_factor_pulses_per_deg))
    records = _read(intact, [saved_waveform(one, run.path) for one in intact], settings)
    band = _dead_band(records, scale_factor, settings.table.rate_u_dps)
    parts = _parts(records, band, settings, scale_factor)
    latitude, tilt = settings.site.latitude_deg, settings.table.tilt_deg
    others = [parts[name] for name in ("table", "earth_rate")]
    return DeadBandEvaluation(
        records=records,
        band=band,
        lock_in_rate_u=math.hypot(*parts.values()),
        bias_rate_u=math.hypot(band.bias_rate_u, *others),
        parts=parts,
        hyperbola=_hyperbola(records, band, settings.table.rate_u_dps),
        earth_rate=float(earth_rate_on_axis(latitude, tilt, 90.0)),
        scale_factor=scale_factor,
        left_out=tuple(Excluded(key, "its checksum is not that of the saved record") for key in damaged),
    )


def _read(taken: Sequence[SavedRecord], waveforms: Sequence[Waveform], settings: DeadBandSettings) -> SweepRecords:
    """Find the beat of every record."""
    intervals = np.array([wave.sample_interval for wave in waveforms])
    sizes = np.array([wave.codes.size for wave in waveforms], dtype=np.int64)
    swing = np.zeros(len(waveforms))  # of a smoothed record; samples without data are left out
    for place, wave in enumerate(waveforms):
        whole = wave.volts.size // _SMOOTHED * _SMOOTHED
        smooth = wave.volts[:whole].reshape(-1, _SMOOTHED).mean(axis=-1)
        smooth = smooth[np.isfinite(smooth)]
        swing[place] = np.ptp(smooth) if smooth.size else 0.0
    locked = swing < _TURNS_FROM * swing.max()
    beat, beat_u = np.where(locked, 0.0, math.nan), np.full(swing.shape, math.nan)
    turning = np.flatnonzero(~locked)
    for batch in rows_of_batches(intervals[turning], sizes[turning]):
        rows = turning[batch]
        volts = np.array([waveforms[row].volts for row in rows])
        fit = estimate_lock_in(volts, float(intervals[rows[0]]), scale_factor=1.0, nan_policy="omit")
        whole = (fit.beat_frequency * intervals[rows] * sizes[rows] >= 1) & ((fit.flags & int(FATAL)) == 0)
        beat[rows], beat_u[rows] = np.where(whole, (fit.beat_frequency, fit.beat_frequency_u), math.nan)
    table_rate = np.array([float(one.conditions["table_rate_dps"]) for one in taken])
    ends = [(one.conditions.get("azimuth_start_deg"), one.conditions.get("azimuth_end_deg")) for one in taken]
    known = [(math.nan, math.nan) if None in pair else pair for pair in ends]
    azimuth = np.asarray(np.mean(np.array(known, dtype=np.float64), axis=-1))
    clock = np.array([float(one.conditions.get("clock_s", math.nan)) for one in taken])
    if not (np.isfinite(clock).all() and np.all(np.diff(clock) >= 0)):
        clock = np.arange(len(taken), dtype=np.float64)  # that of a simulated sweep gone on with began again
    # with the horizontal earth rate where the azimuth is known
    tilt, latitude = settings.table.tilt_deg, settings.site.latitude_deg
    east = float(earth_rate_on_axis(latitude, tilt, 90.0))
    horizontal = earth_rate_on_axis(latitude, tilt, azimuth - settings.table.north_azimuth_deg) - east
    return SweepRecords(
        direction=tuple(str(one.conditions["direction"]) for one in taken),
        table_rate=table_rate,
        rate=table_rate * math.cos(math.radians(tilt)) + np.where(np.isnan(azimuth), 0.0, horizontal),
        duration=intervals * sizes,
        beat=beat,
        beat_u=beat_u,
        swing=swing,
        clock=clock,
        azimuth_known=bool(np.isfinite(azimuth).all()),
    )


def _dead_band(records: SweepRecords, scale_factor: float, rate_u: float) -> DeadBand:
    """Dead band from the turns at each step, as a counter would have shown them."""
    step = records.step
    count = np.bincount(step)
    dwell = float(np.max(records.duration) * count.max())
    # the time base differs from step to step: turns of the same time everywhere
    seconds = np.bincount(step, records.duration)
    turns = np.bincount(step, records.turns)
    pulses = np.maximum(turns / seconds * dwell, 1.0 * (turns > 0))
    # a frequency that was fitted is far finer than a count; one turn that was not is as coarse as one
    by_table = scale_factor * rate_u
    each_u = np.where(
        np.isfinite(records.beat_u), np.hypot(records.beat_u, by_table), COUNTED_U / records.duration
    )
    each_u = np.where(records.beat == 0, by_table, each_u)
    try:
        return find_dead_band(
            np.bincount(step, records.rate) / count,
            pulses,
            dwell,
            scale_factor=scale_factor,
            pulses_u=np.sqrt(np.bincount(step, each_u**2)) / count * dwell,
            times=np.bincount(step, records.clock) / count,
        )
    except ValueError:
        if not (turns > 0).all() and (turns > 0).any():
            raise NoUsableSignal(
                "the sweep was too short: no sense holds both rates with a beat and rates without"
            ) from None
        which, advice = ("a", "smaller") if (turns > 0).any() else ("no", "larger")
        raise NoUsableSignal(f"there is {which} beat at every rate of the sweep: take {advice} rates") from None


def drift_of(records: SweepRecords, band: DeadBand) -> Array:
    """How far the bias had drifted at each record since the middle of the sweep, deg/s; 0 where nobody knows."""
    span = float(np.ptp(records.clock))
    if not math.isfinite(band.drift) or span == 0:
        return np.zeros(records.rate.shape)
    return np.asarray(band.drift * ((records.clock - records.clock[0]) / span - 0.5))


def _parts(
    records: SweepRecords, band: DeadBand, settings: DeadBandSettings, scale_factor: float
) -> dict[str, float]:
    """Standard uncertainties of the lock-in rate, deg/s, by their cause."""
    tilt, latitude = settings.table.tilt_deg, settings.site.latitude_deg
    # a beat of less than a turn in the record is not seen: the true edge may lie so much below the one found
    slowest = 1 / (scale_factor * float(np.max(records.duration)))
    unseen = band.lock_in_rate - math.sqrt(max(band.lock_in_rate**2 - slowest**2, 0.0))
    swing = float(earth_rate_on_axis(latitude, tilt, 0.0) - earth_rate_on_axis(latitude, tilt, 90.0))
    senses = max(int(np.isfinite(band.edges).any(axis=1).sum()), 1)
    return {
        "steps_hysteresis_noise": band.lock_in_rate_u,
        "slow_beats": unseen / math.sqrt(3),
        "table": settings.table.rate_u_dps / math.sqrt(senses),
        "earth_rate": 0.0 if records.azimuth_known else abs(swing) / math.sqrt(2),
    }


def _hyperbola(records: SweepRecords, band: DeadBand, rate_u: float) -> FrequencyFit | None:
    """Fit f^2 = K^2 [(W - W0)^2 - WL^2] to the records with some periods, less the drift; K is fitted too."""
    used = records.beat * records.duration >= _TURNS_TO_FIT
    rate = (records.rate - drift_of(records, band))[used]
    try:
        return fit_frequencies(rate, records.beat[used], records.beat_u[used], input_rate_u=rate_u)
    except ValueError:  # NoFit, or a frequency without an uncertainty
        return None


# --------------------
# The dead band as numbers and sentences


_FAR = 3.0  # standard uncertainties

_OF_BAND: dict[str, Any] = {"of": "band.lock_in_rate", "u": "lock_in_rate_u", "limit": True, "trend": True}
BAND = (
    replace(DEAD_BAND_WIDTH, **_OF_BAND, scale=2.0, headline=True),
    replace(LOCK_IN_RATE, **_OF_BAND),
    Quantity("lock_in_rate_u", "dps", limit=True),
    replace(BIAS_RATE, of="band.bias_rate", u="bias_rate_u", limit=True, doc="middle of the band"),
    Quantity("earth_rate_on_axis", "dps", "earth_rate", doc="its vertical part"),
    Quantity(
        "hysteresis",
        "dps",
        "band.hysteresis",
        u=True,
        limit=True,
        doc="from where the beat begins to where it ends",
    ),
    Quantity("bias_drift", "dps", "band.drift", u=True, limit=True, doc="from the first rate to the last"),
    SCALE_FACTOR,
)
CORNER = (
    replace(LOCK_IN_RATE, of="corner_rate"),
    Quantity("random_walk", "deg_per_sqrt_s", u=True, doc="that rounds the corner"),
)
HYPERBOLA = (
    LOCK_IN_RATE,
    BIAS_RATE,
    replace(SCALE_FACTOR, u=True),
    Quantity("chi_square"),
    Quantity("degrees_of_freedom"),
)
EDGE = (Quantity("rate", "dps"), Quantity("half_gap", "dps", doc="half of the step in which the edge lies"))
QUANTITIES = (
    QuantityGroup(BAND),
    QuantityGroup(CORNER, "corner"),
    QuantityGroup(HYPERBOLA, "hyperbola"),
    QuantityGroup(EDGE, "edges", "sense"),
)


def result(found: DeadBandEvaluation, run: SavedRun, settings: DeadBandSettings) -> Result:
    """Put into numbers and sentences what was found."""
    band = found.band
    lock_in, truth = _with_u(band.lock_in_rate, found.lock_in_rate_u), ""
    if (known := run.facts.truth) is not None:
        size, bias = known[LOCK_IN_RATE.key()], known[BIAS_RATE.key()]
        truth = f"the truth is a lock-in rate of {size:g} deg/s and a bias of {bias:+.6g} deg/s"
    return Result(
        name="dead band",
        value=_with_u(2 * band.lock_in_rate, 2 * found.lock_in_rate_u),
        document=_document(found),
        quantities=QUANTITIES,
        lines=(f"Half of it is the lock-in rate, {lock_in}; from {_count(found)}.",),
        summary=_summary(found),
        sentences=tuple(_sentences(found)),
        to_watch=tuple(_to_watch(found)),
        flags=tuple(_flags(found)),
        left_out=found.left_out,
        truth=truth,
    )


def _with_u(value: float, u: float) -> str:
    return with_uncertainty(value, u, "deg/s")


def _count(found: DeadBandEvaluation) -> str:
    return f"{int(found.records.step[-1]) + 1} rates, {len(found.records.rate)} records"


def _document(found: DeadBandEvaluation) -> dict[str, Any]:
    band, corner = found.band, document(found.band, CORNER)
    if not band.flags & DeadBandFlag.ROUNDED:
        corner |= dict.fromkeys(CORNER[1].values(band))  # a random walk that rounds nothing is not known
    return {
        **document(found, BAND),
        "lock_in_rate_u_parts_dps": {
            name.replace(", ", "_").replace(" ", "_"): u for name, u in found.parts.items()
        },
        "edges": _edges(found),
        "corner": corner,
        "hyperbola": None if found.hyperbola is None else document(found.hyperbola, HYPERBOLA),
        "records": len(found.records.rate),
        "left_out": found.left_out,
    }


def _edges(found: DeadBandEvaluation) -> list[dict[str, Any]]:
    band = found.band
    return [
        {
            "sense": sense,
            "from": coming,
            EDGE[0].key(): sense * float(band.edges[k, m]),
            EDGE[1].key(): float(band.edge_half_widths[k, m]),
        }
        for k, sense in enumerate((1, -1))
        for m, coming in enumerate(("inside", "outside"))
        if math.isfinite(band.edges[k, m])
    ]


def record_rows(found: DeadBandEvaluation) -> list[dict[str, Any]]:
    """Return one JSON object for each record."""
    records = found.records
    return [
        {
            "record": number + 1,
            "direction": records.direction[number],
            "table_rate_dps": records.table_rate[number],
            "rate_dps": records.rate[number],
            BEAT_FREQUENCY.key(): signed_beat(found)[number],
            BEAT_FREQUENCY.key("u"): records.beat_u[number],
            "locked": bool(records.beat[number] == 0),
            "swing_v": records.swing[number],
        }
        for number in range(len(records.rate))
    ]


def signed_beat(found: DeadBandEvaluation) -> Any:
    """Beat frequency in Hz with the sense of the rate on the axis, bias included, shape (n,)."""
    bias = found.band.bias_rate
    seen = found.records.rate - (bias if math.isfinite(bias) else 0.0)
    return np.sign(seen) * found.records.beat


def _summary(found: DeadBandEvaluation) -> list[tuple[str, str]]:
    band, fit = found.band, found.hyperbola
    rows = [
        ("lock-in rate", with_uncertainty(band.lock_in_rate, found.lock_in_rate_u, "deg/s")),
        ("bias rate", with_uncertainty(band.bias_rate, found.bias_rate_u, "deg/s")),
        ("earth rate", f"{found.earth_rate:.6f} deg/s on the axis, vertical part"),
        ("hysteresis", _with_u(band.hysteresis, band.hysteresis_u)),
        ("drift of the bias", f"{_with_u(band.drift, band.drift_u)} from the first rate to the last"),
    ]
    if fit is not None and math.isfinite(fit.lock_in_rate):
        rows.append(("by the hyperbola", _with_u(fit.lock_in_rate, fit.lock_in_rate_u)))
    rows.append(("records", _count(found)))
    return rows


def _sentences(found: DeadBandEvaluation) -> Iterator[str]:
    """Say what the band means, and what this test does not see."""
    band, fit = found.band, found.hyperbola
    half = float(np.nanmax(band.edge_half_widths))
    yield (
        f"The beat ends and begins {_with_u(band.lock_in_rate, found.lock_in_rate_u)} from the middle of the band "
        f"(k = 1); the steps of the table leave an edge open by ± {half:.2g} deg/s."
    )
    if math.isfinite(band.bias_rate):
        rest = _with_u(band.bias_rate + found.earth_rate, found.bias_rate_u)
        yield (
            f"The middle lies at {_with_u(band.bias_rate, found.bias_rate_u)}. The earth turns the axis by "
            f"{found.earth_rate:+.5f} deg/s, which moves the middle the other way; the rest, {rest}, is the own "
            "bias of the gyro and what is not known of the table."
        )
    if fit is not None and math.isfinite(fit.lock_in_rate):
        yield (
            "The same records, as beat frequency against rate, lie on a hyperbola with lock-in rate "
            f"{_with_u(fit.lock_in_rate, fit.lock_in_rate_u)} and bias {_with_u(fit.bias_rate, fit.bias_rate_u)}. "
            "It uses the beats beyond the band and is finer than the steps, but leans on the lock-in equation; "
            "the edges do not."
        )
    yield (
        "The edges need neither waveform nor scale factor: distortion of the detector, which the harmonic method "
        "of `gyrolock measure` must know, does not move them. That method is finer and works far beyond lock-in, "
        "where the rate need not be held so well; it tells nothing of hysteresis."
    )
    yield (
        "Not seen: what happens between two steps, a beat of less than one period in a record, and a bias that "
        "drifts otherwise than evenly; an even drift is found from the beats beyond the band and taken out."
    )


def _flags(found: DeadBandEvaluation) -> list[str]:
    band, apart = found.band, _apart(found)
    flags = [str(flag.name).lower() for flag in DeadBandFlag if flag & band.flags]
    if found.hyperbola is None:
        flags.append("no_hyperbola")
    return [*flags, "hyperbola_disagrees"] if abs(apart) > _FAR else flags


def _apart(found: DeadBandEvaluation) -> float:
    """Distance of the hyperbola's lock-in rate from the edges', in standard uncertainties; 0 if it has none."""
    fit = found.hyperbola
    if fit is None or not math.isfinite(fit.lock_in_rate):
        return 0.0
    return (fit.lock_in_rate - found.band.lock_in_rate) / math.hypot(fit.lock_in_rate_u, found.lock_in_rate_u)


def _to_watch(found: DeadBandEvaluation) -> Iterator[str]:
    band = found.band
    for one in found.left_out:
        yield f"{one.sentence}."
    texts = {
        DeadBandFlag.ONE_SENSE: "An edge was found in one sense only: bias and earth rate are in this number.",
        DeadBandFlag.HYSTERESIS: f"The beat ends {band.hysteresis:.2g} deg/s below the rate at which it begins; "
        "that is part of the uncertainty, and no single lock-in rate fits both ways.",
        DeadBandFlag.ROUNDED: "Noise lets the gyro slip inside the band: the whole corner fits a lock-in rate of "
        f"{band.corner_rate:.5g} ± {band.corner_rate_u:.2g} deg/s with a random walk of "
        f"{60 * band.random_walk:.2g} deg/sqrt(h).",
        DeadBandFlag.NO_SILENT_RATE: "On some branch no rate was silent: take smaller steps about zero.",
        DeadBandFlag.NO_PULSES: "On some branch no rate gave a beat: sweep further.",
        DeadBandFlag.DRIFT: f"The bias drifted by {_with_u(band.drift, band.drift_u)} during the sweep; edges and "
        "hyperbola are taken to the middle of the sweep. A drift that was not even is only partly taken out.",
        DeadBandFlag.PULSES_INSIDE: "Silent rates lie beyond the first one with a beat: noise, or a table that "
        "does not hold its rate.",
    }
    yield from (text for bit, text in texts.items() if band.flags & bit)
    if found.parts["slow_beats"] > found.parts["steps_hysteresis_noise"]:
        yield (
            "The records are too short for this band: beats too slow to be seen matter more than the steps of the "
            "table. Take more periods in a record, if its time base allows."
        )
    if found.parts["earth_rate"] > 0.01 * band.lock_in_rate:
        yield (
            "The axis is tilted and the azimuth is not known: the horizontal earth rate may move the edges by "
            f"{found.parts['earth_rate']:.2g} deg/s."
        )
    if found.hyperbola is None:
        yield "Too few rates gave a beat of some periods for a hyperbola: sweep further."
    elif abs(apart := _apart(found)) > _FAR:
        yield (
            f"The hyperbola's lock-in rate lies {apart:+.1f} standard uncertainties from that of the edges: noise "
            "moves the edges, or the beat does not follow the lock-in equation."
        )


# --------------------
# The dead band in the report: figure and table of the sweep, and the facts at its end


_SIZE = (10.0, 4.2)
_CURVE_POINTS = 801
_CAPTION = (
    "Beat frequency against the rate on the axis, with the sense of rotation. Without lock-in the beats would lie "
    "on the broken line; the closer to the band, the slower they are. In the shaded band there is none."
)


def sections(
    found: DeadBandEvaluation, run: SavedRun, settings: DeadBandSettings, result: Result
) -> list[Section]:
    """Return the sections of the report."""
    rows = []
    for name, value, half in zip(
        ("positive, beat begins", "positive, beat ends", "negative, beat begins", "negative, beat ends"),
        (*found.band.edges[0], *-found.band.edges[1]),
        found.band.edge_half_widths.ravel(),
        strict=True,
    ):
        if math.isfinite(value):
            rows.append((name, f"{value:+.6f}", f"± {half:.2g}"))
    return [
        Section("What this result shows, and what it cannot", sentences=result.sentences),
        Section("Beat against rate", figures=(PlacedFigure(sweep_svg(found), _CAPTION),)),
        Section("Edges", table=TextTable(("edge", "rate, deg/s", "half of the step, deg/s"), tuple(rows))),
        Section("Rates", table=_rates_table(found)),
    ]


def facts(found: DeadBandEvaluation, run: SavedRun, settings: DeadBandSettings) -> list[FactTable]:
    """Return how the sweep was taken and evaluated."""
    table, identity = settings.table, run.facts.get("identity", {})
    bases = sorted(set(found.records.duration.tolist()))
    sweep = [
        (
            "rates on the axis",
            f"{found.records.rate.min():+.5g} to {found.records.rate.max():+.5g} deg/s and back",
        ),
        ("records", str(len(found.records.rate))),
        ("tilt of the axis", f"{table.tilt_deg:g}°"),
        ("latitude", f"{settings.site.latitude_deg:g}°"),
        ("scale factor K", f"{found.scale_factor:g} pulses/deg, for time bases and slow beats"),
    ]
    scope = [
        ("instrument", identity.get("text", "not known")),
        ("resource", settings.scope.resource or "simulated bench"),
        (
            "length of a record",
            " to ".join(with_prefix(base, "s") for base in dict.fromkeys((bases[0], bases[-1]))),
        ),
    ]
    causes = [(name.replace("_", " "), f"{u:.2g} deg/s") for name, u in found.parts.items() if u > 0]
    return [
        FactTable("Sweep", sweep),
        FactTable("Standard uncertainty of the lock-in rate", causes),
        FactTable("Oscilloscope", scope),
    ]


def sweep_svg(found: DeadBandEvaluation) -> str:
    """Draw the beat against the rate, up and down, with the hyperbola and the dead band."""
    return svg_element("sweep", _SIZE, lambda figure: draw_sweep(found, figure))


def draw_sweep(found: DeadBandEvaluation, figure: Figure) -> None:
    """Draw on a figure what :func:`sweep_svg` shows."""
    axes, records, band, fit = figure.add_subplot(), found.records, found.band, found.hyperbola
    middle = band.bias_rate if math.isfinite(band.bias_rate) else 0.0
    edges = middle - band.lock_in_rate, middle + band.lock_in_rate
    axes.axvspan(*edges, color=LINE, label="dead band")
    beat, up = signed_beat(found), np.array([direction == "up" for direction in records.direction])
    if fit is not None and math.isfinite(fit.lock_in_rate):
        rate = np.linspace(records.rate.min(), records.rate.max(), _CURVE_POINTS) - fit.bias_rate
        curve = np.sign(rate) * beat_frequency(fit.scale_factor, rate, fit.lock_in_rate)
        axes.plot(
            rate + fit.bias_rate, fit.scale_factor * rate, "--", color=SOFT, linewidth=0.8, label="no lock-in"
        )
        axes.plot(rate + fit.bias_rate, curve, color=INK, linewidth=1.0, label="fitted hyperbola")
    for chosen, marker, color, label in ((up, "^", ACCENT, "up"), (~up, "v", SECOND, "down")):
        axes.plot(
            records.rate[chosen], beat[chosen], marker, color=color, mfc="none", ms=5, linestyle="", label=label
        )
    axes.set(xlabel="rate on the axis, without the vertical earth rate, deg/s", ylabel="beat frequency, Hz")
    legend_above(axes, columns=5)


def _rates_table(found: DeadBandEvaluation) -> TextTable:
    records, beat = found.records, signed_beat(found)
    rows = tuple(
        (
            records.direction[row],
            f"{records.rate[row]:+.6f}",
            f"{records.table_rate[row]:+.6f}",
            _beat_text(float(beat[row]), float(records.beat_u[row])),
            with_prefix(float(records.duration[row]), "s"),
            with_prefix(float(records.swing[row]), "V"),
        )
        for row in range(len(records.rate))
    )
    return TextTable(("direction", "axis, deg/s", "table, deg/s", "beat, Hz", "record", "swing"), rows)


def _beat_text(beat: float, beat_u: float) -> str:
    if beat == 0:
        return "locked"
    return with_uncertainty(beat, beat_u) if math.isfinite(beat) else "less than two periods"


MEASUREMENT = Measurement(
    name=PURPOSE,
    command="gyrolock deadband",
    title="Dead band",
    kind=DEAD_BAND,
    take=take,
    evaluate=lambda run, settings, choices, workers, progress: evaluate(run, settings, choices),
    choices=("scale_factor",),
    result=result,
    sections=sections,
    facts=facts,
    rows=record_rows,
    quantities=QUANTITIES,
    watch=watch,
    seconds=seconds,
    examine=lambda settings: examine(settings, fastest_table_rate(settings)),
)
