"""Spelling, compound messages, headers: programmer manual 071-1075-04, pp. 2-3 to 2-14."""

import pytest

FACTORY_SETUP = (
    ":HEADER 1;:VERBOSE 1;:DATA:ENCDG RIBINARY;DESTINATION REFA;SOURCE CH1;START 1;STOP 2500;WIDTH 1;"
    ":LOCK NONE;:DISPLAY:FORMAT YT;STYLE VECTORS;PERSISTENCE 0;CONTRAST 50;INVERT OFF;"
    ":ACQUIRE:MODE SAMPLE;NUMAVG 16;STATE 1;STOPAFTER RUNSTOP;"
    + "".join(
        f":CH{n}:PROBE 10;SCALE 1.0E0;POSITION 0.0E0;COUPLING DC;BANDWIDTH OFF;INVERT OFF;" for n in (1, 2, 3, 4)
    )
    + ":HORIZONTAL:VIEW MAIN;MAIN:SCALE 5.0E-4;POSITION 0.0E0;:HORIZONTAL:DELAY:SCALE 5.0E-5;POSITION 0.0E0;"
    ":TRIGGER:MAIN:MODE AUTO;TYPE EDGE;HOLDOFF:VALUE 5.0E-7;"
    ":TRIGGER:MAIN:EDGE:SOURCE CH1;COUPLING DC;SLOPE RISE;"
    ":TRIGGER:MAIN:VIDEO:SOURCE CH1;SYNC LINE;POLARITY NORMAL;LINE 1;STANDARD NTSC;"
    ":TRIGGER:MAIN:PULSE:SOURCE CH1;WIDTH:POLARITY POSITIVE;WHEN EQUAL;WIDTH 1.0E-3;"
    ":TRIGGER:MAIN:LEVEL 0.0E0;"
    ":SELECT:CH1 1;CH2 0;CH3 0;CH4 0;MATH 0;REFA 0;REFB 0;REFC 0;REFD 0;"
    ":CURSOR:FUNCTION OFF;SELECT:SOURCE CH1;:CURSOR:VBARS:UNITS SECONDS;POSITION1 -2.0E-3;POSITION2 2.0E-3;"
    ":CURSOR:HBARS:POSITION1 -3.2E0;POSITION2 3.2E0;"
    + "".join(f":MEASUREMENT:MEAS{n}:TYPE NONE;SOURCE CH1;" for n in (1, 2, 3, 4, 5))
    + ":MEASUREMENT:IMMED:TYPE PERIOD;SOURCE CH1;"
    ':MATH:DEFINE "CH1 - CH2";FFT:HORIZONTAL:POSITION 5.0E1;SCALE 1.0E0;'
    ":MATH:FFT:VERTICAL:POSITION 0.0E0;SCALE 1.0E0;"
    ":HARDCOPY:FORMAT EPSON;PORT CENTRONICS;LAYOUT PORTRAIT;INKSAVER ON;:LANGUAGE ENGLISH"
)


def test_factory_setup_is_that_of_appendix_b(fresh):
    fresh.write("FACTORY")
    assert fresh.ask("SET?") == FACTORY_SETUP
    assert fresh.ask("*LRN?") == FACTORY_SETUP


@pytest.mark.parametrize("header", ["COUP", "COUPL", "coupli", "Couplin", "COUPLING"])
def test_any_abbreviation_between_short_and_long_form_is_taken(fresh, header):
    assert fresh.ask(f"ch1:{header}?") == ":CH1:COUPLING DC"


@pytest.mark.parametrize("header", ["COU", "C", "COUPLINGS", "COUPLNG", ""])
def test_other_abbreviations_are_not(fresh, header):
    assert fresh.ask(f"CH1:{header}?") is None
    assert fresh.events()[:2] in ([401, 113], [401, 110])


