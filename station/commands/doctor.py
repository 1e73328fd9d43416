"""``gyrolock doctor``: checks of an installation; each says what was found, and what to do about it."""

import json
import os
import platform
import re
import shutil
import sqlite3
import sys
import tempfile
import zipfile
from contextlib import ExitStack, nullcontext
from dataclasses import asdict
from importlib.metadata import requires
from pathlib import Path

import click

from instrument.text_files import recorded
from station.errors import EXIT_INSTRUMENT, EXIT_OK, CannotWrite, SettingsError, one_line
from station.files import version
from station.lock_in.settings import Settings, default_settings, load_settings
from station.results.result import Check, guarded
from station.settings import shipped_settings
from station.shell.options import CHANNELS, config_option, full_option, json_option, transcript_option
from station.terminal import PRINTS_ALL, print_json, prints, say

_PACKAGES = [re.split(r"[^\w-]", one)[0] for one in requires("gyrolock") or () if "extra ==" not in one]
_DISK_LOW = 200 * 2**20
_TRANSCRIPT = "transcript.jsonl"


@click.command("doctor")
@click.option("--resource", metavar="NAME", help="Look at this instrument too.")
@click.option(
    "--station",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Look at everything that this campaign will need: the table moves.",
)
@click.option(
    "--bundle",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.zip",
    help="Pack versions, settings, findings and what was said to the instrument, for a bug report.",
)
@click.option(
    "--probe", "probed", type=CHANNELS, metavar="CHn", help="Look at the PROBE COMP output on this input."
)
@full_option
@transcript_option
@config_option
@json_option
def doctor_command(
    resource: str | None,
    station: Path | None,
    bundle: Path | None,
    probed: str | None,
    config: Path | None,
    as_json: bool,
) -> int:
    """Check this installation; say what is missing.

    With --probe the scope's own square wave (PROBE COMP) says whether a 10X probe is compensated.
    With --station the bench of a campaign is opened and looked at too: instruments and their calibration dates,
    disk, clock, rate table, level, trigger and noise. Exit code 3 if something must be mended.
    """
    settings = load_settings(config, resource=resource)
    with ExitStack() as stack:
        said = Path(stack.enter_context(tempfile.TemporaryDirectory())) / _TRANSCRIPT
        with recorded(said) if bundle is not None else nullcontext():
            named = resource or settings.scope.resource or None
            checks = examine(settings, named)
            if probed is not None:
                if named is None:
                    raise click.UsageError("--probe looks at an oscilloscope: name it by --resource")
                checks.append(guarded("probe", lambda: _probe(named, probed, settings)))
            if station is not None:
                from station.campaign.bench import examine_campaign
                from station.campaign.file import read_campaign

                checks += examine_campaign(read_campaign(station, "any unit"))
        if bundle is not None:
            _pack(bundle, settings, checks, said)
    bad = [check for check in checks if check.state == "bad"]
    if as_json:
        print_json({"ok": not bad, "checks": [asdict(check) for check in checks]})
    else:
        say(_ready(bad), answer=True)
        for check in checks if prints(PRINTS_ALL) else [check for check in checks if check.state != "ok"]:
            say(f"{check.state:<5}{check.name:<14}{check.text}")
    return EXIT_INSTRUMENT if bad else EXIT_OK


def _ready(bad: list[Check]) -> str:
    """What can be measured with, and what with nothing but a package more."""
    from instrument.discovery import missing_transports

    missing = missing_transports()
    kinds = [kind for kind in ("RS-232", "TCP", "USB", "GPIB") if kind not in missing]
    if bad:
        return f"NOT READY: {', '.join(check.name for check in bad)}"
    without = "".join(f". NOT for {kind}: {advice}" for kind, advice in missing.items())
    return f"READY for simulated measurements, {', '.join(kinds)}{without}"


def _pack(bundle: Path, settings: Settings, checks: list[Check], said: Path) -> None:
    """Write the ZIP file of a bug report: nothing is in it that these four files do not show."""
    versions = {"gyrolock": version("gyrolock"), "python": sys.version, "system": platform.platform()}
    contents = {
        "versions.json": json.dumps(versions | {name: version(name) for name in _PACKAGES}, indent=2),
        "settings.json": settings.model_dump_json(indent=2),
        "findings.json": json.dumps([asdict(check) for check in checks], indent=2),
        _TRANSCRIPT: said.read_text(encoding="ascii"),
    }
    try:
        with zipfile.ZipFile(bundle, "w", zipfile.ZIP_DEFLATED) as file:
            for name, text in contents.items():
                file.writestr(name, text)
    except OSError as error:
        raise CannotWrite(f"{bundle} cannot be written: {error.strerror or error}") from None


def examine(settings: Settings, resource: str | None = None) -> list[Check]:
    """Examine this installation, and one instrument if it is named."""
    good = sys.version_info >= (3, 11)
    text = f"{platform.python_version()} on {platform.platform(terse=True)}"
    checks = [
        Check("Python", "ok" if good else "bad", text if good else f"{text}: 3.11 or newer is needed"),
        _packages(),
        _settings_files(),
        _visa(),
        _links(),
        _serial_ports(),
        _disk(settings),
        Check("SQLite", "ok", sqlite3.sqlite_version),
    ]
    checks.append(guarded("test record", _test_record))
    if resource:
        checks.append(guarded("resource", lambda: _resource(resource, settings)))
    return checks


def _packages() -> Check:
    versions = {name: version(name) for name in _PACKAGES}
    missing = [name for name, found in versions.items() if found == "not installed"]
    if missing:
        return Check("packages", "bad", f"missing: {', '.join(missing)}; install gyrolock again")
    return Check("packages", "ok", ", ".join(f"{name} {found}" for name, found in versions.items()))


