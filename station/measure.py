"""The paper's experiment: find the tilt on a fast table, go to a slow rate, take records, keep every one.

What is measured is only saved here; numbers come from :mod:`station.evaluate`, which reads the saved run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from instrument import InstrumentError, TransferError, Waveform
from station.autoset import ScopeSetting, find_beat
from station.bench import Bench, open_bench
from station.errors import Failure, RunError, StationError, describe_failure
from station.progress import Progress
from station.provenance import provenance
from station.runs import RunWriter, open_run, utc_now
from station.settings import Settings
from station.tilt import Tilt, evaluate_tilt

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
    bench.scope.set_channel(
        wanted.channel,
        coupling=wanted.coupling,
        probe=wanted.probe,
        bandwidth_limit=wanted.bandwidth_limit,
        invert=False,
    )
    bench.scope.set_acquisition(mode="SAMPLE")


def _experiment(settings: Settings, bench: Bench, writer: RunWriter, progress: Progress) -> None:
    scope, wanted = bench.scope, settings.scope
    gyro, table = settings.gyro, settings.table
    expected = gyro.expected_lock_in_rate_dps * table.slow_rate_over_lock_in
    if bench.table is None:
        progress.note("looking for the beat")
        setting = find_beat(scope, wanted, settings.measurement, gyro.scale_factor_pulses_per_deg * expected)
        table_rate = None
    else:
        tilt, setting = _find_tilt(settings, bench, writer, progress)
        table_rate = expected / math.cos(math.radians(tilt.tilt_deg))
        progress.note(f"tilt {tilt.tilt_deg:.3f}°, slow rate {table_rate:.4g} deg/s on the table")
        table_rate = bench.turn_table(table_rate, table.settle_s)
        slower = gyro.scale_factor_pulses_per_deg * expected
        setting = find_beat(scope, wanted, settings.measurement, _for_frequency(setting, slower))
    writer.save_facts({"scope_setting": asdict(setting), "table_rate_dps": table_rate})
    count = settings.measurement.records
    progress.start("records", count)
    for _ in range(count):
        waveform, conditions = take_record(bench, wanted.channel)
        save_record(writer, "measure", waveform, {**conditions, "table_rate_dps": table_rate})
        progress.advance()


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
            waveform, conditions = take_record(bench, settings.scope.channel)
            save_record(writer, "tilt", waveform, {**conditions, "table_rate_dps": rate})
            progress.advance()
    assert isinstance(start, ScopeSetting)  # there is at least one sense
    tilt = evaluate_tilt(open_run(writer.path).taken_for("tilt"), settings)
    return tilt, start


def take_record(bench: Bench, channel: str) -> tuple[Waveform, dict[str, object]]:
    """Acquire one record and the conditions under which it was taken.

    Parameters
    ----------
    bench : Bench
    channel : str

    Returns
    -------
    Waveform
    dict
        Plain JSON: channel, azimuth before and after where it is known, truth on a simulated bench.

    Raises
    ------
    InstrumentError
        If it does not come, a damaged transfer after some attempts.
    """
    for attempt in range(1, _ATTEMPTS + 1):
        azimuth = bench.azimuth()
        try:
            waveform = bench.scope.acquire(channel)
        except TransferError:
            if attempt == _ATTEMPTS:
                raise
            continue
        azimuth_after = bench.azimuth()
        break
    conditions: dict[str, object] = {"channel": channel}
    if azimuth is not None and azimuth_after is not None:
        conditions |= {"azimuth_start_deg": azimuth, "azimuth_end_deg": azimuth_after}
    if bench.truth is not None:
        conditions["truth"] = bench.truth()
    return waveform, conditions


def save_record(writer: RunWriter, purpose: str, waveform: Waveform, conditions: Mapping[str, object]) -> None:
    writer.save_record(purpose, waveform.codes, waveform.preamble.to_text(), conditions)


def _for_frequency(setting: ScopeSetting, frequency: float) -> ScopeSetting:
    return ScopeSetting(**{**asdict(setting), "beat_frequency": frequency})