@pytest.mark.parametrize(
    ("message", "answer"),
    [
        ("CH1:COUPling?;BANdwidth?", ":CH1:COUPLING DC;:CH1:BANDWIDTH OFF"),
        ("ACQ:MOD AVE;NUMA 64;:ACQ?", ":ACQUIRE:MODE AVERAGE;NUMAVG 64;STATE 1;STOPAFTER RUNSTOP"),
        ("ACQ:NUMA 4;*ESR?;MODE?", "128;:ACQUIRE:MODE SAMPLE"),
        (" \t:ch1:scale\t2 ;; :CH1:SCA? ;", ":CH1:SCALE 2.0E0"),
        ("HORIZONTAL:MAIN:SCALE 1E-3;POSITION 2E-3;:HOR:MAI:POS?", ":HORIZONTAL:MAIN:POSITION 2.0E-3"),
        ("HOR:VIEW MAIN;MAIN:SCALE 1E-3;:HOR:SCA?", ":HORIZONTAL:MAIN:SCALE 1.0E-3"),
        ("HOR?", ":HORIZONTAL:VIEW MAIN;RECORDLENGTH 2500;MAIN:SCALE 5.0E-4;POSITION 0.0E0;"
                 ":HORIZONTAL:DELAY:SCALE 5.0E-5;POSITION 0.0E0"),
        ("RS232?", ":RS232:BAUD 9600;SOFTFLAGGING 0;HARDFLAGGING 1;PARITY NONE;TRANSMIT:TERMINATOR LF"),
        ("DATA?", ":DATA:ENCDG RIBINARY;DESTINATION REFA;SOURCE CH1;START 1;STOP 2500;WIDTH 1"),
        ("SEL?", ":SELECT:CH1 1;CH2 0;CH3 0;CH4 0;MATH 0;REFA 0;REFB 0;REFC 0;REFD 0"),
        ("HEAD OFF;:DATA:ENC RPB;SOU CH2;:DATA?", "RPBINARY;REFA;CH2;1;2500;1"),
        ("HEAD OFF;:CH1:COUP?;BAND?", "DC;OFF"),
        ("VERB OFF;:ACQ:NUMAV?", ":ACQ:NUMAV 16"),
        ("VERB OFF;:ACQ:MOD?", ":ACQ:MOD SAM"),
        ("VERB OFF;:HEAD?", ":HEAD 1"),
        ("TRIG:MAI:EDGE:SOU AC  LINE;SOU?", ":TRIGGER:MAIN:EDGE:SOURCE AC LINE"),
        ("DATA:TARGET REFC;DEST?", ":DATA:DESTINATION REFC"),
        ("CH2:VOLTS 0.5;SCALE?", ":CH2:SCALE 5.0E-1"),
        ("DISPLAY:PERSISTENCE INF;PERS?", ":DISPLAY:PERSISTENCE 99"),
        ("DISPLAY:INVERT ON;INVERT?", ":DISPLAY:INVERT OFF"),
        ("TRIG:MAI:PUL:WID:WID 123E-9;WIDTH?", ":TRIGGER:MAIN:PULSE:WIDTH:WIDTH 1.155E-7"),
        ("TRIG:MAI:PUL:WID:WID 1.3906E-3;WIDTH?", ":TRIGGER:MAIN:PULSE:WIDTH:WIDTH 1.3906E-3"),
        ("ID?", "ID TEK/TDS 2014,CF:91.1CT,FV:v4.12 TDS2CM:CMV:v1.04"),
        ("*IDN?", "TEKTRONIX,TDS 2014,0,CF:91.1CT FV:v4.12 TDS2CM:CMV:v1.04"),
    ],
)  # fmt: skip
def test_messages_and_their_answers(fresh, message, answer):
    assert fresh.ask(message) == answer


def test_colonless_header_is_taken_in_the_branch_of_the_command_before(fresh):
    assert fresh.ask("ACQ:MODE AVERAGE;CH1:SCALE?") is None
    assert 113 in fresh.events()


@pytest.mark.parametrize("first", ["*IDN?", "ID?"])
def test_a_query_after_the_identity_gives_440(bench, first):
    assert bench.ask(f"{first};CH1:SCALE?").count(";") == 0
    assert bench.events() == [440]


def test_setup_string_sent_back_restores_the_setup(make_bench):
    changed = make_bench()
    changed.write("CH1:PROBE 100;SCALE 20;POSITION -1.72;COUPLING AC;INVERT ON;:CH3:BANDWIDTH ON")
    changed.write("HOR:SCALE 2.5E-5;POSITION 1E-4;:TRIG:MAIN:LEVEL 12.5;MODE NORMAL;EDGE:SLOPE FALL")
    changed.write("SEL:CH3 ON;MATH ON;REFB ON;:MATH:DEFINE 'FFT(CH2, FLATTOP)';:MEASU:MEAS2:TYPE CRMS;SOURCE CH4")
    changed.write("CURSOR:FUNCTION VBARS;VBARS:POSITION1 5E-5;POSITION2 -1E-5;:DATA:WIDTH 2;STOP 77;:VERBOSE OFF")
    assert changed.events() == [401]
    setup = changed.ask("SET?")
    assert setup.startswith(":HEAD 1;:VERB 0;:DAT:ENC RIB;")
    other = make_bench()
    other.write(setup)
    assert other.events() == [401]
    assert other.ask("SET?") == setup


def test_setup_strings_are_one_line_with_headers_even_with_header_off(fresh):
    fresh.write("HEADER OFF")
    assert fresh.ask("SET?") == FACTORY_SETUP.replace(":HEADER 1", ":HEADER 0")
