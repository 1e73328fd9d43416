"""Records that are read together because they are alike are the same as records that are read one at a time."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from analysis import Flag
from instrument import Preamble
from station.errors import RunError
from station.lock_in.estimate import Piece, estimate_pieces
from station.runs.store import NewRecord, RunWriter, open_run
from station.sources.batches import stretches_of
from station.sources.find import open_source

GOLDEN = Path(__file__).parents[2] / "golden"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """24 records: two conditions, one of another purpose, one damaged, one too short, one without a preamble."""
    old = open_run(GOLDEN / "single.sqlite")
    taken = old.taken_for("measure")
    with RunWriter.create(tmp_path, {"command": "measure", "settings": old.facts.settings}) as writer:
        for number in range(24):
            one = taken[number % len(taken)]
            purpose = "tilt" if number == 4 else "measure"
            payload = one.payload[:-1] if number == 9 else one.payload
            header = "no preamble" if number == 14 else one.header
            conditions = {"channel": "CH1", "table_rate_dps": 8.0 if number < 18 else 3.0}
            writer.save_records([NewRecord(f"n {number}", purpose, header, payload, conditions)])
    with sqlite3.connect(writer.path) as db:
        db.execute("UPDATE record SET taken_at = taken_at || ' ' WHERE key = 'n 7'")
    return writer.path


def test_the_same_records_with_fewer_words(run: Path) -> None:
    source = open_source(run)
    stretches = list(source.stretches())
    # 0-3 | the tilt | 5 6 | the damaged one | 8-13, of which 9 is short | no preamble | 15-17 | the other rate
    assert [[int(key.split()[1]) for key in one.keys] for one in stretches] == [
        *([0, 1, 2, 3], [4], [5, 6], [7], [8, 9, 10, 11, 12, 13], [14], [15, 16, 17], [18, 19, 20, 21, 22, 23])
    ]
    saved = open_run(run).records
    assert [record for one in stretches for record in one.records()] == list(saved)
    assert [record for one in stretches_of(saved) for record in one.records()] == list(saved)
    assert [len(one) for one in stretches_of(saved)] == [len(one) for one in stretches]


def test_the_mains_that_a_run_states_count_for_its_records(tmp_path: Path) -> None:
    old, flags = open_run(GOLDEN / "single.sqlite"), []
    (before,) = estimate_pieces([Piece(GOLDEN / "single.sqlite")])
    beat = float(np.median(before.each.beat_frequency))
    for mains in (1.37 * beat, 2 * beat):  # the second stands on every second harmonic
        site = old.facts.settings["site"] | {"mains_hz": mains}
        with RunWriter.create(
            tmp_path, {"command": "measure", "settings": old.facts.settings | {"site": site}}
        ) as writer:
            writer.save_records(
                [NewRecord(one.key, one.purpose, one.header, one.payload, one.conditions) for one in old.records]
            )
        (found,) = estimate_pieces([Piece(writer.path)])
        flags.append((found.each.flags & Flag.MAINS_BESIDE) != 0)
    assert not flags[0].any() and flags[1].all()


def test_what_cannot_be_used_costs_itself_only(run: Path) -> None:
    (found,) = estimate_pieces([Piece(run)], at_once=5)
    assert [key.split()[1] for key in found.labels["key"]] == [
        str(number) for number in range(24) if number not in (4, 7, 9, 14)
    ]
    assert found.taken == 23 and found.damaged == (6,)
    assert found.places.tolist() == [n - (n > 4) for n in range(24) if n not in (4, 7, 9, 14)]
    assert found.columns["table_rate_dps"].tolist() == [8.0] * 14 + [3.0] * 6
    assert [one.record for one in found.left_out] == ["n 7", "n 9", "n 14"]
    assert "2499 bytes of codes" in found.left_out[1].reason
    assert len(found.fast) == 1 and found.each is not None
    # one at a time, each in a batch of its own
    (alone,) = estimate_pieces([Piece(run)], at_once=1)
    assert alone.each is not None
    assert found.each.lock_in_rate.tobytes() == alone.each.lock_in_rate.tobytes()


def test_what_was_read_before_the_disk_failed_is_analysed(tmp_path: Path) -> None:
    old = open_run(GOLDEN / "single.sqlite")
    one = old.taken_for("measure")[0]
    with RunWriter.create(tmp_path, {"command": "measure", "settings": old.facts.settings}) as writer:
        for number in range(300):
            writer.save_records([NewRecord(f"n {number}", "measure", one.header, one.payload, one.conditions)])
    pages = writer.path.stat().st_size // 16384
    with writer.path.open("r+b") as file:
        file.seek(pages // 2 * 16384)
        file.write(b"\xff" * 16384)
    source, read = open_source(writer.path), []
    with pytest.raises(RunError, match="is damaged and cannot be read"):
        for stretch in source.stretches():
            read += list(stretch.records())
    assert 50 < len(read) < 250
    assert [record.key for record in read] == [f"n {number}" for number in range(len(read))]
    (found,) = estimate_pieces([Piece(writer.path)])
    assert len(found) == len(read)
    assert len(found.left_out) == 1


def test_one_text_is_one_preamble() -> None:
    """Records of one run are compared by it a million times."""
    header = open_run(GOLDEN / "single.sqlite").taken_for("measure")[0].header
    assert Preamble.parse(header) is Preamble.parse("".join(list(header)))