def _settings_files() -> Check:
    try:
        default_settings("simulated")
        default_settings("bench")
        return Check("settings", "ok", f"defaults in {shipped_settings('simulated').parent}")
    except (SettingsError, ValueError) as error:
        return Check("settings", "bad", f"{one_line(error)}; install gyrolock again")


def _visa() -> Check:
    import pyvisa

    try:
        manager = pyvisa.ResourceManager()
    except (OSError, ValueError, pyvisa.Error) as error:
        return Check("VISA", "bad", f"{one_line(error)}; install pyvisa-py or a vendor's VISA")
    backend = str(manager.visalib)
    manager.close()
    return Check("VISA", "ok", backend)


def _links() -> Check:
    from instrument.discovery import missing_transports

    missing = missing_transports()
    if not missing:
        return Check("links", "ok", "GPIB, USB, RS-232 and TCP can be used")
    return Check("links", "ok", "; ".join(f"no {kind}: {advice}" for kind, advice in missing.items()))


def _serial_ports() -> Check:
    from serial.tools.list_ports import comports

    ports = [port.device for port in comports()]
    if not ports:
        return Check("serial ports", "ok", "none")
    closed = [port for port in ports if os.path.exists(port) and not os.access(port, os.R_OK | os.W_OK)]
    if closed:
        advice = "your user may not open them; on Linux join the group that owns them (often dialout)"
        return Check("serial ports", "bad", f"{', '.join(closed)}: {advice}")
    return Check("serial ports", "ok", ", ".join(ports))


def _disk(settings: Settings) -> Check:
    directory = Path(settings.output.directory).absolute()
    existing = next(folder for folder in (directory, *directory.parents) if folder.exists())
    if not os.access(existing, os.W_OK):
        return Check("disk", "bad", f"{directory} cannot be written: choose another with --runs DIR")
    free = shutil.disk_usage(existing).free
    text = f"{free / 2**30:.1f} GiB free for {directory}"
    return Check("disk", "ok", text) if free > _DISK_LOW else Check("disk", "bad", f"{text}: make room")


def _test_record() -> Check:
    """Send one record of the simulated scope through a real link, the store and the analysis."""
    from station.live.events import Progress
    from station.lock_in.evaluate import evaluate_records
    from station.lock_in.served import at_slow_rate
    from station.ring_laser.bench import open_bench
    from station.ring_laser.records import acquisition_records, take_record
    from station.runs.store import RunWriter, open_run
    from station.sources.workers import ThisProcess

    settings = at_slow_rate(default_settings("simulated"))
    with tempfile.TemporaryDirectory() as folder, open_bench(settings) as bench:
        with RunWriter.create(Path(folder), {"simulated": True}) as writer:
            bench.scope.set_channel(1, scale=0.1)
            bench.scope.set_timebase(0.025)
            waveforms, conditions = take_record(bench, ("CH1",))
            writer.save_records(acquisition_records("measure", "1", waveforms, ("CH1",), conditions))
        evaluation = evaluate_records(open_run(writer.path), settings, {}, ThisProcess(), Progress())
        name = bench.scope.resource_name
    if not evaluation.usable:
        return Check("test record", "bad", f"the simulated scope at {name} gave no lock-in rate")
    return Check("test record", "ok", f"{waveforms[0].codes.size} points from the simulated scope at {name}")


def _resource(name: str, settings: Settings) -> Check:
    from instrument.discovery import check_resource

    found = check_resource(name, baud_rate=settings.scope.baud_rate or None)
    if found.identity is None:
        return Check("resource", "bad", f"{name}: {found.problem}")
    return Check("resource", "ok", f"{name}: {found.identity.text}")


def _probe(resource: str, channel: str, settings: Settings) -> Check:
    """How flat the scope's own square wave of 1 kHz comes through a probe."""
    import numpy as np

    from analysis import fit_harmonics
    from station.scope.tools import open_scope

    with open_scope(resource, settings.scope.baud_rate) as scope:
        scope.set_channel(channel, probe=settings.scope.probe, scale=1.0, position=-2.5, displayed=True)
        scope.set_timebase(5e-4, position=0.0)
        scope.set_trigger(source=channel, level=2.5, slope="RISE", mode="AUTO")
        waveform = scope.acquire(channel)
    volts, period = waveform.volts, 1 / float(fit_harmonics(waveform.volts, waveform.sample_interval).frequency)
    middle = (np.nanmin(volts) + np.nanmax(volts)) / 2
    edges = np.flatnonzero((volts[1:] > middle) != (volts[:-1] > middle))
    none = Check("probe", "bad", f"{channel}: no square wave of 1 kHz: put the probe on PROBE COMP")
    if not 0.8e-3 < period < 1.2e-3:
        return none
    half = round(period / 2 / waveform.sample_interval)
    tops = [(volts[edge + 1 : edge + half] - middle) * np.sign(volts[edge + 2] - middle) for edge in edges[:-1]]
    top = np.mean([one for one in tops if len(one) == half - 1] or [np.zeros(half)], axis=0)
    early, late = top[half // 50 : half // 15].mean(), top[-half // 5 :].mean()
    if not late > 0.8 * top[half // 2] > 0:
        return none
    # of the top, not of half the swing; what has died away in the first 20 us of 100 is put back
    error = 1.25 * (early - late) / (2 * late)
    if abs(error) < 0.005:
        return Check("probe", "ok", f"{channel}: compensated within 0.5 % (1 kHz, {2 * late:.3g} V)")
    way = "too high" if error > 0 else "too low"
    return Check(
        "probe", "bad", f"{channel}: the edge is {abs(error):.1%} {way}: turn the probe's trimmer until it is flat"
    )
