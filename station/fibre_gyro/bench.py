"""The bench of a fibre gyro: a serial link and a table that an operator turns, or both simulated."""

import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from analysis.fibre_gyro import ClosedLoop, LoopDesign, OutputBlock, OutputModel
from analysis.rotation import EARTH_RATE_DPS
from instrument import InstrumentError, ManualRateTable, RateTable
from instrument.fibre_gyro import TABLE_ANGLE, FibreGyroLink, FrameFormat, Losses, Recording, counts_per_unit
from instrument.simulated.fibre_gyro import PtyGyroServer, TcpGyroServer
from station.controllers import open_rate_table, open_surroundings
from station.errors import UsageError
from station.fibre_gyro.segments import OVERLOAD, FogBench, PlannedSegment
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.sniff import read_frame_format
from station.terminal import ask_operator, remark

Ask = Callable[[str], str]


class SerialFogBench:
    """A gyro on a serial link, and a table."""

    _BY_HAND = ("axis", "end_up", "run", "temperature_c", "by_hand")

    def __init__(
        self,
        link: FibreGyroLink,
        table: RateTable,
        ask: Ask,
        surroundings: Callable[[], dict[str, float]] = dict,
        counts_per_dps: float | None = None,
    ) -> None:
        self._link, self._table, self._ask, self._surroundings = link, table, ask, surroundings
        self._counts_per_dps = counts_per_dps
        self._by_hand: tuple[Any, ...] = ()
        self._rate = 0.0
        self._step = 0.0
        self._held = False

    def refuses(self, planned: PlannedSegment) -> str:
        """Axes that the frames do not hold, steps beyond what they can express, commands that are not there."""
        layout, wanted = self._link.layout, planned.conditions
        try:
            layout.output_of(str(wanted.get("axis") or ""))
        except InstrumentError as error:
            return str(error)
        if "loop" in wanted and "hold_feedback" not in layout.commands:
            return "the frame format of this gyro has no command hold_feedback"
        step = float(wanted.get("step_codes", 0.0))
        lowest, highest = layout.step_range
        if not lowest <= step <= highest:
            return (
                f"a step of {step:+.6g} codes cannot be injected, the gyro takes {lowest:g} to {highest:g}: "
                "choose a smaller rate"
            )
        return ""

    def prepare(self, planned: PlannedSegment) -> dict[str, Any]:
        """Turn, inject, hold the feedback; return the rate and the step that were reached."""
        wanted = planned.conditions
        self._set_by_hand(wanted)
        reached: dict[str, Any] = {}
        rate = float(wanted["rate_dps"])
        if rate != self._rate:
            self._table.set_rate(rate)
            self._rate = rate
        if rate:
            reached["table_rate_dps"] = self._table.rate()
        self._set_loop(wanted.get("loop") == "held")
        if "step_codes" in wanted:
            reached |= self._inject(float(wanted["step_codes"]), wanted)
        if not self._link.acknowledges and ("step_codes" in wanted or "loop" in wanted):
            reached["acknowledged"] = False
        if self._link.layout.unit != "counts":
            reached["output_unit"] = self._link.layout.unit
        return reached | self._surroundings()

    def record(self, planned: PlannedSegment, progress: Callable[[float], None]) -> Recording:
        """Record from the link; where frames hold several outputs, that of the segment's axis."""
        times, steps = turned_over(planned)
        recording = self._link.record(
            planned.seconds,
            inject_at=list(zip(planned.settle_s + times, steps, strict=True)),
            skip_s=planned.settle_s,
            progress=progress,
            axis=str(planned.conditions.get("axis") or ""),
            counts_per_dps=self._counts_per_dps,
        )
        self._step = steps[-1] if steps.size else self._step
        return recording

    def leave(self) -> None:
        """Take the injection away, close the loop and stop the table; never raises."""
        with suppress(InstrumentError, OSError):
            if self._step:
                self._link.inject(0.0)
        with suppress(InstrumentError, OSError):
            self._set_loop(False)
        with suppress(InstrumentError, OSError):
            if self._rate:
                self._table.close()

    def _set_by_hand(self, wanted: Any) -> None:
        now = tuple(wanted.get(name) for name in self._BY_HAND)
        if now == self._by_hand or now == (None,) * len(now):
            return
        self._by_hand = now
        axis, end_up, run, temperature, also = now
        how = "up" if end_up != -1 else "upside down"
        asked = [] if "position" in wanted else [f"Bring axis {axis} of the gyro to the table's axis, {how}."]
        if run is not None:
            asked.append(f"For {run}: switch the gyro off, let it take {temperature:g} deg C, switch it on.")
        asked += [] if also is None else [str(also)]
        self._ask("\n".join([*asked, "Press Enter when done: "]))

    def _set_loop(self, held: bool) -> None:
        if held != self._held:
            if held:
                self._link.hold_feedback()
            else:
                self._link.close_loop()
            self._held = held

    def _inject(self, step: float, wanted: Any) -> dict[str, float]:
        """Inject a step; the number that was really sent replaces the one that was wanted."""
        sent = self._link.inject(step) if step or self._step else 0.0
        self._step = sent
        reached = {"step_codes": sent}
        if step and "number" in wanted:
            reached["number"] = float(wanted["number"]) * sent / step
        return reached


