"""``gyrolock measure``, the main job, ``acquire``, its first half, ``start``, ``deadband`` and ``settings``."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from instrument.errors import LinkError
from station.errors import CannotWrite
from station.shell.options import (
    CHANNELS,
    RUN_PATH,
    config_option,
    dither_option,
    json_option,
    overrides,
    positive,
    report_option,
    run_measurement,
    run_options,
    shown_for,
    take_measurement,
    told_as_options,
    unused_config_option,
)
from station.terminal import print_failure, print_json, remark, say

if TYPE_CHECKING:
    from station.runs.acquisition import Taken

F = TypeVar("F", bound=Callable[..., Any])

_PLACES = {
    "resource": "scope.resource",
    "scale_factor": "gyro.scale_factor_pulses_per_deg",
    "table": "table.kind",
    "rate_table": "controllers.rate_table",
    "rates": "measurement.rates_over_lock_in",
    "records": "measurement.records",
    "channel": "scope.channel",
}


def _rates(_: click.Context, __: click.Parameter, value: str | None) -> str | list[float] | None:
    if value is None or value == "auto":
        return value
    try:
        return [float(one) for one in value.split(",")]
    except ValueError:
        raise click.BadParameter(f"{value!r} is neither auto nor numbers such as 8 or 3,5,8,15,30") from None


def _table(context: click.Context, _: click.Parameter, value: str | None) -> str | None:
    """The kind of table, and its controller beside it."""
    if value is None:
        return None
    if (words := _table_words(value)) is None:
        raise click.BadParameter(f"{value!r} is neither manual, none nor NAME@RESOURCE with {_TEMPLATES} as NAME")
    kind, controller = words
    if controller:
        context.params["rate_table"] = controller
    return kind


def _table_words(value: str) -> tuple[str, dict[str, str]] | None:
    """The kind of table, and its controller: a name is that of a template, with where it is connected."""
    from station.controllers import TABLES

    if value in ("manual", "none"):
        return value, {}
    name, _, resource = value.partition("@")
    file = Path(name)
    if name in TABLES:
        return "controller", {"resource": resource, "file": name}
    return ("controller", {"resource": resource, "file": str(file.resolve())}) if file.is_file() else None


_TEMPLATES = "acutrol, ideal_aerosmith, rate_table or the file of a template"


def _bench_options(function: F) -> F:
    """Add the options that say what to acquire with, and how much."""
    options = (
        click.option(
            "--resource", metavar="NAME", help="VISA name of the oscilloscope. Without one the bench is simulated."
        ),
        click.option(
            "--scale-factor",
            type=float,
            callback=positive,
            metavar="K",
            help="Pulses per degree. With --resource it must be given, here or in the settings.",
        ),
        click.option(
            "--table",
            callback=_table,
            metavar="WHAT",
            help="Who turns the table: manual (you), none (it turns already), or NAME@RESOURCE of its controller "
            "(acutrol, ideal_aerosmith, rate_table or the file of a template).",
        ),
        click.option(
            "--rates",
            callback=_rates,
            metavar="LIST",
            help="Rates in expected lock-in rates: 8 for one rate, 3,5,8,15,30 for several, auto.",
        ),
        click.option(
            "--records", type=click.IntRange(1, 1_000_000), metavar="N", help="Records at each rate and sense."
        ),
        click.option("--channel", type=CHANNELS, metavar="CHn", help="Input channel, CH1 to CH4."),
        run_options,
    )
    for option in reversed(options):
        function = option(function)
    return function


@click.command("measure")
@_bench_options
@dither_option
@report_option
def measure(**given: Any) -> int:
    """Measure the lock-in rate: acquire, save, analyse, report.

    Without --resource the whole bench is simulated: rate table, gyro and oscilloscope. With --resource the
    gyro is expected to turn already, unless --table or the settings say who sets the table.

    Where the table can be set, the gyro goes through several rates in both senses, chosen for the expected lock-in
    rate: they tell distortion of the detector and the laser's gain corner from lock-in. `--rates 8` takes the
    paper's single rate.

    Ctrl-C keeps the records taken so far; --resume goes on with such a run.
    """
    given, places = _with_scale_factor(given), _PLACES | {"dither": "dither.on"}
    if not _dithers(given):
        return run_measurement("measure", given, places=places)
    if given["rates"] is not None:
        raise click.UsageError("--rates: a gyro that dithers is measured at rest, or as it turns already")
    return run_measurement("dither", given, places=places | {"records": "dither.records"})


def _dithers(given: Mapping[str, Any]) -> bool:
    """Whether the gyro's body dithers: an option says so, the run that is gone on with, or the settings."""
    from station.lock_in.settings import load_settings
    from station.runs.store import open_run

    if given["resume"] is not None:
        return open_run(given["resume"]).facts.command == "dither"
    if given["dither"] is not None:
        return bool(given["dither"] == "on")
    return load_settings(given["config"], overrides=overrides(given, {"resource": "scope.resource"})).dither.on


