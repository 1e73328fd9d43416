"""`python -m benchmarks.fibre_gyro.frames`: damaged frames of real gyros, and what is delivered of them.

Frames that share no code with the product are damaged, each with the same chance, by a byte lost or inserted or a
bit flipped, and read by the product. Printed for each kind: how many delivered frames were never sent (wrong), how
far off they are at most, in standard deviations of the noise, how far those that the outlier check of every mean
leaves move the mean of all, in its standard uncertainty by that noise, how many of those that arrived whole were
not delivered (lost), and how fast they were read, damaged and undamaged (seconds of one core). Off by and moved
are the worst of several seeds.

    python -m benchmarks.fibre_gyro.frames --frames 4000 --damage 0.09 --seeds 1 [--only kvh_dsp]
"""

from __future__ import annotations

import argparse
import sys
import time
import tomllib
from dataclasses import dataclass

import numpy as np

from analysis.fibre_gyro.scatter import outliers
from benchmarks.fibre_gyro.real_gyros import REAL_GYROS, RealGyro, damaged, is_same, raw_outputs
from instrument.fibre_gyro import FrameFormat, parse_frame_format
from instrument.fibre_gyro.frame_stream import FrameStream
from instrument.fibre_gyro.frames import Frame
from station.settings import shipped_settings

_AHEAD = 60  # frames behind the last delivered one among which the next is looked for
_PIECE = 1000  # bytes that are read at once


@dataclass
class Score:
    """What became of the frames of one kind."""

    sent: int = 0
    whole: int = 0
    delivered: int = 0
    wrong: int = 0
    far: float = 0.0
    moved: float = 0.0


def layout_of(gyro: RealGyro) -> FrameFormat:
    """The shipped description of a gyro."""
    with shipped_settings(gyro.file).open("rb") as file:
        return parse_frame_format(tomllib.load(file)["formats"][gyro.name], gyro.name)


def read(layout: FrameFormat, data: bytes) -> list[Frame]:
    """What the product delivers of some bytes."""
    stream, found = FrameStream(layout), []
    for begin in range(0, len(data), _PIECE):
        found += stream.feed(data[begin : begin + _PIECE])
    found += stream.feed(b"", silent=True)
    return [event for event in found if isinstance(event, Frame) and not event.problem]


def run(gyro: RealGyro, frames: int, damage: float, seed: int) -> tuple[Score, float, float]:
    """Damage and read: the score, and bytes per second damaged and undamaged."""
    rng = np.random.default_rng(seed)
    layout = layout_of(gyro)
    raw = raw_outputs(gyro, frames, rng)
    clean = [gyro.pack(n, one) for n, one in enumerate(raw)]
    parts = [damaged(one, rng) if rng.random() < damage else one for one in clean]
    began = time.process_time()
    delivered = read(layout, b"".join(parts))
    between = time.process_time()
    read(layout, b"".join(clean))
    ended = time.process_time()
    score = judge(gyro, raw, delivered)
    score.whole = sum(part == one for part, one in zip(parts, clean, strict=True))
    return score, sum(map(len, parts)) / (between - began), sum(map(len, clean)) / (ended - between)


def judge(gyro: RealGyro, raw: list[int] | list[tuple[int, int, int]], delivered: list[Frame]) -> Score:
    """Find each delivered frame among those that were sent, in their order."""
    score, place, moved = Score(sent=len(raw), delivered=len(delivered)), 0, 0.0
    left_out = np.any([outliers(of) for of in np.array([one.values for one in delivered]).T], axis=0)
    for frame, is_out in zip(delivered, left_out, strict=True):
        for ahead in range(place, min(place + _AHEAD, len(raw))):
            counter, values = gyro.values(ahead, raw[ahead])
            if counter == frame.counter and is_same(frame.values, values):
                place = ahead + 1
                break
        else:
            score.wrong += 1
            off = _off(gyro, raw, place, frame)
            score.far = max(score.far, abs(off))
            moved += 0.0 if is_out else off
    score.moved = abs(moved) / len(delivered) ** 0.5
    return score


def _off(gyro: RealGyro, raw: list[int] | list[tuple[int, int, int]], place: int, frame: Frame) -> float:
    """How far a frame that was never sent lies from those around it, in standard deviations of the noise."""
    around = [gyro.values(n, raw[n])[1] for n in range(max(0, place - 200), min(place + 200, len(raw)))]
    table = np.array(around)
    spread = table.std(axis=0)
    moving = spread > 0
    off = (np.array(frame.values) - table.mean(axis=0))[moving] / spread[moving]
    return float(off[np.argmax(np.abs(off))]) if off.size else 0.0


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=4000)
    parser.add_argument("--damage", type=float, default=0.09)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--only", default="", help="formats whose name holds this text")
    given = parser.parse_args()
    lines = [
        "| format | bytes | frames | whole | wrong | off by, sd | mean moved, u | lost, % "
        "| MB/s, damaged | MB/s |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for gyro in (one for one in REAL_GYROS if given.only in one.name):
        total, slow, fast = Score(), [], []
        for seed in range(given.seeds):
            score, damaged_rate, clean_rate = run(gyro, given.frames, given.damage, seed)
            for name in ("sent", "whole", "delivered", "wrong"):
                setattr(total, name, getattr(total, name) + getattr(score, name))
            total.far = max(total.far, score.far)
            total.moved = max(total.moved, score.moved)
            slow.append(damaged_rate)
            fast.append(clean_rate)
        lost = 100 * (1 - (total.delivered - total.wrong) / total.whole)
        size = len(gyro.pack(1, (700_000,) * 3 if gyro.axes == 3 else 700_000))
        lines.append(
            f"| `{gyro.name}` | {size} | {total.sent} | {total.whole} | {total.wrong} | "
            f"{f'{total.far:.1f} | {total.moved:.2f}' if total.wrong else '- | -'} | {max(lost, 0.0):.1f} | "
            f"{max(slow) / 1e6:.2f} | {max(fast) / 1e6:.2f} |"
        )
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
