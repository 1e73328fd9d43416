"""The modulator staircase on an oscilloscope: taking it, evaluation, result and report."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from analysis.fibre_gyro import (
    ClosedLoop,
    StaircaseWitness,
    describe_witness_flag,
    rounding_left,
    steps_beyond_dac,
    two_pi_error_of_drive,
    witness_staircase,
)
from instrument import TDS2014, InstrumentError, ManualRateTable, Preamble, Waveform, read_waveform
from instrument.fibre_gyro import FibreGyroLink
from instrument.simulated import SimulatedTDS2014, VirtualClock
from station.errors import NoUsableSignal, UsageError
from station.fibre_gyro.bench import SerialFogBench, loop_settings
from station.fibre_gyro.common import PPM, beyond_converter, gyro_table
from station.fibre_gyro.segments import PlannedSegment
from station.fibre_gyro.settings import FIBRE_GYRO, FogSettings, TestSettings
from station.fibre_gyro.sniff import read_frame_format
from station.live.preview import Preview, PreviewTrace, PreviewValue, trace_of, waveform_of
from station.measurements import Measurement
from station.report.figure import ACCENT, INK, SECOND, SOFT, WIDE, legend_above, svg_element
from station.results.numbers import TWO_PI_ERROR_PPM, TWO_PI_VOLTAGE
from station.results.quantity import Quantity, QuantityGroup, document
from station.results.result import (
    Excluded,
    FactTable,
    PlacedFigure,
    Result,
    Section,
    TextTable,
    ppm,
    with_uncertainty,
)
from station.runs.acquisition import Acquisition
from station.runs.store import NewRecord, SavedRun
from station.scope.autoset import KnobPositions, ScreenShape, fit_channel, oscilloscope_steps
from station.scope.tools import open_scope, serve
from station.settings import Finite, NotNegative
from station.terminal import ask_operator

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# --------------------
# Records of the modulator staircase: from an oscilloscope while the gyro injects, or from its files


class WitnessSettings(TestSettings):
    """The oscilloscope on the phase modulator."""

    resource: str
    baud_rate: Annotated[int, Field(ge=0)]
    channel: Literal["CH1", "CH2", "CH3", "CH4"]
    probe: Literal[1, 10, 100, 1000]
    records: Annotated[int, Field(ge=1, le=10_000)]
    step_codes: Finite
    half_wave_v: NotNegative
    half_wave_u_v: NotNegative
    gain_u: NotNegative
    time_base_u: NotNegative


_own = WitnessSettings.of


_SETTING = "scope_setting"


_SHAPE = ScreenShape(periods_min=80.0)  # at least so many steps in a record, if each has at least so many samples


def is_simulated(settings: FogSettings) -> bool:
    """Whether the oscilloscope is simulated: none is named."""
    return not _own(settings).resource


def take(settings: FogSettings, session: Acquisition) -> None:
    """Take the records; of a run that was cut short those that are missing, with the scope set as it was."""
    _check(settings)
    witness, before = _own(settings), session.facts.get(_SETTING)
    injected = session.open(_injecting(settings))
    scope = session.open(_scope(settings, session))
    session.watch(scope)
    knobs = _set_up(scope, settings, KnobPositions(**before) if before else None)
    facts = {"injected": injected, "identity": asdict(scope.identity), _SETTING: asdict(knobs)}
    writer = session.begin({**facts, **_truth(settings)})
    session.progress.note(f"{scope.identity.model} ({witness.resource or 'simulated'}), run {writer.path}")
    there = len(session.so_far().taken_for(PURPOSE))
    if there:
        session.progress.note(f"{there} of {witness.records} records are saved already")
    session.progress.start("records", witness.records - there)
    for number in session.free_numbers("record ", witness.records - there):
        waveform = scope.acquire(witness.channel)
        writer.save_records([_record(f"record {number}", waveform, {"channel": witness.channel})])
        session.progress.advance()


def take_files(settings: FogSettings, paths: Sequence[Path], session: Acquisition) -> None:
    """Make a run of files that the oscilloscope or its PC software wrote."""
    waveforms = [read_waveform(path) for path in paths]
    for path, waveform in zip(paths, waveforms, strict=True):
        if waveform.codes.dtype != np.int8:
            raise UsageError(f"{path}: holds more than eight bits a point: save a single record, not an average")
    writer = session.begin({"injected": {}, "logs": [str(path) for path in paths]})
    for number, (path, waveform) in enumerate(zip(paths, waveforms, strict=True), start=1):
        writer.save_records([_record(f"record {number} ({path.name})", waveform, {"file": path.name})])


def _record(key: str, waveform: Waveform, conditions: dict[str, object]) -> NewRecord:
    return NewRecord(key, PURPOSE, waveform.preamble.to_text(), waveform.codes.tobytes(), conditions)


def _check(settings: FogSettings) -> None:
    """Refuse what cannot be done, before anything moves."""
    step, bits = _own(settings).step_codes, settings.gyro.dac_bits
    if is_simulated(settings) and settings.link.port:
        raise UsageError(
            f"link.port names a real gyro ({settings.link.port}) and witness.resource no oscilloscope: give both, "
            "or neither"
        )
    if not (is_simulated(settings) or settings.link.port):
        return  # the operator brings a staircase about
    if steps_beyond_dac(step, bits):
        raise UsageError(f"witness.step_codes: {beyond_converter(step, bits)}")
    if not step:
        raise UsageError("witness.step_codes: without a step there is no staircase; give 2^N/100 to 2^N/8 codes")


def _truth(settings: FogSettings) -> dict[str, dict[str, float]]:
    """Return the fact ``truth`` of a simulated run, what it should find."""
    if not is_simulated(settings):
        return {}
    eps, half_wave = settings.simulation.two_pi_error, settings.simulation.half_wave_v
    truth = {
        TWO_PI_VOLTAGE.key(): 2 * half_wave * (1 + eps),
        TWO_PI_ERROR_PPM.key(): PPM * eps,
        STEP_TIME.key(): settings.coil.transit_time,
        "step_codes": _own(settings).step_codes,
    }
    return {"truth": truth}


def _scope(settings: FogSettings, session: Acquisition) -> AbstractContextManager[TDS2014]:
    witness = _own(settings)
    if not is_simulated(settings):
        return open_scope(
            witness.resource,
            witness.baud_rate,
            tell=session.link_says,
            put_back=session.panel_to_put_back,
            same_as=session.scope_so_far,
        )

    return open_simulated_scope(settings, times_resumed=session.times_resumed)


@contextmanager
def _injecting(settings: FogSettings) -> Iterator[dict[str, Any]]:
    """Hold the feedback and inject the step, if the gyro's port is named; in closed loop the two would cancel."""
    if not settings.link.port:
        yield {"step_codes": _own(settings).step_codes} if is_simulated(settings) else {}
        return
    wanted = {"loop": "held", "step_codes": _own(settings).step_codes, "rate_dps": 0.0}
    planned = PlannedSegment(PURPOSE, 0.0, 0.0, wanted)
    layout = read_frame_format(settings)
    with FibreGyroLink(settings.link.port, layout, speed=settings.link.speed) as link:
        bench = SerialFogBench(link, ManualRateTable(ask=ask_operator), ask_operator)
        if reason := bench.refuses(planned):
            raise UsageError(reason)
        try:
            yield bench.prepare(planned)
        finally:
            bench.leave()


