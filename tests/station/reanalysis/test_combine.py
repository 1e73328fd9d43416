"""One result of many files: of a memory card, at one rate or at several."""

from pathlib import Path

import numpy as np
import pytest

from analysis import beat_signal
from instrument import Preamble, Waveform
from instrument.tek_files import csv_text
from station.cli import main
from station.errors import NoUsableSignal, RunError, UsageError
from station.live.events import Progress
from station.reanalysis.combine import AnalyzedFiles, analyze_file, combine, scale_factor_of_files
from station.report.show import render_report
from station.runs.store import NewRecord, RunWriter, open_run
from station.sources.find import find_sources
from station.sources.workers import Processes, ThisProcess

K, LOCK_IN = 2000.0, 0.02
PREAMBLE = Preamble.parse(
    '1;8;BIN;RI;MSB;2500;"Ch1, 5.0E-1 V/div, 5.0E-3 s/div, 2500 points, Sample mode";'
    'Y;2.0E-5;0;-2.5E-2;"s";2.0E-2;0.0E0;0.0E0;"Volts"'
)
KEYS = {"Probe Atten": "1.000000e+00", "Model Number": "TDS2014C", "Serial Number": "C042203"}
SETUP = ':ACQUIRE:MODE SAMPLE;:CH1:PROBE 1.0E0;COUPLING DC;BANDWIDTH OFF;INVERT OFF;YUNIT "V"'


def card(folder: Path, *rates: float, channel: str = "Ch1") -> Path:
    """A memory card with one record at each rate."""
    rng = np.random.default_rng(6)
    times = np.arange(2500) * PREAMBLE.xincr
    for number, rate in enumerate(rates):
        beat = beat_signal(times, scale_factor=K, input_rate=rate, lock_in_rate=LOCK_IN, initial_phase=number)
        codes = np.rint(90 * beat + rng.standard_normal(2500)).astype(np.int8)
        place = folder / f"ALL{number:04d}"
        place.mkdir(parents=True, exist_ok=True)
        text = csv_text(Waveform(codes, PREAMBLE), KEYS).replace("Source,CH1", f"Source,{channel.upper()}")
        (place / f"F{number:04d}{channel.upper()}.CSV").write_text(text)
        (place / f"F{number:04d}TEK.SET").write_text(SETUP)
    return folder


def combined(folder: Path, processes: int = 1, **wanted: object) -> AnalyzedFiles:
    with Processes(processes) as workers:
        sources = find_sources([folder])
        return combine(sources, {"scale_factor": K}, workers, Progress(), **wanted)


@pytest.mark.slow
def test_a_card_gives_one_result_with_budget_and_report(tmp_path: Path) -> None:
    found = combined(card(tmp_path, 0.3, 0.3, 0.3))
    document = found.document()
    assert document["records"] == 3
    low, high = document["lock_in_rate_low_95_dps"], document["lock_in_rate_high_95_dps"]
    assert low < LOCK_IN < high
    assert document["taken_with"][0] | {"serial": "C042203", "probe": "1X"} == document["taken_with"][0]
    # the setup beside the files says how the channel was coupled
    coupling = next(one for one in document["budget"]["inputs"] if "coupling" in one["quantity"])
    assert coupling["contribution_dps"] == 0
    page = render_report(found)
    assert "Uncertainty budget" in page
    assert "serial C042203" in page
    assert "F0002CH1.CSV" in page


def test_the_same_bits_by_two_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = card(tmp_path, 0.3, 0.3, 0.3)
    alone = combined(folder).document()
    monkeypatch.setattr("station.reanalysis.analyze_table.TOGETHER", 1)
    assert combined(folder, processes=2).document() == alone


def test_files_at_several_rates_need_to_be_told_them(tmp_path: Path) -> None:
    folder = card(tmp_path / "card", 0.1, 0.2, -0.3)
    with pytest.raises(UsageError, match="give --rates-from"):
        combined(folder)
    rates = tmp_path / "rates.csv"
    rates.write_text("file;input_rate_dps\nALL0000/F0000CH1.CSV;0,1\nF0001CH1.CSV;0,2\nF0002CH1.CSV;-0,3\n")
    document = combined(folder, rates=rates).document()
    assert len(document["several_rates"]["rates"]) == 3
    assert abs(document["lock_in_rate_dps"] - LOCK_IN) < 4 * document["lock_in_rate_u_dps"]
    assert document["lock_in_rate_u_dps"] < 0.02 * LOCK_IN


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("name,rate\n", "needs the columns file and input_rate_dps"),
        ("file,input_rate_dps\nF0000CH1.CSV,fast\n", "line 2: needs a file and a rate"),
        ("file,input_rate_dps\nF0000CH1.CSV,0.1\nF0000CH1.CSV,0.2\n", "line 3: F0000CH1.CSV is there twice"),
        ("file,input_rate_dps\nF0000CH1.CSV,0.1\n", "says no rate for .*F0001CH1.CSV and 1 more"),
    ],
)
def test_a_file_of_rates_that_does_not_fit_is_refused(text: str, problem: str, tmp_path: Path) -> None:
    folder = card(tmp_path / "card", 0.1, 0.2, -0.3)
    rates = tmp_path / "rates.csv"
    rates.write_text(text)
    with pytest.raises(UsageError, match=problem):
        combined(folder, rates=rates)


