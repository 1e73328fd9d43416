"""Trigger, time base, states and acquisition modes: user manual 071-1064-00; programmer manual 071-1075-04."""

import numpy as np
import pytest


def ramp(times: np.ndarray) -> np.ndarray:
    """Volts equal to time: the codes tell when they were taken."""
    return np.asarray(times, dtype=float)


def sawtooth(times: np.ndarray) -> np.ndarray:
    """Rises from -4 V to 4 V in 1 ms."""
    return 8.0 * ((1000.0 * times) % 1.0) - 4.0


def volts(bench) -> np.ndarray:
    ymult, yoff = map(float, bench.ask("HEADER OFF;:WFMPRE:YMULT?;YOFF?", timeout=1000).split(";"))
    return (bench.codes().astype(float) - yoff) * ymult


def times(bench) -> np.ndarray:
    xincr, xzero = map(float, bench.ask("HEADER OFF;:WFMPRE:XINCR?;XZERO?", timeout=1000).split(";"))
    return xzero + xincr * np.arange(2500)


@pytest.mark.parametrize("slope", ["RISE", "FALL"])
@pytest.mark.parametrize("level", [0.0, 1.3, -1.7])
@pytest.mark.parametrize("position", [0.0, 8e-4, -1.2e-3, 4e-3])
def test_the_record_shows_the_trigger_at_time_zero(bench, slope, level, position):
    bench.write(f"TRIG:MAIN:EDGE:SLOPE {slope};:TRIG:MAIN:LEVEL {level};:HOR:POSITION {position}")
    bench.single()
    shown, axis = volts(bench), times(bench)
    sign = 1 if slope == "RISE" else -1
    phase = np.arcsin(level / 2.0) if slope == "RISE" else np.pi - np.arcsin(level / 2.0)
    expected = 2.0 * np.sin(2 * np.pi * 1000 * axis + phase)
    # one level of rounding, and the sampling clock is up to half a sample off the trigger
    assert np.abs(shown - expected).max() < 0.02 + 2 * np.pi * 1000 * 2.0 * 1.1e-6
    if position <= 0:
        index = int(np.argmin(np.abs(axis)))
        assert sign * (shown[index + 20] - shown[index - 20]) > 0


