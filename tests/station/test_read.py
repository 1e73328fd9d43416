"""From the records of a run to arrays: what belongs together, what is refused, what a sample says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.budget import bounded
from instrument import Preamble, Waveform
from instrument.tek_files import csv_text
from station.errors import RunError
from station.live.events import Progress
from station.lock_in.evaluate import LockInEvaluation, evaluate_records, fast_run_tilt
from station.lock_in.result import result
from station.lock_in.settings import RING_LASER, Settings, bench_knowledge, default_settings, run_knowledge
from station.reanalysis.combine import combine
from station.runs.store import SavedRecord, SavedRun, open_run
from station.settings import saved_settings
from station.sources.workers import ThisProcess

GOLDEN = Path(__file__).parent.parent / "golden"
TEXT = '1;8;BIN;RI;MSB;{points};"Ch1, DC";Y;1.0E-5;0;0.0E0;"s";{ymult};0.0E0;0.0E0;"Volts"'


def settings_of(run: SavedRun) -> Settings:
    return saved_settings(RING_LASER, run.facts.settings, str(run.path))


def evaluated(run: SavedRun) -> LockInEvaluation:
    return evaluate_records(run, settings_of(run), {}, ThisProcess(), Progress())


@pytest.fixture(scope="module")
def pairs() -> SavedRun:
    """A run with two photodiodes."""
    return open_run(GOLDEN / "quadrature.sqlite")


def changed(run: SavedRun, purpose: str, **fields: object) -> SavedRun:
    """The run with another first record of one purpose."""
    first = run.taken_for(purpose)[0]
    records = tuple(one._replace(**fields) if one is first else one for one in run.records)
    return replace(run, records=records)


@pytest.mark.parametrize("purpose", ["measure", "quadrature", "tilt"])
def test_codes_and_preamble_that_do_not_belong_together(pairs: SavedRun, purpose: str) -> None:
    first = pairs.taken_for(purpose)[0]
    with pytest.raises(RunError, match=rf"record {first.number} .*2499.* (came with|its preamble says)"):
        evaluated(changed(pairs, purpose, payload=first.payload[:-1]))


def test_what_is_no_record_over_time(pairs: SavedRun) -> None:
    text = pairs.taken_for("measure")[0].preamble
    with pytest.raises(RunError, match="is a spectrum"):
        evaluated(changed(pairs, "measure", header=text.replace('"s"', '"Hz"')))


def test_an_acquisition_is_sine_and_cosine(pairs: SavedRun) -> None:
    sines, (cosine, *_) = pairs.taken_for("measure"), pairs.taken_for("quadrature")
    found = evaluated(replace(pairs, records=tuple(one for one in pairs.records if one is not cosine)))
    assert found.quadratures is None
    assert list(found.names) == [str(number + 1) for number in range(len(sines))]
    both = evaluated(pairs)
    assert both.quadratures is not None
    assert both.quadratures.sine_alone == pytest.approx(float(np.mean(found.each.lock_in_rate)), rel=1e-6)


def test_the_tilt_is_the_same_while_taking_and_afterwards(pairs: SavedRun) -> None:
    settings = settings_of(pairs)
    early, late = fast_run_tilt(pairs, settings), evaluated(pairs).tilt
    assert late is not None
    # only the lock-in rate is not known yet, which the fast beat hardly feels
    assert early.tilt_deg == pytest.approx(late.tilt_deg, abs=5 * late.tilt_u_deg)
    wrong = settings.model_copy(
        update={"gyro": settings.gyro.model_copy(update={"scale_factor_pulses_per_deg": 2})}
    )
    with pytest.raises(RunError, match="the fast run gives no tilt: the beat is"):
        fast_run_tilt(pairs, wrong)


def test_what_the_settings_say_of_the_bench(pairs: SavedRun) -> None:
    settings = settings_of(pairs)
    known = run_knowledge(settings)
    assert known.scale_factor == settings.gyro.scale_factor_pulses_per_deg
    assert known.latitude_deg == settings.site.latitude_deg
    assert known.both_senses == settings.table.both_senses
    assert known.response is None
    nothing = run_knowledge(settings.model_copy(update={"budget": None}))
    # a latitude that was looked up for its town; of the table's rate nobody said anything
    assert nothing.table_rate_u_ppm == 0
    assert nothing.latitude_u_deg == pytest.approx(0.1 / 3**0.5)
    assert np.isnan(nothing.bench.scale_factor_u_ppm)


def test_what_counts_noise_alone_says_so(pairs: SavedRun) -> None:
    said = result(evaluated(pairs))
    rows = dict(said.summary)
    assert "u by noise and table" in rows["by the table's rate"]
    assert [name for name in said.tables[0].header if "(noise)" in name] == ["lock-in rate (noise), deg/s"]


def test_of_a_real_bench_nothing_is_known_that_nobody_stated() -> None:
    known = bench_knowledge(default_settings("bench"))
    found = bounded(known, 100.0)
    assert found.assumed >= {"scale_factor", "distortion", "third_order", "bandwidth", "gain_corner"}


def sines(codes: np.ndarray, ymult: str = "1.0E-2") -> Waveform:
    return Waveform(codes, Preamble.parse(TEXT.format(points=codes.size, ymult=ymult)))


def of_files(waves: list[Waveform], folder: Path) -> LockInEvaluation:
    for name, wave in zip("abcd", waves, strict=False):
        (folder / f"{name}.csv").write_text(csv_text(wave, {}), encoding="ascii")
    files = sorted(folder.glob("*.csv"))
    return combine(files, {"scale_factor": 2000.0}, ThisProcess(), Progress()).found


def test_files_are_evaluated_without_a_bench(tmp_path: Path) -> None:
    codes = [np.rint(100 * np.sin(0.05 * np.arange(2500) + start)).astype(np.int8) for start in (0.0, 1.0)]
    found = of_files([sines(one) for one in codes], tmp_path)
    assert [Path(name).name for name in found.names] == ["a.csv", "b.csv"]
    assert found.tilt is None
    assert {"scale_factor", "distortion", "bandwidth"} < {line.name for line in found.budget.not_stated}
    assert float(found.combined.beat_frequency) == pytest.approx(0.05 / (2 * np.pi) / 1e-5, rel=1e-6)


@pytest.mark.parametrize(
    ("kind", "codes", "clipped"),
    [
        (np.int8, [0, 126, 127, -126, -127, -128], [False, False, True, False, True, False]),
        (np.int16, [0, 127, 32511, 32512, -32512, -128], [False, False, False, True, True, False]),
    ],
)
def test_clipped_is_the_end_of_the_range_and_not_a_gap(kind: type, codes: list[int], clipped: list[bool]) -> None:
    wave = sines(np.array(codes, dtype=kind))
    assert wave.clipped_samples.tolist() == clipped
    assert wave.clipped


def test_records_of_several_time_bases_keep_their_order(tmp_path: Path) -> None:
    steps, sizes = (0.05, 0.0505, 0.0505, 0.05), (2500, 2000, 2500, 2500)
    codes = [
        np.rint(100 * np.sin(step * np.arange(size) + place)).astype(np.int8)
        for place, (step, size) in enumerate(zip(steps, sizes, strict=True))
    ]
    found = of_files([sines(one) for one in codes], tmp_path)
    assert found.each.beat_frequency == pytest.approx(np.array(steps) / (2 * np.pi) / 1e-5, rel=1e-5)


def test_a_table_rate_that_is_missing_leaves_the_table_out(pairs: SavedRun) -> None:
    first = pairs.taken_for("measure")[0]
    unknown = {name: value for name, value in first.conditions.items() if name != "table_rate_dps"}
    found = evaluated(changed(pairs, "measure", conditions=unknown))
    assert found.tilt is None and found.table_check is None
    assert found.budget is not None


def test_damaged_records_alone_are_no_run(pairs: SavedRun) -> None:
    def spoilt(record: SavedRecord) -> SavedRecord:
        return record._replace(intact=record.purpose == "tilt")

    with pytest.raises(RunError, match="only damaged records"):
        evaluated(replace(pairs, records=tuple(spoilt(record) for record in pairs.records)))
