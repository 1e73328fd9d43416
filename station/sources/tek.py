"""A file of an oscilloscope as a source: one record, and what the file and its neighbours say of the scope."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from instrument import Waveform
from instrument.tek_files import TekFile as File
from instrument.tek_files import read_tek_file
from station.runs.facts import RunFacts
from station.runs.store import SavedRecord
from station.sources.source import Source

PURPOSE = "measure"


class TekFile(Source):
    """One CSV, ISF or curve file; what the ``TEK.SET`` beside it says of the channel goes into the preamble."""

    def __init__(self, path: Path) -> None:
        self.path, self.name, self.unusable = path, str(path), {}
        file = read_tek_file(path)
        self.kind, self.waveform = file.kind, _with_coupling(file)
        self.channel = self.waveform.preamble.wfid.split(",")[0].upper()
        self.facts = RunFacts(_facts(file))

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


def _with_coupling(file: File) -> Waveform:
    """A CSV does not say how its channel was coupled: the setup beside it does, in the words of a preamble."""
    wave, coupling = file.waveform, file.setting("COUPLING")
    if "coupling" in wave.preamble.wfid or not coupling:
        return wave
    source, _, rest = wave.preamble.wfid.partition(", ")
    return Waveform(wave.codes, replace(wave.preamble, wfid=f"{source}, {coupling} coupling, {rest}"))


def _facts(file: File) -> dict[str, Any]:
    about, facts = file.about, dict[str, Any]()
    if about:
        facts["identity"] = {name: about[name] for name in ("model", "serial", "firmware") if name in about}
    if "probe" in about:
        facts["probe"] = float(about["probe"])
    if file.setup:
        facts["setup"] = file.setup
    return facts
