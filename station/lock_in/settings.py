"""Settings of the ring laser, and what they state of its bench for the evaluation.

Sections that came later have defaults here as well: a run that was saved without them can still be read.
"""

import csv
import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Discriminator, Field, Tag

from analysis.budget import FRONT_END_LIMIT, LATITUDE_LIMIT_DEG, PROBE_LIMIT, BenchKnowledge, ResponseCorner
from analysis.channel import ChannelResponse
from analysis.dithered import FEWEST_GATES
from analysis.lock_in_run import Method, RunKnowledge
from analysis.single_beams import BeamsKnowledge
from station.controllers import ControllersSettings, with_controllers
from station.errors import SettingsError, UsageError
from station.measurements import limits_of
from station.ring_laser.settings import (
    BeamsSettings,
    DitherSettings,
    RingLaserSettings,
    ScopeSettings,
    SimulationSettings,
)
from station.settings import (
    Finite,
    Limits,
    NotNegative,
    OutputSettings,
    Positive,
    SettingsKind,
    SettingsSection,
    SiteSettings,
    Values,
    load,
    merged,
    read_text,
    read_toml,
    shipped_settings,
)

ResponseRow = tuple[float, float, float]
T = TypeVar("T")

Ratio = Annotated[float, Field(gt=1.05, le=1000)]


# left to the program, or given: told apart beforehand, so that a mistake is told once
Auto = Annotated[Literal["auto"], Tag("auto")]
_ByKind = Discriminator(lambda value: "auto" if isinstance(value, str) else "value")
Records = Annotated[Annotated[int, Field(ge=1, le=1_000_000), Tag("value")] | Auto, _ByKind]
Rates = Annotated[Annotated[tuple[Ratio, ...], Tag("value")] | Auto, _ByKind]
Senses = Annotated[Annotated[bool, Tag("value")] | Auto, _ByKind]


class TestedGyroSettings(RingLaserSettings):
    """The gyro whose lock-in rate is wanted; its scale factor is 0 as long as nobody has given it."""

    scale_factor_pulses_per_deg: NotNegative = 0.0


class TableSettings(SettingsSection):
    """The rate table and what it is asked to do."""

    kind: Literal["simulated", "manual", "controller", "none"]
    fast_rate_dps: Positive
    highest_rate_dps: Positive = 1000.0
    both_senses: bool
    slow_rate_over_lock_in: Ratio
    settle_s: NotNegative
    north_azimuth_deg: Finite
    known_tilt_deg: Annotated[float, Field(ge=0, lt=90)] | None = None
    known_tilt_u_deg: NotNegative = 0.01


class FrontEndSettings(SettingsSection):
    """What is known of the channel between photodiode and converter; 0 and empty: nothing to correct."""

    low_pass_hz: NotNegative = 0.0
    ac_corner_hz: NotNegative = 0.0
    response_file: str = ""
    response: tuple[tuple[Positive, Positive, Finite], ...] = ()


class MeasurementSettings(SettingsSection):
    """How many records of which shape, at which rates."""

    records: Records
    rates_over_lock_in: Rates = ()
    both_senses: Senses = False
    tilt_records: Annotated[int, Field(ge=1, le=1000)]
    periods_min: Annotated[float, Field(ge=3, le=500)]
    samples_per_period_min: Annotated[float, Field(ge=5, le=500)]
    fill_levels: Annotated[float, Field(ge=10, le=120)]


class BudgetSettings(SettingsSection):
    """What is known of the bench, for the uncertainty budget; 0 where a comment of the file says "not known"."""

    scale_factor_u_ppm: NotNegative
    time_base_limit_ppm: NotNegative
    distortion_limit_dbc: Annotated[float, Field(le=0, ge=-200)]
    third_order_limit_dbc: Annotated[float, Field(le=0, ge=-200)] = 0.0
    phase_change_limit_rad: Annotated[float, Field(ge=0, le=10)] = 0.0
    lock_in_drift_limit_percent: Annotated[float, Field(ge=0, le=50)] = 0.0
    thermal_tail_limit_percent: Annotated[float, Field(ge=0, le=10)] = 0.0
    bandwidth_hz: NotNegative
    front_end_u_percent: NotNegative = 5.0
    gain_corner_hz: NotNegative
    table_rate_u_ppm: NotNegative
    latitude_u_deg: NotNegative