def _set_up(scope: TDS2014, settings: FogSettings, before: KnobPositions | None) -> KnobPositions:
    """Set the scope as it was set before, or so that a record holds enough steps and they fill the screen."""
    witness, beat = _own(settings), 1 / settings.coil.transit_time
    channel = witness.channel
    scope.set_channel(channel, coupling="DC", probe=witness.probe, bandwidth_limit=False, invert=False)
    scope.set_acquisition(mode="SAMPLE")
    if before is None:
        wanted = oscilloscope_steps().time_base(beat, _SHAPE.periods_min, _SHAPE.samples_per_period_min)
        base = scope.set_timebase(wanted, position=0.0)
        scope.set_trigger(source=channel, level=0.0, slope="FALL", mode="AUTO")
        start = KnobPositions(base, 1.0 * witness.probe, 0.0, 0.0, beat)
        vertical = fit_channel(scope, channel, witness, _SHAPE, start)
        level = -vertical.position * vertical.scale
        knobs = KnobPositions(base, vertical.scale, vertical.position, level, beat)
    else:
        knobs = before
        scope.set_timebase(knobs.seconds_per_division, position=0.0)
        scope.set_channel(channel, scale=knobs.volts_per_division, position=knobs.position)
    scope.set_trigger(source=channel, level=knobs.trigger_level, slope="FALL", mode="AUTO")
    return knobs


