"""``gyrolock settings``: a commented settings file to copy, and the JSON Schema of one for editors."""

from pathlib import Path

import click

from station.shell.options import config_option, json_option
from station.terminal import print_json, say

# file of defaults: the measurement that reads it
_FILES = {"simulated": "measure", "bench": "measure", "dead_band": "deadband", "fibre_gyro": "table"}
_OTHERS = {
    "campaign": "campaign",
    "rate_table": "controllers/rate_table",
    "acutrol": "controllers/acutrol",
    "ideal_aerosmith": "controllers/ideal_aerosmith",
    "chamber": "controllers/chamber",
    "power_supply": "controllers/power_supply",
}
_NAMES = [*_FILES, *_OTHERS]


@click.command("settings")
@click.argument("name", type=click.Choice(_NAMES), default="simulated")
@click.option("--schema", is_flag=True, help="Print its JSON Schema, for the completion of an editor.")
@config_option
@json_option
def command(name: str, schema: bool, config: Path | None, as_json: bool) -> int:
    """Print a commented settings file to copy: `simulated` for the simulated bench, `bench` for a real one.

    `dead_band` is that of `gyrolock deadband`, `campaign` that of `gyrolock station`; `rate_table`, `chamber` and
    `power_supply` are templates of controllers, `acutrol` and `ideal_aerosmith` those of two kinds of rate tables.
    With --json, or with --config FILE, the values that would be used are printed instead of the file.
    """
    from station.settings import read_toml, shipped_settings

    if schema:
        print_json(_schema(name))
        return 0
    shipped = shipped_settings(_OTHERS.get(name, name))
    if name in _OTHERS:
        if config is not None:
            raise click.UsageError(f"--config shows values of a measurement; {name} is none")
        values = read_toml(shipped)
    elif config is not None or as_json:
        from station.measurements import measurement
        from station.settings import load

        kind = measurement(_FILES[name]).kind
        read = load(kind, config) if config is not None else kind.model.model_validate(read_toml(shipped))
        print_json(read.model_dump(mode="json"))
        return 0
    if as_json:
        print_json(values)
    else:
        say(shipped.read_text(encoding="utf-8").rstrip())
    return 0


def _schema(name: str) -> dict[str, object]:
    from station.campaign.file import campaign_schema, settings_schema, template_schema

    if name == "campaign":
        return campaign_schema()
    return template_schema() if name in _OTHERS else settings_schema(_FILES[name])
