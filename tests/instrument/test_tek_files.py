"""Files that real scopes saved, and what people do to such files afterwards."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from instrument import FileFormatError, Preamble, Waveform, read_waveform
from instrument.tek_files import csv_text, parse_csv, parse_isf, read_tek_file

TEK_FILES = Path(__file__).parents[3] / "shared" / "data" / "tek-files"
CSV_FILES = sorted(TEK_FILES.glob("*.CSV"))
needs_files = pytest.mark.skipif(not CSV_FILES, reason="the recorded scope files are not on this computer")

PREAMBLE = Preamble.parse(
    '1;8;BIN;RI;MSB;2500;"Ch2, DC coupling, 5.0E-2 V/div, 5.0E-4 s/div, 2500 points, Sample mode";'
    'Y;2.0E-6;0;-2.5E-3;"s";2.0E-3;0.0E0;2.5E1;"Volts"'
)


def scope_csv(waveform: Waveform, *, source: str, scale: float, per_division: float, tail: list[str]) -> str:
    """Write a record as the scopes do: the layout was found in 283 files of the family."""
    preamble = waveform.preamble
    hertz = preamble.xunit == "Hz"
    unit = "V" if preamble.yunit == "Volts" else preamble.yunit
    keys = [
        f"Record Length,{preamble.nr_pt:e}",
        f"Sample Interval,{preamble.xincr:e}",
        f"Trigger Point,{-preamble.xzero / preamble.xincr + 0.0:.12e}",
        *[","] * 3,
        f"Source,{source}",
        f"Vertical Units,{unit}",
        f"Vertical Scale,{scale:e}",
        f"Vertical Offset,{preamble.yoff * preamble.ymult + 0.0:e}",
        f"Horizontal Units,{preamble.xunit}",
        f"Horizontal Scale,{per_division:e}",
        f"Pt Fmt,{preamble.pt_fmt}",
        f"Yzero,{preamble.yzero:e}",
        *tail,
    ]
    lines = []
    width = 0
    for n, value in enumerate(waveform.volts):
        time = preamble.xzero + n * preamble.xincr
        digits = f"{abs(time):.{5 if hertz else 12}f}"
        # A record that starts before the trigger has its time zero with a minus sign.
        last_negative = 0.5 * preamble.xincr if preamble.xzero < 0 else -0.5 * preamble.xincr
        sign = "-" if time < last_negative else ""
        if n < len(keys):
            field, key = f"{sign + digits:>17}", keys[n]
            width = width or len(sign + digits)
        else:
            # No padding blanks here: zeros after the sign, up to the width of the first value.
            field, key = sign + digits.zfill(width), ","
        lines.append(f"{key},,{field},{value:10.5f},\n")
    return "".join(lines)


def key_rows(text: str) -> dict[str, str]:
    return dict(line.split(",")[:2] for line in text.splitlines() if line[0] != ",")


@needs_files
@pytest.mark.parametrize("file", CSV_FILES, ids=lambda file: file.name)
def test_real_file_has_whole_codes_and_the_same_numbers(file):
    waveform = read_waveform(file)
    rows = [line.split(",") for line in file.read_text().splitlines()]
    assert waveform.codes.dtype == np.int8
    assert len(waveform.codes) == len(rows)
    np.testing.assert_allclose(waveform.volts, [float(row[4]) for row in rows], atol=6e-6)
    np.testing.assert_allclose(
        waveform.times, [float(row[3]) for row in rows], atol=1e-4 * waveform.sample_interval
    )


@needs_files
@pytest.mark.parametrize("file", CSV_FILES, ids=lambda file: file.name)
def test_real_file_can_be_written_again_byte_for_byte(file):
    text = file.read_text()
    waveform = read_waveform(file)
    keys = key_rows(text)
    tail = [",".join(line.split(",")[:2]) for line in text.splitlines()[14:18] if line[0] != ","]
    again = scope_csv(
        waveform,
        source=keys["Source"],
        scale=float(keys["Vertical Scale"]),
        per_division=float(keys["Horizontal Scale"]),
        tail=tail,
    )
    if waveform.preamble.xunit == "Hz":
        # The scope adds up its frequency step in coarse numbers: there the column itself is not compared.
        again, text = _without_third_column(again), _without_third_column(text)
    assert again == text


def _without_third_column(text: str) -> str:
    return "".join(",".join(line.split(",")[:3] + line.split(",")[4:]) for line in text.splitlines(True))


OVER_TIME = [file for file in CSV_FILES if not file.name.endswith("MTH.CSV")]


@needs_files
@pytest.mark.parametrize("file", OVER_TIME, ids=lambda file: file.name)
def test_what_we_write_is_what_the_scope_wrote_byte_for_byte(file):
    found = read_tek_file(file)
    names = ("Probe Atten", "Model Number", "Serial Number", "Firmware Version")
    written = csv_text(found.waveform, {name: found.keys[name] for name in names if name in found.keys})
    assert written.encode() == file.read_bytes()


def test_what_no_scope_of_this_family_could_have_written_is_refused():
    wide = Waveform(np.zeros(2500, np.int16), replace(PREAMBLE, byt_nr=2, bit_nr=16))
    blank = Waveform(np.full(2500, -128, np.int8), PREAMBLE)
    for wave in (wide, blank, Waveform(np.zeros(2500, np.int8), replace(PREAMBLE, xunit="Hz"))):
        with pytest.raises(FileFormatError, match="take another kind"):
            csv_text(wave)


@needs_files
def test_real_files_say_what_they_are():
    high = read_waveform(TEK_FILES / "tds1012b_cliphigh_F0001CH2.CSV")
    assert high.clipped
    assert set(high.codes.tolist()) == {127}
    low = read_waveform(TEK_FILES / "tds2014c_cliplow_F0000CH3.CSV")
    assert set(low.codes.tolist()) == {-127}
    shifted = read_waveform(TEK_FILES / "tds1012b_trigpos_F0000CH1.CSV")
    # Horizontal position 2.22E-4 s at 50 us/div; vertical position -2.04 div.
    assert shifted.preamble.xzero == pytest.approx(-5 * 5e-5 + 2.22e-4)
    assert shifted.preamble.yoff == -51.0
    assert shifted.preamble.wfid.startswith("Ch1, 5.0E0 V/div, 5.0E-5 s/div")
    spectrum = read_waveform(TEK_FILES / "tds2mem_fft_F0000MTH.CSV")
    assert (spectrum.preamble.xunit, spectrum.preamble.yunit, len(spectrum.codes)) == ("Hz", "dB", 1024)
    assert spectrum.volts.min() == pytest.approx(-66.9897)


codes_lists = st.lists(st.integers(-127, 127), min_size=20, max_size=60)


@given(
    codes_lists,
    st.sampled_from([2e-3, 5e-3, 1e-2, 5e-2, 0.2, 1.0, 5.0, 50.0]),
    st.integers(-100, 100),
    st.sampled_from([2.5e-8, 1e-6, 5e-4, 0.025, 1.0]),
)
def test_codes_come_back_exactly_from_any_scale(codes, scale, level, per_division):
    preamble = replace(
        PREAMBLE,
        nr_pt=len(codes),
        ymult=scale / 25,
        yoff=float(level),
        xincr=per_division / 250,
        xzero=-5 * per_division,
    )
    waveform = Waveform(np.array(codes, np.int8), preamble)
    again = parse_csv(scope_csv(waveform, source="CH2", scale=scale, per_division=per_division, tail=[]))
    assert again.codes.tolist() == codes
    assert again.preamble.yoff == level
    assert again.preamble.xzero == pytest.approx(preamble.xzero)


def make_csv(points: int = 40) -> str:
    codes = np.array([(n * 13) % 200 - 100 for n in range(points)], np.int8)
    preamble = replace(PREAMBLE, nr_pt=points)
    return scope_csv(
        Waveform(codes, preamble), source="CH2", scale=0.05, per_division=5e-4, tail=["Probe Atten,1.000000e+01"]
    )


def test_edited_files_are_still_read():
    text = make_csv()
    plain = parse_csv(text)
    assert parse_csv(text.replace("\n", "\r\n")) == plain
    assert parse_csv("My measurement,,,,\n\n" + text) == plain
    assert parse_csv("Time,Volt,,t,v\n" + text) == plain
    without_key = "".join(line for line in text.splitlines(True)[1:])
    # Without its first row the record begins one interval later.
    with pytest.raises(FileFormatError, match="Trigger Point"):
        parse_csv(without_key)
    short = "\n".join(
        ",".join([*line.split(",")[:3], f"{float(line.split(',')[3]):.6g}", f"{float(line.split(',')[4]):.5g}"])
        for line in text.splitlines()
    )
    assert parse_csv(short) == plain
    no_probe = (
        text.replace("Probe Atten,1.000000e+01", ",").replace("Pt Fmt,Y", ",").replace("Yzero,0.000000e+00", ",")
    )
    assert parse_csv(no_probe) == plain


def test_interval_and_scale_that_are_missing_are_found():
    text = make_csv()
    plain = parse_csv(text)
    without = text.replace("Sample Interval,2.000000e-06", ",").replace("Vertical Scale,5.000000e-02", ",")
    found = parse_csv(without)
    assert found.codes.tolist() == plain.codes.tolist()
    np.testing.assert_array_equal(found.volts, plain.volts)
    assert found.sample_interval == plain.sample_interval
    bare = "".join(f",,,{line.split(',')[3]},{line.split(',')[4]},\n" for line in text.splitlines())
    with pytest.raises(FileFormatError, match="not a waveform file"):
        parse_csv(bare)


def of_a_spreadsheet(text: str, separator: str) -> str:
    """The same with decimal commas."""
    return text.replace(",", "\0").replace(".", ",").replace("\0", separator)


@pytest.mark.parametrize("separator", [";", "\t"])
def test_files_of_spreadsheets_with_decimal_commas(separator, tmp_path):
    text = make_csv()
    file = tmp_path / "F0000CH2.CSV"
    file.write_bytes(b"\xef\xbb\xbf" + of_a_spreadsheet(text, separator).replace("\n", "\r\n").encode())
    assert read_waveform(file) == parse_csv(text)
    file.write_text(of_a_spreadsheet(text, separator), encoding="utf-16")
    assert read_waveform(file) == parse_csv(text)
    cells = [line.split(",") for line in text.splitlines()]
    quoted = "\n".join(",".join('"' + cell.strip().replace(".", ",") + '"' for cell in row) for row in cells)
    file.write_text(quoted)
    assert read_waveform(file) == parse_csv(text)


def later_csv(volts: np.ndarray, *, heading: str = "TIME,CH1", interval: float = 4e-6) -> str:
    """As a TBS1000C writes it."""
    keys = ["Model,TBS1102C", "Firmware Version,1.25.5", "Point Format,Y,", "Horizontal Units,S,"]
    keys += ["Horizontal Scale,0.001,", f"Sample Interval,{interval:g},", f"Record Length,{len(volts)},"]
    keys += [
        "Probe Attenuation,1,",
        "Vertical Units,V,",
        "Vertical Offset,0,",
        "Vertical Scale,0.5,",
        ",,",
        "Label,,",
    ]
    rows = [f"{-0.005 + n * interval:.9e},{value:.6g}," for n, value in enumerate(volts)]
    return "\n".join([*keys, heading, *rows]) + "\n"


@pytest.mark.parametrize(("levels", "offset"), [(1, 0.0), (1, 0.3), (5, 0.0), (1, 2.4)])
def test_files_of_later_models(levels, offset, tmp_path):
    rng = np.random.default_rng(5)
    codes = np.clip(np.rint(60 * np.sin(np.arange(2000) / 70) + rng.standard_normal(2000)), -100, 100) * levels
    volts = codes * 0.02 + offset
    file = tmp_path / "tek0000CH1.csv"
    file.write_text(later_csv(volts))
    found = read_tek_file(file)
    np.testing.assert_allclose(found.waveform.volts, volts, atol=1e-5)
    assert np.ptp(found.waveform.codes.astype(int)) == np.ptp(codes) / levels
    assert found.waveform.sample_interval == 4e-6
    assert found.about == {"model": "TBS1102C", "firmware": "1.25.5", "probe": "1"}


@pytest.mark.parametrize(
    ("heading", "problem"),
    [
        ("TIME,CH1,CH2", "several traces"),
        ("TIME,CH1,CH1 Peak Detect", "Peak Detect"),
        ("FREQUENCY,MATH", "spectrum"),
    ],
)
def test_what_later_models_save_besides_is_refused(heading, problem, tmp_path):
    file = tmp_path / "tek0000CH1.csv"
    file.write_text(later_csv(np.arange(50) * 0.02, heading=heading))
    with pytest.raises(FileFormatError, match=problem):
        read_waveform(file)


@needs_files
def test_a_curve_that_a_program_has_kept(tmp_path):
    """The published answer of CURVe? of a TDS2014B, and that of WFMPre? beside it or before it."""
    curve = (TEK_FILES / "tds2014b_curve_ribinary_width2.bin").read_bytes()
    preamble = (
        '2;16;BIN;RI;MSB;2500;"Ch1, DC coupling, 2.0E0 V/div, 2.5E-5 s/div, 2500 points, Sample mode";Y;1.0E-7;0;'
        '-1.25E-4;"s";3.125E-4;0.0E0;-1.1008E4;"Volts"'
    )
    file = tmp_path / "channel-1.bin"
    file.write_bytes(curve)
    with pytest.raises(FileFormatError, match=r"channel-1\.wfmpre"):
        read_waveform(file)
    file.with_suffix(".wfmpre").write_text(preamble + "\n")
    beside = read_waveform(file)
    assert beside.codes.dtype == np.int8
    both = tmp_path / "both.txt"
    both.write_bytes(preamble.encode() + b"\n" + curve)
    assert read_waveform(both) == beside
    both.write_text(preamble + "\n")
    with pytest.raises(FileFormatError, match="without that of CURVe"):
        read_waveform(both)


@needs_files
def test_what_files_say_of_their_scope():
    found = read_tek_file(TEK_FILES / "tds2014c_pwm_F0000CH1.CSV")
    assert found.about == {"model": "TDS2014C", "serial": "C042203", "firmware": "v24.26", "probe": "1.000000e+00"}
    assert (found.setting("COUPLING"), found.setting("BANDWIDTH"), found.setting("INVERT")) == ("DC", "OFF", "OFF")


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("Vertical Scale,5.000000e-02", "Vertical Scale,zero", "Vertical Scale"),
        ("Vertical Scale,5.000000e-02", "Vertical Scale,0", "positive"),
        ("Vertical Scale,5.000000e-02", "Vertical Scale,7.000000e-02", "whole number of converter levels"),
        ("Vertical Scale,5.000000e-02", "Vertical Scale,2.500000e-02", "8-bit converter"),
        ("Trigger Point,1.250000000000e+03", "Trigger Point,0", "Trigger Point"),
        (",,,-00.002436000000,  -0.21800,\n", "", "missing or doubled"),
        (",,,-00.002436000000,  -0.21800,\n", ",,,-00.002436000000,broken,\n", "line 33"),
        (",,,-00.002436000000,  -0.21800,\n", ",,,-00.002436000000,nan,\n", "not a number"),
        (",,,-00.002436000000,  -0.21800,\n", ",,,,\n", "missing or doubled"),
    ],
)
def test_damaged_files_are_refused_with_a_reason(old, new, problem, tmp_path):
    text = make_csv()
    assert old in text
    file = tmp_path / "F0000CH2.CSV"
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(FileFormatError, match=problem) as caught:
        read_waveform(file)
    assert str(file) in str(caught.value)
    assert "ask again" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"\n\n", b"\x00\x01\xff" * 100, b"a,b,c,d,e\n1,2,3,4,5\n", b"%PDF-1.4"])
def test_other_files_are_refused(content, tmp_path):
    file = tmp_path / "other.csv"
    file.write_bytes(content)
    with pytest.raises(FileFormatError, match="not a waveform file"):
        read_waveform(file)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_waveform(tmp_path / "none.csv")


def test_isf_with_long_headers():
    codes = [(n * 7) % 250 - 124 for n in range(2500)]
    assert 10 in codes  # a line feed in the data
    head = (
        b":WFMPRE:BYT_NR 1;BIT_NR 8;ENCDG BIN;BN_FMT RI;BYT_OR MSB;NR_PT 2500;"
        b'WFID "Ch1, DC coupling, 2.0E-1 V/div, 5.0E-7 s/div, 2500 points, Sample mode";PT_FMT Y;'
        b'XINCR 2.0E-9;PT_OFF 0;XZERO -2.5E-6;XUNIT "s";YMULT 8.0E-3;YZERO 0.0E0;YOFF 5.0E1;YUNIT "Volts";:CURVE '
    )
    body = b"#42500" + np.array(codes, np.int8).tobytes()
    for end in (b"", b"\n", b"\r\n", b"\n\n\n"):
        waveform = parse_isf(head + body + end)
        assert waveform.codes.tolist() == codes
        assert waveform.volts[0] == pytest.approx((codes[0] - 50) * 8e-3)
    as_text = head.replace(b"ENCDG BIN", b"ENCDG ASC") + ",".join(map(str, codes)).encode() + b"\n"
    assert parse_isf(as_text).codes.tolist() == codes


def test_isf_with_short_tags_and_real_sixteen_bits(tmp_path):
    head = (
        b':WFMP:BYT_N 2;BIT_N 16;ENC BIN;BN_F RI;BYT_O MSB;WFI "Ch1, DC coupling, 100.0mV/div";NR_P 3;PT_F Y;'
        b'XUN "s";XIN 4.0E-9;XZE -2.0E-5;PT_O 0;YUN "V";YMU 1.5625E-5;YOF 1.28E3;YZE 0.0E0;VSCALE 1.0E-1;'
        b"HSCALE 4.0E-6;VPOS 2.0E-1;VOFFSET 0.0E0;HDELAY 0.0E0;:CURV "
    )
    file = tmp_path / "tek0000CH1.isf"
    file.write_bytes(head + b"#16\x01\x00\x7f\xff\x80\x01")
    waveform = read_waveform(file)
    assert waveform.codes.tolist() == [256, 32767, -32767]
    np.testing.assert_allclose(waveform.volts, (np.array([256, 32767, -32767]) - 1280) * 1.5625e-5)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b":WFMPRE:BYT_NR 1;BIT_NR 8", "no curve"),
        (b":WFMPRE:BYT_NR 1;:CURVE #11a", "no BIT_NR"),
        (b":WFMPRE:\xff\xfe;:CURVE #11a", "fields instead of 16"),
    ],
)
def test_cut_isf(content, problem, tmp_path):
    file = tmp_path / "cut.isf"
    file.write_bytes(content)
    with pytest.raises(FileFormatError, match=problem):
        read_waveform(file)


def test_isf_with_a_short_block(tmp_path):
    file = tmp_path / "short.isf"
    text = ":WFMPRE:" + ";".join(
        f"{name.upper()} {value}"
        for name, value in zip(vars(PREAMBLE), PREAMBLE.to_text().split(";"), strict=True)
    )
    file.write_bytes(text.encode() + b";:CURVE #42500" + bytes(2000))
    with pytest.raises(FileFormatError, match="2000 of 2500"):
        read_waveform(file)
