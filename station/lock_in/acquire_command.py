"""``gyrolock acquire``: acquire and save only."""

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


@click.command("acquire")
@bench_options
@config_option
@json_option
def command(
    resource: str | None,
    records: int | None,
    channel: str | None,
    seed: int | None,
    out: Path | None,
    config: Path | None,
    as_json: bool,
) -> int:
    """Acquire and save records only; `gyrolock analyze` reads them later.

    The scope is set up as `gyrolock measure` does it. Ctrl-C keeps the records taken so far.
    """
    from station.errors import EXIT_OK
    from station.lock_in.take import take_run
    from station.runs.progress import Progress
    from station.runs.store import open_run
    from station.settings.load import load_settings

    simulated = load_settings(config, resource=resource).simulated
    chosen = overrides(records=records, channel=channel, seed=seed, out=out, simulated=simulated)
    settings = load_settings(config, resource=resource, overrides=chosen)
    taken = take_run(settings, Progress())
    saved = len(open_run(taken.path).taken_for("measure"))
    document: dict[str, object] = {"run": str(taken.path), "records": saved}
    if taken.failure is not None:
        document["error"] = taken.failure.as_json()
    if as_json:
        print_json(document)
    else:
        click.echo(f"saved   {saved} records in {taken.path}")
    if taken.failure is None:
        return EXIT_OK
    print_failure(taken.failure)
    return taken.failure.exit_code