# --------------------
# The voltage on the phase modulator of the simulated gyro, and a simulated oscilloscope that shows it


Floats = NDArray[np.float64]

_DRIVER_TIME_CONSTANT_S = 0.05e-6
_TRACE_SAMPLES = 512


def modulator_voltage(settings: FogSettings) -> Callable[[Floats], Floats]:
    """Return the voltage on the modulator as a function of time, with the feedback held and a step injected."""
    # The loop is computed at every transit time for a while and its staircase then continued with the same steps:
    # in open loop nothing else happens.
    coil, loop = settings.coil, loop_settings(settings)
    gyro = ClosedLoop(coil, loop, settings.simulation.seed, kernel="numpy")
    gyro.clear_feedback()
    trace = gyro.trace(_TRACE_SAMPLES, injected_step=_own(settings).step_codes, closed=False)
    staircase, bias = trace.staircase.astype(np.int64), (trace.code - trace.staircase)[:2].astype(np.int64)
    whole = staircase.size - 2  # an even number, so that the bias fits
    grown = int(staircase[whole] - staircase[0])
    volts_per_code = 2 * settings.simulation.half_wave_v * (1 + loop.two_pi_error) / loop.codes

    def volts_of(number: NDArray[np.int64]) -> Floats:
        laps, place = np.divmod(number, whole)
        counter = np.mod(staircase[place] + laps * grown, loop.wrap)
        return np.asarray(volts_per_code * (counter + bias[number % 2]), dtype=np.float64)

    def voltage(times: Floats) -> Floats:
        turns = np.asarray(times, dtype=np.float64) / coil.transit_time
        number = np.floor(turns).astype(np.int64)
        # what is left of the edge behind the driver of the modulator
        left = np.exp(-(turns - number) * coil.transit_time / _DRIVER_TIME_CONSTANT_S)
        before, now = volts_of(number - 1), volts_of(number)
        return np.asarray((now + (before - now) * left) * (1 + settings.simulation.scope_gain_error))

    return voltage


@contextmanager
def open_simulated_scope(settings: FogSettings, *, times_resumed: int = 0) -> Iterator[TDS2014]:
    """Open a simulated oscilloscope on the modulator, through a real byte stream; its clock jumps over waiting."""
    witness, seed = _own(settings), settings.simulation.seed
    if times_resumed:
        seed = int(np.random.SeedSequence([seed, times_resumed]).generate_state(1)[0])
    voltage = modulator_voltage(settings)
    scope = SimulatedTDS2014(
        {int(witness.channel[2:]): lambda times: voltage(times) / witness.probe}, clock=VirtualClock(), seed=seed
    )
    with serve(scope, "auto") as resource, open_scope(resource, simulated=True) as opened:
        yield opened


# --------------------
# What the oscilloscope says of the modulator staircase: each record, their mean, the 2 pi error


PURPOSE = "witness"
_SHARED = 0.5
"""Of the uncertainty of one record, what all records of a run share: 24 simulated runs of 5 records scatter 1.4
times as much as records that share nothing."""


