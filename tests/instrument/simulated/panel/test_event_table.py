"""The event queue after each of nearly four hundred good and bad messages, from a table made from the manuals."""

from pathlib import Path

import pytest

TABLE = Path(__file__).with_name("event_table.txt")
COMMAND_ERRORS, EXECUTION_ERRORS = range(100, 200), (*range(200, 300), *range(2200, 2400))
CLASSES = {"CME": COMMAND_ERRORS, "EXE": EXECUTION_ERRORS}


def groups():
    """Messages that are sent one after the other to one instrument: how it is prepared, and the lines."""
    found = []
    for number, line in enumerate(TABLE.read_text(encoding="utf-8").splitlines(), start=1):
        if line.startswith("["):
            found.append((line.strip("[]"), []))
        elif line.strip() and not line.startswith("#"):
            message, _, codes = line.rpartition(" -> ")
            found[-1][1].append((number, message, codes.strip()))
    return found


def fits(codes, wanted):
    """Whether the codes are the wanted ones, or one of a wanted class."""
    if wanted == "-":
        return codes == []
    if wanted.isdigit():
        return codes == [int(wanted)]
    return len(codes) == 1 and any(codes[0] in CLASSES[word] for word in wanted.split("|"))


def test_table_is_as_long_as_promised():
    lines = [line for _, lines in groups() for line in lines]
    assert len(lines) >= 300
    bad = [line for line in lines if line[2] != "-"]
    assert 100 <= len(bad) <= 200


@pytest.mark.parametrize(("prepare", "lines"), groups(), ids=lambda value: value if isinstance(value, str) else "")
def test_events_after_each_message(fresh, prepare, lines):
    fresh.write(prepare)
    fresh.clock.sleep(1.0)
    fresh.link.pump()
    fresh.events()
    wrong = []
    for number, message, wanted in lines:
        fresh.write(message)
        fresh.link.pump()
        asks = message.endswith("?") and not message.startswith("*DDT ")
        if asks and wanted == "-":
            answer = fresh.read(timeout=5.0)
            if answer is None:
                wrong.append(f"line {number}: {message} was not answered")
        fresh.link.clear()  # an answer that is not wanted must not give 410
        codes = fresh.events()
        if not fits(codes, wanted):
            wrong.append(f"line {number}: {message} gave {codes} instead of {wanted}")
    assert not wrong, "\n".join(wrong)


def test_events_of_reading_and_not_reading(fresh):
    """410 to 440, which need more than one message (p. 3-23)."""
    fresh.events()
    fresh.write("CH1?")
    fresh.write("CH2?")
    assert fresh.read() is not None
    assert fresh.events() == [410]
    assert fresh.read(timeout=0.1) is None
    assert fresh.events() == [420]
    assert fresh.ask("FOO?", timeout=0.1) is None
    assert fresh.events() == [113, 420]
