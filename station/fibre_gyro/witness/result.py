"""What the staircase on the oscilloscope means, in sentences."""

from __future__ import annotations

import math

from analysis.fibre_gyro import describe_witness_flag
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.witness.measurement import WitnessEvaluation
from station.fibre_gyro.words import ppm_words
from station.lock_in.sentences import with_uncertainty

_PPM = 1e6


def headline(found: WitnessEvaluation) -> tuple[str, list[str]]:
    """Return the result in large letters and the lines below it."""
    voltage, step, fall, time = found.two_pi_voltage, found.step_height, found.reset_height, found.step_time
    value = "V_2π unknown: no reset is in the records"
    if math.isfinite(voltage.value):
        value = f"V_2π = {with_uncertainty(voltage.value, voltage.u, 'V')}"
    lines = [
        f"Step {with_uncertainty(step.value, step.u, 'V')} every "
        f"{with_uncertainty(1e6 * time.value, 1e6 * time.u, 'µs')}; fall at a reset "
        f"{with_uncertainty(fall.value, fall.u, 'V')}."
    ]
    if math.isfinite(found.two_pi_error.value):
        error = found.two_pi_error
        lines.append(
            f"2π error {_percent(error.value, error.u)} against twice {found.half_wave_v:g} V; from "
            f"{len(found.records)} records."
        )
    return value, lines


def sentences(found: WitnessEvaluation, settings: FogSettings, injected: float | None) -> list[str]:
    """Say what the numbers show and what they cannot."""
    witness = settings.witness
    alone = found.two_pi_voltage_record_u
    said = [
        f"Volts are the oscilloscope's reading: its gain is known to {100 * witness.gain_u:.3g} % (k = 1), which "
        "is in every uncertainty in volts here. A wrong resistor shows, a drift of 0.1 % does not."
    ]
    if math.isfinite(alone):
        said.append(
            f"Without the gain V_2π is known to {1000 * alone:.2g} mV, "
            f"{100 * alone / found.two_pi_voltage.value:.2g} %: so well two runs with the same settings of the "
            "oscilloscope compare."
        )
        said.append(_step_sentence(found, injected))
    difference = found.step_time_ppm
    said.append(
        "Step time against the transit time of the coil by design: "
        f"{ppm_words(difference.value, difference.u)}, by the oscilloscope's time base."
    )
    if not found.half_wave_v:
        said.append("The half-wave voltage (witness.half_wave_v) is not known, so no 2π error is given.")
    return said


def _step_sentence(found: WitnessEvaluation, injected: float | None) -> str:
    step = found.step_codes
    text = f"Step over V_2π, free of the gain: {with_uncertainty(step.value, step.u)} codes"
    if not injected:
        return f"{text}."
    return f"{text}; {injected:g} were injected."


def flags(found: WitnessEvaluation, settings: FogSettings) -> list[str]:
    """Say what to watch, of the records and of the limits."""
    said = [f"{one.sentence}." for one in found.left_out]
    total = len(found.records)
    for name in found.flags:
        count = sum(name in one.found.flags for one in found.records)
        sentence = describe_witness_flag(name)
        said.append(sentence if count == total else f"{sentence} ({count} of {total} records)")
    if any(one.step_time_given for one in found.records):
        said.append("Single steps hardly stand out: they were looked for at the transit time of the coil.")
    limit, u = settings.limits.witness_two_pi_error_ppm, _PPM * found.two_pi_error.u
    if limit is not None and u > limit:
        said.append(
            f"The 2π error is uncertain by {u:.3g} ppm, more than its limit of {limit:g} ppm: neither PASS nor "
            "FAIL is proved. Compare the oscilloscope with a voltmeter and set witness.gain_u."
        )
    return said


def _percent(value: float, u: float) -> str:
    text = with_uncertainty(100 * value, 100 * u)
    return f"{'' if text.startswith('-') else '+'}{text} %"