def test_a_beat_outside_the_response_of_the_channel_is_told(tmp_path: Path) -> None:
    settings = tmp_path / "bench.toml"
    settings.write_text("[front_end]\nresponse = [[1, 1.0, 0.0], [2, 0.98, -5]]\n")
    with pytest.raises(RunError, match=r"known from 1 to 2 Hz, but .* Hz is needed"):
        combined(card(tmp_path / "card", 0.3, 0.3), config=settings)


def test_a_settings_file_counts_with_what_it_states_and_nothing_else(tmp_path: Path) -> None:
    (file,) = sorted(card(tmp_path / "card", 0.16).rglob("*.CSV"))
    settings = tmp_path / "gyro.toml"
    settings.write_text(f"[gyro]\nscale_factor_pulses_per_deg = {K}\n")
    nothing = combined(file).document()
    # the shipped settings know the bandwidth of their simulated bench, and its scale factor to 50 ppm
    assert {"bandwidth", "scale_factor"} < set(nothing["budget"]["not_stated"])
    for found in (combined(file, config=settings), analyze_file(file, settings, {})):
        assert found.document()["budget"] == nothing["budget"]
    settings.write_text(settings.read_text() + "[front_end]\nlow_pass_hz = 1000\n[budget]\ngain_corner_hz = 1e5\n")
    told = analyze_file(file, settings, {}).document()
    assert told["lock_in_rate_dps"] > 1.01 * nothing["lock_in_rate_dps"]
    assert told["lock_in_rate_dps"] == combined(file, config=settings).document()["lock_in_rate_dps"]
    assert {"bandwidth", "gain_corner"}.isdisjoint(told["budget"]["not_stated"])


def test_files_are_judged_by_the_limits_of_a_settings_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (file,) = sorted(card(tmp_path / "card", 0.16).rglob("*.CSV"))
    settings = tmp_path / "bench.toml"
    for limit, verdict, exit_code in ((0.01, "FAIL", 1), (1.0, "PASS", 0)):
        settings.write_text(
            f"[gyro]\nscale_factor_pulses_per_deg = {K}\n[limits]\nlock_in_rate_high_95_dps = {limit}\n"
        )
        assert analyze_file(file, settings, {}).document()["verdict"] == verdict
        assert combined(file, config=settings).verdict == verdict
        for how in ([], ["--combine"]):
            assert main(["analyze", str(file), "--config", str(settings), *how]) == exit_code
            assert f"{verdict} lock-in rate high 95" in capsys.readouterr().out


def test_two_inputs_are_not_two_records(tmp_path: Path) -> None:
    card(tmp_path, 0.3)
    card(tmp_path, 0.3, channel="Ch2")
    with pytest.raises(UsageError, match=r"mixed inputs.*--channel"):
        combined(tmp_path)
    assert combined(tmp_path, channel="CH2").document()["records"] == 1


def test_what_is_no_record_is_left_out(tmp_path: Path) -> None:
    folder = card(tmp_path, 0.3, 0.3)
    (folder / "ALL0001" / "F0001CH1.CSV").write_text("no waveform\n")
    found = combined(folder)
    assert [Path(one.source).name for one in found.left_out] == ["F0001CH1.CSV"]
    (folder / "ALL0000" / "F0000CH1.CSV").write_text("no waveform\n")
    with pytest.raises(NoUsableSignal, match="none of 2 sources"):
        combined(folder)


def test_gyros_and_scale_factors_are_not_mixed(tmp_path: Path) -> None:
    old = open_run(Path(__file__).parents[2] / "golden" / "single.sqlite")
    record = old.taken_for("measure")[0]
    for unit, factor in (("SN1", K), ("SN1", 2 * K), ("SN2", K)):
        settings = old.facts.settings | {"gyro": {"name": "gyro", "scale_factor_pulses_per_deg": factor}}
        facts = {"command": "measure", "settings": settings, "unit": unit}
        with RunWriter.create(tmp_path, facts) as writer:
            writer.save_records([NewRecord("1", "measure", record.header, record.payload, {"channel": "CH1"})])
    first, other_factor, other_unit = sorted(tmp_path.iterdir())
    for second, problem in (
        (other_factor, "mixed scale factors.*give --scale-factor"),
        (other_unit, "mixed units"),
    ):
        with pytest.raises(UsageError, match=problem):
            combine([first, second], {}, ThisProcess(), Progress())
    copy = tmp_path / "copy.sqlite"
    copy.write_bytes((first / "run.sqlite").read_bytes())
    found = combine([first, first, copy], {}, ThisProcess(), Progress())
    assert len(found.found.names) == 1  # counted twice, a record would seem better known than it is
    assert [one.reason for one in found.left_out] == [
        f"holds the same records as {first}/run.sqlite: counted once"
    ]


def test_the_scale_factor_of_a_side_file(tmp_path: Path) -> None:
    folder = card(tmp_path / "card", 0.3, 0.3)
    files = list(find_sources([folder]))
    (folder / "gyrolock.toml").write_text("[gyro]\nscale_factor_pulses_per_deg = 1990.0\n")
    assert scale_factor_of_files(None, files) == 1990.0
    (folder / "ALL0001" / "gyrolock.toml").write_text("[gyro]\nscale_factor_pulses_per_deg = 2010.0\n")
    with pytest.raises(UsageError, match="mixed scale factors"):
        scale_factor_of_files(None, files)
