"""The report of files: what a run's report shows, without a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from station.lock_in.presentation.sections import sections
from station.reanalysis.files import AnalyzedFiles
from station.results.limits import Tested
from station.results.parts import FactTable, Section
from station.results.result import Result
from station.runs.facts import COMPLETE, RunFacts
from station.runs.store import SavedRun


@dataclass(frozen=True)
class FilesReport:
    """Files as the report needs them; see `station.report.report.Shown`."""

    files: AnalyzedFiles

    @property
    def tested(self) -> Sequence[Tested]:
        """Numbers against their limits."""
        return self.files.tested

    @property
    def verdict(self) -> str | None:
        """``"PASS"``, ``"FAIL"`` or, without limits, ``None``."""
        return self.files.verdict

    @property
    def heading(self) -> str:
        """What was measured."""
        return f"Lock-in rate: {len(self.files.paths)} files" if len(self.files.paths) > 1 else "Lock-in rate"

    @property
    def run(self) -> SavedRun:
        """A run that holds nothing but where the files are."""
        return SavedRun(self.files.paths[0], RunFacts({"command": "analyze", "outcome": COMPLETE}), (), None)

    @property
    def result(self) -> Result:
        """Values and sentences."""
        return self.files.result

    def sections(self) -> list[Section]:
        """Figures and tables."""
        return sections(self.files.found, self.result)

    def fact_tables(self) -> list[FactTable]:
        """Method, files, and what they say of the oscilloscope."""
        found = self.files.found
        rows = [
            ("method", found.method_text),
            ("scale factor K", f"{found.method.scale_factor:g} pulses/deg"),
            ("noise model", found.combined.noise_model),
            ("records", f"{len(found.names)}, left out {found.records_rejected}"),
        ]
        names = [(f"{number}", str(path)) for number, path in enumerate(self.files.paths[:40], start=1)]
        if len(self.files.paths) > len(names):
            names.append(("", f"and {len(self.files.paths) - len(names)} more"))
        missing = [(str(Path(one.source).name), one.reason) for one in self.files.left_out[:40]]
        scopes = [tuple(line.split("   ", 1)) for line in self.files.taken_with()]
        said = [(first, rest) for first, rest in scopes]
        return [
            FactTable("Result", rows),
            FactTable("Oscilloscope", said),
            FactTable("Files", names),
            FactTable("Left out", missing),
        ]
