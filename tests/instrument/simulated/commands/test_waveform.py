"""Preamble and curve against answers of real instruments and the rules of the programmer manual."""

import numpy as np
import pytest


def level(times: np.ndarray) -> np.ndarray:
    return np.full_like(times, 0.72)


REAL_PREAMBLES = [
    pytest.param(
        "CH1:PROBE 1;SCALE 2;POSITION -1.72;:HOR:SCALE 2.5E-5;:DATA:WIDTH 2;ENC RIB",
        '2;16;BIN;RI;MSB;2500;"Ch1, DC coupling, 2.0E0 V/div, 2.5E-5 s/div, 2500 points, Sample mode";'
        'Y;1.0E-7;0;-1.25E-4;"s";3.125E-4;0.0E0;-1.1008E4;"Volts"',
        id="TDS2014B",
    ),
    pytest.param(
        "CH1:PROBE 1;SCALE 0.2;POSITION 2;:HOR:SCALE 5E-7",
        '1;8;BIN;RI;MSB;2500;"Ch1, DC coupling, 2.0E-1 V/div, 5.0E-7 s/div, 2500 points, Sample mode";'
        'Y;2.0E-9;0;-2.5E-6;"s";8.0E-3;0.0E0;5.0E1;"Volts"',
        id="TDS2024C",
    ),
    pytest.param(
        "CH1:PROBE 1;SCALE 0.5;:HOR:SCALE 5E-5;:DATA:WIDTH 2;ENC RPB",
        '2;16;BIN;RP;MSB;2500;"Ch1, DC coupling, 5.0E-1 V/div, 5.0E-5 s/div, 2500 points, Sample mode";'
        'Y;2.0E-7;0;-2.5E-4;"s";7.8125E-5;0.0E0;3.2768E4;"Volts"',
        id="positive",
    ),
    pytest.param(
        "CH1:PROBE 1;SCALE 0.01;POSITION 2;:HOR:SCALE 1E-6;POSITION 4.6E-6;:DATA:ENC ASCII",
        '1;8;ASC;RP;MSB;2500;"Ch1, DC coupling, 1.0E-2 V/div, 1.0E-6 s/div, 2500 points, Sample mode";'
        'Y;4.0E-9;0;-4.0E-7;"s";4.0E-4;0.0E0;5.0E1;"Volts"',
        id="ASCII",
    ),
    pytest.param(
        "CH1:PROBE 1;SCALE 0.1;POSITION -1.4;:HOR:SCALE 5E-4;POSITION 1.6002E-2;:DATA:ENC SRI",
        '1;8;BIN;RI;LSB;2500;"Ch1, DC coupling, 1.0E-1 V/div, 5.0E-4 s/div, 2500 points, Sample mode";'
        'Y;2.0E-6;0;1.3502E-2;"s";4.0E-3;0.0E0;-3.5E1;"Volts"',
        id="TDS220",
    ),
]


@pytest.mark.parametrize(("setup", "preamble"), REAL_PREAMBLES)
def test_preambles_of_real_instruments(make_bench, setup, preamble):
    bench = make_bench({1: level})
    bench.write(setup + ";:HEADER OFF")
    bench.single()
    assert bench.ask("WFMPRE?") == preamble


def test_preamble_with_headers_is_that_of_a_real_tds2024(make_bench):
    bench = make_bench({3: level})
    bench.write("SEL:CH3 ON;CH1 OFF;:CH3:PROBE 1;SCALE 0.5;POSITION -6.76;:HOR:SCALE 0.1;POSITION 0.4")
    bench.write("TRIG:MAIN:MODE NORMAL;EDGE:SOURCE LINE;:DATA:SOURCE CH3;ENC SRI")
    bench.single()
    assert bench.ask("WFMPRE?", timeout=100) == (
        ':WFMPRE:BYT_NR 1;BIT_NR 8;ENCDG BIN;BN_FMT RI;BYT_OR LSB;NR_PT 2500;WFID "Ch3, DC coupling, '
        '5.0E-1 V/div, 1.0E-1 s/div, 2500 points, Sample mode";PT_FMT Y;XINCR 4.0E-4;PT_OFF 0;'
        'XZERO -1.0E-1;XUNIT "s";YMULT 2.0E-2;YZERO 0.0E0;YOFF -1.69E2;YUNIT "Volts"'
    )


