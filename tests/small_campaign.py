"""A campaign that takes seconds: one rate on an ideal bench, so that its result stands."""

from pathlib import Path

from tests.ideal_bench import CLEAN, KNOWN

CAMPAIGN = """
[campaign]
name = "Acceptance"
unit_type = "RLG-2000"
station = "bench 3"
reports = false

[output]
directory = {directory!r}

[[instrument]]
role = "oscilloscope"
model = "TDS 2014"
serial = "C012345"
calibrated_on = 2020-01-15
calibration_due = 2021-01-15

[bench.gyro]
scale_factor_pulses_per_deg = 2000.0
expected_lock_in_rate_dps = 0.01

[bench.simulation.contaminants]
{clean}
[bench.budget]
{known}
[unit.BAD.simulation]
lock_in_rate_dps = 0.012

[[step]]
name = "lock-in rate"
measurement = "measure"

[step.settings.measurement]
rates_over_lock_in = [8.0]
records = 2
tilt_records = 2

[[step.limit]]
number = "lock_in_rate_dps"
at_least = 0.008
at_most = 0.011

[[step.limit]]
number = "noise_rms_v"
at_most = 0.010
guard_band = "none"
"""


def write_campaign(folder: Path, more: str = "") -> Path:
    """Write the campaign into a folder, its tests below it."""
    clean, known = ("".join(f"{name} = {value}\n" for name, value in one.items()) for one in (CLEAN, KNOWN))
    path = folder / "campaign.toml"
    text = CAMPAIGN.format(directory=str(folder / "tests"), clean=clean, known=known)
    path.write_text(text + more, encoding="utf-8")
    return path
