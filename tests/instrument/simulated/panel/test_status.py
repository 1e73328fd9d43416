"""Status registers, event queue, synchronisation: programmer manual 071-1075-04, chapter 3."""

import pytest


def test_power_on_is_reported_once(fresh):
    assert fresh.ask("*ESR?") == "128"
    assert fresh.ask("ALLEV?") == ':ALLEV 401,"Power on; "'
    assert fresh.ask("*ESR?") == "0"
    assert fresh.ask("EVENT?") == ":EVENT 0"


def test_events_are_readable_only_after_esr(bench):
    bench.write("FOO")
    assert bench.ask("EVENT?") == ":EVENT 1"
    assert bench.ask("EVMSG?") == ':EVMSG 1,"No events to report : new events pending *ESR?"'
    assert bench.ask("*ESR?") == "32"
    assert bench.ask("EVQTY?") == ":EVQTY 1"
    assert bench.ask("EVMSG?") == ':EVMSG 113,"Undefined header; FOO"'
    assert bench.ask("ALLEV?") == ':ALLEV 0,"No events to report : queue empty"'


def test_second_esr_drops_what_was_not_fetched(bench):
    bench.write("FOO")
    bench.ask("*ESR?")
    bench.write("CH1:COUPLING WET")
    assert bench.ask("*ESR?") == "32"
    assert bench.ask("EVENT?") == ":EVENT 102"
    assert bench.ask("EVENT?") == ":EVENT 0"


def test_twentieth_event_becomes_an_overflow(bench):
    for _ in range(30):
        bench.write("FOO")
    assert bench.events() == [113] * 19 + [350]


def test_long_commands_are_cut_from_the_left_to_60_characters(bench):
    bench.write("CH1:NOTHING" + "A" * 100 + "Z")
    bench.ask("*ESR?")
    text = bench.ask("HEADER OFF;:EVMSG?").split(",", 1)[1].strip('"')
    assert text.startswith("Undefined header; A") and text.endswith("Z") and len(text) == 60


@pytest.mark.parametrize(
    ("message", "event"),
    [
        ("FOO?", 113),
        ("CH5:SCALE?", 113),
        ("CH1:SCALE", 104),
        ("CH1:SCALE 1,2", 108),
        ("CH1:SCALE TALL", 104),
        ("CH1:SCALE? 1", 108),
        ("CH1:COUPLING XY", 102),
        ("SELECT:CH1 MAYBE", 104),
        ("DATA:SOURCE CH7", 102),
        ("*SRE 300", 200),
        ("*SAV 11", 222),
        ("MATH:DEFINE 'CH1*CH2'", 2235),
        ("MATH:DEFINE CH1-CH2", 104),
        ("HORIZONTAL:RECORDLENGTH 500", 113),
        ("1ABC", 110),
        ("CURVE #15ab", 161),
        ("CH1:SCALE ,", 102),
        ("MATH:DEFINE 'CH1", 102),
        ("DATA:SOURCE CH2;:WFMPRE:YMULT?", 2244),
        ("DATA:SOURCE CH2;:CURVE?", 2244),
        ("WFMPRE:CH3?", 2244),
        ("WFMPRE:XMULT?", 100),
        ("WFMPRE:CH1:XINCR 1", 2241),
        ("SAVE:WAVEFORM CH2,REFA", 2245),
        ("TRIGGER:MAIN:EDGE:SOURCE LINE;:TRIGGER:MAIN:LEVEL 1", 221),
        ("DISPLAY:FORMAT XY;:CURSOR:FUNCTION VBARS", 221),
        ("AUTOSET:VIEW SINE", 221),
        ("ACQUIRE:STATE OFF;:TRIGGER:MAIN SETLEVEL", 221),
        ("DATE?", 113),
    ],
)
def test_bad_messages_and_their_events(bench, message, event):
    bench.write(message)
    assert bench.events() == [event]


def test_unknown_query_is_never_answered_and_reading_gives_420(bench):
    assert bench.ask_raw("FOO?", timeout=1.0) is None
    assert bench.events() == [113, 420]


def test_curve_of_a_waveform_that_is_not_displayed(bench):
    assert bench.ask("DATA:SOURCE CH3;:CURVE?") is None
    assert bench.events() == [2244, 420]


def test_unread_answer_is_thrown_away_by_the_next_message(bench):
    bench.write("CH1:SCALE?")
    bench.write("CH1:POSITION?")
    assert bench.read() == b":CH1:POSITION 0.0E0\n"
    assert bench.events() == [410]


