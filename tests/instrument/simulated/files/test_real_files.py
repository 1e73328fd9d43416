"""Setup strings and curves that real instruments wrote go into the simulated one and come out the same."""

import re
from pathlib import Path

import pytest

from instrument import read_waveform
from instrument.simulated.front_end.traces import Trace
from instrument.simulated.pictures import csv_file

FILES = Path(__file__).resolve().parents[5] / "shared" / "data" / "tek-files"
pytestmark = pytest.mark.skipif(not FILES.is_dir(), reason="the collection of real files is not beside this tree")


def leaves(setup: str) -> dict[str, str]:
    """Full headers and values of a setup string."""
    found, branch = {}, ""
    for part in setup.strip().split(";"):
        header, _, value = part.partition(" ")
        header = header[1:] if header.startswith(":") else branch + header
        branch = header[: header.rfind(":") + 1]
        found[header] = value
    return found


def test_setup_of_a_first_series_instrument(make_bench):
    setup = (FILES / "tds2mem_fft_F0000TEK.SET").read_text()
    bench = make_bench(model="TDS2012")
    bench.write(setup)
    assert bench.events() == [401]
    wanted, answered = leaves(setup), leaves(bench.ask("SET?"))
    wanted.pop("HORIZONTAL:SCALE")  # a second name of MAIN:SCALE
    assert {header: answered[header] for header in wanted} == wanted
    # in the same order, too
    assert [header for header in answered if header in wanted] == list(wanted)


@pytest.mark.parametrize(
    ("file", "model"),
    [
        ("tds2014c_F0000TEK.SET", "TDS2014C"),
        ("tds2014c_pwm_F0000TEK.SET", "TDS2014C"),
        ("tds1012b_trigpos_F0000TEK.SET", "TDS1012B"),
        ("tds2022b_average4_F0000TEK.SET", "TDS2022B"),
    ],
)
def test_setup_of_later_models(make_bench, file, model):
    setup = (FILES / file).read_text()
    wanted = leaves(setup)
    bench = make_bench(model=model)
    bench.write(setup)
    assert bench.events() == [401]  # every command is known
    answered = leaves(bench.ask("SET?"))
    assert {header: answered[header] for header in wanted} == wanted
    assert [header for header in answered if header in wanted] == list(wanted)
    assert bench.ask("*LRN?") == bench.ask("SET?")


@pytest.mark.parametrize(
    ("file", "model"),
    [
        ("tds2014c_F0000TEK.SET", "TDS2014C"),
        ("tds2014c_pwm_F0000TEK.SET", "TDS2014C"),
        ("tds1012b_trigpos_F0000TEK.SET", "TDS1012B"),
        ("tds2022b_average4_F0000TEK.SET", "TDS2022B"),
        ("tds2mem_fft_F0000TEK.SET", "TDS2012+TDS2MEM"),
    ],
)
def test_setup_file_recalled_and_saved_again_is_the_same_file(make_bench, file, model):
    bench, setup = make_bench(model=model), (FILES / file).read_bytes()
    bench.scope.storage.files["A:\\REAL.SET"] = setup
    bench.write("RECALL:SETUP 'REAL.SET'")
    bench.write("SAVE:SETUP 'AGAIN.SET'")
    assert bench.events() == [401]
    assert bench.scope.storage.files["A:\\AGAIN.SET"] == setup


def test_setup_of_a_c_model_on_a_b_model_loses_what_it_does_not_know_and_nothing_else(make_bench):
    setup = (FILES / "tds2014c_F0000TEK.SET").read_bytes()
    bench = make_bench(model="TDS2014B")
    bench.scope.storage.files["A:\\C.SET"] = setup
    bench.write("RECALL:SETUP 'C.SET'")
    unknown = {"DATALOGGING", "LIMIT"}
    wanted, answered = leaves(setup.decode()), leaves(bench.ask("SET?"))
    lost = {header for header in wanted if header not in answered}
    assert lost == {h for h in wanted if h.split(":")[0] in unknown} | {"MEASUREMENT:METHOD"}
    assert {header: answered[header] for header in wanted if header not in lost} == {
        header: value for header, value in wanted.items() if header not in lost
    }
    assert bench.events() == [401] + [113] * len(lost)


def test_curve_of_a_real_tds2014b_comes_back_byte_for_byte(make_bench):
    curve = (FILES / "tds2014b_curve_ribinary_width2.bin").read_bytes()
    assert curve.startswith(b"#45000")
    bench = make_bench()
    bench.write("HEADER OFF;:DATA:ENC RIB;WIDTH 2;DEST REFA;SOURCE REFA;:SELECT:REFA ON")
    bench.write(b"CURVE " + curve[:5006])
    assert bench.events() == [401]
    assert bench.ask_raw("CURVE?") == curve[:5006] + b"\n"


@pytest.mark.parametrize("file", sorted(path.name for path in FILES.glob("*.CSV")) or ["none"])
def test_waveform_file_is_written_again_byte_for_byte(file):
    """Codes and keys of a real file, through our writer."""
    content = (FILES / file).read_bytes()
    read = read_waveform(FILES / file)
    scales = read.preamble
    keys = dict(line.split(",")[:2] for line in content.decode().splitlines()[:18])
    last = {key: keys[key] for key in ("Model Number", "Serial Number", "Firmware Version") if key in keys}
    scale = (scales.ymult, scales.yzero, scales.yoff, scales.yunit)
    trace = Trace(read.codes, scales.wfid, scales.pt_fmt, scales.xincr, scales.xzero, scales.xunit, *scale)
    written = csv_file(trace, keys["Source"], float(keys["Probe Atten"]), last)
    if scales.xunit == "Hz":  # the unit adds up its frequencies with rounding errors of its own
        written, content = (re.sub(rb",, *[0-9.]+,", b",,f,", text) for text in (written, content))
    assert written == content
