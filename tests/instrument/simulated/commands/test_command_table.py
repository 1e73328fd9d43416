"""Every setting of the table written and read back, and the parser under fire."""

import random

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from benchmarks import fuzz
from instrument.simulated.panel.models import MODELS, find_model
from instrument.simulated.panel.parsing import abbreviations
from instrument.simulated.panel.settings import (
    Constant,
    MathExpression,
    NumberedWords,
    QuotedWords,
    Real,
    Steps,
    Switch,
    Whole,
    Words,
    setting_rows,
)


def settable(model):
    return [row for row in setting_rows(find_model(model)) if not isinstance(row.kind, Constant)]


ROWS = settable("TDS2014")
# Every setting of the first series, and what the later models have beyond it or otherwise.
EVERY_SETTING = [("TDS2014", row) for row in ROWS]
for _model in ("TDS2014+TDS2MEM", "TDS2014B", "TDS2014C", "TPS2014", "TPS2012"):
    _known = {(row.header, repr(row.kind)) for _, row in EVERY_SETTING}
    EVERY_SETTING += [(_model, row) for row in settable(_model) if (row.header, repr(row.kind)) not in _known]

FEW = settings(max_examples=settings().max_examples // 25, suppress_health_check=list(HealthCheck))


def spelling(draw, header: str) -> str:
    """Any accepted spelling of a header, in any letter case."""
    parts = [draw(st.sampled_from(abbreviations(mnemonic))) for mnemonic in header.split(":")]
    text = ":".join(parts)
    return draw(st.sampled_from([text, text.lower(), text.title(), ":" + text]))


@st.composite
def assignments(draw, row):
    """A command that sets a row, and the value that must be answered (None: the nearest allowed)."""
    kind = row.kind
    header = spelling(draw, draw(st.sampled_from([row.header, *row.aliases])))
    if isinstance(kind, QuotedWords):
        word = draw(st.sampled_from(kind.words))
        return f'{header} "{word}"', word
    if isinstance(kind, Words):
        word = draw(st.sampled_from(kind.words))
        return f"{header} {draw(st.sampled_from(abbreviations(word)))}", word.upper()
    if isinstance(kind, Switch):
        value = draw(st.sampled_from(["ON", "off", "0", "1", "17", "0.2"]))
        on = value in ("ON", "1", "17")
        return f"{header} {value}", ("OFF", "ON")[on] if kind.words else str(int(on))
    if isinstance(kind, MathExpression):
        text = draw(st.sampled_from(["CH1 - CH2", "CH2 - CH1", "CH1 + CH2", "FFT(CH2,RECTANGULAR)"]))
        return f"{header} '{text}'", f'"{text}"'
    if isinstance(kind, NumberedWords):
        word, number = draw(st.sampled_from(kind.words))
        return f"{header} {word}", str(number)
    if isinstance(kind, Whole):
        number = draw(st.integers(kind.low, kind.high))
        return f"{header} {number}", str(number)
    if isinstance(kind, Steps):
        step = draw(st.sampled_from(kind.steps))
        return f"{header} {step!r}", step
    assert isinstance(kind, Real)
    return f"{header} {draw(st.floats(kind.low, kind.high, allow_nan=False))!r}", None


def read_back(bench, row) -> str:
    return bench.ask(f":HEADER OFF;:VERBOSE ON;:{row.header}?", timeout=100)


def name_of(item):
    return item if isinstance(item, str) else item.header


@pytest.mark.parametrize(("model", "row"), EVERY_SETTING, ids=name_of)
@FEW
@given(data=st.data())
def test_every_setting_can_be_written_and_read_back(make_bench, model, row, data):
    command, expected = data.draw(assignments(row))
    bench = make_bench(model=model)
    bench.write(command)
    assert bench.events() == [401], command
    header_wanted = row.header.upper() in ("HEADER", "VERBOSE")
    answer = bench.ask(f":{row.header}?") if header_wanted else read_back(bench, row)
    answer = answer.split(" ")[-1] if header_wanted else answer
    if row.header == "DISplay:INVert":
        expected = "OFF"
    if isinstance(expected, float | int):
        assert float(answer) == pytest.approx(expected)
    elif expected is not None:
        assert answer.strip('"') == expected.strip('"'), command
    # what was answered can be sent back, and is then exactly what is answered
    bench.write(f":{row.header} {answer}")
    again = bench.ask(f":{row.header}?").split(" ")[-1] if header_wanted else read_back(bench, row)
    assert again == answer, command


@pytest.mark.parametrize(
    ("model", "row"), [(m, r) for m, r in EVERY_SETTING if isinstance(r.kind, Real | Whole | Steps)], ids=name_of
)
@FEW
@given(value=st.floats(-1e9, 1e9))
def test_numbers_out_of_range_are_forced_silently(make_bench, model, row, value):
    bench = make_bench(model=model)
    bench.write(f":{row.header} {value!r}")
    assert bench.events() == [401]
    forced = read_back(bench, row)
    bench.write(f":{row.header} {forced}")
    assert read_back(bench, row) == forced


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.header)
def test_factory_value_survives_a_round_trip(fresh, row):
    first = fresh.ask(f":{row.header}?")
    header, value = first.split(" ", 1)
    assert header == ":" + row.header.upper()
    fresh.write(first)
    assert fresh.events() == [401]
    assert fresh.ask(f":{row.header}?") == f"{header} {value}"


