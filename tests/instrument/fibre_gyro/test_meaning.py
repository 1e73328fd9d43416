"""Descriptions that fit the bytes and not their meaning."""

import copy
import tomllib

import numpy as np
import pytest

from benchmarks.fibre_gyro.frames import read
from benchmarks.fibre_gyro.real_gyros import REAL_GYROS, raw_outputs
from instrument.fibre_gyro import parse_frame_format
from instrument.fibre_gyro.frames import doubts_about
from station.settings import shipped_settings

GYROS = {gyro.name: gyro for gyro in REAL_GYROS}


def doubts(name, *, at_rest=False, **changes):
    """What is doubted where the output of a shipped description is described otherwise."""
    gyro = GYROS[name]
    table = copy.deepcopy(tomllib.loads(shipped_settings(gyro.file).read_text(encoding="utf-8"))["formats"][name])
    for entry in table["fields"]:
        if entry["name"].startswith("counts"):
            for key, value in changes.items():
                entry.pop(key, None) if value is None else entry.update({key: value})
    layout = parse_frame_format(table, name)
    raw = raw_outputs(gyro, 600, np.random.default_rng(1))
    if at_rest:
        raw = [(one - 700_000) // 20 if isinstance(one, int) else one for one in raw]
    rows = [frame.values for frame in read(layout, b"".join(gyro.pack(n, one) for n, one in enumerate(raw)))]
    assert len(rows) > 500
    return doubts_about(layout, rows)


@pytest.mark.parametrize("name", sorted(GYROS))
@pytest.mark.parametrize("at_rest", [False, True])
def test_a_right_description_is_not_doubted(name, at_rest):
    assert doubts(name, at_rest=at_rest) == ()


@pytest.mark.parametrize("at_rest", [False, True])
def test_seven_bits_read_as_eight(at_rest):
    (said,) = doubts("packed_7_bits", at_rest=at_rest, data_bits=None, value_bits=None)
    assert "highest bit of all its bytes was 0" in said and "data_bits = 7" in said


@pytest.mark.parametrize("at_rest", [False, True])
def test_bytes_in_the_wrong_order(at_rest):
    (said,) = doubts("eb90", at_rest=at_rest, byte_order="big")
    assert "counts: jumps by" in said and "low byte first" in said
    (said,) = doubts("low_high_mid", at_rest=at_rest, byte_order="little")
    assert "byte_order = [0, 2, 1]" in said


def test_a_sign_that_is_not_read():
    (said,) = doubts("eb90", at_rest=True, type="unsigned")
    assert "as a signed number" in said


def test_floats_that_are_none():
    (said,) = doubts("eb90", at_rest=True, type="float", byte_order="big")
    assert "is it a float" in said
    assert len(doubts("kvh_1750", byte_order="little")) == 3


def test_a_random_output_is_nobodys_mistake():
    layout = parse_frame_format(
        {"kind": "binary", "output_rate_hz": 1.0, "header": "55", "fields": [{"name": "counts", "bytes": 4}]}
    )
    rng = np.random.default_rng(2)
    assert doubts_about(layout, [(float(one),) for one in rng.integers(-(2**31), 2**31, 500)]) == ()
    assert doubts_about(layout, [(float(n % 100),) for n in range(500)]) == ()
