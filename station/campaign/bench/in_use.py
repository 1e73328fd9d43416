"""One campaign on a bench: its instruments are kept from other programs from the first step to the last."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

from instrument.in_use import claim
from instrument.pyvisa_sessions import meant_by
from station.campaign.bench.surroundings import controllers_of
from station.campaign.plan import CampaignPlan

_PLACES = (("scope", "resource"), ("link", "port"), ("witness", "resource"))
"""Sections of the measurements' settings that name an instrument of a real bench."""


@contextmanager
def bench_in_use(plan: CampaignPlan) -> Iterator[None]:
    """Keep other programs of this computer from every instrument that a campaign names.

    A simulated bench is a program's own and names none.
    """
    doing = f"campaign {plan.name}, unit {plan.unit}"
    with ExitStack() as claims:
        for name in instruments_of(plan):
            claims.enter_context(claim(name, doing, means=meant_by(name)))
        yield


def instruments_of(plan: CampaignPlan) -> list[str]:
    """Return the resource names of the instruments that the steps of a campaign use, each once."""
    return list(dict.fromkeys(name for step in plan.steps for name in _named(step.settings) if name))


def _named(settings: Mapping[str, Any]) -> Iterator[str]:
    for section, name in _PLACES:
        yield (settings.get(section) or {}).get(name) or ""
    for controller in controllers_of(settings).there.values():
        yield controller.resource