@click.command("acquire")
@_bench_options
def acquire(**given: Any) -> int:
    """Acquire and save records only; `gyrolock analyze` reads them later.

    The scope is set up as `gyrolock measure` does it. Ctrl-C keeps the records taken so far; --resume goes on with
    such a run.
    """
    given = _with_scale_factor(given)
    with shown_for("measure", given) as progress:
        taken = take_measurement("measure", given, progress, places=_PLACES)
        code = _end_acquire(taken, given)
        progress.end(code)
    return code


def _end_acquire(taken: Taken, given: Mapping[str, Any]) -> int:
    """Say what is saved; the exit code."""
    from station.shell.finish import about_run, run_as_it_ends, save_outcome

    run, failure = run_as_it_ends(taken), taken.failure
    failure = failure or save_outcome(run, None)
    saved = len(run.taken_for("measure"))
    document: dict[str, object] = {"records": saved, **about_run(run)}
    if failure is not None:
        document["error"] = failure.as_json()
    if given["as_json"]:
        print_json(document)
    elif given["jsonl"] and failure is not None:
        print_json({"error": failure.as_json()})
    elif not given["jsonl"]:
        say(f"saved   {saved} records in {taken.path}", answer=True)
    if failure is None:
        return 0
    print_failure(failure if taken.failure is None else taken.to_tell)
    return failure.exit_code


def _with_scale_factor(given: dict[str, Any]) -> dict[str, Any]:
    """Return the options with the scale factor; where nobody has given it, the operator is asked."""
    from station.lock_in.settings import ask_scale_factor, load_settings

    if given["resume"] is not None:
        return given
    with told_as_options(_PLACES):
        settings = load_settings(given["config"], overrides=overrides(given, _PLACES))
    if settings.gyro.scale_factor_pulses_per_deg:
        return given
    return given | {"scale_factor": ask_scale_factor()}


# --------------------
# ``gyrolock start``: the first measurement, step by step


_WHO_TURNS = """\
Who turns the rate table?
  manual          you, when the program asks: five rates in both senses, ±0.1 %
  none            nobody, it turns already: one rate, ±20 %, since distortion cannot be told from lock-in
  NAME@RESOURCE   its controller (acutrol, ideal_aerosmith, or the file of a template): as manual, by itself
Table [none]: """


@click.command("start")
@click.option(
    "--resource", metavar="NAME", help="VISA name of the oscilloscope, where it is not found by looking."
)
@click.option(
    "--to", type=click.Path(path_type=Path), default=Path("bench.toml"), metavar="FILE", help="Settings file."
)
@unused_config_option
@json_option
@click.pass_context
def start(context: click.Context, resource: str | None, to: Path, as_json: bool) -> int:
    """Measure for the first time, step by step: find the oscilloscope, look at its channels, ask, measure.

    The answers are written to FILE [bench.toml], so the next time is `gyrolock measure --config bench.toml`.
    """
    from station.lock_in.settings import default_settings
    from station.report.show import write_page
    from station.scope.autoset import look_at_channels
    from station.scope.tools import open_scope
    from station.terminal import ask_number, ask_operator, check_terminal

    tell = remark if as_json else say
    check_terminal()
    if to.exists() or not os.access(to.parent, os.W_OK):
        raise click.UsageError(
            f"{to} is there already, or cannot be written: `gyrolock measure --config {to}`, or another --to"
        )
    resource = resource or _found_instrument(tell)
    shipped = default_settings("bench").scope
    with open_scope(resource) as scope:
        tell(f"{scope.identity.text} on {resource}; looking at its channels...")
        seen, beats = scope.channels, list[str]()
        for name, text, periodic in look_at_channels(
            scope, lambda one: shipped.model_copy(update={"channel": one})
        ):
            beats += [name] if periodic and "?" not in text else []
            tell(f"  {text}{' looks like a beat' if name in beats else ''}")
    first = (beats or seen)[0]
    channel = _answered(f"Channel of the beat [{first}]: ", first, lambda text: text.upper() in seen).upper()
    factor = ask_number("Scale factor of the gyro in pulses per degree, from its data sheet: ", "no terminal")
    expected = ask_number("Lock-in rate that you expect, deg/s [0.01]: ", "no terminal", default="0.01")
    options = _answered(_WHO_TURNS, "none", lambda text: _table_words(text) is not None)
    kind, controller = _table_words(options) or ("none", {})
    unit = ask_operator("Serial number of the unit [none]: ").strip()
    lines = [
        "# Written by `gyrolock start`. All that can be set: `gyrolock settings bench`.",
        f"[gyro]\nscale_factor_pulses_per_deg = {factor!r}\nexpected_lock_in_rate_dps = {expected!r}",
        f"[scope]\nresource = {json.dumps(resource)}\nchannel = {json.dumps(channel)}",
        f"[table]\nkind = {json.dumps(kind)}",
    ]
    if controller:
        names = (f"{key} = {json.dumps(value)}" for key, value in controller.items())
        lines.append("\n".join(["[controllers.rate_table]", *names]))
    try:
        write_page(to, "\n\n".join(lines) + "\n")
    except OSError as error:
        raise CannotWrite(f"{to}: {error.strerror}: another name with --to") from error
    tell(f"Written to {to}. The same again: gyrolock measure --config {to}")
    return int(context.invoke(measure, config=to, unit=unit or None, as_json=as_json))