def test_undisplayed_source_has_five_fields(bench):
    bench.write("HEADER OFF;:DATA:SOURCE CH2")
    assert bench.ask("WFMPRE?") == "1;8;BIN;RI;MSB"
    assert bench.ask("WAVFRM?") == "1;8;BIN;RI;MSB"
    assert bench.events() == []


@pytest.mark.parametrize("width", [1, 2])
@pytest.mark.parametrize(
    ("encoding", "dtype", "centre"),
    [("RIB", ">i", 0), ("SRI", "<i", 0), ("RPB", ">u", 128), ("SRP", "<u", 128), ("ASCI", None, 0)],
)
def test_every_encoding_carries_the_same_codes(bench, encoding, dtype, centre, width):
    bench.single()
    codes = bench.codes().astype(int)
    assert np.ptp(codes) == 100
    bench.write(f"DATA:ENC {encoding};WIDTH {width}")
    answer = bench.ask_raw("CURVE?")
    factor = 256 if width == 2 else 1
    if dtype is None:
        received = np.array(answer.decode().split(","), dtype=int)
        assert b" " not in answer
    else:
        assert answer[:6] == (b"#45000" if width == 2 else b"#42500")
        received = np.frombuffer(answer[6:-1], dtype=f"{dtype}{width}").astype(int)
    assert np.array_equal(received, (codes + centre) * factor)


def test_start_and_stop_cut_the_record_and_may_be_swapped(bench):
    bench.single()
    codes = bench.codes()
    bench.write("DATA:START 1001;STOP 1500")
    assert bench.ask("WFMPRE:NR_PT?") == "500"
    assert bench.ask_raw("CURVE?") == b"#3500" + codes[1000:1500].tobytes() + b"\n"
    assert bench.events() == []
    bench.write("DATA:START 1500;STOP 1001")
    assert bench.ask_raw("CURVE?") == b"#3500" + codes[1000:1500].tobytes() + b"\n"
    assert bench.events() == [530]
    bench.write("DATA:START 7;STOP 7")
    assert bench.ask_raw("CURVE?") == b"#11" + codes[6:7].tobytes() + b"\n"


def test_stop_beyond_the_record_is_taken(bench):
    assert bench.ask("DATA:STOP 1000000;STOP?") == ":DATA:STOP 2500"
    assert bench.events() == []


def test_waveform_is_preamble_and_curve_in_one_answer(bench):
    bench.single()
    preamble, curve = bench.ask_raw("WFMPRE?"), bench.ask_raw("CURVE?")
    assert curve.startswith(b":CURVE #42500")
    assert bench.ask_raw("WAVFRM?") == preamble[:-1] + b";" + curve
    assert bench.ask_raw("WFMPRE?;:CURVE?") == preamble[:-1] + b";" + curve
    bench.write("VERBOSE OFF")
    assert b";:CURV #42500" in bench.ask_raw("WAVFRM?")


def test_named_preamble_has_its_own_order(bench):
    bench.single()
    bench.write("HEADER OFF")
    assert bench.ask("WFMPRE:CH1?") == (
        '"Ch1, DC coupling, 1.0E0 V/div, 5.0E-4 s/div, 2500 points, Sample mode";Y;2.0E-6;0;-2.5E-3;"s";'
        '4.0E-2;0.0E0;0.0E0;"Volts";2500'
    )


def test_volts_of_a_constant_follow_the_scaling_rule(make_bench):
    bench = make_bench({1: level}, noise_levels=0.0)
    bench.write("CH1:PROBE 10;SCALE 5;POSITION -1.2;INVERT OFF")
    bench.single()
    codes = bench.codes()
    # 0.72 V at the BNC are 7.2 V at the tip of a 10:1 probe: 1.44 div above ground at -1.2 div
    assert set(codes.tolist()) == {6}
    fields = bench.ask("WFMPRE:YMULT?;YOFF?;YZERO?").split(";")
    ymult, yoff, yzero = map(float, fields)
    assert (codes[0] - yoff) * ymult + yzero == pytest.approx(7.2)


