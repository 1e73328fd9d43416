"""Records of the modulator staircase, from an oscilloscope or from its files, saved raw as a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from analysis.fibre_gyro import steps_beyond_dac
from instrument import TDS2014, InstrumentError, Waveform, read_waveform
from instrument.fibre_gyro import FibreGyroLink
from instrument.rate_table import ManualRateTable
from station.errors import RunError, StationError, UsageError, describe_failure
from station.fibre_gyro.campaign import Campaign, PlannedSegment
from station.fibre_gyro.selfcal.measurement import beyond_words
from station.fibre_gyro.serial_bench import SerialFogBench, ask_operator, read_frame_format
from station.fibre_gyro.settings import FogSettings
from station.lock_in.bench.bench import open_scope
from station.provenance import provenance
from station.runs.database import utc_now
from station.runs.progress import Progress
from station.runs.store import RunWriter
from station.scope.autoset import ScopeSetting, fit_channel, oscilloscope_steps
from station.settings.load import default_settings

PURPOSE: Final = "witness"
_STEPS, _SAMPLES_PER_STEP = 80, 20  # a record holds at least so many steps, if each has at least so many samples


def is_simulated(settings: FogSettings) -> bool:
    """Whether the oscilloscope is simulated: none is named."""
    return not settings.witness.resource


def take_staircase_run(settings: FogSettings, progress: Progress) -> Campaign:
    """Record the staircase and save it.

    Parameters
    ----------
    settings : FogSettings
    progress : Progress

    Returns
    -------
    Campaign
        Also when it was interrupted or the link was lost: the run then holds the records so far.

    Raises
    ------
    InstrumentError, StationError
        Oscilloscope or gyro cannot be opened, or the run cannot be written: then there is no run.
    """
    _check(settings)
    writer: RunWriter | None = None
    try:
        with _injecting(settings) as reached, _open(settings) as scope:
            _set_up(scope, settings)
            writer = RunWriter(Path(settings.output.directory), _facts(settings, scope, reached))
            source = settings.witness.resource or "simulated"
            progress.note(f"{scope.identity.model} ({source}), run {writer.path}")
            progress.start("records", settings.witness.records)
            for _ in range(settings.witness.records):
                _save(writer, scope.acquire(settings.witness.channel), {"channel": settings.witness.channel})
                progress.advance()
        writer.save_facts({"ended_at": utc_now(), "outcome": "complete"})
        return Campaign(writer.path, None)
    except (InstrumentError, StationError, OSError, KeyboardInterrupt) as error:
        if writer is None:
            raise
        failure = describe_failure(error)
        assert failure is not None  # all of these classes are known to it
        with suppress(RunError):  # a full disk takes no more; the records it took are there
            writer.save_facts({"ended_at": utc_now(), "outcome": failure.as_json()})
        return Campaign(writer.path, failure)
    finally:
        progress.close()
        if writer is not None:
            writer.close()


def staircase_run_from_files(settings: FogSettings, paths: Sequence[Path]) -> Campaign:
    """Make a run of files that the oscilloscope or its PC software wrote.

    Parameters
    ----------
    settings : FogSettings
    paths : sequence of Path
        Tektronix CSV or ISF files.

    Raises
    ------
    FileFormatError, OSError, RunError
        A file cannot be read, or the run cannot be written; then there is no run.
    UsageError
        A file holds more than eight bits a point.
    """
    waveforms = [read_waveform(path) for path in paths]
    for path, waveform in zip(paths, waveforms, strict=True):
        if waveform.codes.dtype != np.int8:
            raise UsageError(f"{path}: holds more than eight bits a point: save a single record, not an average")
    facts = _facts(settings, None, {}) | {"simulated": False, "logs": [str(path) for path in paths]}
    facts.pop("truth", None)
    with RunWriter(Path(settings.output.directory), facts) as writer:
        for path, waveform in zip(paths, waveforms, strict=True):
            _save(writer, waveform, {"file": path.name})
        writer.save_facts({"ended_at": utc_now(), "outcome": "complete"})
    return Campaign(writer.path, None)


def _check(settings: FogSettings) -> None:
    witness = settings.witness
    if is_simulated(settings) and settings.link.port:
        raise UsageError(
            f"link.port names a real gyro ({settings.link.port}) and witness.resource no oscilloscope: give both, "
            "or neither"
        )
    if not (is_simulated(settings) or settings.link.port):
        return  # the operator brings a staircase about
    if steps_beyond_dac(witness.step_codes, settings.gyro.dac_bits):
        raise UsageError(f"witness.step_codes: {beyond_words(witness.step_codes, settings.gyro.dac_bits)}")
    if not witness.step_codes:
        raise UsageError("witness.step_codes: without a step there is no staircase; give 2^N/100 to 2^N/8 codes")


def _facts(settings: FogSettings, scope: TDS2014 | None, reached: dict[str, Any]) -> dict[str, Any]:
    simulated = scope is not None and is_simulated(settings)
    facts: dict[str, Any] = {
        "command": PURPOSE,
        "settings": settings.model_dump(mode="json"),
        "simulated": simulated,
        "injected": reached,
        "provenance": provenance(),
    }
    if scope is not None:
        facts["identity"] = asdict(scope.identity)
    if simulated:
        eps, half_wave = settings.simulation.two_pi_error, settings.simulation.half_wave_v
        facts["truth"] = {"two_pi_voltage_v": 2 * half_wave * (1 + eps), "two_pi_error_ppm": 1e6 * eps}
        facts["truth"] |= {"step_time_s": settings.coil.transit_time, "step_codes": settings.witness.step_codes}
    return facts


@contextmanager
def _open(settings: FogSettings) -> Iterator[TDS2014]:
    if is_simulated(settings):
        from station.fibre_gyro.simulated_modulator import open_simulated_scope

        with open_simulated_scope(settings) as scope:
            yield scope
        return
    with open_scope(settings.witness.resource, settings.witness.baud_rate) as scope:
        yield scope


@contextmanager
def _injecting(settings: FogSettings) -> Iterator[dict[str, Any]]:
    """Hold the feedback and inject the step, if the gyro's port is named; in closed loop the two would cancel."""
    if not settings.link.port:
        step = settings.witness.step_codes
        yield {"step_codes": step} if is_simulated(settings) else {}
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


def _set_up(scope: TDS2014, settings: FogSettings) -> None:
    """Set the scope so that a record holds some eighty steps and the staircase fills the screen."""
    witness, bench = settings.witness, default_settings("bench")
    channel = witness.channel
    scope.set_channel(channel, coupling="DC", probe=witness.probe, bandwidth_limit=False, invert=False)
    scope.set_acquisition(mode="SAMPLE")
    wanted = oscilloscope_steps().time_base(1 / settings.coil.transit_time, _STEPS, _SAMPLES_PER_STEP)
    base = scope.set_timebase(wanted, position=0.0)
    scope.set_trigger(source=channel, level=0.0, slope="FALL", mode="AUTO")
    knobs = bench.scope.model_copy(update={"channel": channel, "probe": witness.probe})
    start = ScopeSetting(base, 1.0 * witness.probe, 0.0, 0.0, 1 / settings.coil.transit_time)
    vertical = fit_channel(scope, channel, knobs, bench.measurement, start)
    scope.set_trigger(source=channel, level=-vertical.position * vertical.scale, slope="FALL", mode="AUTO")


def _save(writer: RunWriter, waveform: Waveform, conditions: dict[str, object]) -> None:
    writer.save_record(PURPOSE, waveform.codes, waveform.preamble.to_text(), conditions)