class Settings(SettingsSection):
    """All settings of a run. ``simulation`` is absent on a real bench."""

    gyro: TestedGyroSettings
    site: SiteSettings
    table: TableSettings
    scope: ScopeSettings
    front_end: FrontEndSettings = FrontEndSettings()
    measurement: MeasurementSettings
    output: OutputSettings
    budget: BudgetSettings | None = None  # runs of earlier versions were saved without it
    beams: BeamsSettings = BeamsSettings()
    dither: DitherSettings = DitherSettings()
    controllers: ControllersSettings | None = None
    simulation: SimulationSettings | None = None
    limits: Limits = Limits()

    @property
    def simulated(self) -> bool:
        """Whether the bench is simulated: no oscilloscope is named."""
        return not self.scope.resource

    @property
    def turning_dps(self) -> float:
        """Rate at which a simulated table turns from the beginning: the slow rate, if it cannot be set."""
        if self.table.kind != "none" or self.simulation is None:
            return 0.0
        wanted = self.gyro.expected_lock_in_rate_dps * self.slow_over_lock_in
        return wanted / math.cos(math.radians(self.simulation.tilt_deg))

    @property
    def rates_are_chosen(self) -> bool:
        """Whether the program chooses the rates: it is left to it, and there is a table that can be set."""
        return self.measurement.rates_over_lock_in == "auto" and self.table.kind != "none"

    @property
    def named_rates(self) -> tuple[float, ...]:
        """Rates that the user has named, in expected lock-in rates; empty if there are none."""
        rates = self.measurement.rates_over_lock_in
        return () if rates == "auto" else tuple(sorted(set(rates)))

    @property
    def slow_over_lock_in(self) -> float:
        """The slow rate in expected lock-in rates, where there is but one."""
        return self.named_rates[0] if self.named_rates else self.table.slow_rate_over_lock_in


def load_settings(
    path: Path | None = None, *, resource: str | None = None, overrides: Values | None = None
) -> Settings:
    """Read the settings of a run."""
    named = {"scope": {"resource": resource}} if resource else {}
    return load(RING_LASER, path, merged(overrides or {}, named))


@cache
def default_settings(name: Literal["simulated", "bench"] = "simulated") -> Settings:
    """Return the settings of a shipped file as they stand."""
    return RING_LASER.model.model_validate(read_toml(shipped_settings(name)))


_NO_SCALE_FACTOR = (
    "the scale factor of the gyro is not given, and the lock-in rate goes 1 : 1 with it: give --scale-factor K in "
    "pulses per degree, or scale_factor_pulses_per_deg in [gyro] of the settings"
)


def ask_scale_factor() -> float:
    """Ask the operator for the scale factor; UsageError if there is no terminal."""
    # only here somebody is asked
    from station.terminal import ask_number

    return ask_number("Scale factor of the gyro in pulses per degree: ", _NO_SCALE_FACTOR)


def check_scale_factor(settings: Settings) -> None:
    """See that the scale factor is known: every lock-in rate goes 1 : 1 with it; UsageError if nobody gave it."""
    if not settings.gyro.scale_factor_pulses_per_deg:
        raise UsageError(_NO_SCALE_FACTOR)


def _resource(values: Any) -> Any:
    scope = values.get("scope")
    return scope.get("resource") if isinstance(scope, dict) else None


def _adapt(values: dict[str, Any]) -> None:
    """Let a file that was made for the simulated bench be used with a real scope: its truth then means nothing."""
    if _resource(values):
        values.pop("simulation", None)
        table = values.get("table")
        if isinstance(table, dict) and table.get("kind") == "simulated":
            table["kind"] = "none"