def _found_instrument(tell: Callable[[str], None]) -> str:
    """VISA name of the oscilloscope: the one that answers, or which of them."""
    from instrument import find_resources

    tell("Looking for oscilloscopes on serial ports, USB, GPIB and the network...")
    found = find_resources()
    usable = [one for one in found if one.identity is not None]
    for one in found:
        tell(f"  {one.resource_name}  {one.identity.text if one.identity else one.problem}")
    if not usable:
        raise LinkError(
            f"none of {len(found)} names is an oscilloscope that can be used: `gyrolock doctor` says what is "
            "missing; give a name with --resource, or see it work without hardware: `gyrolock measure`"
        )
    names = [one.resource_name for one in usable]
    return names[0] if len(names) == 1 else _answered(f"Which one [{names[0]}]: ", names[0], names.__contains__)


def _answered(question: str, default: str, is_right: Callable[[str], bool]) -> str:
    """Ask until the answer is one of those that can be meant; Enter means the default."""
    from station.terminal import ask_operator

    asked = question
    while not is_right(answer := ask_operator(asked).strip() or default):
        asked = f"{answer!r} cannot be meant. {question}"
    return answer


# --------------------
# ``gyrolock deadband``: the search for the dead band


_DEADBAND_PLACES = {
    "resource": "scope.resource",
    "channel": "scope.channel",
    "highest": "sweep.highest_over_lock_in",
    "steps": "sweep.steps",
    "records": "sweep.records",
}


@click.command("deadband")
@click.argument("paths", nargs=-1, type=RUN_PATH, metavar="[RUN]")
@click.option(
    "--resource", metavar="NAME", help="VISA name of the oscilloscope. Without one the bench is simulated."
)
@click.option("--channel", type=CHANNELS, metavar="CHn", help="Input channel, CH1 to CH4.")
@click.option(
    "--highest",
    type=click.FloatRange(1, min_open=True),
    metavar="X",
    help="Highest rate, in expected lock-in rates.",
)
@click.option("--steps", type=click.IntRange(2, 10_000), metavar="N", help="Rates between zero and the highest.")
@click.option("--records", type=click.IntRange(1, 1000), metavar="N", help="Records at each rate.")
@run_options
@report_option
def deadband(paths: tuple[Path, ...], **given: Any) -> int:
    """Search the dead band: sweep the rate through zero, up and down.

    It shows where the beat ends and where it begins again. Without --resource the whole bench is simulated; with
    it an operator sets the table: the program says on the terminal what to set, and asks what the table shows.
    RUN is a saved sweep, to be evaluated again.

    Ctrl-C keeps the records taken so far; --resume goes on with such a run.
    """
    return run_measurement("deadband", given, places=_DEADBAND_PLACES, paths=paths)


# --------------------
# ``gyrolock settings``: a commented settings file to copy, and the JSON Schema of one for editors


# file of defaults: the measurement that reads it
_FILES = {"simulated": "measure", "bench": "measure", "dead_band": "deadband"}
_FILES |= {"fibre_gyro": "table", "program": "program"}
_CONTROLLERS = ("rate_table", "acutrol", "ideal_aerosmith", "chamber", "power_supply")
_OTHERS = {"campaign": "campaign", **{name: f"controllers/{name}" for name in _CONTROLLERS}}
_NAMES = [*_FILES, *_OTHERS]


@click.command("settings")
@click.argument("name", type=click.Choice(_NAMES), default="simulated")
@click.option("--schema", is_flag=True, help="Print its JSON Schema, for the completion of an editor.")
@config_option
@json_option
def settings_command(name: str, schema: bool, config: Path | None, as_json: bool) -> int:
    """Print a commented settings file to copy: `simulated` for the simulated bench, `bench` for a real one.

    `dead_band` is that of `gyrolock deadband`, `campaign` that of `gyrolock station`, `program` that of a step
    that is a program of yours; `rate_table`, `chamber` and `power_supply` are templates of controllers, `acutrol`
    and `ideal_aerosmith` those of two kinds of rate tables.
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
        say(shipped.read_text(encoding="utf-8").rstrip(), answer=True)
    return 0


def _schema(name: str) -> dict[str, object]:
    from station.campaign.file import campaign_schema, settings_schema, template_schema

    if name == "campaign":
        return campaign_schema()
    return template_schema() if name in _OTHERS else settings_schema(_FILES[name])