def test_the_sample_clock_is_not_locked_to_the_trigger(make_bench):
    bench = make_bench({1: lambda t: 1e-3 * np.sin(2 * np.pi * 3000 * t)}, noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 2E-3;:HOR:SCALE 5E-3")
    firsts = []
    for _ in range(40):
        bench.single()
        firsts.append(bench.codes().tobytes())
    assert len(set(firsts)) > 3


@pytest.mark.parametrize(
    ("asked", "got"),
    [("1E-3", "1.0E-3"), ("1.1E-3", "1.0E-3"), ("2E-3", "2.5E-3"), ("1E-12", "5.0E-9"), ("100", "5.0E1")],
)
def test_time_base_goes_to_the_nearest_step(fresh, asked, got):
    assert fresh.ask(f"HOR:MAIN:SCALE {asked};:HOR:MAIN:SCALE?") == f":HORIZONTAL:MAIN:SCALE {got}"
    assert fresh.events() == [401]


def test_sample_interval_is_a_250th_of_a_division_at_every_step(fresh):
    fresh.write("HEADER OFF;:TRIG:MAIN:EDGE:SOURCE LINE")
    for step in (5e-9, 1e-8, 2.5e-8, 1e-7, 1e-6, 2.5e-5, 5e-4, 1e-3, 2.5e-2):
        fresh.write(f"HOR:SCALE {step}")
        fresh.single()
        assert float(fresh.ask("WFMPRE:XINCR?")) == pytest.approx(step / 250, rel=1e-9)
        ratio = float(fresh.ask("WFMPRE:XZERO?")) / float(fresh.ask("WFMPRE:XINCR?"))
        assert ratio == pytest.approx(-1250, abs=1e-6)


@pytest.mark.parametrize(
    ("probe", "asked", "got"),
    [(1, 2e-3, 2e-3), (1, 1e-6, 2e-3), (1, 50, 5.0), (10, 50, 50.0), (10, 1e-3, 2e-2), (1, 0.288, 0.288)],
)
def test_vertical_scale_keeps_to_the_range_of_the_probe(fresh, probe, asked, got):
    fresh.write(f"CH1:PROBE {probe};SCALE {asked}")
    assert float(fresh.ask("HEADER OFF;:CH1:SCALE?")) == pytest.approx(got)


@pytest.mark.parametrize(
    ("scale", "limit"), [(2e-3, 1000), (5e-3, 400), (0.2, 10), (0.5, 100), (1, 50), (2, 25), (5, 10)]
)
def test_vertical_position_is_bounded_as_the_manual_says(fresh, scale, limit):
    fresh.write(f"HEADER OFF;:CH1:PROBE 1;SCALE {scale};POSITION 5000")
    assert float(fresh.ask("CH1:POSITION?")) == limit
    assert float(fresh.ask("CH1:POSITION -5000;POSITION?")) == -limit


def test_probe_factor_scales_the_readout(fresh):
    fresh.write("HEADER OFF;:CH1:SCALE 2;:TRIG:MAIN:LEVEL 3;:CH1:PROBE 100")
    assert fresh.ask("CH1:SCALE?;:TRIG:MAIN:LEVEL?") == "2.0E1;3.0E1"


def test_window_time_base_follows_and_leads_the_main_one(fresh):
    fresh.write("HEADER OFF;:HOR:MAIN:SCALE 1E-5")
    assert fresh.ask("HOR:DELAY:SCALE?") == "1.0E-5"
    assert fresh.ask("HOR:DELAY:SCALE 1E-3;:HOR:MAIN:SCALE?") == "1.0E-3"


def test_trigger_states_of_a_sequence_in_normal_mode(make_bench):
    bench = make_bench({1: lambda t: np.where(np.asarray(t) < 10.0, -1.0, 1.0)}, noise_levels=0.0)
    bench.write(
        "CH1:PROBE 1;SCALE 1;:HEADER OFF;:HOR:SCALE 5E-2;:TRIG:MAIN:MODE NORMAL;:ACQ:STOPAFTER SEQ;STATE ON"
    )
    assert bench.ask("TRIG:STATE?") == "ARMED"
    bench.clock.sleep(1.0)
    assert bench.ask("TRIG:STATE?") == "READY"
    bench.clock.sleep(10.05 - bench.clock.now())
    assert bench.ask("TRIG:STATE?") == "TRIGGER"
    bench.clock.sleep(0.25)
    assert bench.ask("TRIG:STATE?;:ACQ:STATE?;NUMACQ?") == "SAVE;0;1"
    shown = volts(bench)
    assert shown[:1249].max() == pytest.approx(-1.0) and shown[1251:].min() == pytest.approx(1.0)


def test_auto_mode_runs_free_without_a_trigger_and_normal_waits(bench):
    bench.write("HEADER OFF;:TRIG:MAIN:LEVEL 7")
    bench.single()
    assert bench.ask("ACQ:NUMACQ?") == "1"
    bench.write("ACQ:STOPAFTER RUNSTOP;STATE RUN")
    bench.clock.sleep(1.0)
    assert {bench.ask("TRIG:STATE?") for _ in range(20)} <= {"AUTO", "ARMED"}
    bench.write("ACQ:STOPAFTER SEQUENCE;:TRIG:MAIN:MODE NORMAL;:ACQ:STATE RUN")
    bench.clock.sleep(3600)
    assert bench.ask("BUSY?;:TRIG:STATE?;:ACQ:NUMACQ?") == "1;READY;0"


def test_signal_smaller_than_the_sensitivity_does_not_trigger(make_bench):
    bench = make_bench({1: lambda t: 0.02 * np.sin(2 * np.pi * 1000 * t)}, noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 1;:TRIG:MAIN:MODE NORMAL;:ACQ:STOPAFTER SEQ;STATE ON")
    assert bench.ask("*OPC?", timeout=100) is None


@pytest.mark.parametrize("nap", [0.3, 30.0])
def test_auto_says_that_the_signal_is_gone_however_seldom_it_is_asked(make_bench, nap):
    bench = make_bench({1: lambda t: np.sin(6283.0 * t) * (t < 20.0)}, noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 0.5;:HOR:SCALE 2.5E-4")
    bench.clock.sleep(5.0)
    assert {bench.ask("TRIG:STATE?") for _ in range(9)} <= {"ARMED", "READY", "TRIGGER"}
    bench.clock.sleep(20.0)
    bench.ask("TRIG:STATE?")  # READY is possible as long as this sweep has not waited longer than usual
    for _ in range(9):
        bench.clock.sleep(nap)
        assert bench.ask("TRIG:STATE?") in ("ARMED", "AUTO")
    assert set(bench.codes().tolist()) == {0}


def test_averages_are_of_sweeps_one_after_the_other_and_the_latest(make_bench):
    bench = make_bench({1: lambda t: np.sin(6283.0 * t)}, noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 0.5;:HOR:SCALE 1E-5;:ACQ:MODE AVERAGE;NUMAVG 16")
    bench.codes()
    for pause in (0.02, 0.5, 0.07, 3.0):
        bench.clock.sleep(pause)
        bench.ask("TRIG:STATE?")
        bench.codes()
        starts = np.array(bench.scope.acquisition.record.starts)
        assert np.diff(starts).min() > 5e-3
        assert 0.0 < bench.clock.now() - starts[-1] - 1e-4 < 0.05


def test_force_trigger_completes_a_waiting_acquisition(bench):
    bench.write("HEADER OFF;:HOR:SCALE 1E-2;:TRIG:MAIN:LEVEL 7;MODE NORMAL;:ACQ:STOPAFTER SEQ;STATE ON")
    bench.write("TRIG FORCE")
    bench.clock.sleep(0.1)
    assert bench.ask("BUSY?") == "1"  # it was still ARMED: ignored
    bench.write("TRIG FORCE")
    assert bench.ask("BUSY?") == "1"
    bench.clock.sleep(0.1)
    assert bench.ask("BUSY?;:ACQ:STATE?;*ESR?") == "0;0;0"


def test_trigger_source_need_not_be_displayed(make_bench):
    bench = make_bench({1: ramp, 2: lambda t: np.sin(2 * np.pi * 100 * t)}, noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 5;:CH2:PROBE 1;SCALE 0.5;:TRIG:MAIN:EDGE:SOURCE CH2;:TRIG:MAIN:MODE NORMAL")
    bench.write("HOR:SCALE 2.5E-2")
    bench.single()
    assert bench.events() == [401]


def test_all_channels_are_sampled_at_the_same_time(make_bench):
    bench = make_bench({1: sawtooth, 2: lambda t: -sawtooth(t)}, noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 2;:CH2:PROBE 1;SCALE 2;:SEL:CH2 ON")
    bench.single()
    first = volts(bench)
    bench.write("DATA:SOURCE CH2")
    assert np.abs(first + volts(bench)).max() <= 0.081


def test_inverted_channel_is_upside_down(make_bench):
    bench = make_bench({1: lambda t: np.full_like(t, 1.52)}, noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 1;INVERT ON")
    bench.single()
    assert volts(bench) == pytest.approx(-1.52, abs=0.01)


def test_ground_coupling_shows_a_flat_line(bench):
    bench.write("CH1:COUPLING GND;POSITION 1")
    bench.single()
    assert set(bench.codes().tolist()) == {25}


@pytest.mark.parametrize("frequency", [200.0, 1000.0, 51283.7, 200e3])
def test_ac_coupling_takes_the_mean_away(make_bench, frequency):
    bench = make_bench({1: lambda t: 3.0 + np.sin(2 * np.pi * frequency * t)}, noise_levels=0.0)
    bench.write(f"CH1:PROBE 1;SCALE 1;COUPLING AC;:HOR:SCALE {0.5 / frequency}")
    bench.single()
    shown = volts(bench)
    assert abs((shown.max() + shown.min()) / 2) < 0.06
    assert np.ptp(shown) == pytest.approx(2.0, abs=0.1)


def test_ac_coupling_halves_the_power_at_10_hz(make_bench):
    bench = make_bench({1: lambda t: 2.0 * np.sin(2 * np.pi * 10.0 * t)}, noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 1;COUPLING AC;:HOR:SCALE 5E-2")
    bench.clock.sleep(10.0)
    bench.single()
    assert np.ptp(volts(bench)) == pytest.approx(4.0 / np.sqrt(2), abs=0.1)


def test_stopped_record_keeps_its_settings_when_knobs_are_turned(bench):
    bench.single()
    before = bench.ask_raw("WAVFRM?")
    bench.write("CH1:SCALE 5;POSITION 2;:HOR:SCALE 1;POSITION 3;:TRIG:MAIN:LEVEL 1")
    assert bench.ask_raw("WAVFRM?") == before


def test_average_reduces_the_noise_and_keeps_whole_codes(make_bench):
    deviations = []
    for mode in ("SAMPLE", "AVERAGE;NUMAVG 16"):
        bench = make_bench({1: lambda t: np.full_like(t, 0.05)}, noise_levels=8.0)
        bench.write(f"CH1:PROBE 1;SCALE 1;:ACQ:MODE {mode}")
        bench.single()
        deviations.append(bench.codes().std())
    assert deviations[0] / deviations[1] == pytest.approx(4.0, rel=0.15)
    assert bench.ask("ACQ:NUMACQ?") == "16"
    assert "Average mode" in bench.ask("WFMPRE:WFID?")


def test_peak_detect_sends_pairs_of_minimum_and_maximum(make_bench):
    bench = make_bench({1: lambda t: np.sin(2 * np.pi * 1e6 * t)}, noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 1;:HOR:SCALE 1.0E-3;:ACQ:MODE PEAK")
    bench.single()
    codes = bench.codes()
    assert codes[0::2].max() < -20 and codes[1::2].min() > 20
    assert bench.ask("WFMPRE:PT_FMT?;NR_PT?;XINCR?") == "ENV;2500;4.0E-6"
    assert "Pk Detect mode" in bench.ask("WFMPRE:WFID?")
    bench.write("HOR:SCALE 2.5E-6")
    bench.single()
    assert bench.ask("WFMPRE:PT_FMT?") == "Y"


def test_scan_mode_rolls_with_a_blank_of_one_division(make_bench):
    bench = make_bench({1: ramp}, noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 5;:HOR:SCALE 0.1")
    began = bench.clock.now()
    assert bench.ask("TRIG:STATE?;:WFMPRE:XZERO?") == "SCAN;0.0E0"
    bench.clock.sleep(0.42)
    codes = bench.codes()
    taken = int((bench.clock.now() - began) / 4e-4)
    assert np.all(codes[taken + 2 :] == -128) and np.all(codes[: taken - 2] != -128)
    bench.clock.sleep(1.0)
    codes = bench.codes()
    blank = np.flatnonzero(codes == -128)
    assert len(blank) == 250 and np.ptp(blank) == 249
    assert codes[blank[0] - 1] * 0.2 == pytest.approx(bench.clock.now(), abs=0.21)
    assert codes[blank[-1] + 1] * 0.2 == pytest.approx(bench.clock.now() - 0.9, abs=0.21)
    assert bench.ask("ACQ:NUMACQ?") == "0"


def test_single_sequence_in_scan_mode_fills_the_screen(make_bench):
    bench = make_bench({1: ramp}, noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 5;:HOR:SCALE 0.25")
    began = bench.clock.now()
    bench.single()
    assert bench.clock.now() - began == pytest.approx(2.5, abs=0.4)
    assert bench.codes().min() > -128


def test_a_record_of_a_running_scope_is_fresh_after_hours(make_bench):
    bench = make_bench({1: lambda t: np.where(np.asarray(t) > 7000.0, 1.0, -1.0)}, noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 1")
    assert set(bench.codes().tolist()) == {-25}
    bench.clock.sleep(7200)
    assert set(bench.codes().tolist()) == {25}


def test_a_periodic_signal_is_followed_over_hours_without_work(make_bench):
    asked = []

    def counted(t):
        asked.append(len(t))
        return np.where(np.asarray(t) > 3000.0, 3.0, 1.0) * np.sin(2 * np.pi * 1000 * np.asarray(t))

    bench = make_bench({1: counted}, noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 1")
    while bench.ask("TRIG:STATE?") != "TRIGGER":
        bench.clock.sleep(1.7e-3)
    bench.clock.sleep(3600.0)
    assert np.ptp(volts(bench)) == pytest.approx(6.0, abs=0.1)
    assert sum(asked) < 300_000
    assert int(bench.ask("ACQ:NUMACQ?")) > 10_000


def test_normal_mode_sees_a_rare_event_however_seldom_it_is_asked(make_bench):
    bench = make_bench({1: lambda t: np.where(np.abs(np.asarray(t) - 500.0) < 0.3, 1.0, -1.0)}, noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 1;:TRIG:MAIN:MODE NORMAL;:HOR:SCALE 5E-2")
    bench.clock.sleep(1000.0)
    assert bench.ask("ACQ:NUMACQ?") == "1"
    assert volts(bench)[1400] == pytest.approx(1.0) and volts(bench)[1100] == pytest.approx(-1.0)


def test_without_any_trigger_there_is_no_data(make_bench):
    bench = make_bench()
    bench.write("TRIG:MAIN:MODE NORMAL;*CLS")
    assert set(bench.codes().tolist()) == {-128}
    assert "Ch1, DC coupling" in bench.ask("WFMPRE:WFID?")
    assert bench.events() == []


def test_newly_displayed_channel_is_waited_for(make_bench):
    bench = make_bench({1: ramp, 2: lambda t: np.full_like(t, 1.0)}, noise_levels=0.0)
    bench.codes()
    bench.write("CH2:PROBE 1;SCALE 1;:SELECT:CH2 ON;:DATA:SOURCE CH2")
    assert set(bench.codes().tolist()) == {25}


def test_level_to_half_and_frequency_counter(make_bench):
    bench = make_bench({1: lambda t: 1.0 + np.sin(2 * np.pi * 1234.0 * t)}, noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 1;:TRIG:MAIN SETLEVEL")
    assert float(bench.ask("TRIG:MAIN:LEVEL?")) == pytest.approx(1.0, abs=1e-3)
    assert float(bench.ask("TRIG:MAIN:FREQUENCY?")) == pytest.approx(1234.0, rel=1e-3)
    bench.events()
    bench.write("TRIG:MAIN:LEVEL 5")
    assert bench.ask("TRIG:MAIN:FREQUENCY?") == "9.9E37"
    assert bench.events() == [2207]


def test_trigger_level_reaches_eight_divisions(fresh):
    fresh.write("HEADER OFF;:CH1:SCALE 1;POSITION 2;:TRIG:MAIN:LEVEL 100")
    assert fresh.ask("TRIG:MAIN:LEVEL?") == "6.0E0"
    assert fresh.ask("TRIG:MAIN:EDGE:SOURCE EXT;:TRIG:MAIN:LEVEL?") == "1.6E0"
    assert fresh.ask("TRIG:MAIN:EDGE:SOURCE EXT5;:TRIG:MAIN:LEVEL -9;LEVEL?") == "-8.0E0"


def test_autoset_shows_a_few_periods_that_fill_the_screen(make_bench):
    bench = make_bench({1: lambda t: 0.3 + 0.04 * np.sin(2 * np.pi * 5000.0 * t)}, noise_levels=0.0)
    bench.write("AUTOSET EXECUTE")
    bench.single()
    codes = bench.codes()
    assert 50 < np.ptp(codes) <= 200 and codes.max() < 127
    rises = np.count_nonzero((codes[:-1] < codes.mean()) & (codes[1:] >= codes.mean()))
    assert 2 <= rises <= 12
    assert bench.ask("TRIG:STATE?") == "SAVE"


def test_setup_memories(fresh):
    fresh.write("HEADER OFF;:CH1:SCALE 5;*SAV 2;:CH1:SCALE 0.5;:SAVE:SETUP 10;*RST")
    assert fresh.ask("CH1:SCALE?") == "1.0E0"
    assert fresh.ask("*RCL 2;:CH1:SCALE?") == "5.0E0"
    assert fresh.ask("RECALL:SETUP 10;:CH1:SCALE?") == "5.0E-1"
    assert fresh.ask("RECALL:SETUP FACTORY;:CH1:SCALE?") == "1.0E0"
    assert fresh.events() == [401]


def test_defined_trigger_runs_a_message(fresh):
    fresh.write("*DDT 'CH1:SCALE 2;*TRG'")
    assert fresh.ask("*TRG;:HEADER OFF;:CH1:SCALE?;*DDT?") == "2.0E0;#216CH1:SCALE 2;*TRG"
