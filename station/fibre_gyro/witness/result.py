"""What the staircase on the oscilloscope means, as numbers and sentences."""

from __future__ import annotations

import math
from typing import Any

from analysis.fibre_gyro import describe_witness_flag
from station.fibre_gyro.common import PPM
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.witness.evaluate import Uncertain, WitnessedRecord, WitnessFound
from station.results.as_json import picked
from station.results.numbers import ppm, with_uncertainty
from station.results.result import Measured, Result
from station.runs.store import SavedRun

LIMITED = ("witness_two_pi_error_ppm", "witness_step_time_ppm")
_RECORD = {
    "step_height_v": "step_height",
    "step_height_u_v": "step_height_u",
    "step_time_s": "step_time",
    "step_time_u_s": "step_time_u",
    "reset_height_v": "reset_height",
    "reset_height_u_v": "reset_height_u",
    "two_pi_voltage_v": "two_pi_voltage",
    "two_pi_voltage_u_v": "two_pi_voltage_u",
    "bias_height_v": "bias_height",
    "bias_height_u_v": "bias_height_u",
    "steps": "steps",
    "resets": "resets",
    "noise_rms_v": "noise_rms",
    "flags": "flags",
}


def result(found: WitnessFound, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    voltage, lines = found.two_pi_voltage, tuple(_lines(found))
    value = "V_2π unknown: no reset is in the records"
    if math.isfinite(voltage.value):
        value = f"V_2π = {with_uncertainty(voltage.value, voltage.u, 'V')}"
    watched = tuple(_to_watch(found, settings))
    return Result(
        name="result",
        value=value,
        document=_document(found, settings),
        measured=(
            Measured("witness_two_pi_error_ppm", PPM * found.two_pi_error.value, u=PPM * found.two_pi_error.u),
            Measured("witness_step_time_ppm", found.step_time_ppm.value, u=found.step_time_ppm.u),
        ),
        lines=lines,
        summary=[("", line) for line in lines],
        sentences=tuple(_sentences(found, settings, run.facts.get("injected", {}).get("step_codes"))),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
    )


def _document(found: WitnessFound, settings: FogSettings) -> dict[str, Any]:
    return {
        **_pair("step_height", found.step_height, "_v"),
        **_pair("step_time", found.step_time, "_s"),
        **_pair("reset_height", found.reset_height, "_v"),
        **_pair("two_pi_voltage", found.two_pi_voltage, "_v"),
        **_pair("bias_height", found.bias_height, "_v"),
        **_pair("step", found.step_codes, "_codes"),
        **_pair("step_time_difference", found.step_time_ppm, "_ppm"),
        **_pair("two_pi_error", found.two_pi_error, ""),
        "two_pi_error_ppm": PPM * found.two_pi_error.value,
        "two_pi_error_u_ppm": PPM * found.two_pi_error.u,
        "two_pi_voltage_u_without_gain_v": found.two_pi_voltage_record_u,
        "half_wave_v": found.half_wave_v or None,
        "gain_u": settings.witness.gain_u,
        "time_base_u": settings.witness.time_base_u,
        "records": [_record(one) for one in found.records],
        "left_out": found.left_out,
    }


def _pair(name: str, value: Uncertain, unit: str) -> dict[str, float]:
    return {f"{name}{unit}": value.value, f"{name}_u{unit}": value.u}


def _record(one: WitnessedRecord) -> dict[str, Any]:
    return {"name": one.name, **picked(one.found, _RECORD), "step_time_given": one.step_time_given}


def _lines(found: WitnessFound) -> list[str]:
    step, fall, time, error = found.step_height, found.reset_height, found.step_time, found.two_pi_error
    lines = [
        f"Step {with_uncertainty(step.value, step.u, 'V')} every "
        f"{with_uncertainty(1e6 * time.value, 1e6 * time.u, 'µs')}; fall at a reset "
        f"{with_uncertainty(fall.value, fall.u, 'V')}."
    ]
    if math.isfinite(error.value):
        percent = with_uncertainty(100 * error.value, 100 * error.u)
        lines.append(
            f"2π error {'' if percent.startswith('-') else '+'}{percent} % against twice {found.half_wave_v:g} V; "
            f"from {len(found.records)} records."
        )
    return lines


def _sentences(found: WitnessFound, settings: FogSettings, injected: float | None) -> list[str]:
    """Say what the numbers show and what they cannot."""
    alone, difference = found.two_pi_voltage_record_u, found.step_time_ppm
    said = [
        f"Volts are the oscilloscope's reading: its gain is known to {100 * settings.witness.gain_u:.3g} % (k = "
        "1), which is in every uncertainty in volts here. A wrong resistor shows, a drift of 0.1 % does not."
    ]
    if math.isfinite(alone):
        said.append(
            f"Without the gain V_2π is known to {1000 * alone:.2g} mV, "
            f"{100 * alone / found.two_pi_voltage.value:.2g} %: so well two runs with the same settings of the "
            "oscilloscope compare."
        )
        step = with_uncertainty(found.step_codes.value, found.step_codes.u)
        told = f"; {injected:g} were injected" if injected else ""
        said.append(f"Step over V_2π, free of the gain: {step} codes{told}.")
    said.append(
        f"Step time against the transit time of the coil by design: {ppm(difference.value, difference.u)}, by the "
        "oscilloscope's time base."
    )
    if not found.half_wave_v:
        said.append("The half-wave voltage (witness.half_wave_v) is not known, so no 2π error is given.")
    return said


def _to_watch(found: WitnessFound, settings: FogSettings) -> list[str]:
    """Say what to watch, of the records and of the limits."""
    said = [f"{one.sentence}." for one in found.left_out]
    total = len(found.records)
    for name in found.flags:
        count = sum(name in one.found.flags for one in found.records)
        sentence = describe_witness_flag(name)
        said.append(sentence if count == total else f"{sentence} ({count} of {total} records)")
    if any(one.step_time_given for one in found.records):
        said.append("Single steps hardly stand out: they were looked for at the transit time of the coil.")
    limit, u = settings.limits.witness_two_pi_error_ppm, PPM * found.two_pi_error.u
    if limit is not None and u > limit:
        said.append(
            f"The 2π error is uncertain by {u:.3g} ppm, more than its limit of {limit:g} ppm: neither PASS nor "
            "FAIL is proved. Compare the oscilloscope with a voltmeter and set witness.gain_u."
        )
    return said
