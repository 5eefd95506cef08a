"""`unidrive validate`."""

from __future__ import annotations

import json
import sys
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from unidrive_cli.cli.progress import Progress
from unidrive_cli.cli.shared import (
    CONFIG,
    DEBUG,
    JSON,
    LAYOUT,
    VERSION,
    guarded,
    jobs_of,
    option,
    plural,
    say_layout,
)

if TYPE_CHECKING:
    from unidrive_cli.check.validation import Validation

SHOWN_FINDINGS = 5
"""So many findings of a rule are shown as text."""


def _rules(wanted: bool) -> None:
    if wanted:
        from unidrive_cli.check.rules import rules_page

        typer.echo(rules_page(), nl=False)
        raise typer.Exit


@guarded
def validate_command(
    dataset: Path = typer.Argument(..., metavar="DATASET", readable=False, help="The folder that holds v1.0-*."),
    version: str | None = VERSION,
    layout: str | None = LAYOUT,
    fix: bool = option(
        False, "--fix", help="Mend what is safe: lists, counts and ends. The old tables are kept beside (.bak)."
    ),
    rules: bool = typer.Option(False, "--rules", callback=_rules, is_eager=True, help="Print the rules, and stop."),
    jobs: int | None = option(None, "--jobs", "-j", help="Files looked at together (default: one per core)."),
    as_json: bool = JSON,
    config: Path | None = CONFIG,
    debug: bool = DEBUG,
) -> None:
    """Look whether a dataset keeps the rules that its readers rely on; it is changed with --fix alone.

    Ends with 0 where nothing was found, 1 where something was, 3 where nothing can be read.
    """
    from unidrive_cli.check.mending import mend
    from unidrive_cli.check.validation import find_subject, validate
    from unidrive_cli.warp.pictures import picture_size

    workers = jobs_of(jobs)
    subject = find_subject(dataset, version, picture_size, workers, layout)
    say_layout(subject.layout, subject.folder, layout)
    with Progress("rules", sys.stderr) as progress:
        found = validate(subject, progress)
    if fix and found.fixable:
        fixed = mend(find_subject(dataset, version, picture_size, layout=layout))
        with Progress("rules", sys.stderr) as progress:
            found = validate(find_subject(dataset, version, picture_size, workers, layout), progress)
        found.fixed = fixed
    if as_json:
        typer.echo(json.dumps(found.document()))
    else:
        _say(found)
    if found.total:
        raise typer.Exit(1)


def _say(found: Validation) -> None:
    for table, count in found.fixed.items():
        typer.echo(f"fixed {plural(count, 'row')} of {table}.json; the table as it was is beside it (.bak)")
    for rule, findings in groupby(found.findings, key=lambda finding: finding.rule):
        shown = list(findings)
        count = found.counts[rule]
        typer.echo(f"{rule} {shown[0].severity}: {plural(count, 'finding')}")
        for finding in shown[:SHOWN_FINDINGS]:
            typer.echo(f"  {finding.where}: {finding.what}")
        if count > SHOWN_FINDINGS:
            typer.echo(f"  and {count - SHOWN_FINDINGS:,} more")
    looked = f"{plural(len(found.counts), 'rule')} looked at"
    if found.not_checked:
        looked += f"; not {', '.join(found.not_checked)}, because of what was found"
    devkit = "opened with nuscenes-devkit" if found.opened_with_devkit else "not opened with nuscenes-devkit"
    typer.echo(f"{found.root} ({found.version}): {plural(found.total, 'finding')}; {looked}; {devkit}")