def _check(settings: Settings, path: Path) -> Settings:
    """Check what no single value shows, and read the channel's response, so that a run carries it along."""
    if settings.simulated and settings.simulation is None:
        raise SettingsError(f"{path}: scope.resource is empty and there is no [simulation]: name the oscilloscope")
    if settings.simulated and settings.table.kind == "manual":
        raise SettingsError(
            f"{path}: table.kind: an operator cannot turn a simulated table: name the oscilloscope (--resource)"
        )
    if len(settings.named_rates) > 1 and settings.table.kind == "none":
        raise SettingsError(
            f"{path}: measurement.rates_over_lock_in: several rates need a table that can be set; "
            'table.kind = "none" has none'
        )
    if settings.scope.quadrature_channel == settings.scope.channel:
        raise SettingsError(f"{path}: scope.quadrature_channel: is the same as scope.channel")
    taken = [settings.scope.channel, *filter(None, (settings.scope.quadrature_channel, *settings.beams.channels))]
    if len(set(taken)) < len(taken):
        raise SettingsError(f"{path}: beams.channels: a channel stands there twice, or is that of the beat")
    if settings.beams.channels and len(settings.beams.level_v) not in (0, len(settings.beams.channels)):
        raise SettingsError(f"{path}: beams.level_v: needs one level for each of beams.channels, or none")
    if settings.beams.channels and settings.scope.quadrature_channel:
        raise SettingsError(f"{path}: beams.channels: either single beams or a cosine channel, not both")
    return _with_counts(path, _with_response(path, with_controllers(settings, settings.table.kind, path)))


def _with_response(path: Path, settings: Settings) -> Settings:
    front_end = settings.front_end
    if not front_end.response_file:
        if front_end.response:
            check_response(front_end.response, f"{path}: front_end.response")
        return settings
    if front_end.response:
        raise SettingsError(f"{path}: front_end: give either response or response_file, not both")
    # a relative name is meant from where the settings stand
    table = path.parent / front_end.response_file
    rows = tuple(_rows(table, _response_row, "three numbers (frequency_hz, gain, phase_deg)"))
    check_response(rows, str(table))
    return settings.model_copy(update={"front_end": front_end.model_copy(update={"response": rows})})


def _with_counts(path: Path, settings: Settings) -> Settings:
    named = settings.dither.counts
    if not named:
        return settings
    file = path.parent / named if isinstance(named, str) else path
    whole = tuple(_rows(file, int, "a whole number of counts")) if isinstance(named, str) else named
    if len(whole) < FEWEST_GATES:
        raise SettingsError(
            f"{file}: {len(whole)} gates of counts show no random walk: it takes {FEWEST_GATES} at least"
        )
    return settings.model_copy(update={"dither": settings.dither.model_copy(update={"counts": whole})})


def _rows(path: Path, read: Callable[[str], T], what: str) -> Iterator[T]:
    """Lines that are no remarks, as `read` reads them; the first one may be a heading."""
    numbered = enumerate(read_text(path).splitlines(), start=1)
    for place, (number, line) in enumerate((n, s) for n, s in numbered if s.strip() and s.lstrip()[0] != "#"):
        try:
            yield read(line)
        except ValueError:
            if place:
                raise SettingsError(f"{path}: line {number}: not {what}: {line!r}") from None


def check_response(rows: list[ResponseRow] | tuple[ResponseRow, ...], where: str) -> None:
    """See that a table can be interpolated."""
    if len(rows) < 2:
        raise SettingsError(f"{where}: a response needs at least two frequencies")
    if any(after[0] <= before[0] for before, after in itertools.pairwise(rows)):
        raise SettingsError(f"{where}: the frequencies must rise from line to line")
    if any(row[0] <= 0 or row[1] <= 0 for row in rows):
        raise SettingsError(f"{where}: frequencies and gains must be positive")


def _response_row(line: str) -> ResponseRow:
    frequency, gain, phase = (float(field) for field in next(csv.reader([line], skipinitialspace=True)))
    if not all(map(math.isfinite, (frequency, gain, phase))):
        raise ValueError
    return frequency, gain, phase


