"""What settings files of every measurement share: sections that take no unknown name, and what values may be."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Limit = Positive | None


class SettingsSection(BaseModel):
    """A section of a settings file: an unknown name is a mistake, and nothing changes once it is read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SiteSettings(SettingsSection):
    """Where the bench stands."""

    latitude_deg: Annotated[float, Field(ge=-90, le=90)]


class OutputSettings(SettingsSection):
    """Where results go."""

    directory: Annotated[str, Field(min_length=1)]
