"""``gyrolock analyze``: analyse saved records again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from station.commands.options import config_option, json_option, print_failure, print_json

if TYPE_CHECKING:
    from analysis.lockin_equation import Relation
    from station.analyze import Analyzed


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

    PATH is a run (its directory or its file), or a file that the scope or its PC software wrote. With --json and
    several paths the document holds a list `results`. Exit code 4 if any of them gives no lock-in rate.
    """
    from station.analyze import Choices, analyze_path
    from station.errors import EXIT_NO_SIGNAL, EXIT_OK, Failure, NoUsableSignal
    from station.settings import load_settings
    from station.words import no_result_words

    if jsonl and as_json:
        raise click.UsageError("--json and --jsonl exclude each other")
    settings = load_settings(config)
    choices = Choices(scale_factor, input_rate, relation)
    documents = []
    failures = []
    for path in paths:
        analyzed = analyze_path(path, choices, settings)
        document = analyzed.document()
        if not analyzed.evaluation.usable:
            sentence = f"{path}: {no_result_words(analyzed.evaluation)}"
            failures.append(Failure(NoUsableSignal.kind, sentence, EXIT_NO_SIGNAL))
            document["error"] = failures[-1].as_json()
        documents.append(document)
        if jsonl:
            for record in analyzed.record_documents():
                click.echo(json.dumps(record, allow_nan=False))
        elif not as_json:
            _print(analyzed, document)
    if as_json:
        print_json(documents[0] if len(documents) == 1 else {"results": documents})
    for failure in failures:
        print_failure(failure)
    return failures[0].exit_code if failures else EXIT_OK


def _print(analyzed: Analyzed, document: dict[str, object]) -> None:
    from station.console import print_harmonics, print_result

    click.echo(f"{analyzed.path}")
    if (harmonics := document.get("harmonics")) is not None:
        print_harmonics(harmonics)
    run = analyzed.run
    print_result(analyzed.evaluation, simulated=run is not None and run.facts["simulated"])
