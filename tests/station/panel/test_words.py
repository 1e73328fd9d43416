"""Every language of the panel has words for all that is shown: no sentence is left in English, whoever says it."""

import ast
import importlib
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest

from analysis.flags import Flag, describe_flag
from instrument import ManualRateTable
from station.fibre_gyro.bench import SerialFogBench
from station.fibre_gyro.settings import load_fog_settings
from station.measurements import MEASUREMENTS, measurement
from station.panel.server import PAGE, FormField, languages, measurements, put, words

ROOT = PAGE.parents[2]
# what stays as it is: names of instruments, commands, options and settings
NAMES = re.compile(
    r"GJB|VISA|pyvisa|Tektronix|IDN|ASCII|BMP|DATA|START|STOP|REF[AB]|[VH]BARS|CH\d|FFT|JSON|SAMPLE|GPIB|USB|DIR|"
    "gyrolock|panel|list|analyze|run|combine|full|exclude|resume|guard|band|none|SIGTERM|SIGHUP|setup|read|"
    "commands|numbers|codes|deg|div|ppm|sqrt|per|frame|slow|gyro"
)


def english(text: str) -> set[str]:
    """Words of English in a text, without names and places of settings."""
    plain = re.sub(r"\[?\b[a-z]\w*\.[a-z_]\w*\]?|\b\w+_\w+\b", "", text)
    return {one for one in re.findall(r"[A-Za-z]{3,}", plain) if not NAMES.fullmatch(one)}


def sentences(tree: ast.AST) -> Iterator[str]:
    """Texts of the source, a 7 in the place of each value."""
    inside = {part for one in ast.walk(tree) if isinstance(one, ast.JoinedStr) for part in ast.walk(one)}
    bare = {one.value for one in ast.walk(tree) if isinstance(one, ast.Expr)}  # docstrings
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(one.value) if isinstance(one, ast.Constant) else "7" for one in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in inside | bare:
            yield node.value


def is_sentence(text: str) -> bool:
    return text.count(" ") > 1 and bool(re.search("[a-z]{2,} [a-z]", text)) and not re.search("%[s(]", text)


def parsed(*names: str) -> Iterator[tuple[str, ast.Module]]:
    for name in names:
        for file in sorted(ROOT.glob(name)):
            if "simulated" not in file.parts:
                yield file.relative_to(ROOT).as_posix(), ast.parse(file.read_text(encoding="utf-8"))


def told_by(call: ast.Call) -> str:
    return getattr(call.func, "attr", getattr(call.func, "id", ""))


def raised(error: str, *names: str) -> list[str]:
    """What is raised as such an error, in words."""
    found = []
    for _, tree in parsed(*names):
        for node in ast.walk(tree):
            call = node.exc if isinstance(node, ast.Raise) else None
            if isinstance(call, ast.Call) and call.args and re.fullmatch(error, told_by(call)):
                found += [one for one in sentences(call.args[0]) if is_sentence(one)][:1]
    return found


def assert_put(said: list[str]) -> None:
    """All of it has words: as it stands, behind what it is of, or as a part of a longer line."""
    left = {}
    for line in said:
        forms = (form.format(line) for form in ("{}", "{}: 7", "7; {}", "7: 7; {}: 7"))
        of_line = min((english(put(one, "zh")) for one in forms), key=len)
        if of_line:
            left[line] = of_line
    assert left == {}


def test_every_language_has_the_same_words() -> None:
    assert languages() == ("en", "zh")
    keys = {code: list(words(code)) for code in languages()}
    assert keys["zh"] == keys["en"]
    for code in languages():
        said = {key: text for key, text in words(code).items() if isinstance(text, str)}
        assert all(said.values())
        for key, text in said.items():
            assert text.count("{}") == words("en")[key].count("{}"), key


