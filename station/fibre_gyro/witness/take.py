"""Records of the modulator staircase: from an oscilloscope while the gyro injects, or from its files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from analysis.fibre_gyro import steps_beyond_dac
from instrument import TDS2014, ManualRateTable, Waveform, read_waveform
from instrument.fibre_gyro import FibreGyroLink
from station.errors import UsageError
from station.fibre_gyro.common import PPM, beyond_converter
from station.fibre_gyro.segments import PlannedSegment
from station.fibre_gyro.serial_bench import SerialFogBench
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.sniff.known import read_frame_format
from station.fibre_gyro.witness.evaluate import PURPOSE
from station.runs.operator import ask_operator
from station.runs.store import NewRecord
from station.runs.taking import Session
from station.scope.autoset import KnobPositions, fit_channel, oscilloscope_steps
from station.scope.open import open_scope

_SETTING = "scope_setting"


@dataclass(frozen=True)
class _Shape:
    """What a record shall hold: at least so many steps, if each has at least so many samples."""

    periods_min: float = 80.0
    samples_per_period_min: float = 20.0
    fill_levels: float = 100.0


_SHAPE = _Shape()


def is_simulated(settings: FogSettings) -> bool:
    """Whether the oscilloscope is simulated: none is named."""
    return not settings.witness.resource


def take(settings: FogSettings, session: Session) -> None:
    """Take the records; of a run that was cut short those that are missing, with the scope set as it was."""
    _check(settings)
    witness, before = settings.witness, session.facts.get(_SETTING)
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


def take_files(settings: FogSettings, paths: Sequence[Path], session: Session) -> None:
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
    step, bits = settings.witness.step_codes, settings.gyro.dac_bits
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
        "two_pi_voltage_v": 2 * half_wave * (1 + eps),
        "two_pi_error_ppm": PPM * eps,
        "step_time_s": settings.coil.transit_time,
        "step_codes": settings.witness.step_codes,
    }
    return {"truth": truth}


def _scope(settings: FogSettings, session: Session) -> AbstractContextManager[TDS2014]:
    witness = settings.witness
    if not is_simulated(settings):
        return open_scope(
            witness.resource,
            witness.baud_rate,
            tell=session.progress.note,
            put_back=session.panel_to_put_back,
            same_as=session.scope_so_far,
        )
    from station.fibre_gyro.witness.modulator import open_simulated_scope

    return open_simulated_scope(settings, times_resumed=session.times_resumed)


@contextmanager
def _injecting(settings: FogSettings) -> Iterator[dict[str, Any]]:
    """Hold the feedback and inject the step, if the gyro's port is named; in closed loop the two would cancel."""
    if not settings.link.port:
        yield {"step_codes": settings.witness.step_codes} if is_simulated(settings) else {}
        return
    wanted = {"loop": "held", "step_codes": settings.witness.step_codes, "rate_dps": 0.0}
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
    witness, beat = settings.witness, 1 / settings.coil.transit_time
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
