"""What displays say in the same words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def duration(seconds: float) -> str:
    """Write a time as a person says it.

    Examples
    --------
    >>> duration(12.4), duration(200), duration(9000)
    ('12 s', '3 min 20 s', '2 h 30 min')
    """
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest} s" if rest and minutes < 10 else f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if minutes else f"{hours} h"


def campaign_line(kind: str, facts: Mapping[str, Any]) -> str:
    """Return what a campaign's event says in one line; empty for an event that is not a campaign's."""
    if kind == "campaign_begun":
        again = "goes on" if facts.get("resumed") else "begins"
        about = f", about {duration(facts['seconds'])}" if facts.get("seconds") else ""
        return f"{facts.get('campaign')}: test of {facts.get('unit')} {again}, {facts.get('of')} steps{about}"
    if kind == "step_begun":
        return f"step {facts.get('number')} of {facts.get('of')}: {facts.get('title') or facts.get('step')}"
    if kind == "step_ended":
        return f"step {facts.get('number')} {facts.get('step')}: {_verdict(facts)}"
    if kind == "campaign_ended":
        return _verdict(facts)
    return ""


def _verdict(facts: Mapping[str, Any]) -> str:
    """A verdict and why, which may begin with the verdict itself."""
    verdict, why = str(facts.get("verdict") or "done"), str(facts.get("message") or "")
    return why if why.startswith(verdict) else f"{verdict}: {why}" if why else verdict


def link_words(link: Mapping[str, Any]) -> str:
    """Return the health of the link in words."""
    return str(link.get("text") or "no faults")


def run_name(run: Mapping[str, Any]) -> str:
    """Return the name of a run's directory from its event; empty without one."""
    parts = str(run.get("run") or "").replace("\\", "/").rstrip("/").split("/")
    named = parts[-2:] if len(parts) > 1 else parts
    return named[0] if named and named[-1].endswith(".sqlite") else named[-1]