@dataclass(frozen=True)
class Uncertain:
    """A value and its standard uncertainty; nan where there is none."""

    value: float
    u: float


@dataclass(frozen=True, eq=False)
class WitnessedRecord:
    """One record."""

    name: str  # its number, or the name of its file
    waveform: Waveform
    found: StaircaseWitness  # without the uncertainty of the oscilloscope's gain and time base
    step_time_given: bool  # its steps were found with the transit time of the coil only


@dataclass(frozen=True, eq=False)
class WitnessEvaluation:
    """Means over the records; gain and time base are in every `u` but those of `record_u`."""

    records: tuple[WitnessedRecord, ...]
    step_height: Uncertain  # V and s
    step_time: Uncertain
    reset_height: Uncertain
    two_pi_voltage: Uncertain
    bias_height: Uncertain
    # without the gain: for comparison with another run with the same settings of the oscilloscope
    two_pi_voltage_record_u: float
    step_codes: Uncertain  # step over 2-pi voltage, times the codes of the converter; free of the gain
    step_time_ppm: Uncertain  # step time over transit time of the coil by design, less one
    half_wave_v: float  # 0 if it is not known
    two_pi_error: Uncertain  # v_2pi/(2 V_pi) - 1
    flags: tuple[str, ...]  # of `analysis.fibre_gyro.staircase`, of any record
    left_out: tuple[Excluded, ...]


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> WitnessEvaluation:
    """Evaluate the records of a run."""
    records, left_out = [], []
    for saved in run.taken_for(PURPOSE):
        name = str(saved.conditions.get("file") or f"record {saved.number}")
        try:
            if not saved.intact:
                raise ValueError("it is not what was once saved")
            waveform = Waveform(saved.codes, Preamble.parse(saved.preamble))
            preamble = waveform.preamble
            if preamble.xunit.lower() != "s":
                raise ValueError(
                    f"it is a spectrum ({preamble.xunit}), not a record over time: save the channel itself"
                )
            if preamble.pt_fmt != "Y":
                raise ValueError("it was taken in Peak Detect, which has no levels: use Sample mode")
            if waveform.clipped:
                raise ValueError("it is clipped: use more volts per division, or shift the position")
            records.append(WitnessedRecord(name, waveform, *witnessed(waveform, settings.coil.transit_time)))
        except (ValueError, InstrumentError) as error:
            left_out.append(Excluded(name, str(error)))
    if not records:
        reasons = "; ".join(dict.fromkeys(one.reason for one in left_out)) or "there are no records"
        raise NoUsableSignal(f"no record shows the staircase of a modulator: {reasons}")
    return _found(tuple(records), tuple(left_out), settings, simulated=run.facts.simulated)


def witnessed(waveform: Waveform, transit_time: float) -> tuple[StaircaseWitness, bool]:
    """Return the staircase of a record, and whether it was found with the transit time of the coil (s) only."""
    volts, interval = waveform.volts, waveform.sample_interval
    try:
        return witness_staircase(volts, interval), False
    except ValueError as alone:
        try:
            return witness_staircase(volts, interval, step_time=transit_time), True
        except ValueError:
            raise alone from None


