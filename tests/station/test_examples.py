"""Examples of inner functions of station: what they make of one value each."""

import numpy as np


def test_time_words() -> None:
    from station.campaign.messages import time_words

    assert (time_words(42.0), time_words(600.0), time_words(8000.0)) == ("42 s", "10 min", "2 h 13 min")


def test_risk_words() -> None:
    from station.campaign.messages import risk_words

    assert (risk_words(0.12), risk_words(3e-9)) == ("12 %", "< 0.01 %")


def test_codes_of() -> None:
    from station.datasets.backends import codes_of

    assert np.frombuffer(codes_of(b"-128,0,7,127"), np.int8).tolist() == [-128, 0, 7, 127]


def test_vhdl_text() -> None:
    from station.fibre_gyro.constants import identifier

    assert (identifier("0.01"), identifier("-20"), identifier("Z axis")) == ("0_01", "m20", "Z_axis")


def test_inert() -> None:
    from station.files import alive, inert

    assert (inert("=1+1"), inert("-0.5"), alive(inert("'=1")), inert("RLG-7")) == ("'=1+1", "-0.5", "'=1", "RLG-7")


def test_duration() -> None:
    from station.live.console import duration

    assert (duration(12.4), duration(200), duration(9000)) == ("12 s", "3 min 20 s", "2 h 30 min")


def test_html_table() -> None:
    from station.notebook.result import html_table

    assert (
        html_table("run", [("unit", "<7>")])
        == "<table><caption>run</caption><tr><th>unit</th><td>&lt;7&gt;</td></tr></table>"
    )


def test_duration_words() -> None:
    from station.plan import duration_words

    assert (duration_words(3.44), duration_words(200.0), duration_words(9000.0)) == (
        "3 s",
        "3 min 20 s",
        "2 h 30 min",
    )


def test_within() -> None:
    from station.results.quantity import within

    assert (within(0.0099977, 0.0099879, 0.0100075, "deg/s"), within(0.0001, 0.0, 0.00069)) == (
        "0.0099977 ± 0.0000098 deg/s",
        "below 0.00069",
    )
    assert within(0.02, 0.011, 0.024, "deg/s") == "0.0200 (0.0110 to 0.0240) deg/s"


def test_decimals_of() -> None:
    from station.results.quantity import decimals_of

    assert (decimals_of(1.2e-5), decimals_of(0.0996), decimals_of(120.0)) == (6, 2, -1)


def test_ppm() -> None:
    from station.results.result import ppm

    assert (ppm(999.9213, 0.43), ppm(float("nan"))) == ("+999.92(43) ppm", "none")


def test_with_prefix() -> None:
    from station.results.result import with_prefix

    assert with_prefix(0.025, "s/div") == "25 ms/div"
    assert with_prefix(0.000004, "s") == "4 µs"


def test_with_uncertainty() -> None:
    from station.results.result import with_uncertainty

    assert with_uncertainty(0.0100023, 0.0000121, "deg/s") == "0.010002(12) deg/s"
    assert with_uncertainty(159.9912, 0.25, "Hz") == "159.99(25) Hz"
    assert with_uncertainty(36.1, 12.0) == "36(12)"


def test_worst() -> None:
    from station.results.verdict import worst

    assert (worst(["PASS", "FAIL", "MARGINAL"]), worst(["FAIL", "ERROR"]), worst([])) == ("FAIL", "ERROR", None)


def test_parse_fault() -> None:
    from station.scope.tools import parse_fault

    assert parse_fault("cut answer:0.05").probability == 0.05


def test_parse_signal() -> None:
    from station.scope.tools import parse_signal

    assert parse_signal("CH2=sine:50:0.5").signal(np.array([0.005])).round(6).tolist() == [0.5]
    assert repr(parse_signal("gyro")) == "ShownSignal(channel=1, signal=None)"


def test_merged() -> None:
    from station.settings import merged

    assert merged({"a": {"b": 1, "c": 2}}, {"a": {"c": 3}}) == {"a": {"b": 1, "c": 3}}


def test_overrides() -> None:
    from station.shell.options import overrides

    assert overrides({"seed": 3, "channel": None}, {"seed": "simulation.seed", "channel": "scope.channel"}) == {
        "simulation": {"seed": 3}
    }


def test_visible() -> None:
    from station.terminal import visible

    assert visible("RLG \x1b[2J7") == "RLG \\x1b[2J7"


def test_large() -> None:
    from station.campaign.messages import MEANING, large

    assert "\n".join(line.rstrip() for line in large("FAIL")) == (
        "#####   ###    ###   #\n"
        "#      #   #    #    #\n"
        "####   #####    #    #\n"
        "#      #   #    #    #\n"
        "#      #   #   ###   #####"
    )
    for verdict in MEANING:  # every verdict has its letters, each as wide
        assert {len(line) for line in large(verdict)} == {7 * len(verdict) - 2}
