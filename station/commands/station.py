"""``gyrolock station``: the test of a unit against limits, that nobody has to watch."""

from __future__ import annotations

import shlex
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.errors import EXIT_OK, CannotWrite, OutOfControl, RunError, StationError, UsageError, describe_failure
from station.shell.options import display_options, json_option, shown, transcript_option
from station.terminal import print_failure, print_json, remark, say, say_briefly

if TYPE_CHECKING:
    from station.campaign.journal import CampaignOutcome, CampaignPlan
    from station.shell.finish import Evaluated

_HOOK_S = 60.0  # the next unit waits no longer for a command of the campaign


@click.command("station")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@click.option("--unit", metavar="SN", help="Serial number of the unit under test.")
@click.option("--loop", is_flag=True, help="One unit after the other, typed or by bar code; an empty line ends.")
@click.option("--operator", metavar="TEXT", help="Who tests.")
@click.option("--note", metavar="TEXT", help="What should be remembered of this test.")
@click.option("--check", is_flag=True, help="Check the file, for every unit that it names, and do nothing.")
@click.option("--dry-run", is_flag=True, help="Print the plan, its time and the predicted uncertainty.")
@click.option(
    "--resume",
    is_flag=False,
    flag_value="",
    metavar="[DIR]",
    help="Go on with a test that was cut short: the unit's only one, 'last', or the one in DIR.",
)
@click.option(
    "--to", "--out", "out", type=click.Path(path_type=Path), metavar="DIR", help="Directory of tests [settings]."
)
@display_options
@transcript_option
@json_option
def command(file: Path, **given: Any) -> int:
    """Test a unit by a campaign file: all steps, all limits, one verdict.

    A step that the bench fails is tried again and then reported, and the rest goes on. What was measured survives
    whatever ends the program; --resume goes on at the same step. `gyrolock settings campaign` prints an example.

    Exit codes: 0 PASS or no limits, 1 FAIL, 6 MARGINAL (a limit lies within the uncertainty); of ERROR and ABORTED
    that of what happened: 3 instrument or link, 4 no usable signal, 5 disk, 130 interrupted, 143 terminated.
    """
    from station.campaign.file import read_campaign

    if given["check"]:
        from station.settings import read_toml

        units = [given["unit"]] if given["unit"] else [*read_toml(file).get("unit", {}), "any other unit"]
        return _checked(file, [read_campaign(file, unit) for unit in units], given["as_json"])
    if given["loop"]:
        return _loop(file, given)
    unit = given["unit"] or _asked_unit()
    plan = read_campaign(file, unit)
    if given["out"] is not None:
        from dataclasses import replace

        plan = replace(plan, directory=given["out"])
    if given["dry_run"]:
        as_json = given["as_json"]
        from station.campaign.messages import dry_run_document, print_dry_run
        from station.plan import predict

        predictions = [predict(step.measurement, step.settings) for step in plan.steps]
        times = [one.seconds for one in predictions]
        halves = [(one.u, one.u95, one.why_not) for one in predictions]
        if as_json:
            print_json(dry_run_document(plan, times, halves))
        else:
            print_dry_run(plan, times, halves)
        return EXIT_OK
    return _test(plan, given)


def _loop(file: Path, given: dict[str, Any]) -> int:
    """Test units until an empty line; a test that cannot be begun does not keep the next unit waiting."""
    from dataclasses import replace

    from station.campaign.file import read_campaign
    from station.terminal import ask_operator, check_terminal

    if given["unit"] or given["resume"] or given["dry_run"]:
        raise click.UsageError("--loop asks for each unit: leave --unit, --resume and --dry-run out")
    check_terminal()
    codes = [EXIT_OK]
    while unit := ask_operator("Serial number of the next unit (Enter: no more): ").strip():
        try:
            plan = read_campaign(file, unit)
            codes.append(_test(replace(plan, directory=given["out"] or plan.directory, ask_for_unit=False), given))
        except StationError as error:
            if failure := describe_failure(error):
                print_failure(failure)
                codes.append(failure.exit_code)
    return max(codes)


def _asked_unit() -> str:
    """Ask for the serial number; UsageError where there is nobody to ask."""
    from station.terminal import ask_operator, somebody_answers

    if not somebody_answers():
        raise UsageError("which unit is tested? Give its serial number: --unit SN")
    while not (unit := ask_operator("Serial number of the unit under test (read it from its label): ").strip()):
        pass
    return unit