def _found(
    records: tuple[WitnessedRecord, ...], left_out: tuple[Excluded, ...], settings: FogSettings, *, simulated: bool
) -> WitnessEvaluation:
    chosen = _own(settings)
    gain, seconds = chosen.gain_u, chosen.time_base_u
    alone = _mean(records, "two_pi_voltage")
    voltage = _widened(alone, gain)
    time = _widened(_mean(records, "step_time"), seconds)
    step = _mean(records, "step_height")
    ratio = step.value / alone.value
    codes = (1 << settings.gyro.dac_bits) * ratio
    half_wave = chosen.half_wave_v or (settings.simulation.half_wave_v if simulated else 0.0)
    error = Uncertain(math.nan, math.nan)
    if half_wave and math.isfinite(voltage.value):
        error = Uncertain(*two_pi_error_of_drive(voltage.value, voltage.u, half_wave, chosen.half_wave_u_v))
    transit = settings.coil.transit_time
    return WitnessEvaluation(
        records=records,
        step_height=_widened(step, gain),
        step_time=time,
        reset_height=_widened(_mean(records, "reset_height"), gain),
        two_pi_voltage=voltage,
        bias_height=_widened(_mean(records, "bias_height"), gain),
        two_pi_voltage_record_u=alone.u,
        # both rise together where the fit is unsure of them, so this is rather too wide
        step_codes=Uncertain(codes, abs(codes) * math.hypot(step.u / step.value, alone.u / alone.value)),
        step_time_ppm=Uncertain(PPM * (time.value / transit - 1), PPM * time.u / transit),
        half_wave_v=half_wave,
        two_pi_error=error,
        flags=tuple(dict.fromkeys(flag for one in records for flag in one.found.flags)),
        left_out=left_out,
    )


def _mean(records: Sequence[WitnessedRecord], name: str) -> Uncertain:
    """Weighted mean; where the records scatter by more than their uncertainties, those grow."""
    # What rounding is wrong by is partly the same in every record, and does not average.
    rows = np.array(
        [(getattr(one.found, name), getattr(one.found, f"{name}_u"), _shared(one)) for one in records],
        dtype=np.float64,
    )
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        return Uncertain(math.nan, math.nan)
    values, u, share = rows.T
    if not u.all():  # a bias that is not there is 0 without an uncertainty
        return Uncertain(float(values.mean()), float(np.std(values)))
    weights = 1 / u**2
    mean = float(np.average(values, weights=weights))
    chi_square = float(np.sum(weights * (values - mean) ** 2)) / max(len(rows) - 1, 1)
    return Uncertain(mean, math.hypot(math.sqrt(max(1.0, chi_square) / weights.sum()), float(np.min(share * u))))


def _shared(record: WitnessedRecord) -> float:
    """Part of the uncertainty that all records of a run have in common: with little noise what rounding does."""
    found = record.found
    if not found.level_spacing:
        return _SHARED
    noise = found.noise_rms / found.level_spacing  # behind the converter, in its levels
    left = rounding_left(math.sqrt(max(noise**2 - 1 / 12, 0.0)))
    samples = max(found.step_time / record.waveform.sample_interval - found.settling_samples, 1.0)
    return max(_SHARED, left / math.hypot(left, noise / math.sqrt(samples)))


def _widened(measured: Uncertain, relative_u: float) -> Uncertain:
    return Uncertain(measured.value, math.hypot(measured.u, relative_u * measured.value))


# --------------------
# What the staircase on the oscilloscope means, as numbers and sentences


def _mean_quantity(name: str, unit: str, of: str, **more: Any) -> Quantity:
    return Quantity(name, unit, f"{of}.value", f"{of}.u", **more)


TWO_PI_ERROR = replace(
    TWO_PI_ERROR_PPM, of="two_pi_error.value", u="two_pi_error.u", limit="witness_two_pi_error_ppm"
)
STEP_TIME = _mean_quantity("step_time", "s", "step_time")
NUMBERS = (
    replace(TWO_PI_VOLTAGE, headline=True),
    _mean_quantity("step_height", "v", "step_height"),
    STEP_TIME,
    _mean_quantity("reset_height", "v", "reset_height", doc="fall of the staircase at a reset"),
    _mean_quantity("bias_height", "v", "bias_height"),
    _mean_quantity("step", "codes", "step_codes", doc="over V_2π, free of the oscilloscope's gain"),
    _mean_quantity("two_pi_error", "", "two_pi_error"),
    TWO_PI_ERROR,
    _mean_quantity(
        "step_time_difference", "ppm", "step_time_ppm", limit="witness_step_time_ppm",
        doc="step time over the coil's transit time by design, less one",
    ),
    Quantity("two_pi_voltage_u_without_gain", "v", "two_pi_voltage_record_u"),
    Quantity("half_wave", "v", lambda found: found.half_wave_v or None),
)  # fmt: skip
RECORD = (
    *(Quantity(name, "v", f"found.{name}", u=True) for name in ("step_height", "reset_height")),
    *(Quantity(name, "v", f"found.{name}", u=True) for name in ("two_pi_voltage", "bias_height")),
    Quantity("step_time", "s", "found.step_time", u=True),
    Quantity("steps", of="found.steps"),
    Quantity("resets", of="found.resets"),
    Quantity("noise_rms", "v", "found.noise_rms"),
)
QUANTITIES = (QuantityGroup(NUMBERS), QuantityGroup(RECORD, "records", "name"))