@pytest.mark.parametrize(("volts", "code"), [(100.0, 127), (-100.0, -127), (5.09, 127), (-5.09, -127), (5.0, 125)])
def test_codes_stop_at_127_on_either_side(make_bench, volts, code):
    bench = make_bench({1: lambda times: np.full_like(times, volts)})
    bench.write("CH1:PROBE 1;SCALE 1")
    bench.single()
    assert abs(int(np.median(bench.codes()))) == abs(code)
    assert set(np.sign(bench.codes()).tolist()) == {np.sign(code)}
    assert bench.codes().min() > -128


def test_noise_has_the_deviation_asked_for_and_is_new_in_each_record(make_bench):
    bench = make_bench({1: level}, noise_levels=3.0, seed=5)
    bench.write("CH1:PROBE 1;SCALE 1")
    bench.single()
    first = bench.codes().astype(float)
    again = bench.codes()
    bench.single()
    second = bench.codes().astype(float)
    assert np.array_equal(first, again)
    assert first.std() == pytest.approx(3.0, rel=0.06)
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.08


def test_same_seed_and_messages_give_the_same_codes(make_bench):
    records = []
    for seed in (1, 1, 2):
        bench = make_bench({1: level}, noise_levels=1.0, seed=seed)
        bench.write("CH1:PROBE 1;SCALE 1")
        bench.single()
        records.append(bench.codes().tobytes())
    assert records[0] == records[1] != records[2]


def test_reference_holds_what_was_saved_or_written(bench):
    bench.single()
    codes = bench.codes()
    bench.write("SAVE:WAVEFORM CH1,REFB;:SELECT:REFB ON;:DATA:SOURCE REFB")
    assert bench.ask_raw("CURVE?") == b"#42500" + codes.tobytes() + b"\n"
    bench.write("DATA:DESTINATION REFC;SOURCE REFC;START 3;:CURVE 5,-6,127;:SELECT:REFC ON")
    bench.write("WFMPRE:YMULT 0.25;YOFF 10;XINCR 1E-3;YUNIT 'V';PT_FMT ENV")
    assert bench.ask("DATA:STOP 6;:DATA:ENC ASCI;:CURVE?") == "5,-6,127,-128"
    assert bench.ask("WFMPRE:REFC:YMULT?;YOFF?;XINCR?;YUNIT?;PT_FMT?") == '2.5E-1;1.0E1;1.0E-3;"V";ENV'
    assert bench.events() == []


def test_block_written_at_width_two_loses_its_low_byte_and_too_much_is_cut(bench):
    bench.write("DATA:DESTINATION REFA;SOURCE REFA;ENC SRI;WIDTH 2;START 2500;:SELECT:REFA ON;:HEADER OFF")
    bench.write(b"CURVE #14\xff\x07\xff\x08")
    assert bench.ask("DATA:ENC ASCI;WIDTH 1;:CURVE?") == "7"
    assert bench.events() == [532]
    assert bench.ask("CURVE -9;:CURVE?") == "-9"
    assert bench.events() == []


def test_indefinite_block_needs_a_message_end(bench):
    from instrument.simulated.links.exchange import MessageExchange

    bench.write("DATA:DESTINATION REFA;SOURCE REFA;STOP 4;:SELECT:REFA ON;:HEADER OFF")
    bench.write(b"CURVE #0\n;\r#")
    assert bench.ask("DATA:ENC ASCI;:CURVE?") == "10,59,13,35"
    serial = MessageExchange(bench.scope, message_ends=False, serial=True)
    serial.receive(b"DATA:ENC RIB\nCURVE #0abcd\nDATA:ENC ASCI\nCURVE?\n")
    serial.pump()
    assert serial.take() == b"10,59,13,35\n"
    assert bench.events() == [161]


def test_preamble_set_forms_change_the_transmission(bench):
    bench.write("WFMPRE:BYT_NR 2;BN_FMT RP;BYT_OR LSB")
    assert bench.ask("HEADER OFF;:DATA?") == "SRPBINARY;REFA;CH1;1;2500;2"
    bench.write("WFMPRE:ENCDG ASC;BIT_NR 8")
    assert bench.ask("DATA?") == "ASCII;REFA;CH1;1;2500;1"


def test_empty_reference_is_all_no_data(bench):
    bench.write("SELECT:REFD ON;:DATA:SOURCE REFD")
    assert set(bench.codes().tolist()) == {-128}