@pytest.mark.slow
def test_setup_restores_itself_after_any_settings(make_bench):
    source = random.Random(4)
    for _ in range(25):
        bench = make_bench()
        for row in source.sample(ROWS, 30):
            if isinstance(row.kind, Words):
                bench.write(f":{row.header} {source.choice(row.kind.words)}")
            elif isinstance(row.kind, Real | Steps | Whole):
                bench.write(f":{row.header} {source.uniform(-3, 3)!r}")
        bench.write(":TRIGGER:MAIN:EDGE:SOURCE CH2")  # with AC LINE the level cannot be set
        setup = bench.ask(":SET?")
        other = make_bench()
        other.write(setup)
        assert other.events() == [401]
        assert other.ask(":SET?") == setup


@pytest.mark.parametrize("model", MODELS)
def test_every_model_answers_its_setup_and_only_its_channels(make_bench, model):
    bench = make_bench(model=model)
    assert bench.ask("*IDN?").startswith(f"TEKTRONIX,{model[:3]} {model[3:].partition('+')[0]},")
    setup = bench.ask("SET?")
    bench.write(setup)
    assert bench.events() == [401]
    assert bench.ask("SET?") == setup
    four = find_model(model).channels == 4
    assert ("CH4" in setup) == four == ("REFD" in setup)
    bench.write("CH4:SCALE 1")
    assert bench.events() == ([] if four else [113])


def test_letter_series_differs_where_the_manual_says(make_bench):
    bench = make_bench(model="TDS2014B")
    bench.write("HEADER ON")
    assert bench.ask("CH1?") == (
        ":CH1:PROBE 1.0E1;CURRENTPROBE 1.0E1;"
        'SCALE 1.0E0;POSITION 0.0E0;COUPLING DC;BANDWIDTH OFF;INVERT OFF;YUNIT "V"'
    )
    assert ";VERTICAL:POSITION 0.0E0;SCALE 2.0E0;:MATH:FFT:HORIZONTAL" in bench.ask("MATH?")


@pytest.mark.slow
@pytest.mark.parametrize("model", ["TDS2014", "TPS2014", "TDS1002"])
def test_no_string_upsets_the_parser(model):
    outcome = fuzz.run(8000, seed=20090417, model=model)
    assert outcome.failures == []
    assert outcome.strings == 8000


def test_fuzzing_notices_a_scope_that_stumbles(monkeypatch, capsys):
    def stumble(scope):
        raise ZeroDivisionError

    monkeypatch.setattr("instrument.simulated.scope.SimulatedTDS2014.settle", stumble)
    assert fuzz.main(["--count", "20"]) == 1
    assert "ZeroDivisionError" in capsys.readouterr().out