RING_LASER = SettingsKind(
    sections=Settings,
    limits=lambda: limits_of("measure", "dither"),
    shipped=lambda given: "bench" if _resource(given) else "simulated",
    adapt=_adapt,
    check=_check,
    knowledge=(
        *("front_end", "budget.*", "limits.*", "beams.*", "table.known_tilt_deg", "table.known_tilt_u_deg"),
        *("dither.frequency_hz", "dither.random_walk_deg_per_sqrt_h", "dither.random_walk_u_deg_per_sqrt_h"),
        *("dither.counts", "dither.gate_s"),
    ),
)


# --------------------
# What the settings say of a bench, in the terms of the analysis


_RECTANGLE = math.sqrt(3.0)

_AC_CORNER_HZ = 10.0
"""Lower -3 dB corner of the AC coupling of a TDS2014 with a direct cable; a 10X probe makes it a tenth."""


def run_knowledge(settings: Settings) -> RunKnowledge:
    """Collect what the settings say of gyro, table and channel of a run."""
    stated = settings.budget
    return RunKnowledge(
        scale_factor=settings.gyro.scale_factor_pulses_per_deg,
        latitude_deg=settings.site.latitude_deg,
        north_azimuth_deg=settings.table.north_azimuth_deg,
        both_senses=settings.table.both_senses,
        response=channel_response(settings.front_end),
        bench=bench_knowledge(settings),
        latitude_u_deg=(stated.latitude_u_deg if stated is not None else 0.0) or LATITUDE_LIMIT_DEG / _RECTANGLE,
        table_rate_u_ppm=stated.table_rate_u_ppm if stated is not None else 0.0,
        known_tilt_deg=math.nan if settings.table.known_tilt_deg is None else settings.table.known_tilt_deg,
        known_tilt_u_deg=settings.table.known_tilt_u_deg,
        beams=beams_knowledge(settings),
    )


def beams_corner_hz(settings: Settings) -> float:
    """Corner of the AC coupling of the beams' channels, Hz; 0: there is none."""
    return _AC_CORNER_HZ / settings.scope.probe if settings.beams.coupling == "AC" else 0.0


def beams_knowledge(settings: Settings) -> BeamsKnowledge:
    """Collect what the settings say of the beams' channels, and of the dead band."""
    stated = settings.beams
    return BeamsKnowledge(
        level_u=0.01 * stated.level_u_percent or math.nan,
        crosstalk_limit=_amplitude(stated.crosstalk_limit_db),
        ac_corner_hz=beams_corner_hz(settings),
        imbalance_limit=0.005 * stated.unequal_limit_percent or math.nan,
        bandwidth_hz=stated.bandwidth_hz or math.nan,
        dead_band=stated.dead_band_dps or math.nan,
        dead_band_u=stated.dead_band_u_dps or _DEAD_BAND_U * stated.dead_band_dps,
    )


_DEAD_BAND_U = 0.1  # of a lock-in rate by the dead band whose uncertainty is not stated


