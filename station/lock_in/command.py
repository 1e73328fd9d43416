"""``gyrolock measure``: the main job."""

from __future__ import annotations

from pathlib import Path

import click

from station.shell.options import (
    bench_options,
    config_option,
    json_option,
    overrides,
    print_failure,
    print_json,
)


@click.command("measure")
@bench_options
@click.option("--report/--no-report", default=True, help="Write report.html beside the run [yes].")
@config_option
@json_option
def command(
    resource: str | None,
    records: int | None,
    channel: str | None,
    seed: int | None,
    out: Path | None,
    report: bool,
    config: Path | None,
    as_json: bool,
) -> int:
    """Measure the lock-in rate: acquire, save, analyse, report.

    Without --resource the whole bench is simulated: rate table, gyro and oscilloscope. With --resource the
    gyro is expected to turn already, unless the settings say that an operator sets the table.

    Ctrl-C keeps the records taken so far.
    """
    from station.lock_in.take import take_run
    from station.runs.progress import Progress
    from station.settings.load import load_settings

    simulated = load_settings(config, resource=resource).simulated
    chosen = overrides(records=records, channel=channel, seed=seed, out=out, simulated=simulated)
    settings = load_settings(config, resource=resource, overrides=chosen)
    taken = take_run(settings, Progress())
    return _finish(taken.path, taken.failure, report=report, as_json=as_json)


def _finish(path: Path, failure: object, *, report: bool, as_json: bool) -> int:
    """Say what the saved records say, also when they are fewer than wanted."""
    from station.errors import EXIT_NO_SIGNAL, EXIT_OK, Failure, NoUsableSignal, RunError
    from station.lock_in.console import print_result
    from station.lock_in.read import evaluate_run
    from station.lock_in.report import write_report
    from station.lock_in.result import result_document
    from station.lock_in.sentences import no_result_words
    from station.runs.database import save_result
    from station.runs.store import open_run

    assert failure is None or isinstance(failure, Failure)
    run = open_run(path)
    document: dict[str, object] = {"run": str(path)}
    try:
        evaluation = evaluate_run(run)
    except RunError as error:
        failure = failure or Failure(error.kind, str(error), EXIT_NO_SIGNAL)
    else:
        document = result_document(evaluation, run)
        save_result(path, document)
        if report:
            document["report"] = str(write_report(evaluation, run))
        if not evaluation.usable:
            failure = failure or Failure(NoUsableSignal.kind, no_result_words(evaluation), EXIT_NO_SIGNAL)
        if not as_json:
            print_result(evaluation, simulated=run.facts["simulated"])
    if failure is not None:
        document["error"] = failure.as_json()
    if as_json:
        print_json(document)
    else:
        click.echo(f"\nsaved   {path}")
        if "report" in document:
            click.echo(f"report  {document['report']}")
    if failure is not None:
        print_failure(failure)
        return failure.exit_code
    return EXIT_OK
