"""A whole search: from a search file and cars to a rig file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from unidrive_cli import __version__
from unidrive_cli.errors import OutputError, UsageError
from unidrive_cli.geometry.arrays import lengths
from unidrive_cli.optimize.objective import Car, Cost, Objective
from unidrive_cli.optimize.search import Best, Effort, Search, write_whole
from unidrive_cli.optimize.search_file import SearchFile
from unidrive_cli.rig.model import Rig
from unidrive_cli.rig.yaml_writing import dump_rig

METHOD = 1
"""Changes whenever the same search would take another course."""

Told = Callable[[Best, int], None]
"""Called after each generation with the best so far and the evaluations in all."""


@dataclass(frozen=True, eq=False)
class Found:
    """What a search has found.

    Attributes:
        rig: with its D0.
        best: how far the search went.
        cost, start: the objective of the rig, and of the start.
        interrupted: whether it was stopped before its end.
    """

    rig: Rig
    best: Best
    cost: Cost
    start: Cost
    interrupted: bool


def log_of(out: Path) -> Path:
    """Where the search that writes a rig file keeps its log."""
    return out.with_name(out.name + ".search.jsonl")


def optimise_rig(
    search_file: SearchFile,
    cars: Sequence[Car],
    out: Path,
    effort: Effort,
    *,
    jobs: int = 0,
    resume: bool = False,
    force: bool = False,
    told: Told | None = None,
) -> Found:
    """Searches, and writes the best rig to `out`; an interrupt ends the search with the best so far.

    Args:
        jobs: candidates evaluated at once; the result does not depend on it.
        resume: continue the search whose log lies beside `out`.
        force: replace `out` and its log.

    Raises:
        UsageError: bounds that hold rigs which cannot be, or a log of another search.
        OutputError: `out` or its log exists, or cannot be written.
    """
    for path in (out, log_of(out)):
        if path.exists() and not (force or resume):
            raise OutputError("exists.", where=str(path), hint="--resume continues its search, --force replaces it.")
    _check_bounds(search_file, cars)
    objective = Objective(cars, search_file.penalties, search_file.ground_height_m)
    search = Search(search_file.space, objective, effort, jobs)
    best, interrupted = None, False
    try:
        for best in search.run(log_of(out), resume=resume, identity=_identity(search_file, cars, effort)):
            if told:
                told(best, effort.evaluations)
    except KeyboardInterrupt:
        if best is None:
            raise
        interrupted = True
    assert best is not None  # the start comes first
    space = search_file.space
    values = best.values.tolist()
    rig = space.rig(values, search_file.name, search_file.description)
    found = Found(
        rig,
        best,
        objective(rig, space.depth_limit_m(values)),
        objective(space.rig(space.start_values.tolist()), space.start_depth_limit_m),
        interrupted,
    )
    write_whole(out, dump_rig(rig, _story(found, search_file, effort)))
    return found


def _check_bounds(search_file: SearchFile, cars: Sequence[Car]) -> None:
    """Refuses bounds with virtual cameras below the ground, or half-balls that do not hold all cameras."""
    low, high = search_file.space.reach_m()
    ground_m = search_file.ground_height_m
    if low[2] <= ground_m:
        raise UsageError(
            f"the bounds let a virtual camera stand at {low[2]:g} m; the ground is at {ground_m:g} m.",
            hint="Raise the lower bound of z.",
        )
    nearest_m = search_file.space.lowest_depth_limit_m
    for car in cars:
        for camera in car.rig.cameras:
            centre = camera.centre_ego
            if centre[2] <= ground_m:
                raise UsageError(f"{camera.channel} of {car.rig.name} stands below the ground at {ground_m:g} m.")
            apart_m = float(lengths(np.maximum(np.abs(centre - low), np.abs(centre - high))))
            if nearest_m <= max(apart_m, high[2] - ground_m):
                raise UsageError(
                    f"the bounds let the depth limit be {nearest_m:g} m, but a virtual camera may stand "
                    f"{apart_m:.3g} m from {camera.channel} of {car.rig.name} or {high[2] - ground_m:.3g} m high.",
                    hint="Raise the lower bound of depth_limit.",
                )


def _identity(search_file: SearchFile, cars: Sequence[Car], effort: Effort) -> str:
    """SHA-256 (hex) of all that the course of a search depends on, but for its length."""
    space = search_file.space
    document = [
        METHOD,
        space.start.digest,
        space.start_depth_limit_m,
        search_file.ground_height_m,
        [asdict(parameter) for parameter in space.parameters],
        dict(space.mirror),
        asdict(search_file.penalties),
        search_file.common,
        [effort.seed, effort.population],
        [[car.rig.digest, hashlib.sha256(car.points.round(6).tobytes()).hexdigest()] for car in cars],
    ]
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def _story(found: Found, search_file: SearchFile, effort: Effort) -> str:
    """How the rig was found, for the head of its file."""
    best, weights = found.best, search_file.penalties
    corners = "common corners" if search_file.common else "corners"
    lines = [
        f"Found by `unidrive optimize-rig` (unidrive {__version__}) from {search_file.space.start.name}: "
        f"seed {effort.seed}, {best.evaluations} candidates in {best.generations} generations, "
        f"{best.restarts} restarts{', interrupted' if found.interrupted else ''}.",
        f"Objective {found.start.total:.4f} -> {found.cost.total:.4f} m rad: mean error "
        f"{found.start.error_m_rad:.4f} -> {found.cost.error_m_rad:.4f}, {corners} uncovered "
        f"{found.start.uncovered:.2%} -> {found.cost.uncovered:.2%} (x {weights.uncovered:g}), pixels that some "
        f"car cannot fill {found.start.not_common:.2%} -> {found.cost.not_common:.2%} (x {weights.unfilled:g}), "
        f"worst car {found.start.worst.total(weights):.4f} -> {found.cost.worst.total(weights):.4f} "
        f"(x {weights.worst:g}).",
        "Cars: " + ", ".join(f"{car.name} ({car.corners} {corners})" for car in found.cost.rigs) + ".",
    ]
    return "\n".join(lines)
