"""The memory card of later models: files, folders, what is saved on it and recalled, and the clock."""

import re

import numpy as np
import pytest

from instrument import read_waveform

WITH_CARD = ["TDS2014B", "TDS2024C", "TPS2014", "TDS2014+TDS2MEM"]


def sine(times):
    return 2.0 * np.sin(2 * np.pi * 1000.0 * times)


@pytest.fixture(params=WITH_CARD)
def card(request, make_bench):
    bench = make_bench({1: sine}, model=request.param, noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 1;POSITION 0.4")
    bench.single()
    assert bench.events() == [401]
    return bench


@pytest.mark.parametrize(
    "command",
    [
        "DATE?",
        "TIME?",
        "FILESYSTEM?",
        "SAVE:IMAGE 'A.BMP'",
        "RECALL:WAVEFORM 'A.CSV',REFA",
        "SAVE:IMAGE:FILEFORMAT?",
    ],
)
def test_first_series_without_the_module_has_no_files(fresh, command):
    fresh.write(command)
    assert fresh.events() == [401, 113]


def test_setup_on_the_card(card):
    setup = card.ask("SET?")
    card.write("SAVE:SETUP 'MY.SET'")
    card.write("CH1:SCALE 5;:HOR:SCALE 1")
    card.write("RECALL:SETUP 'my.set'")
    assert card.events() == []
    assert card.ask("SET?") == setup
    card.write("*RST")
    card.write("SAVE:SETUP 3;:RECALL:SETUP 'NONE.SET'")
    assert card.events() == [256]
    card.write("RECALL:SETUP FACTORY;:RECALL:SETUP 3")
    assert card.events() == []


def test_waveform_on_the_card_is_a_file_that_is_read_exactly(card, tmp_path):
    card.write("SAVE:WAVEFORM CH1,'A:\\F0000CH1.CSV'")
    assert card.events() == []
    file = tmp_path / "F0000CH1.CSV"
    file.write_bytes(card.scope.storage.files["A:\\F0000CH1.CSV"])
    read = read_waveform(file)
    assert np.array_equal(read.codes, card.codes())
    assert (read.preamble.yoff, read.preamble.ymult) == (10.0, 0.04)
    card.write("RECALL:WAVEFORM 'F0000CH1.CSV',REFB;:SELECT:REFB ON;:DATA:SOURCE REFB")
    assert card.events() == []
    assert np.array_equal(card.codes(), read.codes)
    card.write("SAVE:WAVEFORM CH2,'B.CSV'")
    assert card.events() == [2245]
    card.write("SAVE:SETUP 'S.CSV';:RECALL:WAVEFORM 'S.CSV',REFA")
    assert card.events() == [253]


@pytest.mark.parametrize(("form", "magic"), [("BMP", b"BM"), ("TIFF", b"II*\0"), ("PCX", b"\x0a\x05")])
def test_picture_on_the_card(card, form, magic):
    card.write(f"SAVE:IMAGE:FILEFORMAT {form};:SAVE:IMAGE 'SCREEN'")
    assert card.events() == []
    assert card.scope.storage.files["A:\\SCREEN"].startswith(magic)
    assert card.ask("SAVE:IMAGE:FILEFORMAT?") == form


def test_folders_and_names(card):
    assert card.ask("FILESYSTEM:CWD?") == '"A:\\"'
    assert card.ask("FILESYSTEM:DIR?") == '""'
    free = int(card.ask("FILESYSTEM:FREESPACE?"))
    card.write("FILESYSTEM:MKDIR 'ALL0000';CWD 'all0000';:SAVE:SETUP 'ONE.SET';:SAVE:SETUP 'TWO.SET'")
    assert card.ask("FILESYSTEM:CWD?;DIR?") == '"A:\\ALL0000\\";"ONE.SET","TWO.SET"'
    assert int(card.ask("FILESYSTEM:FREESPACE?")) < free
    card.write("FILESYSTEM:RENAME 'ONE.SET','..\\THREE.SET';:FILESYSTEM:DELETE '*.*'")
    assert card.events() == []
    assert card.ask("FILESYSTEM:DIR?") == '""'
    card.write("FILESYSTEM:CWD 'A:/';RMDIR 'ALL0000'")
    size = len(card.scope.storage.files["A:\\THREE.SET"])
    assert card.ask("FILESYSTEM?") == f'"A:\\";{free - size}'
    assert card.ask("FILESYSTEM:DIR?") == '"THREE.SET"'
    card.write("FILESYSTEM:FORMAT")
    assert card.ask("FILESYSTEM:FREESPACE?") == str(free)
    assert card.events() == []


@pytest.mark.parametrize(
    ("command", "event"),
    [
        ("FILESYSTEM:DELETE 'NOT.HER'", 256),
        ("FILESYSTEM:CWD 'NOWHERE'", 256),
        ("SAVE:SETUP 'MUCHTOOLONG.SET'", 257),
        ("SAVE:SETUP 'A|B.SET'", 257),
        ("SAVE:SETUP 'X\\Y.SET'", 256),
        ("FILESYSTEM:MKDIR SUB", 104),
        ("FILESYSTEM:RENAME 'A'", 104),
        ("SAVE:SETUP 'A.SET';:FILESYSTEM:RENAME 'A.SET','A.SET'", 257),
        ("FILESYSTEM:MKDIR 'SUB';:SAVE:SETUP 'SUB\\A.SET';:FILESYSTEM:RMDIR 'SUB'", 250),
        ("DATE 'yesterday'", 224),
    ],
)
def test_what_cannot_be_done_with_files(card, command, event):
    card.write(command)
    assert card.events() == [event]


def test_card_is_full_or_missing(card):
    card.scope.storage.files["A:\\BIG"] = bytes(32 * 1024 * 1024 - 100)
    card.write("SAVE:SETUP 'A.SET'")
    assert card.events() == [254]
    card.scope.storage.present = False
    card.write("SAVE:SETUP 'A.SET'")
    assert card.events() == [252]
    assert card.ask("FILESYSTEM:FREESPACE?") is None


def test_clock_goes_and_can_be_set(card):
    card.write('DATE "2009-04-10";:TIME "23:59:30"')
    assert card.ask("DATE?") == '"2009-04-10"'
    assert re.fullmatch(r'"23:59:3\d"', card.ask("TIME?"))
    card.clock.sleep(60)
    assert card.ask("DATE?") == '"2009-04-11"'
    assert card.ask("TIME?").startswith('"00:00:3')
