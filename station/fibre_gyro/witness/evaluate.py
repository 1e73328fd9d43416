"""What the oscilloscope says of the modulator staircase: each record, their mean, the 2 pi error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.fibre_gyro import StaircaseWitness, rounding_left, two_pi_error_of_drive, witness_staircase
from instrument import Preamble, TransferError, Waveform
from station.errors import NoUsableSignal
from station.fibre_gyro.common import PPM
from station.fibre_gyro.settings import FogSettings
from station.results.result import LeftOut
from station.runs.store import SavedRecord, SavedRun

PURPOSE = "witness"
_SHARED = 0.5
"""Of the uncertainty of one record, what all records of a run share: 24 simulated runs of 5 records scatter 1.4
times as much as records that share nothing."""


@dataclass(frozen=True)
class Uncertain:
    """A value and its standard uncertainty; nan where there is none."""

    value: float
    u: float


@dataclass(frozen=True, eq=False)
class WitnessedRecord:
    """One record."""

    name: str  # its number, or the name of its file
    waveform: Waveform
    found: StaircaseWitness  # without the uncertainty of the oscilloscope's gain and time base
    step_time_given: bool  # its steps were found with the transit time of the coil only


@dataclass(frozen=True, eq=False)
class WitnessFound:
    """Means over the records; gain and time base are in every `u` but those of `record_u`."""

    records: tuple[WitnessedRecord, ...]
    step_height: Uncertain  # V and s
    step_time: Uncertain
    reset_height: Uncertain
    two_pi_voltage: Uncertain
    bias_height: Uncertain
    # without the gain: for comparison with another run with the same settings of the oscilloscope
    two_pi_voltage_record_u: float
    step_codes: Uncertain  # step over 2-pi voltage, times the codes of the converter; free of the gain
    step_time_ppm: Uncertain  # step time over transit time of the coil by design, less one
    half_wave_v: float  # 0 if it is not known
    two_pi_error: Uncertain  # v_2pi/(2 V_pi) - 1
    flags: tuple[str, ...]  # of `analysis.fibre_gyro.staircase`, of any record
    left_out: tuple[LeftOut, ...]


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> WitnessFound:
    """Evaluate the records of a run."""
    records, left_out = [], []
    for saved in run.taken_for(PURPOSE):
        name = str(saved.conditions.get("file") or f"record {saved.number}")
        try:
            records.append(_witnessed(name, saved, settings))
        except (ValueError, TransferError) as error:
            left_out.append(LeftOut(name, str(error)))
    if not records:
        reasons = "; ".join(dict.fromkeys(one.reason for one in left_out)) or "there are no records"
        raise NoUsableSignal(f"no record shows the staircase of a modulator: {reasons}")
    return _found(tuple(records), tuple(left_out), settings, simulated=run.facts.simulated)


def _witnessed(name: str, saved: SavedRecord, settings: FogSettings) -> WitnessedRecord:
    """Evaluate one record; ValueError says why it cannot be used."""
    if not saved.intact:
        raise ValueError("it is not what was once saved")
    waveform = Waveform(saved.codes, Preamble.parse(saved.preamble))
    preamble = waveform.preamble
    if preamble.xunit.lower() != "s":
        raise ValueError(f"it is a spectrum ({preamble.xunit}), not a record over time: save the channel itself")
    if preamble.pt_fmt != "Y":
        raise ValueError("it was taken in Peak Detect, which has no levels: use Sample mode")
    if waveform.clipped:
        raise ValueError("it is clipped: use more volts per division, or shift the position")
    return WitnessedRecord(name, waveform, *witnessed(waveform, settings.coil.transit_time))


def witnessed(waveform: Waveform, transit_time: float) -> tuple[StaircaseWitness, bool]:
    """Return the staircase of a record, and whether it was found with the transit time of the coil (s) only."""
    volts, interval = waveform.volts, waveform.sample_interval
    try:
        return witness_staircase(volts, interval), False
    except ValueError as alone:
        try:
            return witness_staircase(volts, interval, step_time=transit_time), True
        except ValueError:
            raise alone from None


def _found(
    records: tuple[WitnessedRecord, ...], left_out: tuple[LeftOut, ...], settings: FogSettings, *, simulated: bool
) -> WitnessFound:
    chosen = settings.witness
    gain, seconds = chosen.gain_u, chosen.time_base_u
    alone = _mean(records, "two_pi_voltage")
    voltage = _widened(alone, gain)
    time = _widened(_mean(records, "step_time"), seconds)
    step = _mean(records, "step_height")
    ratio = step.value / alone.value
    codes = (1 << settings.gyro.dac_bits) * ratio
    half_wave = chosen.half_wave_v or (settings.simulation.half_wave_v if simulated else 0.0)
    error = Uncertain(math.nan, math.nan)
    if half_wave and math.isfinite(voltage.value):
        error = Uncertain(*two_pi_error_of_drive(voltage.value, voltage.u, half_wave, chosen.half_wave_u_v))
    transit = settings.coil.transit_time
    return WitnessFound(
        records=records,
        step_height=_widened(step, gain),
        step_time=time,
        reset_height=_widened(_mean(records, "reset_height"), gain),
        two_pi_voltage=voltage,
        bias_height=_widened(_mean(records, "bias_height"), gain),
        two_pi_voltage_record_u=alone.u,
        # both rise together where the fit is unsure of them, so this is rather too wide
        step_codes=Uncertain(codes, abs(codes) * math.hypot(step.u / step.value, alone.u / alone.value)),
        step_time_ppm=Uncertain(PPM * (time.value / transit - 1), PPM * time.u / transit),
        half_wave_v=half_wave,
        two_pi_error=error,
        flags=tuple(dict.fromkeys(flag for one in records for flag in one.found.flags)),
        left_out=left_out,
    )


def _mean(records: Sequence[WitnessedRecord], name: str) -> Uncertain:
    """Weighted mean; where the records scatter by more than their uncertainties, those grow.

    What rounding is wrong by is partly the same in every record, and does not average.
    """
    rows = np.array(
        [(getattr(one.found, name), getattr(one.found, f"{name}_u"), _shared(one)) for one in records],
        dtype=np.float64,
    )
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        return Uncertain(math.nan, math.nan)
    values, u, share = rows.T
    if not u.all():  # a bias that is not there is 0 without an uncertainty
        return Uncertain(float(values.mean()), float(np.std(values)))
    weights = 1 / u**2
    mean = float(np.average(values, weights=weights))
    chi_square = float(np.sum(weights * (values - mean) ** 2)) / max(len(rows) - 1, 1)
    return Uncertain(mean, math.hypot(math.sqrt(max(1.0, chi_square) / weights.sum()), float(np.min(share * u))))


def _shared(record: WitnessedRecord) -> float:
    """Part of the uncertainty that all records of a run have in common: with little noise what rounding does."""
    found = record.found
    if not found.level_spacing:
        return _SHARED
    noise = found.noise_rms / found.level_spacing  # behind the converter, in its levels
    left = rounding_left(math.sqrt(max(noise**2 - 1 / 12, 0.0)))
    samples = max(found.step_time / record.waveform.sample_interval - found.settling_samples, 1.0)
    return max(_SHARED, left / math.hypot(left, noise / math.sqrt(samples)))


def _widened(measured: Uncertain, relative_u: float) -> Uncertain:
    return Uncertain(measured.value, math.hypot(measured.u, relative_u * measured.value))