def test_every_question_is_put_into_every_language() -> None:
    """What is asked is made by those who ask; no English word may be left but names."""
    asked: list[str] = []

    def answers(*given: str) -> Callable[[str], str]:
        left = iter(given)
        return lambda question: asked.append(question) or next(left)

    table = ManualRateTable(ask=answers("abc", "-3", "-3", "2", "x", "ok", "", ""))
    for rate, why in ((5.0, "At 50.2 Hz hum of the mains would stand beside a harmonic of the beat."), (-5.0, "")):
        table.why = why
        if rate < 0:
            table.doubt("12.3")
            continue
        table.set_rate(rate)
    table.why = "Here lock-in shows in the beat. Records that are taken then: 8."
    table.set_rate(2.0)
    table.close()
    bench = SerialFogBench(mock.MagicMock(), mock.MagicMock(), answers(*[""] * 99))
    for name in ("figures", "temperature", "sensitivity"):
        turning = {"figures": {"turn_on_rate_dps": 5.0}}
        chosen = load_fog_settings(overrides=turning if name == "figures" else {})
        for planned in importlib.import_module(f"station.fibre_gyro.{name}").plan(chosen)[:9]:
            bench.prepare(replace(planned, conditions={**planned.conditions, "end_up": -1}))
    assert len(asked) > 12
    for question in asked:
        assert put(question, "en") == question
        assert english(put(question, "zh")) <= {"abc", "magnetic", "field"}, question


def test_what_the_panel_itself_says_is_put_into_every_language() -> None:
    said = raised("UsageError", "station/panel/*.py")
    for _, tree in parsed("station/panel/guard.py"):
        for node in ast.walk(tree):
            if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple):
                said += filter(is_sentence, sentences(node.value))
    assert len(said) > 10
    assert_put([one for one in said if "exit code" not in one])


@pytest.mark.parametrize("file", ["campaign/conduct.py", "campaign/journal.py", "results/verdict.py", "errors.py"])
def test_what_is_said_of_a_campaign_is_put_into_every_language(file: str) -> None:
    ((_, tree),) = parsed(f"station/{file}")
    said = list(filter(is_sentence, sentences(tree)))
    assert said or file == "errors.py"
    assert_put([one for one in said if one != "gyrolock test journal"])


@pytest.mark.slow
def test_what_is_noticed_of_a_result_is_put_into_every_language() -> None:
    flags = [str(one.name).lower() for one in Flag]
    assert_put([describe_flag(one) for one in flags])
    assert_put([f"slow: {describe_flag(one)} (3 of 40 records)" for one in flags])
    for one in flags:
        name = FormField(one, "", "", "text").name
        assert put(name, "zh") != name
    watching = "to_watch|doubt_sentence|remarks_on|far_from"
    watched = []
    for _, tree in parsed("station/**/*.py"):
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and re.search(watching, node.name):
                watched += filter(is_sentence, sentences(node))
    assert len(watched) > 50
    assert_put(watched)


def test_what_instruments_have_to_say_is_put_into_every_language() -> None:
    files = (
        "instrument/*.py",
        "instrument/dialogue/*.py",
        "instrument/tds2014/*.py",
        "instrument/fibre_gyro/link.py",
    )
    said = raised(
        r"(?!FileFormat|Frame|Value|Attribute)\w+Error|NoAnswer|NoTrigger|WrongInstrument|Command\w+|No\w+", *files
    )
    assert len(said) > 100
    assert_put(said)


@pytest.mark.slow
def test_what_happens_on_the_way_is_put_into_every_language() -> None:
    said = []
    for file, tree in parsed("station/**/*.py", "instrument/**/*.py"):
        telling = {"note"} if file.startswith("station") else {"tell", "_tell"}
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and node.args and told_by(node) in telling:
                said += [one for one in sentences(node.args[0]) if " " in one and one != "7 7"][:1]
    assert len(said) > 20
    assert_put(said)


@pytest.mark.slow
def test_why_there_is_no_result_is_put_into_every_language() -> None:
    said = raised("NoUsableSignal", "station/**/*.py") + raised(
        "InstrumentError|WrongInstrument", "station/**/*.py"
    )
    said += raised("ValueError", "station/fibre_gyro/*.py")
    assert len(said) > 40
    assert_put(said)