def result(found: WitnessEvaluation, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    voltage, lines = found.two_pi_voltage, tuple(_lines(found))
    value = "V_2π unknown: no reset is in the records"
    if math.isfinite(voltage.value):
        value = f"V_2π = {with_uncertainty(voltage.value, voltage.u, 'V')}"
    said = [f"{one.sentence}." for one in found.left_out]
    total = len(found.records)
    for name in found.flags:
        count = sum(name in one.found.flags for one in found.records)
        sentence = describe_witness_flag(name)
        said.append(sentence if count == total else f"{sentence} ({count} of {total} records)")
    if any(one.step_time_given for one in found.records):
        said.append("Single steps hardly stand out: they were looked for at the transit time of the coil.")
    watched = tuple(said)
    return Result(
        name="result",
        value=value,
        document=_document(found, settings),
        quantities=QUANTITIES,
        lines=lines,
        summary=[("", line) for line in lines],
        sentences=tuple(_sentences(found, settings, run.facts.get("injected", {}).get("step_codes"))),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
    )


def _document(found: WitnessEvaluation, settings: FogSettings) -> dict[str, Any]:
    return {
        **document(found, NUMBERS),
        "gain_u": _own(settings).gain_u,
        "time_base_u": _own(settings).time_base_u,
        "records": [
            {
                "name": one.name,
                **document(one, RECORD),
                "flags": one.found.flags,
                "step_time_given": one.step_time_given,
            }
            for one in found.records
        ],
        "left_out": found.left_out,
    }


def _lines(found: WitnessEvaluation) -> list[str]:
    step, fall, time, error = found.step_height, found.reset_height, found.step_time, found.two_pi_error
    lines = [
        f"Step {with_uncertainty(step.value, step.u, 'V')} every "
        f"{with_uncertainty(1e6 * time.value, 1e6 * time.u, 'µs')}; fall at a reset "
        f"{with_uncertainty(fall.value, fall.u, 'V')}."
    ]
    if math.isfinite(error.value):
        percent = with_uncertainty(100 * error.value, 100 * error.u)
        lines.append(
            f"2π error {'' if percent.startswith('-') else '+'}{percent} % against twice {found.half_wave_v:g} V; "
            f"from {len(found.records)} records."
        )
    return lines


def _sentences(found: WitnessEvaluation, settings: FogSettings, injected: float | None) -> list[str]:
    """Say what the numbers show and what they cannot."""
    alone, difference = found.two_pi_voltage_record_u, found.step_time_ppm
    said = [
        f"Volts are the oscilloscope's reading: its gain is known to {100 * _own(settings).gain_u:.3g} % (k = "
        "1), which is in every uncertainty in volts here. A wrong resistor shows, a drift of 0.1 % does not."
    ]
    if math.isfinite(alone):
        said.append(
            f"Without the gain V_2π is known to {1000 * alone:.2g} mV, "
            f"{100 * alone / found.two_pi_voltage.value:.2g} %: so well two runs with the same settings of the "
            "oscilloscope compare."
        )
        step = with_uncertainty(found.step_codes.value, found.step_codes.u)
        told = f"; {injected:g} were injected" if injected else ""
        said.append(f"Step over V_2π, free of the gain: {step} codes{told}.")
    said.append(
        f"Step time against the transit time of the coil by design: {ppm(difference.value, difference.u)}, by the "
        "oscilloscope's time base."
    )
    if not found.half_wave_v:
        said.append("The half-wave voltage (witness.half_wave_v) is not known, so no 2π error is given.")
    return said


# --------------------
# Report of the oscilloscope on the modulator: plots, table of the records, conditions


_MICRO = 1e6


def sections(found: WitnessEvaluation, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    first = found.records[0]
    return [
        Section("What this result shows, and what it cannot", sentences=result.sentences),
        Section(
            "Staircase on the oscilloscope",
            figures=(PlacedFigure(_record_svg(first), f"Samples and fitted levels of {first.name}."),),
        ),
        Section(
            "Levels less the even staircase",
            "Heights of the levels against what even steps and resets would give. A pattern over the height is "
            "converter nonlinearity, of the gyro's or of the oscilloscope's.",
            figures=(PlacedFigure(_level_residuals_svg(found), "Every level of every record."),),
        ),
        Section(
            "Records",
            "Without the uncertainty of gain and time base.",
            table=TextTable(_COLUMNS, tuple(map(_row, found.records))),
        ),
    ]


def _record_svg(record: WitnessedRecord) -> str:
    """Draw the samples of a record and the levels that were fitted."""
    found, volts = record.found, record.waveform.volts

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        begin = _MICRO * record.waveform.sample_interval * np.arange(volts.size)
        axes.plot(begin, volts, color=ACCENT, linewidth=0.7, label="samples")
        half = _MICRO * found.step_time / 2
        middle = _MICRO * found.times
        label = "fitted levels"
        axes.hlines(found.model, middle - half, middle + half, color=SECOND, linewidth=1.8, label=label)
        axes.set(xlabel="time from the first sample, µs", ylabel="V")
        axes.set_xlim(0, begin[-1])
        legend_above(axes, columns=2)

    return svg_element("witness-record", WIDE, draw)


def _level_residuals_svg(found: WitnessEvaluation) -> str:
    """Draw levels less fitted levels against their height."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for one in found.records:
            levels = one.found.levels
            axes.plot(levels, 1000 * (levels - one.found.model), ".", ms=3.5, color=INK, alpha=0.6)
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="height of the level, V", ylabel="level less fit, mV")

    return svg_element("witness-levels", WIDE, draw)


_COLUMNS = ("record", "step, V", "step time, µs", "fall, V", "V_2π, V", "bias, V", "resets", "noise, mV")


def _row(record: WitnessedRecord) -> tuple[str, ...]:
    found = record.found
    return (
        record.name,
        with_uncertainty(found.step_height, found.step_height_u),
        with_uncertainty(_MICRO * found.step_time, _MICRO * found.step_time_u),
        with_uncertainty(found.reset_height, found.reset_height_u),
        with_uncertainty(found.two_pi_voltage, found.two_pi_voltage_u),
        with_uncertainty(found.bias_height, found.bias_height_u),
        f"{found.resets}",
        f"{1000 * found.noise_rms:.2g}",
    )


def facts(found: WitnessEvaluation, run: SavedRun, settings: FogSettings) -> list[FactTable]:
    """Return how the records were taken, for the facts of the report."""
    known, witness = run.facts, _own(settings)
    identity, step = known.get("identity"), known.get("injected", {}).get("step_codes")
    half_wave = "not known"
    if witness.half_wave_v:
        half_wave = f"{witness.half_wave_v:g} V, u {witness.half_wave_u_v:g} V"
    elif known.simulated:
        half_wave = f"{settings.simulation.half_wave_v:g} V of the simulation"
    rows = [
        ("records from", ", ".join(known.sources) or witness.resource or "simulated oscilloscope"),
        ("oscilloscope", f"{identity['manufacturer']} {identity['model']}" if identity else "not known"),
        ("setting", "; ".join(dict.fromkeys(Preamble.parse(record.preamble).wfid for record in run.records))),
        ("injected step", f"{step:g} codes, feedback held" if step else "not by this program"),
        ("half-wave voltage", half_wave),
        ("gain, time base", f"u {100 * witness.gain_u:.3g} %, {_MICRO * witness.time_base_u:.3g} ppm"),
    ]
    return [gyro_table(settings), FactTable("Conditions", rows)]


# --------------------
# What one record of the staircase says as soon as it is there, and all so far: for those who watch


_RESETS = 3.0  # falls of the staircase that are shown


class _WitnessPreview:
    def __init__(self, settings: FogSettings) -> None:
        self._transit_time = settings.coil.transit_time
        self._found: list[StaircaseWitness] = []

    def __call__(self, records: Sequence[NewRecord]) -> Preview | None:
        record = records[0]
        waveform = waveform_of(record)
        clipped = ("clipped",) if waveform.clipped else ()
        try:
            found, _ = witnessed(waveform, self._transit_time)
        except ValueError:  # the result will say why it is left out
            return Preview(
                record.key, record.purpose, (), flags=(*clipped, "no_staircase"), trace=_trace(waveform, None)
            )
        self._found.append(found)
        running = _values(self._found)
        flags = (*clipped, *found.flags)
        return Preview(
            record.key, record.purpose, _values([found]), running, running[:1], flags, _trace(waveform, found)
        )


def _values(found: Sequence[StaircaseWitness]) -> tuple[PreviewValue, ...]:
    """Means by their weights; without the gain of the oscilloscope, which all records share."""
    voltage, voltage_u = _mean_so_far([(one.two_pi_voltage, one.two_pi_voltage_u) for one in found])
    time, time_u = _mean_so_far([(one.step_time, one.step_time_u) for one in found])
    step, step_u = _mean_so_far([(one.step_height, one.step_height_u) for one in found])
    said = with_uncertainty(voltage, voltage_u, "V") if math.isfinite(voltage) else "no reset"
    return (
        PreviewValue(NUMBERS[0].key(), voltage, voltage_u, said, len(found)),
        PreviewValue(NUMBERS[1].key(), step, step_u, with_uncertainty(step, step_u, "V"), len(found)),
        PreviewValue(NUMBERS[2].key(), time, time_u, with_uncertainty(1e6 * time, 1e6 * time_u, "µs"), len(found)),
    )


def _mean_so_far(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    known = np.array([pair for pair in values if all(map(math.isfinite, pair)) and pair[1] > 0])
    if not len(known):
        return math.nan, math.nan
    weights = 1 / known[:, 1] ** 2
    return float(np.average(known[:, 0], weights=weights)), float(1 / math.sqrt(weights.sum()))


def _trace(waveform: Waveform, found: StaircaseWitness | None) -> PreviewTrace:
    """A few resets with the even staircase through them; without one the whole record."""
    if found is None or not found.step_time > 0:
        return trace_of(waveform, math.inf, None)

    def staircase(times: NDArray[np.float64]) -> NDArray[np.float64]:
        edges = (found.times[1:] + found.times[:-1]) / 2
        return np.asarray(found.model[np.searchsorted(edges, times)])

    steps = found.two_pi_voltage / abs(found.step_height) if found.step_height else math.nan
    shown = _RESETS * steps * found.step_time
    return trace_of(waveform, shown if math.isfinite(shown) else math.inf, staircase)


_KNOWN = ("half_wave_v", "half_wave_u_v", "gain_u", "time_base_u")

MEASUREMENT = Measurement(
    name=PURPOSE,
    command="gyrolock fog witness",
    title="Modulator staircase by oscilloscope",
    kind=replace(FIBRE_GYRO, knowledge=("limits.*", *(f"witness.{name}" for name in _KNOWN))),
    take=take,
    take_files=take_files,
    evaluate=lambda run, settings, choices, workers, progress: evaluate(run, settings, choices),
    result=result,
    sections=sections,
    facts=facts,
    quantities=QUANTITIES,
    simulated=is_simulated,
    section=WitnessSettings,
    watch=_WitnessPreview,
)
