"""gyrolock for scripts and notebooks.

>>> import gyrolock
>>> result = gyrolock.measure(records=5, seed=3)                   # doctest: +SKIP
>>> result.lock_in_rate_dps, result.lock_in_rate_u_dps              # doctest: +SKIP
>>> run = gyrolock.open_run("runs/2026-11-21T060530Z_001")          # doctest: +SKIP
>>> run.volts.shape, run.estimates.lock_in_rate                     # doctest: +SKIP

`measure` does the main job, `open_run` opens what any command saved, `read` takes files of an oscilloscope. The
driver, the reader of files and the estimator of single records stand beside them under their own names. Nothing is
imported before it is used.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from analysis import LockInEstimate, beat_signal, combine_estimates, estimate_lock_in, fit_rates
    from instrument import TDS2014, Waveform, read_waveform
    from station.notebook.measure import measure
    from station.notebook.records import Record
    from station.notebook.result import Result
    from station.notebook.run import Run, open_run, read

__all__ = [
    "TDS2014",
    "LockInEstimate",
    "Record",
    "Result",
    "Run",
    "Waveform",
    "beat_signal",
    "combine_estimates",
    "estimate_lock_in",
    "fit_rates",
    "measure",
    "open_run",
    "read",
    "read_waveform",
]

_HOMES = {
    "analysis": ("LockInEstimate", "beat_signal", "combine_estimates", "estimate_lock_in", "fit_rates"),
    "instrument": ("TDS2014", "Waveform", "read_waveform"),
    "station.notebook.measure": ("measure",),
    "station.notebook.records": ("Record",),
    "station.notebook.result": ("Result",),
    "station.notebook.run": ("Run", "open_run", "read"),
}


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            found = globals()[name] = getattr(importlib.import_module(home), name)
            return found
    raise AttributeError(f"gyrolock has no {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    return [*globals(), *__all__]