def test_masked_events_leave_no_trace(bench):
    bench.write("DESE 128;FOO")
    assert bench.events() == []
    bench.write("DESE 255;BAR")
    assert bench.events() == [113]


def test_status_byte_follows_the_masks(bench):
    bench.write("*ESE 32;*SRE 32;FOO")
    assert bench.ask("*STB?") == "96"
    bench.ask("*ESR?")
    assert bench.ask("*STB?") == "0"
    assert bench.ask("*ESR?;*STB?") == "0;0"
    assert bench.ask("*ESE?;*SRE?;DESE?;*PSC?") == "32;32;:DESE 255;1"


def test_masks_survive_the_power_switch_only_without_psc(bench):
    bench.write("*PSC 1;*ESE 5;DESE 200")
    bench.scope.power_off()
    bench.scope.power_on()
    assert bench.ask("*ESE?;DESE?;*ESR?") == "0;:DESE 255;128"
    bench.write("*PSC 0;*ESE 5")
    bench.scope.power_off()
    bench.scope.power_on()
    assert bench.ask("*ESE?") == "5"


def test_opc_reports_the_end_of_a_single_sequence(bench):
    bench.write("HOR:SCALE 5E-2;:ACQ:STOPAFTER SEQ;STATE ON;*OPC")
    assert bench.ask("BUSY?;*ESR?") == ":BUSY 1;0"
    bench.clock.sleep(2.0)
    assert bench.ask("BUSY?") == ":BUSY 0"
    assert bench.ask("*ESR?;:ALLEV?") == '1;:ALLEV 402,"Operation complete; "'


def test_opc_query_waits_for_the_sequence_and_needs_none(bench):
    assert bench.ask("*OPC?") == "1"
    bench.write("HOR:SCALE 1E-1;:TRIG:MAIN:MODE NORMAL;:ACQ:STOPAFTER SEQ;STATE ON")
    before = bench.clock.now()
    assert bench.ask("*OPC?", timeout=0.5) is None
    assert bench.read(timeout=5.0) == b"1\n"
    assert 1.0 <= bench.clock.now() - before < 2.0


def test_wai_holds_the_commands_after_it(bench):
    bench.write("HOR:SCALE 5E-2;:ACQ:STOPAFTER SEQ;STATE ON;*WAI;:ACQ:STATE?")
    assert bench.link.working
    assert bench.read() == b":ACQUIRE:STATE 0\n"


def test_opc_waits_for_ever_without_a_trigger_and_a_clear_frees_the_link(bench):
    bench.write("TRIG:MAIN:MODE NORMAL;LEVEL 7;:ACQ:STOPAFTER SEQ;STATE ON")
    assert bench.ask("*OPC?", timeout=50.0) is None
    bench.link.clear()
    assert bench.ask("TRIG:STATE?") == ":TRIGGER:STATE READY"
    assert bench.ask("BUSY?") == ":BUSY 1"


def test_cls_empties_the_queue(bench):
    bench.write("FOO")
    bench.write("*CLS")
    assert bench.events() == []


def test_factory_resets_masks_and_header_but_reset_does_not(bench):
    bench.write("HEADER OFF;:VERBOSE OFF;*ESE 7;DESE 100;*PSC 0;:DATA:WIDTH 2;:CH1:SCALE 5;*RST")
    assert bench.ask("HEADER?;*ESE?;DESE?;*PSC?;:DATA:WIDTH?;:CH1:SCALE?") == "0;7;100;0;2;1.0E0"
    bench.write("FACTORY")
    assert bench.ask("HEADER?;VERBOSE?;*ESE?;DESE?;*PSC?;:DATA:WIDTH?") == (
        ":HEAD 1;:VERB 0;0;:DESE 255;1;:DAT:WID 1"
    )


def test_break_answers_dcl(bench):
    bench.write("CH1?")
    bench.link.break_signal()
    assert bench.read() == b"DCL\n"


def test_a_message_with_more_questions_than_both_buffers_hold_is_a_deadlock(bench):
    bench.write("HEADER OFF")
    bench.write("CURVE?;" * 2 + ":CH1:SCALE 2;" + ":CH1:SCALE?;" * 100)
    assert bench.read() is None
    assert bench.events() == [430, 420]
    assert bench.ask("CH1:SCALE?") == "2.0E0"


def test_a_long_message_that_asks_last_is_no_deadlock(bench):
    setup = bench.ask("SET?")
    answer = bench.ask_raw(f"{setup};:HEADER OFF;:WAVFRM?;:DATA:WIDTH 2;:CURVE?")
    assert answer is not None and len(answer) > 7500
    assert bench.events() == []
