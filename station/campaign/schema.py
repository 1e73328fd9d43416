"""JSON Schemas of the files that a person writes, for the completion and the checks of an editor."""

from __future__ import annotations

from typing import Any

from instrument.templates import ControllerTemplate
from station.campaign.settings import CampaignFile
from station.measurements import MEASUREMENTS, measurement

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def settings_schema(name: str) -> dict[str, Any]:
    """Return the schema of a measurement's settings file; nothing is required, since a file holds what differs."""
    return {"$schema": _DIALECT, **_partial(measurement(name).kind.model.model_json_schema())}


def template_schema() -> dict[str, Any]:
    """Return the schema of a controller's template."""
    return {"$schema": _DIALECT, **ControllerTemplate.model_json_schema()}


def campaign_schema() -> dict[str, Any]:
    """Return the schema of a campaign file: the settings of each step are those of its measurement."""
    schema = CampaignFile.model_json_schema()
    definitions = schema["$defs"]
    cases = []
    for name in MEASUREMENTS:
        of_settings = _partial(
            measurement(name).kind.model.model_json_schema(ref_template=f"#/$defs/{name}.{{model}}")
        )
        for inner, found in of_settings.pop("$defs", {}).items():
            definitions[f"{name}.{inner}"] = found
        for ours in ("limits", "output"):
            of_settings["properties"].pop(ours, None)
        definitions[f"{name}.settings"] = of_settings
        cases.append(
            {
                "if": {"properties": {"measurement": {"const": name}}, "required": ["measurement"]},
                "then": {"properties": {"settings": {"$ref": f"#/$defs/{name}.settings"}}},
            }
        )
    definitions["StepSection"]["allOf"] = cases
    return {"$schema": _DIALECT, **schema}


def _partial(schema: Any) -> Any:
    """The same without anything that is required: what is absent stands in the shipped file."""
    if isinstance(schema, dict):
        return {name: _partial(value) for name, value in schema.items() if name != "required"}
    return [_partial(one) for one in schema] if isinstance(schema, list) else schema
