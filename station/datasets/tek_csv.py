"""Export as the oscilloscope does it: a CSV file for each record, in the folders that its SAVE ALL makes."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from instrument import InstrumentError, Preamble, Waveform
from instrument.tek_files import csv_text
from station.datasets.data_set import Exported
from station.errors import CannotWrite, StationError, UsageError
from station.results.numbers import SCALE_FACTOR
from station.runs.database import RunFacts
from station.runs.store import SavedRecord
from station.sources.batches import NO_RECORD, ExcludedRecord, Source

_BESIDE = ("quadrature", "beam 1", "beam 2")  # of the same acquisition as the record before it
_SIDE_FILE = "gyrolock.toml"


def write_tek_files(
    sources: Iterable[Source], folder: Path, *, replace: bool, left_out: list[ExcludedRecord] | None = None
) -> Exported:
    """Write the records of sources as files ``ALL0000/F0000CH1.CSV``."""
    # Several sources, or records of several purposes, get folders of their own. Beside them stands what such files
    # do not hold: ``gyrolock.toml`` with the scale factor of the gyro.
    done = Exported(left_out=[] if left_out is None else left_out)
    if not replace and folder.is_dir() and any(folder.iterdir()):
        raise UsageError(f"{folder}: holds files already: name another folder, or add --replace")
    every, taken = list(sources), Counter[Path]()
    try:
        for place, source in zip(_places(folder, every), every, strict=True):
            before = done.records
            _write(source, place, done, taken)
            done.sources += done.records > before
    except OSError as error:
        raise CannotWrite(f"{folder}: the files cannot be written ({error.strerror or error})") from None
    if not done.records:
        why = f" ({done.left_out[0]})" if done.left_out else ""
        raise UsageError(f"there is no record of an oscilloscope to export{why}")
    return done


def _places(folder: Path, sources: list[Source]) -> Iterator[Path]:
    """A folder for each run, one for all files; names that are the same get numbers."""
    runs = sum(source.is_run for source in sources)
    seen: dict[str, int] = {}
    for source in sources:
        if not source.is_run:
            yield folder if not runs else folder / "files"
            continue
        path = Path(source.name)
        name = path.parent.name if path.name in ("run.sqlite", "fog.sqlite") else path.stem
        seen[name] = seen.get(name, 0) + 1
        again = f"_{seen[name]}" if seen[name] > 1 else ""
        yield folder if len(sources) == 1 else folder / f"{name or 'run'}{again}"


def _write(source: Source, folder: Path, done: Exported, taken: Counter[Path]) -> None:
    """Write the records of one source; `taken` says how many acquisitions a folder holds."""
    try:
        records = [record for record in source.records() if not record.aside]
    except (StationError, InstrumentError) as error:
        done.left_out.append(ExcludedRecord(source.name, None, str(error).removeprefix(f"{source.name}: ")))
        return
    if not records:
        done.left_out.append(ExcludedRecord(source.name, None, NO_RECORD))
    keys = _keys(source.facts)
    purposes = dict.fromkeys(record.purpose for record in records if record.purpose not in _BESIDE)
    below = folder
    for record in records:
        if record.purpose not in _BESIDE:  # which belongs to the acquisition before it
            below = folder / record.purpose if len(purposes) > 1 else folder
            taken[below] += 1
        number = max(taken[below] - 1, 0)
        try:
            wave = _waveform(record)
            text = csv_text(wave, keys)
        except InstrumentError as error:
            done.left_out.append(
                ExcludedRecord(source.name, record.key, f"{record.number} ({record.key}) {error}")
            )
            continue
        channel = wave.preamble.wfid.split(",")[0].upper() or "CH1"
        file = below / f"ALL{number:04d}" / f"F{number:04d}{channel}.CSV"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(text.encode("ascii"))
        done.files.append(str(file))
        done.records += 1
    known = source.facts.settings.get("gyro", {}).get(SCALE_FACTOR.key())
    for one in dict.fromkeys(folder / purpose if len(purposes) > 1 else folder for purpose in purposes):
        if isinstance(known, int | float) and one.is_dir():
            text = f"# of the gyro whose records these are\n[gyro]\nscale_factor_pulses_per_deg = {known!r}\n"
            (one / _SIDE_FILE).write_text(text, encoding="utf-8")


def _waveform(record: SavedRecord) -> Waveform:
    if not record.intact:
        raise InstrumentError("is damaged")
    if record.header.startswith("{"):
        raise InstrumentError("is the output of a fibre gyro, not a record of an oscilloscope")
    preamble = Preamble.parse(record.header)
    kind: Any = np.int8 if preamble.byt_nr == 1 else ">i2"
    return Waveform(np.frombuffer(record.payload, kind), preamble)


def _keys(facts: RunFacts) -> Mapping[str, str]:
    """The last key rows: what is known of the oscilloscope."""
    identity, scope = facts.get("identity") or {}, facts.settings.get("scope") or {}
    keys = {}
    if isinstance(probe := scope.get("probe"), int | float):
        keys["Probe Atten"] = f"{float(probe):e}"
    model, serial, firmware = (str(identity.get(name) or "") for name in ("model", "serial", "firmware"))
    if model.endswith(("B", "C")):  # the plain models do not write theirs
        keys |= {"Model Number": model.replace(" ", ""), "Serial Number": serial}
    version = "FV:" + firmware.rpartition("FV:")[2].split(" ")[0]
    return keys | ({"Firmware Version": version} if firmware else {})
