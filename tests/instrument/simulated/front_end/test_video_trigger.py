"""Video trigger on composite signals that are built half line by half line from the tables of ITU-R BT.1700."""

import numpy as np
import pytest

LINE, EQUALISING, BROAD = 4.7e-6, 2.35e-6, 27.3e-6
HALF_LINES = {"PAL": 1250, "NTSC": 1050}
HALF_LINE = {"PAL": 32e-6, "NTSC": 1.001 / 31_500}
# First half line (counted from 1) of each run of equal pulses, their number, and their width.
RUNS = {
    "PAL": ((1, 5, BROAD), (6, 5, EQUALISING), (621, 5, EQUALISING), (626, 5, BROAD), (631, 5, EQUALISING),
            (1246, 5, EQUALISING)),
    "NTSC": ((1, 6, EQUALISING), (7, 6, BROAD), (13, 6, EQUALISING), (526, 6, EQUALISING), (532, 6, BROAD),
             (538, 6, EQUALISING)),
}  # fmt: skip
LINES = {"PAL": ((6, 310), (319, 623)), "NTSC": ((10, 263), (273, 525))}
ODD, EVEN = {"PAL": 1, "NTSC": 7}, {"PAL": 626, "NTSC": 532}  # half lines of the first broad pulses


def pulse_widths(standard):
    """Width of the sync pulse at the beginning of each half line, 0 where there is none."""
    widths = np.zeros(HALF_LINES[standard])
    for first, last in LINES[standard]:
        widths[2 * np.arange(first, last + 1) - 2] = LINE
    for first, count, width in RUNS[standard]:
        widths[first - 1 : first - 1 + count] = width
    return widths


def video(standard, *, start=3.21e-3, inverted=False):
    """1 V of composite video: sync from 0 to 0.3 V, a picture above it that differs from line to line."""
    widths, half = pulse_widths(standard), HALF_LINE[standard]

    def signal(times):
        position = (times - start) % (half * len(widths))
        number = np.minimum((position / half).astype(int), len(widths) - 1)
        since = position - number * half
        line_time = position % (2 * half)
        picture = 0.35 + 0.3 * (1 + np.sin(number * 0.7 + line_time * 2e5))
        shown = (line_time > 10.5e-6) & (line_time < 2 * half - 1.7e-6) & (widths[number] != EQUALISING)
        volts = np.where(since < widths[number], 0.0, np.where(shown & (widths[number] != BROAD), picture, 0.3))
        return -volts if inverted else volts

    return signal


def trigger_times(make_bench, standard, settings, *, inverted=False, count=3):
    """Half lines and the rest, from the beginning of the frame, at which `count` acquisitions triggered."""
    bench = make_bench({1: video(standard, inverted=inverted)}, noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 0.2;:HOR:SCALE 1E-5;:TRIG:MAIN:MODE NORMAL;TYPE VIDEO")
    bench.write(f"TRIG:MAIN:VIDEO:STANDARD {standard};{settings}")
    found = []
    for _ in range(count):
        bench.clock.sleep(0.0071)
        bench.single()
        record = bench.scope.acquisition.record
        halves = (record.starts[0] - record.xzero - 3.21e-3) / HALF_LINE[standard] % HALF_LINES[standard]
        found.append((round(halves) % HALF_LINES[standard] + 1, abs(halves - round(halves)) * HALF_LINE[standard]))
    return found


@pytest.mark.parametrize("standard", ["PAL", "NTSC"])
@pytest.mark.parametrize("inverted", [False, True])
def test_any_line(make_bench, standard, inverted):
    polarity = "INVERT" if inverted else "NORMAL"
    for half_line, error in trigger_times(
        make_bench, standard, f"SYNC LINE;POLARITY {polarity}", inverted=inverted
    ):
        assert half_line % 2 == 1 or pulse_widths(standard)[half_line - 1] != LINE
        assert pulse_widths(standard)[half_line - 1] > 0
        assert error < 0.2e-6


@pytest.mark.slow
@pytest.mark.parametrize("standard", ["PAL", "NTSC"])
@pytest.mark.parametrize("sync", ["ODD", "EVEN", "FIELD"])
def test_fields(make_bench, standard, sync):
    allowed = {"ODD": {ODD[standard]}, "EVEN": {EVEN[standard]}, "FIELD": {ODD[standard], EVEN[standard]}}[sync]
    for half_line, error in trigger_times(make_bench, standard, f"SYNC {sync}"):
        assert half_line in allowed
        assert error < 0.2e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("standard", "line"), [("PAL", 1), ("PAL", 17), ("PAL", 310), ("PAL", 400), ("NTSC", 21), ("NTSC", 500)]
)
def test_one_line_by_its_number(make_bench, standard, line):
    for half_line, error in trigger_times(make_bench, standard, f"SYNC LINENUM;LINE {line}", count=2):
        assert half_line == 2 * line - 1
        assert error < 0.2e-6


@pytest.mark.slow
def test_wrong_polarity_and_small_signals_do_not_trigger(make_bench):
    for signal, settings in (
        (video("PAL"), "CH1:SCALE 5"),
        (video("PAL"), "TRIG:MAIN:VIDEO:SYNC ODD;POLARITY INVERT"),
    ):
        bench = make_bench({1: signal}, noise_levels=0.0)
        bench.write("CH1:PROBE 1;SCALE 0.2;:TRIG:MAIN:MODE NORMAL;TYPE VIDEO;VIDEO:STANDARD PAL")
        bench.write(f"{settings};:ACQ:STOPA SEQ;STATE RUN")
        assert bench.ask("*OPC?", timeout=0.3) is None


def test_other_triggers_after_video(make_bench):
    bench = make_bench({1: video("PAL")}, noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 0.2;:TRIG:MAIN:TYPE VIDEO;:TRIG:MAIN:TYPE EDGE;LEVEL 0.15")
    bench.single()
    assert bench.ask("TRIG:STATE?") == ":TRIGGER:STATE SAVE"