def test_what_is_noticed_of_beams_and_of_two_channels_is_put_into_every_language() -> None:
    (messages,) = (tree for _, tree in parsed("station/lock_in/messages.py"))
    tables = [node for node in messages.body if isinstance(node, ast.Assign) and isinstance(node.value, ast.Dict)]
    named = {"_BEAMS_FLAGS", "_QUADRATURE_FLAGS"}
    said = [
        one
        for node in tables
        if isinstance(node.targets[0], ast.Name) and node.targets[0].id in named
        for one in sentences(node.value)
        if is_sentence(one)
    ]
    assert len(said) == 14
    assert_put(said)


def test_every_measurement_and_what_is_counted_has_a_name_in_every_language() -> None:
    counted = ("records", "tilt", "logs", "seconds of output", "lock-in rate", "ratio")
    for title in (*measurements().values(), *counted):
        assert put(title, "zh") != title


def test_every_number_that_a_verdict_may_be_on_has_a_name_in_every_language() -> None:
    groups = [group for name in MEASUREMENTS for group in measurement(name).quantities_in({})]
    judged = {one.words for group in groups for one in group.quantities if one.limit_name or one.headline}
    assert len(judged) > 50
    for name in judged:
        verdict = put(f"slow: PASS {name} of X: 0.5 [0.4, 0.6] deg/s, at most 1 deg/s, margin +0.5 deg/s", "zh")
        assert english(verdict) <= {"Allan"}, verdict


def test_a_verdict_keeps_its_numbers() -> None:
    said = "rate: FAIL rate: 0.0110 [0.0109, 0.0111] deg/s, at most 0.01 deg/s, margin -0.0010 deg/s"
    in_chinese = put(said, "zh")
    assert re.findall(r"[-\d.]+", in_chinese) == re.findall(r"[-\d.]+", said)
    assert words("zh")["FAIL"] in in_chinese
    assert not re.search("FAIL|most|margin", in_chinese)


def test_several_reasons_in_a_line_are_put_one_by_one() -> None:
    reasons = [describe_flag("misfit"), describe_flag("mains"), "The largest uncertainty is an assumption: 7, 7."]
    said = f"slow: MARGINAL slow: 0.01 deg/s, at most 0.02 deg/s; the result is doubtful: {'; '.join(reasons)}"
    in_chinese = put(said, "zh")
    assert english(in_chinese) == set()
    for one in reasons:
        assert put(one, "zh") in in_chinese


def test_a_line_without_end_is_put_too() -> None:
    for many in (500, 100_000):
        assert put("a: " * many, "zh").count("a") == many


def test_no_sentence_stands_in_a_template() -> None:
    for template in PAGE.glob("*.j2"):
        text = re.sub(r"(?s)\{#.*?#\}|\{%.*?%\}|\{\{.*?\}\}|<[^>]*>", " ", template.read_text(encoding="utf-8"))
        left = set(re.findall(r"[A-Za-z]{2,}", text)) - {"gyrolock", "deg", "VISA"}
        assert left == set(), template.name
    used = set(re.findall(r"\bw\.(\w+)", "".join(one.read_text(encoding="utf-8") for one in PAGE.glob("*.j2"))))
    assert used - {"get"} <= set(words("en"))
    code = Path(PAGE.parent / "server.py").read_text(encoding="utf-8")
    code += "".join(one.read_text(encoding="utf-8") for one in PAGE.glob("*.j2"))
    said_by_state = {"PASS", "FAIL", "MARGINAL", "ERROR", "ABORTED", "stands", "doubtful", "fails"}
    said_by_state |= {f"means_{one}" for one in said_by_state} | {
        one for one in words("en") if one.startswith("exit_")
    }
    for key in set(words("en")) - used - said_by_state:
        assert f'"{key}"' in code, key
