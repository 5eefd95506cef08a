"""`unidrive optimize-rig`."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from unidrive_cli.cli.progress import Progress
from unidrive_cli.cli.shared import (
    CONFIG,
    DEBUG,
    INTERRUPTED,
    JSON,
    guarded,
    jobs_of,
    option,
    plural,
    say_table,
)

if TYPE_CHECKING:
    from unidrive_cli.optimize.objective import Cost
    from unidrive_cli.optimize.run import Found
    from unidrive_cli.optimize.search import Best

SCHEMA_VERSION = 1


@guarded
def optimize_rig_command(
    sources: list[str] = typer.Argument(
        ..., metavar="SRC...", help="The cars: dataset folders, or rig files or shipped rigs with --boxes."
    ),
    search: Path = option(..., "--search", help="Search file: the start, what is free, what is bad."),
    out: Path = option(..., "--out", help="The rig file to write."),
    boxes: str | None = option(
        None, "--boxes", help="Dataset whose boxes stand in for those that a SRC lacks.", show_default=False
    ),
    max_boxes: int = option(10_000, "--max-boxes", help="Boxes per dataset, drawn at random where it has more."),
    seed: int = option(0, "--seed", help="Another seed, another course."),
    evaluations: int | None = option(
        None,
        "--evaluations",
        help="Candidates in all, the last generation whole (default: the search file's, or 4000).",
    ),
    resume: bool = option(False, "--resume", help="Continue the search whose log lies beside --out."),
    force: bool = option(False, "--force", help="Replace --out."),
    jobs: int | None = option(None, "--jobs", "-j", help="Candidates weighed at once (default: one per core)."),
    as_json: bool = JSON,
    config: Path | None = CONFIG,
    debug: bool = DEBUG,
) -> None:
    """Search for the virtual rig that is least wrong for several cars at once (CMA-ES)."""
    from unidrive_cli.optimize.cars import cars_of
    from unidrive_cli.optimize.run import log_of, optimise_rig
    from unidrive_cli.optimize.search_file import load_search
    from unidrive_cli.tables.rig_of_dataset import resolve_rig
    from unidrive_cli.warp.pictures import size_of_file

    plan = load_search(search, lambda name: resolve_rig(name, size_of_file=size_of_file)[0])
    effort = replace(
        plan.effort, seed=seed, evaluations=plan.effort.evaluations if evaluations is None else evaluations
    )
    cars, notes = cars_of(sources, boxes, max_boxes, size_of_file, common=plan.common)
    for note in notes:
        typer.echo(f"note: {note}", err=True)
    with Progress("candidates", sys.stderr) as progress:

        def told(best: Best, total: int) -> None:
            progress(min(best.evaluations, total), total, f"best {best.total:.4f}")

        found = optimise_rig(plan, cars, out, effort, jobs=jobs_of(jobs), resume=resume, force=force, told=told)
    if as_json:
        typer.echo(json.dumps({"schema_version": SCHEMA_VERSION, "rig": str(out), **_document(found, plan.common)}))
    else:
        _say(found, out, plan.common)
    if found.interrupted:
        typer.echo(f"interrupted: {out} is the best so far; --resume continues ({log_of(out)}).", err=True)
        raise typer.Exit(INTERRUPTED)


def _document(found: Found, common: bool) -> dict[str, Any]:
    return {
        "corners": "common" if common else "own",
        "evaluations": found.best.evaluations,
        "generations": found.best.generations,
        "restarts": found.best.restarts,
        "interrupted": found.interrupted,
        "depth_limit": found.rig.depth_limit_m,
        "start": _cost_document(found.start),
        "found": _cost_document(found.cost),
    }


def _cost_document(cost: Cost) -> dict[str, Any]:
    return {
        "objective": cost.total,
        "error": cost.error_m_rad,
        "uncovered": cost.uncovered,
        "not_common": cost.not_common,
        "worst": cost.worst.name,
        "penalties": asdict(cost.penalties),
        "by_rig": [{**asdict(rig), "total": rig.total(cost.penalties)} for rig in cost.rigs],
    }


def _say(found: Found, out: Path, common: bool) -> None:
    best, corners = found.best, "common corners" if common else "corners"
    typer.echo(
        f"{out}: {plural(best.evaluations, 'candidate')}, {plural(best.generations, 'generation')}, "
        f"{plural(best.restarts, 'restart')}"
    )
    header = (
        "car",
        *(cell for name in ("error", "uncovered", "unfilled", "cost", "bare sum") for cell in (name, "found")),
    )
    rows = []
    for start, now in zip(found.start.rigs, found.cost.rigs, strict=True):
        cells = zip(_cells(start, found.start), _cells(now, found.cost), strict=True)
        rows.append((start.name, *(cell for pair in cells for cell in pair)))
    say_table(header, rows, left=1)
    for name, before, after in (
        ("mean error, m rad", found.start.error_m_rad, found.cost.error_m_rad),
        (f"{corners} that no virtual camera sees", found.start.uncovered, found.cost.uncovered),
        ("pixels that some car cannot fill", found.start.not_common, found.cost.not_common),
        ("objective", found.start.total, found.cost.total),
    ):
        typer.echo(f"{name}: {before:.4f} -> {after:.4f}")
    typer.echo(f"depth limit: {found.rig.depth_limit_m:g} m")


def _cells(rig: Any, cost: Cost) -> tuple[str, ...]:
    return (
        f"{rig.error_m_rad:.4f}",
        f"{rig.uncovered:.2%}",
        f"{rig.unfilled:.1%}",
        f"{rig.total(cost.penalties):.4f}",
        f"{rig.pair_sum_m_rad:.0f}",
    )
