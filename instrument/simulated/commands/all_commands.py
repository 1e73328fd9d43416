"""All commands of a model: the tree of their headers and what they do."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

from instrument.simulated.commands import (
    acquisition,
    file,
    hard_copy,
    later_models,
    measurement,
    setup,
    status,
    waveform,
)
from instrument.simulated.commands.action import Action
from instrument.simulated.commands.command_tree import CommandTree
from instrument.simulated.panel.models import Model
from instrument.simulated.panel.settings_table import setting_rows


@lru_cache(maxsize=32)
def command_set(model: Model) -> tuple[CommandTree, Mapping[str, Action]]:
    """The headers of a model, and by its header every action that is more than a stored setting."""
    actions = {
        **status.ACTIONS,
        **acquisition.ACTIONS,
        **setup.ACTIONS,
        **measurement.ACTIONS,
        **hard_copy.ACTIONS,
        **waveform.actions(model),
        **later_models.actions(model),
        **(file.ACTIONS if model.has_storage else {}),
    }
    return CommandTree(setting_rows(model), actions), actions
