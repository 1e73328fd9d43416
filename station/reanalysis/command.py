"""``gyrolock compare``: two analyses, or two gyros."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from station.shell.options import config_option, json_option, positive
from station.terminal.lines import print_json, remark, say


@click.command("compare")
@click.argument("first", metavar="A")
@click.argument("second", metavar="B")
@click.option("--a", "part_a", default="", metavar="TEXT", help="Of a table with several analyses: this one.")
@click.option("--b", "part_b", default="", metavar="TEXT", help="The same for B.")
@click.option("--relation-a", type=click.Choice(["exact", "paper-13", "paper-10"]), help="For records of A.")
@click.option("--relation-b", type=click.Choice(["exact", "paper-13", "paper-10"]), help="For records of B.")
@click.option(
    "--scale-factor", type=float, callback=positive, metavar="K", help="Pulses per degree; a run knows its own."
)
@click.option(
    "--plot", type=click.Path(path_type=Path), metavar="FILE", help="Draw the differences: .svg, .png or .pdf."
)
@click.option(
    "--processes", type=click.IntRange(1, 256), default=1, show_default=True, help="Processes that share the work."
)
@config_option
@json_option
def command(first: str, second: str, config: Path | None, as_json: bool, **given: Any) -> int:
    """Compare two analyses of the same records, or records of two gyros.

    A and B are results tables of `gyrolock analyze --to`, or runs, files and folders, which are then analysed.
    Where records are in both, they are compared one by one, in the uncertainties of their noise, which is all that
    two methods can differ by. Else the results are, every input counted: those of runs, and of files at one rate.
    Results tables know the noise of records only, and are compared by their means. With --config the scale factor
    of files is that of FILE.
    """
    from station.reanalysis.compare import compare, read_records, with_headlines
    from station.report.console import text_table
    from station.sources.workers import Processes
    from station.terminal.console import stdout_console

    factor = given["scale_factor"]
    if factor is None and config is not None:
        from station.reanalysis.files import scale_factor_of_files

        factor = scale_factor_of_files(config)
    with Processes(given["processes"]) as workers:
        a, b = (
            read_records(place, {"scale_factor": factor, "relation": given[relation]}, workers, given[part])
            for place, relation, part in ((first, "relation_a", "part_a"), (second, "relation_b", "part_b"))
        )
        a, b = with_headlines(a, b, workers)
    for one in (*a.left_out, *b.left_out):
        remark(f"left out: {one}")
    found = compare(a, b)
    if given["plot"] is not None:
        from station.reanalysis.compare_plot import write_comparison_plot

        write_comparison_plot(given["plot"], found)
    if as_json:
        print_json(found.document())
        return 0
    for name, side in (("A", a), ("B", b)):
        say(f"{name}   {side.name}: {len(side.keys)} records; {'; '.join(side.analyses)}")
    stdout_console().print(text_table(found.table(), left=1))
    for sentence in found.sentences():
        say(sentence)
    return 0
