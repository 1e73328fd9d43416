"""Examples of inner functions of analysis: what they make of one value each."""

import numpy as np


def test_lowest_gain_corner() -> None:
    from analysis.budget import lowest_gain_corner

    assert (lowest_gain_corner(160.0), lowest_gain_corner(4000.0)) == (480.0, 5000.0)


def test_lowest_bandwidth() -> None:
    from analysis.budget import lowest_bandwidth

    assert lowest_bandwidth(160.0) == 800.0


def test_level() -> None:
    from analysis.budget import level

    assert (level(0.01), level(0.0)) == ("-40 dBc", "none")


def test_ratio_factor() -> None:
    from analysis.channel import ChannelResponse, ratio_factor

    factors = [
        ratio_factor(ChannelResponse(low_pass_hz=[5.0]), 1.0),
        ratio_factor(ChannelResponse(high_pass_hz=[0.2]), 1.0),
    ]
    assert [round(100 * (float(abs(factor)) - 1), 1) for factor in factors] == [-5.3, 1.5]


def test_control_chart() -> None:
    from analysis.control_chart import control_chart

    chart = control_chart([10, 11, 10, 9, 10, 11, 9, 10, 10, 16])
    assert (chart.signals[0].place, chart.last_is_in_control) == (9, False)


def test_rounded_pulse_rate() -> None:
    from analysis.dead_band import rounded_pulse_rate

    assert rounded_pulse_rate([0.05, 0.2], scale_factor=2000, lock_in_rate=0.05, random_walk=1e-4).round(
        2
    ).tolist() == [8.58, 387.3]


def test_outputclock() -> None:
    from analysis.fibre_gyro.loop.design import FibreCoil, OutputClock

    clock = OutputClock(FibreCoil())
    ends, pairs = clock.next_outputs(3, 0.01)
    assert (ends.tolist(), pairs.tolist()) == ([0.01, 0.02, 0.03], [1021, 1021, 1021])


def test_cosine_of_turns() -> None:
    from analysis.fibre_gyro.loop.kernels import cosine_of_turns

    turns = np.array([0.0, 0.125, 0.5, -3.25])
    result, u, w = np.empty((3, 4))
    cosine_of_turns(turns, result, u, w)
    assert result.round(12).tolist() == [1.0, 0.707106781187, -1.0, 0.0]


def test_outliers() -> None:
    from analysis.fibre_gyro.scatter import outliers

    assert outliers([5.0, 5.1, 4.9, 5.0, 1e6, 5.1, 4.9, 5.0]).tolist().index(True) == 4


def test_signal_interval() -> None:
    from analysis.fibre_gyro.scatter import signal_interval

    assert [round(end) for end in signal_interval(4.0, 10.0, 1e6)] == [0, 5]
    assert [round(end) for end in signal_interval(1000.0, 10.0, 1e6)] == [871, 1119]


def test_size_interval() -> None:
    from analysis.lockin_rate import size_interval

    low, high = size_interval([0.5, 20.0])
    assert [round(float(v), 1) for v in (*low, *high)] == [0.0, 18.0, 2.0, 21.9]


def test_default_rates() -> None:
    from analysis.plan import default_rates

    assert default_rates(0.01, 2000.0) == (3.0, 5.3, 9.5, 17.0, 30.0)


def test_run_order() -> None:
    from analysis.plan import run_order

    assert run_order([3.0, 30.0]) == ((30.0, False), (3.0, False), (30.0, True))
    assert run_order([8.0, -8.0]) == ((8.0, False), (-8.0, False), (8.0, True))
    assert [rate for rate, _ in run_order([3.0, 10.0, -3.0, -10.0])] == [10.0, 3.0, -3.0, -10.0]


def test_first_of_groups() -> None:
    from analysis.several_rates.points import first_of_groups

    assert repr(first_of_groups([np.array([1.0, 2.0]), np.array([2.01, 1.009, 1.018])], 0.01)) == "array([1., 2.])"


def test_visits_of_rates() -> None:
    from analysis.several_rates.points import visits_of_rates

    assert repr(visits_of_rates(np.repeat([3.0, 1.0, 3.0], [1, 8, 2]))) == "array([ 0,  1,  3,  5,  7,  9, 10])"
