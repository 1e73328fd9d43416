"""``gyrolock study``: the paper's simulations beside the exact method."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from station.shell.options import config_option, json_option
from station.terminal.lines import print_json, say

if TYPE_CHECKING:
    from station.study.study import Study


@click.command("study")
@click.option(
    "--figure",
    "figures",
    type=click.IntRange(2, 6),
    multiple=True,
    metavar="N",
    help="Only this figure of the paper, 2 to 6; may be given several times.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Write plots, tables (CSV) and study.json there."
)
@click.option(
    "--format",
    "kind",
    type=click.Choice(["svg", "png", "pdf"]),
    default="svg",
    show_default=True,
    help="Of the plots.",
)
@config_option
@json_option
def command(figures: tuple[int, ...], out: Path | None, kind: str, config: Path | None, as_json: bool) -> int:
    """Compute the paper's simulations, its Figs. 2 to 6, with its method and with the exact one.

    Zhan et al., Acta Optica Sinica 29, 960 (2009): K = 2000 pulses per degree, 20 kHz, 3 s. Without --figure the
    bias of its formulas and the causes of its error are told as well. Nothing in a settings file changes this.
    """
    from station.display.opening import shown
    from station.settings.toml_files import read_toml
    from station.study.sentences import study_sentences
    from station.study.study import run_study, study_document

    if config is not None:
        read_toml(config)  # a file with a mistake is one here too
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    with shown({}, "study") as progress:
        study = run_study(figures, progress)
    sentences = study_sentences(study)
    files = _write(out, study, sentences, kind) if out is not None else []
    if as_json:
        print_json(study_document(study, sentences, files))
    else:
        _print(study, sentences, files)
    return 0


def _write(out: Path, study: Study, sentences: list[str], kind: str) -> list[str]:
    import json

    from station.results.as_json import plain
    from station.study.plots import write_study_plots
    from station.study.study import study_document
    from station.study.tables import study_tables

    files = [str(path) for path in write_study_plots(out, study, kind)]
    for table in study_tables(study):
        path = out / f"{table.name}.csv"
        path.write_text(table.as_csv(), encoding="utf-8")
        files.append(str(path))
    path = out / "study.json"
    document = study_document(study, sentences, [*files, str(path)])
    path.write_text(json.dumps(plain(document), indent=1, allow_nan=False), encoding="utf-8")
    return [*files, str(path)]


def _print(study: Study, sentences: list[str], files: list[str]) -> None:
    from station.report.console import text_table
    from station.results.parts import TextTable
    from station.study.tables import study_tables
    from station.terminal.console import stdout_console

    console = stdout_console()
    for table in study_tables(study):
        console.print(table.title, style="bold")
        console.print(text_table(TextTable(table.columns, tuple(map(tuple, table.texts())))))
        console.print()
    for sentence in sentences:
        console.print(f"• {sentence}")
    for file in files:
        say(f"wrote   {file}")
