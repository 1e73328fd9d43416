"""All classes of hostile records."""

from __future__ import annotations

from benchmarks.hostile import light, moving, moving_rate, noise, receiver
from benchmarks.hostile.record_class import RecordClass

_ORDER = ("ideal", "cure", "detect", "blind")

CLASSES: tuple[RecordClass, ...] = tuple(
    sorted(
        (*noise.CLASSES, *moving.CLASSES, *moving_rate.CLASSES, *light.CLASSES, *receiver.CLASSES),
        key=lambda one: _ORDER.index(one.kind),
    )
)
