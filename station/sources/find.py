"""From paths as a user gives them to sources: runs, memory cards, trees, and files of an oscilloscope."""

import hashlib
import os
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from instrument import Waveform
from instrument.tek_files import read_tek_file
from station.errors import UsageError
from station.runs.database import LAYOUTS, RunFacts, is_database
from station.runs.store import RUN_FILES, SavedRecord
from station.sources.batches import Source
from station.sources.run import RunSource

WAVEFORM_FILES = (".csv", ".isf")


def find_sources(paths: Iterable[Path | str]) -> Iterator[Path | Source]:
    """Expand paths: a folder that holds no run stands for every run and every waveform file in and below it."""
    # data sets are made of the other files of this package: they are there when it is
    from station.datasets.data_set import is_dataset, sources_of

    for given in paths:
        if is_dataset(given):
            yield from sources_of(given)
            continue
        path = Path(given)
        if not path.is_dir() or _holds_run(path):
            yield path
            continue
        found = False
        for source in _below(path, {os.path.realpath(path)}):
            found = True
            yield source
        if not found:
            raise UsageError(f"{path}: holds no run and no CSV or ISF file, neither it nor a folder below it")


def _below(folder: Path, entered: set[str]) -> Iterator[Path]:
    """All in and below a folder that may be a source; what cannot be looked at is named when it is opened."""
    try:
        with os.scandir(folder) as entries:
            # hidden ones are drafts, indexes, and what some computers leave beside the files of a card
            names = sorted((one for one in entries if not one.name.startswith(".")), key=lambda entry: entry.name)
    except OSError:
        yield folder
        return
    for entry in names:
        path = Path(entry.path)
        try:
            is_folder = entry.is_dir()
            found = (
                _holds_run(path)
                if is_folder
                else entry.is_file() and (_is_waveform_file(path) or _is_run_file(path))
            )
        except OSError:
            is_folder, found = False, True
        if found:
            yield path
        elif is_folder and (not entry.is_symlink() or first_time(entry.path, entered)):
            yield from _below(path, entered)


def first_time(path: str, entered: set[str]) -> bool:
    """Whether a link leads to where nobody has been: a link to a folder above would never end."""
    target = os.path.realpath(path)
    if any(target == one or one.startswith(f"{target}{os.sep}") for one in entered):
        return False
    entered.add(target)
    return True


def _holds_run(folder: Path) -> bool:
    return any((folder / name).is_file() for name in RUN_FILES)


def _is_waveform_file(path: Path) -> bool:
    """Whether a file may be an oscilloscope's; records that were exported beside it are there twice."""
    from station.datasets.data_set import is_dataset

    return path.suffix.lower() in WAVEFORM_FILES and not is_dataset(path)


def _is_run_file(path: Path) -> bool:
    """Whether a file of any name is a run: databases of other programs in a tree are passed over."""
    if path.suffix.lower() != ".sqlite":
        return False
    with path.open("rb") as file:
        header = file.read(72)
    return int.from_bytes(header[68:72], "big") in {layout.application_id for layout in LAYOUTS}


def is_run(source: Path | Source) -> bool:
    """Whether a source is a run, of a data set too; OSError if it is not there."""
    return is_database(source) if isinstance(source, Path) else source.is_run


def open_source(path: Path | Source, held: ExitStack | None = None) -> Source:
    """Open one source; its content decides what it is. One of a data set is open already."""
    if isinstance(path, Source):
        return path
    if path.is_dir() and not _holds_run(path):
        with os.scandir(path):  # one that may not be looked at says so
            pass
    return RunSource(path, held) if is_database(path) else TekSource(path)


# --------------------
# A file of an oscilloscope as a source: one record, and what the file and its neighbours say of the scope


PURPOSE = "measure"


class TekSource(Source):
    """One CSV, ISF or curve file; what the ``TEK.SET`` beside it says of the channel goes into the preamble."""

    def __init__(self, path: Path) -> None:
        self.path, self.name, self.unusable = path, str(path), {}
        file = read_tek_file(path)
        self.kind, self.waveform, wave = file.kind, file.waveform, file.waveform
        # a CSV does not say how its channel was coupled: the setup beside it does, in the words of a preamble
        if "coupling" not in wave.preamble.wfid and (coupling := file.setting("COUPLING")):
            source, _, rest = wave.preamble.wfid.partition(", ")
            said = replace(wave.preamble, wfid=f"{source}, {coupling} coupling, {rest}")
            self.waveform = Waveform(wave.codes, said)
        self.channel = self.waveform.preamble.wfid.split(",")[0].upper()
        about, facts = file.about, dict[str, Any]()
        if about:
            facts["identity"] = {name: about[name] for name in ("model", "serial", "firmware") if name in about}
        if "probe" in about:
            facts["probe"] = float(about["probe"])
        if file.setup:
            facts["setup"] = file.setup
        self.facts = RunFacts(facts)

    def __len__(self) -> int:
        return 1

    def records(self, numbers: range | None = None) -> Iterator[SavedRecord]:
        """Give the one record; see `Source`."""
        if numbers is not None and 1 not in numbers:
            return
        codes = self.waveform.codes
        payload = codes.tobytes() if codes.dtype == np.int8 else codes.astype(">i2").tobytes()
        header, conditions = self.waveform.preamble.to_text(), {"channel": self.channel}
        yield SavedRecord(1, self.path.name, "", PURPOSE, header, payload, True, conditions)

    @property
    def sha256(self) -> str:
        """SHA-256 of the file."""
        return hashlib.sha256(self.path.read_bytes()).hexdigest()
