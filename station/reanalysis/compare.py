"""Two analyses of the same records, or records of two gyros: what they differ by, in their uncertainties."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from instrument import InstrumentError
from station.errors import NoUsableSignal, RunError, StationError, UsageError
from station.live.events import Progress
from station.measurements import measurement
from station.reanalysis.analyze_table import KINDS, Work, table_file
from station.reanalysis.combine import (
    ONE_RATE,
    combine,
    front_end_of_files,
    scale_factor_of_files,
    states_scale_factor,
)
from station.reanalysis.table_file import rows_of_pieces
from station.report.figure import ACCENT, INK, SECOND, SOFT, write_picture
from station.results.numbers import BEAT_FREQUENCY, LOCK_IN_RATE, LOCK_IN_RATE_NOISE_U
from station.results.result import TextTable, plain, with_uncertainty
from station.results.verdict import BudgetedValue, budgeted_values, derived, shared_inputs
from station.shell.finish import evaluate_saved
from station.sources.batches import ExcludedRecord
from station.sources.find import find_sources, is_run
from station.sources.workers import Workers

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Floats = NDArray[np.float64]

QUANTITIES = {
    LOCK_IN_RATE.key(): (LOCK_IN_RATE_NOISE_U.key(), "deg/s", "lock-in rate"),
    BEAT_FREQUENCY.key(): (BEAT_FREQUENCY.key("u"), "Hz", "beat frequency"),
    "ratio": ("ratio_u", "", "r = A2/A1"),
}
_TEXTS = ("source", "source_sha256", "analysis", "unit")
_SURE = 3.0  # standard uncertainties of the difference beyond which two means differ


@dataclass(frozen=True)
class ComparedRecords:
    """Rows of one analysis."""

    name: str  # the table or path
    analyses: tuple[str, ...]  # by which they were made
    keys: list[tuple[str, int]]  # (str, int): SHA-256 of the source and number in it, of each row
    labels: list[str]  # source and number, as they are shown
    values: dict[str, Floats]  # of each of `QUANTITIES`, nan where there is none; standard uncertainty by noise
    us: dict[str, Floats]
    left_out: tuple[ExcludedRecord, ...] = ()
    # by which they were estimated; ``None`` of a table, which knows the noise of records only
    choices: Mapping[str, Any] | None = None
    headline: BudgetedValue | None = None  # their lock-in rate, every input counted
    one_rate: bool = True  # several have no one beat and no one ratio


@dataclass(frozen=True)
class Difference:
    """What two analyses differ by in one quantity: the second less the first."""

    quantity: str
    unit: str
    title: str
    compared: int  # records that both have a value of; of sets that share none, the records of both
    # weighted means, and their standard uncertainties by the scatter or the noise, whichever is more
    mean_first: float
    mean_first_u: float
    mean_second: float
    mean_second_u: float
    difference: float  # of the means
    difference_u: float
    rms_over_u: float  # of the differences of the records over their uncertainties; nan where no record is in both
    largest_over_u: float
    largest_of: str  # the record of the largest
    beyond_2: float  # share of the records that differ by more than two uncertainties
    over_u: Floats  # difference of each record over its uncertainty

    @property
    def differs(self) -> bool:
        """Whether the uncertainty does not explain the difference."""
        return bool(abs(self.difference) > _SURE * self.difference_u)


@dataclass(frozen=True)
class Comparison:
    """Two analyses side by side."""

    first: ComparedRecords
    second: ComparedRecords
    # whether they are of the same records: then noise is common to both, and a difference is counted in the larger
    # of the two uncertainties; else in both together
    same_records: bool
    only_first: int  # records that have a lock-in rate in one of them only
    only_second: int
    differences: tuple[Difference, ...]
    # of the lock-in rates by noise and scatter alone, where `differences` count every input of both results
    by_noise: Difference | None = None
    shared: tuple[str, ...] = ()  # inputs that both results share

    @property
    def counted(self) -> str:
        """What the uncertainties of the lock-in rates count."""
        return "noise and scatter" if self.by_noise is None else "every input"

    def document(self) -> dict[str, Any]:
        """Return it as plain JSON."""
        each = [
            {name: getattr(one, name) for name in Difference.__dataclass_fields__ if name != "over_u"}
            | {"differs": one.differs}
            for one in self.differences
        ]
        sides = [
            {"name": one.name, "analyses": one.analyses, "records": len(one.keys), "left_out": len(one.left_out)}
            for one in (self.first, self.second)
        ]
        document = {
            "schema": {"name": "gyrolock compare", "version": 2},
            "first": sides[0],
            "second": sides[1],
            "same_records": self.same_records,
            "counted": self.counted,
            "only_in_first": self.only_first,
            "only_in_second": self.only_second,
            "differences": each,
            "sentences": self.sentences(),
        }
        return dict(plain(document))

    def table(self) -> TextTable:
        """Return one row for each quantity."""
        rows = [
            (
                one.title,
                f"{one.compared}",
                with_uncertainty(one.mean_first, one.mean_first_u, one.unit),
                with_uncertainty(one.mean_second, one.mean_second_u, one.unit),
                with_uncertainty(one.difference, one.difference_u, one.unit),
                _number(one.rms_over_u),
                _number(one.largest_over_u),
            )
            for one in self.differences
        ]
        headings = ("", "records", "A", "B", "B - A", "rms/u", "largest/u")
        return TextTable(headings, tuple(rows))

    def sentences(self) -> list[str]:
        """Say what the numbers mean."""
        said, first = [], self.differences[0]
        if self.same_records:
            said.append(
                "The same records: their noise is common to both, u is the larger of the two that it gives each."
            )
        elif self.by_noise is not None:
            both = (
                f"what both share cancels ({', '.join(self.shared).replace('_', ' ')})"
                if self.shared
                else ("no input of a named unit or oscilloscope is in both")
            )
            said.append(f"No record is in both: the results are compared, all uncertainties included; {both}.")
        else:
            said.append(
                "No record is in both: the means are compared, by noise and scatter of their records alone. Scale "
                "factor, detector and channel are not counted: compare runs, or files at one rate, for that."
            )
        if self.only_first or self.only_second:
            said.append(f"A lock-in rate in A alone: {self.only_first} records, in B alone: {self.only_second}.")
        if self.same_records and first.largest_of:
            said.append(
                f"The lock-in rates differ by up to {first.largest_over_u:.3g} u ({first.largest_of}); "
                f"{first.beyond_2:.1%} of the records by more than 2 u."
            )
        elif first.differs:
            said.append(f"The lock-in rates differ by {first.difference / first.difference_u:+.3g} u.")
        else:
            within = "their scatter" if self.by_noise is None else "their uncertainties"
            said.append(f"The lock-in rates agree within {within}.")
        if self.by_noise is not None and self._at_one_rate and self.by_noise.differs:
            by_noise = self.by_noise.difference / self.by_noise.difference_u
            said.append(f"By noise and scatter of their records alone they differ by {by_noise:+.3g} u.")
        return said

    @property
    def _at_one_rate(self) -> bool:
        return self.first.one_rate and self.second.one_rate


def compare(first: ComparedRecords, second: ComparedRecords) -> Comparison:
    """Compare the lock-in rates, beat frequencies and ratios of two analyses."""
    for one in (first, second):
        if not np.isfinite(one.values[LOCK_IN_RATE.key()]).any():
            raise NoUsableSignal(f"{one.name}: holds no record with a lock-in rate")
    places = {key: row for row, key in enumerate(second.keys)}
    pairs = [(row, places[key]) for row, key in enumerate(first.keys) if key in places]
    same = bool(pairs)
    here, there = (np.array(rows, dtype=np.intp) for rows in zip(*pairs, strict=True)) if same else (None, None)
    differences = tuple(_difference(name, first, second, here, there) for name in QUANTITIES)
    a, b = first.values[LOCK_IN_RATE.key()], second.values[LOCK_IN_RATE.key()]
    only = (0, 0)
    if here is not None and there is not None:
        known_a, known_b = np.isfinite(a[here]), np.isfinite(b[there])
        only = int((known_a & ~known_b).sum()), int((known_b & ~known_a).sum())
    if same or first.headline is None or second.headline is None:
        return Comparison(first, second, same, *only, differences)
    by_noise, *others = differences
    of_first, of_second = first.headline, second.headline
    difference = derived("less", of_second, of_first)
    headlines = replace(
        by_noise,
        mean_first=of_first.value.value,
        mean_first_u=of_first.value.u,
        mean_second=of_second.value.value,
        mean_second_u=of_second.value.u,
        difference=difference.value,
        difference_u=difference.u,
    )
    # a mean over several rates is nobody's beat and nobody's ratio
    shown = (headlines, *others) if first.one_rate and second.one_rate else (headlines,)
    shared = tuple(name for name, _, _ in shared_inputs(of_first, of_second))
    return Comparison(first, second, same, *only, shown, by_noise, shared)


def _difference(
    name: str,
    first: ComparedRecords,
    second: ComparedRecords,
    here: NDArray[np.intp] | None,
    there: NDArray[np.intp] | None,
) -> Difference:
    _, unit, title = QUANTITIES[name]
    a, b, a_u, b_u = first.values[name], second.values[name], first.us[name], second.us[name]
    over_u, largest, where = np.empty(0), math.nan, ""
    if here is not None and there is not None:
        a, b, a_u, b_u = a[here], b[there], a_u[here], b_u[there]
        both = np.isfinite(a) & np.isfinite(b)
        rows, a, b, a_u, b_u = here[both], a[both], b[both], a_u[both], b_u[both]
        u = np.maximum(a_u, b_u)
        over_u = np.divide(b - a, u, out=np.zeros(a.size), where=u > 0)
        if over_u.size:
            place = int(np.argmax(np.abs(over_u)))
            largest, where = float(over_u[place]), first.labels[int(rows[place])]
    mean_a, mean_a_u = _mean(a, a_u)
    mean_b, mean_b_u = _mean(b, b_u)
    difference, difference_u = mean_b - mean_a, math.hypot(mean_a_u, mean_b_u)
    if here is not None and a.size:
        difference = float(np.mean(b - a))
        difference_u = float(np.std(b - a)) / math.sqrt(a.size) if a.size > 1 else max(mean_a_u, mean_b_u)
    return Difference(
        name,
        unit,
        title,
        int(a.size if here is not None else np.isfinite(a).sum() + np.isfinite(b).sum()),
        mean_a,
        mean_a_u,
        mean_b,
        mean_b_u,
        difference,
        difference_u,
        float(np.sqrt(np.mean(over_u**2))) if over_u.size else math.nan,
        largest,
        where,
        float(np.mean(np.abs(over_u) > 2)) if over_u.size else math.nan,
        over_u,
    )


def _mean(values: Floats, us: Floats) -> tuple[float, float]:
    """Weighted mean, and its uncertainty: from the noise, or from the scatter where that is more."""
    known = np.isfinite(values) & np.isfinite(us) & (us > 0)
    if not known.any():
        return math.nan, math.nan
    weights = us[known] ** -2.0
    mean = float(np.sum(weights * values[known]) / weights.sum())
    u = float(1 / np.sqrt(weights.sum()))
    if known.sum() > 1:
        chi_square = float(np.sum(weights * (values[known] - mean) ** 2)) / (int(known.sum()) - 1)
        u *= math.sqrt(max(chi_square, 1.0))
    return mean, u


def read_records(
    place: str, choices: Mapping[str, Any], workers: Workers, analysis: str = "", config: Path | None = None
) -> ComparedRecords:
    """Read the rows of a results table, or estimate the records of runs and files."""
    path = Path(place)
    if path.suffix.lower() in KINDS and path.is_file() and _is_table(path):
        rows = (row for row in table_file(path).rows() if analysis in str(row["analysis"]))
        return _records(place, rows, ())
    inside = Path(place.partition("#")[0])  # a source in a data set
    if "://" not in place and not (path.exists() or inside.exists()):
        raise UsageError(f"{place}: No such file or directory")
    sources = list(find_sources([place]))
    files = [one for one in sources if isinstance(one, Path) and not is_run(one)]
    # beside runs, which know their own, files get what somebody has stated and nobody is asked
    asked = len(files) == len(sources) or states_scale_factor(config)
    if choices.get("scale_factor") is None and files and asked:
        choices = {**choices, "scale_factor": scale_factor_of_files(config, files)}
    choices = {**choices, "front_end": front_end_of_files(config)}
    work = Work(sources, choices, whole=True)
    parts = [rows for found in work.done_by(workers, rows_of_pieces, Progress()) for rows in found]
    left_out = tuple(one for part in parts for one in part.left_out)
    if left_out and not any(part.count for part in parts):
        raise RunError(f"{left_out[0]}")
    names = (*_TEXTS, "record", *QUANTITIES, *(u for u, _, _ in QUANTITIES.values()))
    given = (
        dict(zip(names, values, strict=True))
        for part in parts
        if part.count
        for values in zip(*(part.column(name) for name in names), strict=True)
    )
    return replace(_records(place, given, left_out), choices=choices)


def with_headlines(
    first: ComparedRecords, second: ComparedRecords, workers: Workers, config: Path | None = None
) -> tuple[ComparedRecords, ComparedRecords]:
    """Evaluate both sides as a whole, where they hold no record in common: then noise is not all that counts."""
    if not set(first.keys).isdisjoint(second.keys):
        return first, second
    return _with_headline(first, workers, config), _with_headline(second, workers, config)


def _with_headline(side: ComparedRecords, workers: Workers, config: Path | None) -> ComparedRecords:
    """Evaluate a run, or records at one rate, with their budget; as it is where they have no one result."""
    if side.choices is None:
        return side
    quiet = Progress()
    choices = {name: value for name, value in side.choices.items() if name != "front_end"}
    try:
        sources = list(find_sources([side.name]))
        if len(sources) == 1 and is_run(sources[0]):
            document = evaluate_saved(sources[0], workers, quiet, config=config, choices=choices).document()
        else:
            beats = side.values[BEAT_FREQUENCY.key()]
            known = beats[np.isfinite(beats)]
            if not known.size or np.ptp(known) >= ONE_RATE * known.max():
                return side
            document = combine(sources, choices, workers, quiet, config=config).document()
    except (StationError, InstrumentError):
        return side
    declared = measurement(document.get("command", "measure")).quantities
    found = next(budgeted_values(document, declared, LOCK_IN_RATE.key()), None)
    if found is None or not math.isfinite(found.value.value + found.value.u):
        return side
    return replace(side, headline=found, one_rate="several_rates" not in document)


def _is_table(path: Path) -> bool:
    """Whether a file is a results table: its ending alone does not tell it from a run or a data set."""
    from station.errors import RunError

    try:
        next(iter(table_file(path).rows()), None)
    except RunError:
        return path.suffix.lower() == ".jsonl"
    return True


def _records(name: str, rows: Iterable[Mapping[str, Any]], left_out: Sequence[ExcludedRecord]) -> ComparedRecords:
    keys: list[tuple[str, int]] = []
    labels: list[str] = []
    analyses: dict[str, None] = {}
    values: dict[str, list[float]] = {column: [] for column in QUANTITIES}
    us: dict[str, list[float]] = {column: [] for column in QUANTITIES}
    for row in rows:
        keys.append((str(row["source_sha256"]), int(row["record"])))
        labels.append(f"{row['source']}, record {row['record']}")
        analyses[str(row["analysis"])] = None
        for column, (u, _, _) in QUANTITIES.items():
            values[column].append(_float(row[column]))
            us[column].append(_float(row[u]))
    if len(set(keys)) < len(keys):
        listed = "; ".join(f"'{one}'" for one in analyses)
        raise UsageError(f"{name}: holds several analyses: name one with --a or --b, by a part of {listed}")
    of_values, of_us = ({column: np.array(found) for column, found in one.items()} for one in (values, us))
    return ComparedRecords(name, tuple(analyses), keys, labels, of_values, of_us, tuple(left_out))


def _float(value: Any) -> float:
    return math.nan if value is None else float(value)


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.3g}"


# --------------------
# Differences of two analyses over their uncertainties


_SIZE = (9.0, 4.0)
_POINTS = 20_000


def write_comparison_plot(path: Path, found: Comparison) -> None:
    """Draw a comparison into a .svg, .png or .pdf file."""
    write_picture(path, "compare", _SIZE, lambda figure: _draw(figure, found))


def _draw(figure: Figure, found: Comparison) -> None:
    if found.same_records:
        over_u = found.differences[0].over_u
        left, right = figure.subplots(1, 2, width_ratios=(3, 1), sharey=True)
        shown = np.linspace(0, over_u.size - 1, min(over_u.size, _POINTS)).astype(int)
        left.plot(shown + 1, over_u[shown], ".", color=ACCENT, markersize=4 if over_u.size < 500 else 2)
        for axes in (left, right):
            axes.axhline(0, color=INK, linewidth=0.8)
        left.set(xlabel="record in both", ylabel="lock-in rate: (B - A) over its uncertainty")
        right.hist(over_u, bins=min(60, max(8, over_u.size // 5)), orientation="horizontal", color=SECOND)
        right.set(xlabel="records")
        figure.suptitle(
            f"A: {Path(found.first.name).name}   B: {Path(found.second.name).name}", fontsize=9, color=SOFT
        )
    else:
        _means(figure, found)


def _means(figure: Figure, found: Comparison) -> None:
    """Both means with twice their uncertainty, one panel for each quantity."""
    panels = figure.subplots(1, len(found.differences), squeeze=False)[0]
    for axes, one in zip(panels, found.differences, strict=True):
        pairs = ((one.mean_first, one.mean_first_u, ACCENT), (one.mean_second, one.mean_second_u, SECOND))
        for place, (value, u, color) in enumerate(pairs):
            axes.errorbar([place], [value], [2 * u], fmt="o", color=color, capsize=4)
        axes.set_xticks([0, 1], ["A", "B"])
        axes.set(xlim=(-0.6, 1.6), title=f"{one.title}{', ' + one.unit if one.unit else ''}")
        axes.title.set_fontsize(9)
        axes.ticklabel_format(axis="y", useOffset=False)
    counted = (
        "noise and scatter" if found.by_noise is None else "every input for the lock-in rate, noise for the rest"
    )
    figure.supxlabel(f"with twice the standard uncertainty: {counted}", fontsize=9, color=SOFT)
