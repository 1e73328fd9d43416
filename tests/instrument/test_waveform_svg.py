"""What a notebook shows of a waveform."""

import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser

import matplotlib
import numpy as np
import pytest

from instrument import TDS2014
from instrument.simulated import resource_manager

SVG = "{http://www.w3.org/2000/svg}"


def picture(waveform):
    """Root of the picture, and its curve as points in divisions across and volts up, read off its own labels."""
    html = waveform._repr_html_()
    root = ET.fromstring(html[html.index("<svg") :])
    numbers = re.findall(r"[ML]([\d.]+) ([\d.]+)", root.find(f"{SVG}path").get("d"))
    points = np.array(numbers, dtype=float)
    lines = [{key: float(line.get(key)) for key in ("x1", "x2", "y1", "y2")} for line in root.iter(f"{SVG}line")]
    left, right = min(line["x1"] for line in lines), max(line["x2"] for line in lines)
    top, bottom = min(line["y1"] for line in lines), max(line["y2"] for line in lines)
    labels = [text.text for text in root.iter(f"{SVG}text")]
    high, low = float(labels[0]), float(labels[2])
    across = (points[:, 0] - left) / (right - left) * 10
    up = high + (points[:, 1] - top) / (bottom - top) * (low - high)
    return labels, across, up


def test_three_lines_give_a_picture():
    with TDS2014("GPIB0::1::INSTR", resource_manager=resource_manager(noise_levels=0.0)) as scope:
        waveform = scope.acquire("CH1")
    labels, across, up = picture(waveform)
    assert labels[:4] == ["4", "0", "-4", "Volts"]
    assert labels[4:] == ["-0.0025 s", "0 s", "0.0025 s"]
    assert across.min() >= 0
    assert across.max() <= 10
    # 2 V sine of 1 kHz over 5 ms: the picture has to agree with the signal itself
    expected = 2.0 * np.sin(2 * np.pi * 1000.0 * (across * 5e-4 - 2.5e-3))
    assert np.abs(up - expected).max() < 0.15


class Checker(HTMLParser):
    """Every tag that is opened is closed again, in order."""

    def __init__(self):
        super().__init__()
        self.open = []

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.mark.slow
@pytest.mark.parametrize("command", ["CH1:COUPLING GND", "CH1:SCALE 0.05", "HOR:SCALE 0.25", "ACQ:MODE PEAK"])
def test_flat_clipped_scanned_and_paired_records_have_a_picture(command, bench):
    bench.write(command)
    waveform = bench.acquire(1)
    html = waveform._repr_html_()
    checker = Checker()
    checker.feed(html)
    assert checker.open == []
    ET.fromstring(html[html.index("<svg") :])
    assert "nan" not in html
    assert ("clipped" in html) == waveform.clipped


def test_file_of_a_spectrum_has_a_picture(bench):
    bench.set_math("FFT(CH1, HANNING)")
    bench.acquire(1)  # and stop: the first spectrum has another preamble than what stood there before
    labels, _, up = picture(bench.fetch("MATH"))
    assert labels[3] == "dB"
    assert labels[-1].endswith("Hz")
    assert np.ptp(up) > 20


def test_plot(bench):
    matplotlib.use("Agg")
    waveform = bench.acquire(1)
    axes = waveform.plot()
    (line,) = axes.get_lines()
    np.testing.assert_array_equal(line.get_ydata(), waveform.volts)
    assert axes.get_xlabel() == "time from trigger / s"
    assert axes.get_ylabel() == "Ch1 / V"
    assert waveform.plot(axes) is axes
    matplotlib.pyplot.close(axes.figure)
