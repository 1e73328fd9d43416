"""``gyrolock analyze``: analyse saved records again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.shell.options import config_option, json_option, print_failure, print_json

if TYPE_CHECKING:
    from analysis.lockin_equation import Relation
    from station.errors import Failure
    from station.lock_in.analyze import Analyzed, Choices
    from station.settings.load import Settings


@click.command("analyze")
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="PATH...")
@click.option(
    "--scale-factor", type=click.FloatRange(min=0, min_open=True), metavar="K", help="Pulses per degree."
)
@click.option(
    "--input-rate",
    type=float,
    metavar="W",
    help="Rate on the gyro's axis, deg/s. Without it the beat frequency is the reference.",
)
@click.option(
    "--relation", type=click.Choice(["exact", "paper-13", "paper-10"]), default="exact", show_default=True
)
@click.option("--jsonl", is_flag=True, help="One JSON object a record, one a line, on stdout.")
@config_option
@json_option
def command(
    paths: tuple[Path, ...],
    scale_factor: float | None,
    input_rate: float | None,
    relation: Relation,
    jsonl: bool,
    config: Path | None,
    as_json: bool,
) -> int:
    """Analyse saved runs and Tektronix CSV or ISF files again.

    PATH is a run (its directory or its file), or a file that the scope or its PC software wrote. With --json
    and several paths the document holds a list `results`. Exit code 4 if any of them gives no lock-in rate.

    A run is analysed with the settings that it was taken with; with --config its [front_end] and [budget] are
    those of FILE, for a channel that was measured later.
    """
    from station.lock_in.analyze import Choices
    from station.settings.load import load_settings

    if jsonl and as_json:
        raise click.UsageError("--json and --jsonl exclude each other")
    settings = load_settings(config)
    choices = Choices(scale_factor, input_rate, relation, None if config is None else settings)
    documents, failures = [], []
    for path in paths:
        analyzed, failure = _analyze(path, choices, settings)
        document: dict[str, Any] = analyzed.document() if analyzed is not None else {"file": str(path)}
        if failure is not None:
            failures.append(failure)
            document["error"] = failure.as_json()
        documents.append(document)
        if jsonl:
            for line in analyzed.record_documents() if analyzed is not None else [document]:
                click.echo(json.dumps(line, allow_nan=False))
        elif analyzed is not None and not as_json:
            _print(analyzed)
        if failure is not None:
            print_failure(failure)
    if as_json:
        print_json(documents[0] if len(documents) == 1 else {"results": documents})
    # what could not be read at all (2) comes before what holds no lock-in rate (4)
    return min((failure.exit_code for failure in failures), default=0)


def _analyze(path: Path, choices: Choices, settings: Settings) -> tuple[Analyzed | None, Failure | None]:
    """Analyse one path; one that cannot be read must not keep the others from being analysed."""
    from instrument import InstrumentError
    from station.errors import EXIT_NO_SIGNAL, Failure, NoUsableSignal, StationError, describe_failure
    from station.lock_in.analyze import analyze_path
    from station.lock_in.sentences import no_result_words

    try:
        analyzed = analyze_path(path, choices, settings)
    except (InstrumentError, StationError, OSError) as error:
        return None, describe_failure(error)
    if analyzed.evaluation.usable:
        return analyzed, None
    sentence = f"{path}: {no_result_words(analyzed.evaluation)}"
    return analyzed, Failure(NoUsableSignal.kind, sentence, EXIT_NO_SIGNAL)


def _print(analyzed: Analyzed) -> None:
    from station.lock_in.console import print_harmonics, print_result

    click.echo(f"{analyzed.path}")
    if (harmonics := analyzed.harmonics()) is not None:
        print_harmonics(harmonics)
    run = analyzed.run
    print_result(analyzed.evaluation, simulated=run is not None and run.facts["simulated"])