@contextmanager
def _table(settings: FogSettings, tell: Callable[[str], None]) -> Iterator[RateTable]:
    named = None if settings.controllers is None else settings.controllers.rate_table
    if settings.table.kind == "controller" and named is not None:
        with open_rate_table(named, tell=tell) as table:
            yield table
    else:
        yield ManualRateTable(ask=ask_operator)


@contextmanager
def open_fog_bench(settings: FogSettings, tell: Callable[[str], None] = remark) -> Iterator[FogBench]:
    """Open the bench that the settings describe; afterwards the injection is off and the loop is closed."""
    if settings.simulated:
        yield SimulatedFogBench(settings)
        return
    layout = read_frame_format(settings)
    with (
        FibreGyroLink(settings.link.port, layout, speed=settings.link.speed) as link,
        open_surroundings(settings.controllers, tell=tell) as surroundings,
        _table(settings, tell) as table,
    ):
        bench = SerialFogBench(link, table, ask_operator, surroundings, settings.nominal_scale_factor)
        try:
            yield bench
        finally:
            bench.leave()


# --------------------
# The simulated bench of a fibre gyro: gyro and rate table, in as little time as the computation takes.
#
# Every segment begins with a gyro and a noise of its own, made from the seed and the segment's key: a run that is
# resumed gives the same numbers as one in one go


Floats = NDArray[np.float64]

_PPM = 1e6
_OPEN_LOOP_PERIOD_S, _PARTS = 0.05, 8  # parts of an output behind a filter
_OF_FRINGE_LIMIT = 0.995  # what the output can show, beside bias and noise


