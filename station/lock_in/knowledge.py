"""What the settings say of a bench, in the terms of the analysis."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from analysis.budget import FRONT_END_LIMIT, LATITUDE_LIMIT_DEG, BenchKnowledge, Corner
from analysis.channel import ChannelResponse
from analysis.lock_in_run import Method, RunKnowledge
from station.lock_in.settings import (
    RING_LASER,
    BudgetSettings,
    FrontEndSettings,
    Settings,
    default_settings,
    load_settings,
)
from station.settings.toml_files import read_toml

_RECTANGLE = math.sqrt(3.0)

_AC_CORNER_HZ = 10.0
"""Lower -3 dB corner of the AC coupling of a TDS2014 with a direct cable; a 10X probe makes it a tenth."""


def run_knowledge(settings: Settings) -> RunKnowledge:
    """Collect what the settings say of gyro, table and channel of a run."""
    stated = settings.budget
    return RunKnowledge(
        scale_factor=settings.gyro.scale_factor_pulses_per_deg,
        latitude_deg=settings.site.latitude_deg,
        north_azimuth_deg=settings.table.north_azimuth_deg,
        both_senses=settings.table.both_senses,
        response=channel_response(settings.front_end),
        bench=bench_knowledge(settings),
        latitude_u_deg=(stated.latitude_u_deg if stated is not None else 0.0) or LATITUDE_LIMIT_DEG / _RECTANGLE,
        table_rate_u_ppm=stated.table_rate_u_ppm if stated is not None else 0.0,
        known_tilt_deg=math.nan if settings.table.known_tilt_deg is None else settings.table.known_tilt_deg,
        known_tilt_u_deg=settings.table.known_tilt_u_deg,
    )


def bench_knowledge(settings: Settings) -> BenchKnowledge:
    """Collect what an uncertainty budget counts besides the records; nan for whatever nobody stated."""
    scope, stated, front_end = settings.scope, settings.budget, settings.front_end
    share = 0.01 * (stated.front_end_u_percent if stated is not None else 0.0) or FRONT_END_LIMIT / _RECTANGLE
    coupling = Corner(_AC_CORNER_HZ / scope.probe if scope.coupling == "AC" else 0.0)
    if front_end.ac_corner_hz:
        coupling = Corner(front_end.ac_corner_hz, share * front_end.ac_corner_hz, corrected=True)
    bandwidth = Corner((stated.bandwidth_hz if stated is not None else 0.0) or math.nan)
    if front_end.low_pass_hz:
        bandwidth = Corner(front_end.low_pass_hz, share * front_end.low_pass_hz, corrected=True)
    measured = share if front_end.response or front_end.response_file else math.nan
    if math.isfinite(measured):
        # a measured response holds every corner of the channel
        bandwidth, coupling = Corner(math.inf), Corner(0.0)
    if stated is None:
        return BenchKnowledge(high_pass=coupling, bandwidth=bandwidth, response_u=measured)
    return BenchKnowledge(
        scale_factor_u_ppm=stated.scale_factor_u_ppm or math.nan,
        time_base_limit_ppm=stated.time_base_limit_ppm,
        distortion_limit=_amplitude(stated.distortion_limit_dbc),
        third_order_limit=_amplitude(stated.third_order_limit_dbc),
        bandwidth=bandwidth,
        high_pass=coupling,
        gain=Corner(stated.gain_corner_hz or math.nan),
        response_u=measured,
    )


_NOTHING_KNOWN = BudgetSettings(
    scale_factor_u_ppm=0.0,
    time_base_limit_ppm=BenchKnowledge().time_base_limit_ppm,
    distortion_limit_dbc=0.0,
    bandwidth_hz=0.0,
    front_end_u_percent=0.0,
    gain_corner_hz=0.0,
    table_rate_u_ppm=0.0,
    latitude_u_deg=0.0,
)


def stated_of_files(config: Path | None) -> Settings | None:
    """Settings in which nothing of the bench is known but what a file states; ``None`` without one.

    What the shipped settings say of their simulated bench is not true of the one that the records come from.
    """
    if config is None:
        return None
    nothing = default_settings().model_copy(update={"budget": _NOTHING_KNOWN})
    if "coupling" in read_toml(config).get("scope", {}):
        nothing = nothing.model_copy(update={"scope": load_settings(config).scope})
    return RING_LASER.with_knowledge(nothing, config)


def knowledge_of_files(wfids: Iterable[str], method: Method, config: Path | None = None) -> RunKnowledge:
    """Collect what is known of the bench that files come from."""
    coupled = all("DC coupling" in wfid for wfid in wfids)
    bench = BenchKnowledge(high_pass=Corner(0.0 if coupled else math.nan))
    known = RunKnowledge(method.scale_factor, latitude_deg=math.nan, bench=bench)
    settings = stated_of_files(config)
    if settings is None or config is None:
        return known
    bench = bench_knowledge(settings)
    said = "coupling" in read_toml(config).get("scope", {}) or math.isfinite(bench.response_u)
    if not (said or bench.high_pass.corrected):
        bench = replace(bench, high_pass=known.bench.high_pass)
    return replace(known, bench=bench, response=channel_response(settings.front_end))


def _amplitude(level_dbc: float) -> float:
    """Amplitude of a harmonic over the fundamental; nan for 0 dBc, which stands for "not known"."""
    return 10 ** (level_dbc / 20) if level_dbc else math.nan


def channel_response(front_end: FrontEndSettings) -> ChannelResponse | None:
    """Return the response that the settings describe; ``None`` if there is nothing to correct.

    It has no uncertainties: what all records share does not average out, so it stands in the budget and not with
    each record.
    """
    if not (front_end.low_pass_hz or front_end.ac_corner_hz or front_end.response):
        return None
    return ChannelResponse(
        low_pass_hz=[front_end.low_pass_hz] if front_end.low_pass_hz else [],
        high_pass_hz=[front_end.ac_corner_hz] if front_end.ac_corner_hz else [],
        table_hz=[row[0] for row in front_end.response],
        table_gain=[row[1] for row in front_end.response],
        table_phase_rad=[math.radians(row[2]) for row in front_end.response],
    )