def _checked(file: Path, plans: list[CampaignPlan], as_json: bool) -> int:
    from station.campaign.bench import far_limits

    steps, named = plans[0].steps, [plan.unit for plan in plans]
    warned = list(dict.fromkeys(text for plan in plans for text in far_limits(plan)))
    for text in warned:
        remark(text)
    if as_json:
        said = {"ok": True, "file": str(file), "steps": [step.key for step in steps], "units": named}
        print_json({**said, "warnings": warned})
    else:
        limits = sum(len(step.limits) for step in steps)
        sizes = {"step": len(steps), "limit": limits}
        counted = ", ".join(f"{size} {name}{'s' if size != 1 else ''}" for name, size in sizes.items())
        say(f"{file}: {counted}, all well for {', '.join(named)}", answer=True)
    return EXIT_OK


def _test(plan: CampaignPlan, given: dict[str, Any]) -> int:
    from station.campaign.bench import bench_in_use, disk_space
    from station.campaign.conduct import conduct
    from station.campaign.journal import station_log, test_to_resume
    from station.campaign.record import write_record

    _check_bench(plan)
    if (room := disk_space(plan)).state == "bad":
        raise CannotWrite(room.text)
    resumed = None
    if given["resume"] is not None:
        resumed = test_to_resume(plan.directory, plan.unit, given["resume"])
    labels = {name: given[name] for name in ("operator", "note")}
    with bench_in_use(plan):  # before anybody carries a unit to a bench that is taken
        if plan.ask_for_unit:
            _ask_for_unit(plan)
        with station_log(plan.directory) as log, shown(given, "station", unit=plan.unit, **labels) as progress:
            progress.events.read_by(log)
            evaluated: dict[str, Evaluated] = {}
            texts = {name: text or "" for name, text in labels.items()}
            outcome = conduct(plan, progress, **texts, resumed=resumed, evaluated=evaluated)
            page, lost = None, None
            try:
                page = write_record(outcome, evaluated=evaluated).page
            except RunError as error:
                lost = describe_failure(error)
            code = outcome.exit_code if lost is None or outcome.failure is not None else lost.exit_code
            progress.end(code, outcome.message if lost is None else lost.message)
    _tell(outcome, given, page)
    if plan.on_record.strip() and page is not None:
        _hand_on(plan.on_record, page.with_name("record.json"))
    for failure in (outcome.failure, lost):
        if failure is not None:
            remark(failure.message)
    return code


def _check_bench(plan: CampaignPlan) -> None:
    """Refuse a unit where the bench is not in control by its reference unit. Raises OutOfControl."""
    if plan.reference is None or plan.is_reference:
        return
    from station.history import in_control

    every_s, now = 3600 * plan.reference.every_h, datetime.now(UTC)
    unit, simulated = plan.reference.unit, plan.simulated
    found = in_control(plan.directory, unit, plan.unit_type, now, every_s, simulated=simulated)
    if not found.ok:
        raise OutOfControl(f"{plan.unit} is not tested: {found.sentence}")


def _ask_for_unit(plan: CampaignPlan) -> None:
    """Let the operator bring the unit to the bench; UsageError where there is nobody."""
    from station.terminal import WIRING, ask_operator, somebody_answers

    if not somebody_answers():
        raise UsageError(
            "campaign.ask_for_unit: an operator is to connect the unit, and there is no terminal to ask on"
        )
    ask_operator(
        f"Put {plan.unit} ({plan.unit_type}) on the table, its axis as the fixture holds it, and connect it:\n\n"
        f"{WIRING}\n"
        f"Why: the test of this unit begins ({plan.name}).\n"
        f"Then: warm-up, and the steps of the test, {len(plan.steps)} in all.\n"
        "Press Enter when it is connected and switched on: "
    )


def _hand_on(line: str, record: Path) -> None:
    """Run the campaign's command with the record; what goes wrong is told and changes no verdict."""
    try:
        words = [word.replace("{record}", str(record)) for word in shlex.split(line)]
        done = subprocess.run(
            words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=_HOOK_S
        )
        why = f"ended with {done.returncode}: {done.stderr.strip()[-200:]}" if done.returncode else ""
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        why = f"cannot be run ({error})"
    if why:
        remark(f"on_record: {line} {why}; the record is in {record}")


def _tell(outcome: CampaignOutcome, given: dict[str, Any], page: Path | None) -> None:
    from station.campaign.messages import outcome_document, print_outcome
    from station.results.result import plain

    if given["as_json"]:
        files: dict[str, str | None] = {"page": None, "record": None}
        if page is not None:
            files = {"page": str(page), "record": str(page.with_name("record.json"))}
        print_json({**plain(outcome_document(outcome)), **files})
    else:
        why = f": {outcome.message}" if outcome.message else ""
        say_briefly(f"{outcome.plan.unit}; {outcome.verdict or 'no limits'}{why}; {outcome.directory}")
        print_outcome(outcome)
        if page is not None:
            say(f"record  {page}")
