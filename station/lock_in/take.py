"""The paper's experiment: find the tilt on a fast table, go to one slow rate or several, keep every record.

What is measured is only saved here; numbers come from :mod:`station.lock_in.read`, which reads the saved run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from analysis.lock_in_run import Tilt
from instrument import InstrumentError, TransferError, Waveform
from station.errors import Failure, NoUsableSignal, RunError, StationError, describe_failure
from station.lock_in.bench.bench import Bench, open_bench
from station.lock_in.rate_plan import RateStep, rate_plan
from station.lock_in.read import fast_run_tilt
from station.provenance import provenance
from station.runs.database import utc_now
from station.runs.progress import Progress
from station.runs.store import NewRecord, Purpose, RunWriter, open_run
from station.scope.autoset import ScopeSetting, find_beat, fit_channel
from station.settings.load import Settings

_ATTEMPTS = 3


@dataclass(frozen=True)
class Taken:
    """How the taking of records ended.

    Attributes
    ----------
    path : Path
        The run's SQLite file; it holds every record that was acknowledged.
    failure : Failure or None
        What stopped it before its time.
    """

    path: Path
    failure: Failure | None


def take_run(settings: Settings, progress: Progress) -> Taken:
    """Do the whole experiment and save it.

    Parameters
    ----------
    settings : Settings
    progress : Progress

    Returns
    -------
    Taken
        Also when it was interrupted or the link was lost: the run then holds the records so far.

    Raises
    ------
    InstrumentError, StationError
        If the bench cannot be opened or the run cannot be written: then there is no run.
    """
    writer: RunWriter | None = None
    try:
        with open_bench(settings) as bench:
            _set_up(settings, bench)
            writer = RunWriter(Path(settings.output.directory), _facts(settings, bench))
            progress.note(f"{bench.scope.identity.model} ({settings.scope.resource or 'simulated'})")
            _experiment(settings, bench, writer, progress)
        writer.save_facts({"ended_at": utc_now(), "outcome": "complete"})
        return Taken(writer.path, None)
    except (InstrumentError, StationError, OSError, KeyboardInterrupt) as error:
        if writer is None:
            raise
        failure = describe_failure(error)
        assert failure is not None  # all of these classes are known to it
        with suppress(RunError):  # a full disk takes no more; the records it took are there
            writer.save_facts({"ended_at": utc_now(), "outcome": failure.as_json()})
        return Taken(writer.path, failure)
    finally:
        progress.close()
        if writer is not None:
            writer.close()


def _facts(settings: Settings, bench: Bench) -> dict[str, object]:
    return {
        "settings": settings.model_dump(mode="json"),
        "simulated": settings.simulated,
        "identity": asdict(bench.scope.identity),
        "provenance": provenance(),
    }


def _set_up(settings: Settings, bench: Bench) -> None:
    """Set what the trial records do not choose; a channel that is not there shows here."""
    wanted = settings.scope
    for channel in _channels(settings):
        bench.scope.set_channel(
            channel,
            coupling=wanted.coupling,
            probe=wanted.probe,
            bandwidth_limit=wanted.bandwidth_limit,
            invert=False,
        )
    bench.scope.set_acquisition(mode="SAMPLE")


def _channels(settings: Settings) -> tuple[str, ...]:
    """The channels of one acquisition: the sine, and the cosine if there is a second photodiode."""
    scope = settings.scope
    return (scope.channel, scope.quadrature_channel) if scope.quadrature_channel else (scope.channel,)


def _experiment(settings: Settings, bench: Bench, writer: RunWriter, progress: Progress) -> None:
    plan = rate_plan(settings)
    setting, cosine = None, 1.0
    if bench.table is not None:
        tilt, setting = _find_tilt(settings, bench, writer, progress)
        cosine = math.cos(math.radians(tilt.tilt_deg))
        progress.note(f"tilt {tilt.tilt_deg:.3f}°")
    taken: list[dict[str, object]] = []
    without_beat: list[str] = []
    for step in plan:
        table_rate = step.rate_dps / cosine if bench.table is not None else None
        try:
            setting, facts = _take_step(settings, bench, writer, progress, step, table_rate, setting)
        except NoUsableSignal as error:
            if len(plan) == 1:
                raise
            # the other rates may do: which one gave nothing stands in the run and in the result
            without_beat.append(f"{step.sense * step.over_lock_in:+g} expected lock-in rates: {error}")
            progress.note(f"no record at {without_beat[-1]}")
            writer.save_facts({"rates_without_beat": without_beat})
            continue
        taken.append(facts)
        writer.save_facts({"rates": taken})
    if not taken:
        raise NoUsableSignal(without_beat[0])


def _take_step(
    settings: Settings,
    bench: Bench,
    writer: RunWriter,
    progress: Progress,
    step: RateStep,
    table_rate: float | None,
    start: ScopeSetting | None,
) -> tuple[ScopeSetting, dict[str, object]]:
    """Go to one rate, find the beat there and take the records; `table_rate` None: the table turns already."""
    frequency = settings.gyro.scale_factor_pulses_per_deg * abs(step.rate_dps)
    if table_rate is None:
        progress.note("looking for the beat")
    else:
        progress.note(f"slow rate {table_rate:.4g} deg/s on the table")
        table_rate = bench.turn_table(table_rate, settings.table.settle_s)
    begin = frequency if start is None else _for_frequency(start, frequency)
    setting = find_beat(bench.scope, settings.scope, settings.measurement, begin)
    channels = _channels(settings)
    for channel in channels[1:]:
        fit_channel(bench.scope, channel, settings.scope, settings.measurement, setting)
    facts: dict[str, object] = {
        "over_lock_in": step.over_lock_in,
        "table_rate_dps": table_rate,
        "scope_setting": asdict(setting),
    }
    writer.save_facts({"scope_setting": asdict(setting), "table_rate_dps": table_rate})
    count = settings.measurement.records
    progress.start("records", count)
    for _ in range(count):
        waveforms, conditions = take_record(bench, channels)
        known = {**conditions, "table_rate_dps": table_rate, "over_lock_in": step.over_lock_in}
        save_acquisition(writer, "measure", waveforms, channels, known)
        progress.advance()
    return setting, facts


def _find_tilt(
    settings: Settings, bench: Bench, writer: RunWriter, progress: Progress
) -> tuple[Tilt, ScopeSetting]:
    """Turn fast, in both senses if asked for, and find the tilt from the beat frequency."""
    fast = settings.table.fast_rate_dps
    senses = (fast, -fast) if settings.table.both_senses else (fast,)
    count = settings.measurement.tilt_records
    # with the axis along the table's the beat would be as fast as this
    start: ScopeSetting | float = settings.gyro.scale_factor_pulses_per_deg * fast
    for wanted in senses:
        progress.note(f"fast run at {wanted:+g} deg/s")
        rate = bench.turn_table(wanted, settings.table.settle_s)
        start = find_beat(bench.scope, settings.scope, settings.measurement, start)
        progress.start("tilt", count)
        for _ in range(count):
            channels = (settings.scope.channel,)
            waveforms, conditions = take_record(bench, channels)
            save_acquisition(writer, "tilt", waveforms, channels, {**conditions, "table_rate_dps": rate})
            progress.advance()
    assert isinstance(start, ScopeSetting)  # there is at least one sense
    tilt = fast_run_tilt(open_run(writer.path), settings)
    return tilt, start


def take_record(bench: Bench, channels: tuple[str, ...]) -> tuple[tuple[Waveform, ...], dict[str, object]]:
    """Acquire the records of one acquisition and the conditions under which they were taken.

    Parameters
    ----------
    bench : Bench
    channels : tuple of str

    Returns
    -------
    tuple of Waveform
        One for each channel.
    dict
        Plain JSON: azimuth before and after where it is known, truth on a simulated bench.

    Raises
    ------
    InstrumentError
        If they do not come, a damaged transfer after some attempts.
    """
    for attempt in range(1, _ATTEMPTS + 1):
        azimuth = bench.azimuth()
        try:
            waveforms = bench.scope.acquire(channels)
        except TransferError:
            if attempt == _ATTEMPTS:
                raise
            continue
        azimuth_after = bench.azimuth()
        break
    conditions: dict[str, object] = {}
    if azimuth is not None and azimuth_after is not None:
        conditions |= {"azimuth_start_deg": azimuth, "azimuth_end_deg": azimuth_after}
    if bench.truth is not None:
        conditions["truth"] = bench.truth()
    return waveforms, conditions


def save_acquisition(
    writer: RunWriter,
    purpose: Purpose,
    waveforms: Sequence[Waveform],
    channels: Sequence[str],
    conditions: Mapping[str, object],
) -> None:
    """Save the records of one acquisition in one commit; a second channel is the quadrature of the first."""
    purposes: tuple[Purpose, ...] = (purpose, "quadrature")
    writer.save_records(
        [
            NewRecord(kind, wave.codes, wave.preamble.to_text(), {"channel": channel, **conditions})
            for kind, wave, channel in zip(purposes, waveforms, channels, strict=False)
        ]
    )


def _for_frequency(setting: ScopeSetting, frequency: float) -> ScopeSetting:
    return ScopeSetting(**{**asdict(setting), "beat_frequency": frequency})