def bench_knowledge(settings: Settings) -> BenchKnowledge:
    """Collect what an uncertainty budget counts besides the records; nan for whatever nobody stated."""
    scope, stated, front_end = settings.scope, settings.budget, settings.front_end
    share = 0.01 * (stated.front_end_u_percent if stated is not None else 0.0) or FRONT_END_LIMIT / _RECTANGLE
    coupling = ResponseCorner(_AC_CORNER_HZ / scope.probe if scope.coupling == "AC" else 0.0)
    if front_end.ac_corner_hz:
        coupling = ResponseCorner(front_end.ac_corner_hz, share * front_end.ac_corner_hz, corrected=True)
    bandwidth = ResponseCorner((stated.bandwidth_hz if stated is not None else 0.0) or math.nan)
    if front_end.low_pass_hz:
        bandwidth = ResponseCorner(front_end.low_pass_hz, share * front_end.low_pass_hz, corrected=True)
    measured = share if front_end.response or front_end.response_file else math.nan
    if math.isfinite(measured):
        # a measured response holds every corner of the channel
        bandwidth, coupling = ResponseCorner(math.inf), ResponseCorner(0.0)
    if stated is None:
        return BenchKnowledge(high_pass=coupling, bandwidth=bandwidth, response_u=measured)
    return BenchKnowledge(
        scale_factor_u_ppm=stated.scale_factor_u_ppm or math.nan,
        time_base_limit_ppm=stated.time_base_limit_ppm,
        distortion_limit=_amplitude(stated.distortion_limit_dbc),
        third_order_limit=_amplitude(stated.third_order_limit_dbc),
        phase_change_limit=stated.phase_change_limit_rad or math.nan,
        lock_in_drift_limit=0.01 * stated.lock_in_drift_limit_percent or math.nan,
        bandwidth=bandwidth,
        high_pass=coupling,
        gain=ResponseCorner(stated.gain_corner_hz or math.nan),
        probe_limit=PROBE_LIMIT if scope.probe > 1 and math.isnan(measured) else 0.0,
        response_u=measured,
        tail_limit=0.01 * stated.thermal_tail_limit_percent,
    )


_NOTHING_KNOWN = BudgetSettings(
    scale_factor_u_ppm=0.0,
    time_base_limit_ppm=BenchKnowledge().time_base_limit_ppm,
    distortion_limit_dbc=0.0,
    bandwidth_hz=0.0,
    front_end_u_percent=0.0,
    gain_corner_hz=0.0,
    table_rate_u_ppm=0.0,
    latitude_u_deg=0.0,
)


def stated_of_files(config: Path | None) -> Settings | None:
    """Settings in which nothing of the bench is known but what a file states; ``None`` without one."""
    # What the shipped settings say of their simulated bench is not true of the one that the records come from.
    if config is None:
        return None
    nothing = default_settings().model_copy(update={"budget": _NOTHING_KNOWN})
    if "coupling" in read_toml(config).get("scope", {}):
        nothing = nothing.model_copy(update={"scope": load_settings(config).scope})
    return RING_LASER.with_knowledge(nothing, config)


def knowledge_of_files(wfids: Iterable[str], method: Method, config: Path | None = None) -> RunKnowledge:
    """Collect what is known of the bench that files come from."""
    coupled = all("DC coupling" in wfid for wfid in wfids)
    bench = BenchKnowledge(high_pass=ResponseCorner(0.0 if coupled else math.nan))
    known = RunKnowledge(method.scale_factor, latitude_deg=math.nan, bench=bench)
    settings = stated_of_files(config)
    if settings is None or config is None:
        return known
    bench = bench_knowledge(settings)
    said = "coupling" in read_toml(config).get("scope", {}) or math.isfinite(bench.response_u)
    if not (said or bench.high_pass.corrected):
        bench = replace(bench, high_pass=known.bench.high_pass)
    response = channel_response(settings.front_end)
    return replace(known, bench=bench, response=response, beams=beams_knowledge(settings))


def _amplitude(level_dbc: float) -> float:
    """Amplitude of a harmonic over the fundamental; nan for 0 dBc, which stands for "not known"."""
    return 10 ** (level_dbc / 20) if level_dbc else math.nan


def channel_response(front_end: FrontEndSettings) -> ChannelResponse | None:
    """Return the response that the settings describe; ``None`` if there is nothing to correct."""
    # It has no uncertainties: what all records share does not average out, so it stands in the budget and not with
    # each record.
    if not (front_end.low_pass_hz or front_end.ac_corner_hz or front_end.response):
        return None
    return ChannelResponse(
        low_pass_hz=[front_end.low_pass_hz] if front_end.low_pass_hz else [],
        high_pass_hz=[front_end.ac_corner_hz] if front_end.ac_corner_hz else [],
        table_hz=[row[0] for row in front_end.response],
        table_gain=[row[1] for row in front_end.response],
        table_phase_rad=[math.radians(row[2]) for row in front_end.response],
    )
