"""gyrolock for scripts and notebooks.

`measure` does the main job and `open_run` opens what any command saved; both show themselves in a notebook::

    result = gyrolock.measure(records=20)               # the simulated bench; resource="GPIB0::1::INSTR": yours
    result.lock_in_rate_dps, result.lock_in_rate_u_dps  # every key of the command's JSON
    result.plot()
    run = gyrolock.open_run("runs/2026-11-21T060530Z_001")
    run.volts, run.estimates.lock_in_rate, run.to_dataframe()

`Station` tests units against limits, unattended, and writes the record of each test::

    tested = gyrolock.Station("campaign.toml").test("RLG-001", operator="B. Bauer")
    tested.verdict, tested.exit_code, tested.files.page

`read` takes files of an oscilloscope, or a whole memory card. Driver and estimator stand beside them. Nothing is
imported before it is used.

Examples
--------
>>> import gyrolock
>>> times = [n * 4e-5 for n in range(2500)]
>>> volts = gyrolock.beat_signal(times, scale_factor=2000, input_rate=0.08, lock_in_rate=0.01)
>>> estimate = gyrolock.estimate_lock_in(volts, 4e-5, scale_factor=2000)
>>> round(float(estimate.lock_in_rate), 6)
0.01
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from analysis import LockInEstimate, beat_signal, combine_estimates, estimate_lock_in, fit_rates
    from instrument import TDS2014, Waveform, read_waveform
    from station.notebook.measure import Runs, Station, measure, runs
    from station.notebook.result import Record, Result
    from station.notebook.run import Run, export, open_run, read, read_runs

__all__ = [
    "TDS2014",
    "LockInEstimate",
    "Record",
    "Result",
    "Run",
    "Runs",
    "Station",
    "Waveform",
    "beat_signal",
    "combine_estimates",
    "estimate_lock_in",
    "export",
    "fit_rates",
    "measure",
    "open_run",
    "read",
    "read_runs",
    "read_waveform",
    "runs",
]

_HOMES = {
    "analysis": ("LockInEstimate", "beat_signal", "combine_estimates", "estimate_lock_in", "fit_rates"),
    "instrument": ("TDS2014", "Waveform", "read_waveform"),
    "station.notebook.measure": ("Runs", "Station", "measure", "runs"),
    "station.notebook.result": ("Record", "Result"),
    "station.notebook.run": ("Run", "export", "open_run", "read", "read_runs"),
}


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            found = globals()[name] = getattr(importlib.import_module(home), name)
            return found
    raise AttributeError(f"gyrolock has no {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    return sorted(__all__)
