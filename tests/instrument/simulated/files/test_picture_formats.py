"""Hard copies in all formats, read by a program that is not ours, and the zoom of the spectrum."""

import io
import re

import numpy as np
import pytest
from PIL import Image

from instrument.simulated.pictures import COLOURS, FORMATS, eps, packed_bitmap, pcx


def hard_copy(bench, name):
    bench.write(f"HARDCOPY:PORT GPIB;FORMAT {name};:ACQUIRE:STATE OFF")
    return bench.ask_raw("HARDCOPY START")


def colours(data):
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


@pytest.mark.parametrize("name", ["RLE", "PCX", "TIFF"])
def test_every_format_holds_the_same_picture(bench, name):
    bench.single()
    picture = colours(hard_copy(bench, "BMP"))
    assert picture.shape == (240, 320, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) >= 4  # background, grid, frame, trace
    data = hard_copy(bench, name)
    assert Image.open(io.BytesIO(data)).format == {"RLE": "BMP"}.get(name, name)
    assert np.array_equal(colours(data), picture)


def test_postscript_holds_the_picture_in_black_and_white(bench):
    bench.single()
    picture = colours(hard_copy(bench, "BMP"))
    text = hard_copy(bench, "EPSIMAGE").decode("ascii")
    assert text.startswith("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 320 240\n")
    rows = re.findall(r"^[0-9a-f]{80}$", text, re.MULTILINE)
    bits = np.unpackbits(np.frombuffer(bytes.fromhex("".join(rows)), dtype=np.uint8)).reshape(240, 320)
    assert np.array_equal(bits == 1, (picture == 255).all(axis=2))


@pytest.mark.parametrize("width", [1, 2, 63, 64, 65, 255, 256, 301])
def test_long_runs_survive_packing(width):
    rng = np.random.default_rng(width)
    for highest in (1, len(COLOURS)):
        pixels = rng.integers(0, highest, (3, width), dtype=np.uint8)
        expected = np.array(COLOURS, dtype=np.uint8)[pixels]
        for write in (packed_bitmap, pcx):
            assert np.array_equal(colours(write(pixels)), expected), write


def test_colour_numbers_that_look_like_pcx_runs_are_escaped():
    pixels = np.array([[0xC0, 0xC1, 0xFF, 0x0C]], dtype=np.uint8)
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(pcx(pixels)))), pixels)


def test_printer_languages_are_refused_and_eps_is_not_among_them(bench):
    assert hard_copy(bench, "DESKJET") is None
    assert bench.events() == [221, 420]
    assert set(FORMATS) == {"BMP", "RLE", "PCX", "TIFF", "EPSIMAGE"}
    assert eps(np.zeros((2, 8), dtype=np.uint8)).count(b"\nff") == 2


def test_horizontal_zoom_of_the_spectrum_moves_the_peak_on_the_screen(make_bench):
    bench = make_bench({1: lambda times: 2.0 * np.sin(2 * np.pi * 20e3 * times)}, noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 1;:HOR:SCALE 2.5E-4")
    bench.write("MATH:DEFINE 'FFT(CH1,RECT)';:SELECT:MATH ON;CH1 OFF;:DATA:SOURCE MATH")
    bench.single()
    hertz_per_division = []
    for zoom in (1, 2, 5, 10):
        bench.write(f"MATH:FFT:HORIZONTAL:SCALE {zoom};POSITION 0")
        trace = (colours(hard_copy(bench, "BMP")) == COLOURS[3]).all(axis=2)
        peak = np.flatnonzero(trace[np.argmax(trace.any(axis=1))]).mean()
        # 1024 points of 493.2 Hz over ten divisions of 25 pixels that begin at pixel 20
        assert peak == pytest.approx(20 + 250 * zoom * 20e3 / 493.213384 / 1024, abs=1.5 + zoom / 2)
        hertz_per_division.append(float(re.search(r"([0-9.E-]+) Hz/div", bench.ask("WFMPRE:WFID?"))[1]))
        assert bench.ask("WFMPRE:NR_PT?;XINCR?") == "1024;4.93213384E2"
    assert hertz_per_division[0] / np.array(hertz_per_division) == pytest.approx([1, 2, 5, 10])