class SimulatedFogBench:
    """Gyro and rate table of the settings' [simulation]."""

    def __init__(self, settings: FogSettings) -> None:
        self._settings, self._azimuth_deg = settings, np.empty(0)

    def refuses(self, planned: PlannedSegment) -> str:
        """The simulated bench can do everything that is planned."""
        return ""

    def prepare(self, planned: PlannedSegment) -> dict[str, Any]:
        """The table reads what it was asked for: its own error from run to run is not on its display."""
        reached: dict[str, Any] = {"model": self._model(planned)}
        if planned.conditions["rate_dps"]:
            reached["table_rate_dps"] = planned.conditions["rate_dps"]
        if "planned_begin_s" in planned.conditions:
            reached["begin_s"] = planned.conditions["planned_begin_s"]
        return reached

    def record(self, planned: PlannedSegment, progress: Callable[[float], None]) -> Recording:
        """Compute the output of one segment."""
        held = planned.conditions.get("loop") == "held"
        period = min(_OPEN_LOOP_PERIOD_S, 1 / self._settings.simulation.output_rate_hz) if held else (
            1 / self._settings.simulation.output_rate_hz
        )  # fmt: skip
        count = max(2, round(planned.seconds / period))
        block = self._output(planned, count, period, held=held)
        progress(planned.seconds + planned.settle_s)
        return self._recording(planned, block, count, held=held)

    def _model(self, planned: PlannedSegment) -> str:
        chosen = self._settings.simulation.model
        return (
            ("transit" if planned.conditions.get("loop") == "held" else "output") if chosen == "auto" else chosen
        )

    def _output(self, planned: PlannedSegment, count: int, period: float, *, held: bool) -> OutputBlock:
        """Run the gyro; one output more than is kept, the first holds the settling of the loop."""
        rng = self._random(planned.key)
        simulation, conditions = self._settings.simulation, planned.conditions
        change = simulation.scale_change_ppm
        if (run := conditions.get("run")) is not None:
            change += float(self._random(f"switch-on {run}").normal(0, simulation.switch_on_scatter_ppm))
        coil = self._settings.coil.scaled(1 + change / _PPM)
        loop = loop_settings(self._settings)
        seed = int(rng.integers(2**31))
        gyro: ClosedLoop | OutputModel
        gyro = ClosedLoop(coil, loop, seed) if self._model(planned) == "transit" else OutputModel(coil, loop, seed)
        # a filter is computed in parts of an output
        parts = _PARTS if simulation.output_filter_hz and not held else 1
        fine, number = period / parts, (count + 1) * parts
        rates, azimuth = self._rates(planned, number, fine, rng)
        self._azimuth_deg = np.rad2deg(azimuth[2 * parts :: parts])  # at the end of each output that is kept
        block = gyro.run(
            number,
            output_period_s=fine,
            rate_dps=rates,
            injected_step=self._injected(planned, number, fine, parts),
            closed=False if held else None,
        )
        if parts == 1:
            return block
        turn = 2 * np.pi * simulation.output_filter_hz * fine
        keep, begin = np.exp(-turn), float(np.mean(block.counts[:parts]))
        ends = lfilter([1 - keep], [1, -keep], block.counts, zi=[keep * begin])[0]
        before = np.concatenate([[begin], ends[:-1]])
        counts = block.counts + (before - block.counts) * (1 - keep) / turn  # the mean over each part
        return replace(block, counts=counts.reshape(-1, parts).mean(axis=1), interval_s=period)

    def _injected(self, planned: PlannedSegment, count: int, period: float, skipped: int = 1) -> Floats:
        """Injected step in each output period; the first ones are not kept."""
        step, (times, steps) = float(planned.conditions.get("step_codes", 0.0)), turned_over(planned)
        last = np.searchsorted(times, (np.arange(count) + 0.5 - skipped) * period) - 1
        return np.where(last < 0, step, np.append(steps, step)[last])

    def _random(self, key: str) -> np.random.Generator:
        return np.random.default_rng([self._settings.simulation.seed, zlib.crc32(key.encode())])

    def _rates(
        self, planned: PlannedSegment, count: int, period: float, rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        """Rate on the gyro's axis in each output period, deg/s, as the gyro sees it; the table's azimuth, rad."""
        simulation, conditions = self._settings.simulation, planned.conditions
        table = float(conditions["rate_dps"]) * (1 + rng.normal(0, simulation.table_irreproducibility_ppm) / _PPM)
        end = int(conditions.get("end_up", 1))
        latitude, tilt = np.deg2rad(self._settings.site.latitude_deg), 1e-3 * simulation.misalignment_mrad
        edges = np.arange(count + 1) * period
        turned = _overload_deg(conditions, np.asarray(edges - period)) if OVERLOAD in conditions else table * edges
        azimuth = np.deg2rad(turned) + rng.uniform(0, 2 * np.pi)
        # mean of the cosine over each period
        sides = np.cos(azimuth)
        north = np.diff(np.sin(azimuth)) / np.diff(azimuth) if table else (sides[1:] + sides[:-1]) / 2
        vertical = np.diff(turned) / period + EARTH_RATE_DPS * np.sin(latitude)
        if position := conditions.get("position"):  # x to the north, z up
            along = {"x": np.cos(latitude), "y": 0.0, "z": np.sin(latitude)}[position[1]]
            end, vertical, tilt = int(f"{position[0]}1"), np.full(count, EARTH_RATE_DPS * along), 0.0
        on_axis = end * np.cos(tilt) * vertical + np.sin(tilt) * EARTH_RATE_DPS * np.cos(latitude) * north
        warm, times = self._warm(planned, count, period), np.asarray(edges[:-1] + period / 2, dtype=np.float64)
        change = simulation.temperature_coefficient_ppm * warm + simulation.scale_curvature_ppm_per_k2 * warm**2
        if (since := conditions.get("since_on_s")) is not None:
            change += simulation.warm_up_scale_ppm * np.exp(-(since + times) / simulation.warm_up_time_s)
        change += simulation.scale_ppm_per_stimulus * float(conditions.get("stimulus", 0.0))
        seen = as_the_gyro_sees(np.asarray(on_axis), self._settings) * (1 + change / _PPM)
        if OVERLOAD in conditions and simulation.recovery_time_s:
            last = int(np.flatnonzero(np.abs(on_axis) > np.abs(seen) + 1e-9)[-1:].sum())
            keep = np.exp(-period / simulation.recovery_time_s)
            seen[last:] = lfilter([1 - keep], [1, -keep], seen[last:], zi=[keep * seen[last]])[0]
        return seen + self._bias(planned, times, warm), azimuth

    def _warm(self, planned: PlannedSegment, count: int, period: float) -> Floats:
        """Kelvin above the reference temperature in each output period; 0 where nobody says."""
        conditions, reference = planned.conditions, self._settings.figures.reference_temperature_c
        if (begin := conditions.get("planned_temperature_c")) is not None:
            times = (np.arange(count) - 0.5) * period  # the first output is not kept
            return np.asarray(begin - reference + conditions["ramp_c_per_min"] * times / 60, dtype=np.float64)
        temperature = conditions.get("temperature_c")
        return np.full(count, 0.0 if temperature is None else temperature - reference)

    def _bias(self, planned: PlannedSegment, times: Floats, warm: Floats) -> Floats:
        """What temperature and switching on add to the bias, deg/s."""
        simulation, conditions = self._settings.simulation, planned.conditions
        bias = simulation.bias_dph_per_k * warm + simulation.bias_dph_per_k2 * warm**2
        bias = bias + simulation.bias_dph_per_k_per_min * float(conditions.get("ramp_c_per_min", 0.0))
        bias = bias + simulation.bias_dph_per_stimulus * float(conditions.get("stimulus", 0.0))
        if (run := conditions.get("run")) is not None:
            bias = bias + self._random(f"bias at switch-on {run}").normal(0, simulation.switch_on_bias_dph)
        if (since := conditions.get("since_on_s")) is not None:
            bias = bias + simulation.warm_up_bias_dph * np.exp(-(since + times) / simulation.warm_up_time_s)
        return np.asarray(bias / 3600, dtype=np.float64)

    def _recording(self, planned: PlannedSegment, block: OutputBlock, count: int, *, held: bool) -> Recording:
        gyro = self._settings.gyro
        counts = gyro.counts_per_code * np.asarray(block.counts[1:], dtype=np.float64)
        if gyro.output_resolution:
            counts = gyro.output_resolution * np.round(counts / gyro.output_resolution)
        extra = {"normal_error": block.normal_error[1:], "reset_error": block.reset_error[1:]} if held else {}
        if OVERLOAD in planned.conditions or (
            self._settings.simulation.table_encoder and planned.conditions["rate_dps"]
        ):
            extra[TABLE_ANGLE] = self._azimuth_deg % 360.0
        if "half_period_s" in planned.conditions:
            extra["injected"] = self._injected(planned, count + 1, block.interval_s)[1:]
        return Recording(
            times=np.arange(count, dtype=np.float64) * block.interval_s,
            counts=counts,
            temperature=self._thermometer(planned, count, block.interval_s),
            status=None,
            extra={name: np.asarray(values, dtype=np.float64) for name, values in extra.items()},
            gaps=(),
            losses=Losses(good=count),
            interval_s=block.interval_s,
            clock="counter",
        )

    def _thermometer(self, planned: PlannedSegment, count: int, period: float) -> Floats | None:
        """What the gyro says of its temperature; on a ramp with noise."""
        conditions = planned.conditions
        if conditions.get("planned_temperature_c", conditions.get("temperature_c")) is None:
            return None
        warm = self._warm(planned, count + 1, period)[1:] + self._settings.figures.reference_temperature_c
        if "planned_temperature_c" in conditions:
            noise = self._settings.simulation.temperature_noise_c
            warm = warm + self._random(f"thermometer {planned.key}").normal(0, noise, count)
        return warm


def _overload_deg(conditions: Mapping[str, Any], at_s: Floats) -> Floats:
    """Angle of a table that rests, speeds up, turns too fast and stops again."""
    rate, hold, ramp = (float(conditions[name]) for name in (OVERLOAD, "overload_s", "stop_s"))
    up, down = (np.clip((at_s - begin) / ramp, 0.0, None) for begin in (hold, 2 * hold + ramp))
    areas = [np.where(one < 1, one**2 / 2, one - 0.5) for one in (up, down)]
    return np.asarray(rate * ramp * (areas[0] - areas[1]), dtype=np.float64)


def turned_over(planned: PlannedSegment) -> tuple[Floats, Floats]:
    """Times, s since the begin of what is kept, at which the injected step turns over, and the new steps."""
    half = float(planned.conditions.get("half_period_s", 0.0))
    times = np.arange(half, planned.seconds, half) if half else np.empty(0)
    senses = np.where(np.arange(times.size) % 2, 1.0, -1.0)
    return times, np.asarray(float(planned.conditions.get("step_codes", 0.0)) * senses, dtype=np.float64)


def as_the_gyro_sees(rates: Floats, settings: FogSettings) -> Floats:
    """Rates on the axis, deg/s, with the nonlinearity, asymmetry and dead zone of the simulated gyro."""
    simulation = settings.simulation
    full = max(settings.figures.rates_dps)
    shape = (
        1
        + simulation.cubic_ppm / _PPM * (rates / full) ** 2
        + simulation.asymmetry_ppm / _PPM / 2 * np.sign(rates)
    )
    largest = min(simulation.largest_rate_dps, _OF_FRINGE_LIMIT * settings.coil.fringe_limit_dps)
    return np.clip(np.where(np.abs(rates) < simulation.dead_zone_dps, 0.0, rates * shape), -largest, largest)


def loop_settings(settings: FogSettings) -> LoopDesign:
    """Electronics of the simulated gyro."""
    gyro, simulation = settings.gyro, settings.simulation
    return LoopDesign(
        dac_bits=gyro.dac_bits,
        fractional_bits=gyro.fraction_bits,
        two_pi_error=simulation.two_pi_error,
        gated=gyro.gated_resets,
        injection_path=settings.selfcal.path,
        injection_two_pi_error=simulation.injection_error,
        angle_random_walk_deg_per_sqrt_h=simulation.angle_random_walk,
        bias_dph=simulation.bias_dph,
    )


def quiet(settings: LoopDesign) -> LoopDesign:
    """The same electronics without noise, for a picture of the signals."""
    return replace(settings, angle_random_walk_deg_per_sqrt_h=0.0)


# --------------------
# The simulated gyro behind a serial port, for practice and for tests: the model of the output words as frames.


class ServedGyro:
    """What a gyro server asks for numbers: output words of the settings' gyro at a rate that can be changed."""

    def __init__(self, settings: FogSettings, interval_s: float) -> None:
        self.rate_dps = 0.0
        self.temperature_c = settings.figures.reference_temperature_c
        self._settings, self._interval_s = settings, interval_s
        self._loop = loop_settings(settings)
        self.noise_from(0)
        self._earth = EARTH_RATE_DPS * np.sin(np.deg2rad(settings.site.latitude_deg))
        self._step, self._held = 0.0, False

    def noise_from(self, number: int) -> None:
        """Begin anew with other noise, for one of several gyros."""
        coil = self._settings.coil.scaled(1 + 1e-6 * self._settings.simulation.scale_change_ppm)
        self._model = OutputModel(coil, self._loop, self._settings.simulation.seed + number)

    def samples(self, count: int) -> Mapping[str, NDArray[np.float64]]:
        """The next output words, in counts."""
        block = self._model.run(
            count,
            output_period_s=self._interval_s,
            rate_dps=as_the_gyro_sees(np.array(self.rate_dps + self._earth), self._settings),
            injected_step=self._step,
            closed=not self._held,
        )
        gyro = self._settings.gyro
        resolution = gyro.output_resolution or 1.0
        counts = resolution * np.round(gyro.counts_per_code * block.counts / resolution)
        return {
            "counts": counts,
            "temperature": np.full(count, self.temperature_c),
            "normal_error": np.nan_to_num(block.normal_error),
            "reset_error": np.nan_to_num(block.reset_error),
        }

    def command(self, name: str, step: float) -> None:
        """Inject, hold the feedback, open or close the loop; ValueError for a step beyond the converter."""
        if name != "inject":
            self._held = name != "close_loop"
        elif abs(step) > self._loop.largest_step:
            raise ValueError(f"a step of {step:g} codes is beyond the converter")
        else:
            self._step = step


class SpokenAs:
    """A served gyro whose outputs are named, and in the unit, as a frame format has them."""

    # Of several outputs that of the table's last axis sees its rate, the others are gyros at rest.

    def __init__(self, gyro: ServedGyro, settings: FogSettings, layout: FrameFormat) -> None:
        self._gyro = gyro
        self._unit = 1.0
        if layout.unit != "counts":
            self._unit = 1 / counts_per_unit(layout.unit, layout.interval_s, settings.nominal_scale_factor)
        turned = layout.output_of(settings.table.axes[-1])
        self._turned = turned
        self._others = {name: ServedGyro(settings, layout.interval_s) for name in layout.outputs if name != turned}
        for number, other in enumerate(self._others.values(), start=1):
            other.noise_from(number)

    def samples(self, count: int) -> Mapping[str, NDArray[np.float64]]:
        """The next output words of all gyros."""
        made = dict(self._gyro.samples(count))
        made[self._turned] = self._unit * made.pop("counts")
        for name, other in self._others.items():
            made[name] = self._unit * other.samples(count)["counts"]
        return made

    def command(self, name: str, step: float) -> None:
        """What the gyro on the table is told; ValueError as there."""
        self._gyro.command(name, step)


@contextmanager
def serve_gyro(
    settings: FogSettings,
    layout: FrameFormat,
    *,
    tcp_port: int | None = None,
    speed: float = 1.0,
    rate_dps: float = 0.0,
    clock_ppm: float = 0.0,
) -> Iterator[PtyGyroServer | TcpGyroServer]:
    """Serve the simulated gyro until the context ends."""
    gyro = ServedGyro(settings, layout.interval_s)
    gyro.rate_dps = rate_dps
    model = SpokenAs(gyro, settings, layout)
    try:
        if tcp_port is None:
            server: PtyGyroServer | TcpGyroServer = PtyGyroServer(model, layout, speed=speed, clock_ppm=clock_ppm)
        else:
            server = TcpGyroServer(model, layout, tcp_port=tcp_port, speed=speed, clock_ppm=clock_ppm)
    except OSError as error:
        raise UsageError(f"the simulated gyro cannot be served: {error.strerror or error}") from None
    with server:
        yield server
