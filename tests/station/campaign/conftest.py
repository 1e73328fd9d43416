"""A campaign of seconds on the simulated bench: one good unit, one at the limit, one bad."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.ideal_bench import CLEAN, KNOWN

CAMPAIGN = f"""
[campaign]
name = "Acceptance"
unit_type = "RLG-1"
station = "bench 1"
reports = false
attempts = 3
retry_after_s = 0.0

[bench.measurement]
rates_over_lock_in = [8.0]
records = 2
tilt_records = 1

[bench.simulation.contaminants]
{chr(10).join(f"{name} = {value}" for name, value in CLEAN.items())}

[bench.budget]
scale_factor_u_ppm = 2000.0
{chr(10).join(f"{name} = {value}" for name, value in KNOWN.items())}

[unit.GOOD.simulation]
lock_in_rate_dps = 0.009

[unit.LIMIT.simulation]
lock_in_rate_dps = 0.010

[unit.BAD.simulation]
lock_in_rate_dps = 0.011

[[step]]
name = "first"
measurement = "measure"

[[step.limit]]
number = "lock_in_rate_dps"
at_most = 0.010

[[step]]
name = "second"
measurement = "measure"

[[step.limit]]
number = "noise_rms_v"
at_most = 0.01
guard_band = "none"
"""


@pytest.fixture
def campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Write the campaign file with texts replaced, in a directory that the test then works in."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GYROLOCK_STATE", str(tmp_path / "state"))

    def write(*changes: tuple[str, str], steps: int = 2, more: str = "") -> Path:
        text = CAMPAIGN if steps == 2 else CAMPAIGN[: CAMPAIGN.rindex("[[step]]")]
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new, 1)
        path = tmp_path / "campaign.toml"
        path.write_text(text + more)
        return path

    return write
