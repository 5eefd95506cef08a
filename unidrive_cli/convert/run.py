"""Carries a plan out: units over workers, then finalise. The one call behind `unidrive convert`."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2

from unidrive_cli.convert.finalise import Failure, Summary, finalise, read_summary, write_run
from unidrive_cli.convert.plan import Plan, Unit
from unidrive_cli.convert.units import Frame, Job, Receipt, read_receipt, run_unit
from unidrive_cli.convert.verify import verify
from unidrive_cli.errors import CheckError, DatasetError, UnidriveError
from unidrive_cli.tables.destination import (
    Destination,
    abandon,
    begin,
    check_apart,
    check_destination,
    finish,
    held,
    resolved_destination,
    sweep,
)
from unidrive_cli.workers import in_workers

Progress = Callable[[int, int], None]
"""Called with (finished units, all units)."""


def convert(plan: Plan, destination_root: Path, *, force: bool = False, progress: Progress | None = None) -> Summary:
    """Converts a dataset as planned; the same call continues a conversion that was stopped.

    Args:
        destination_root: DST; must not exist, be empty, or hold this very conversion.
        force: replace a conversion with other options.
        progress: told after every unit.

    Returns:
        What was done. A DST that holds this very conversion, finished, is verified again and left as it
        is; samples that were left out of it are tried again.

    Raises:
        UsageError: DST inside SRC, or it holds a conversion with other options.
        OutputError: DST cannot be written or belongs to somebody else.
        PictureError, DatasetError: a source picture is broken (with `on_error` stop).
        CheckError: the verification failed, or no unit succeeded.
    """
    check_apart(plan.dataset.root, destination_root)
    root = resolved_destination(destination_root)
    same = check_destination(root, plan.identity, force=force)
    with held(root):
        if same and not force and Destination(root).finished:
            summary = read_summary(Destination(root))
            if not summary.failures:
                sweep(Destination(root), keep_work=False)
                summary.verified = verify(plan, root)
                return summary
        return _convert(plan, begin(root, plan.identity, same=same, force=force), progress)


def _convert(plan: Plan, destination: Destination, progress: Progress | None) -> Summary:
    started = time.monotonic()
    try:
        receipts, failures = _run_units(plan, destination, progress)
        rendered = time.monotonic()
        if not receipts:
            raise CheckError(f"not one sample could be converted; the first: {failures[0].sentence}")
        summary = finalise(plan, destination, receipts, failures)
    except BaseException:
        abandon(destination)
        raise
    summary.seconds = {
        "units": round(rendered - started, 3),
        "finalise": round(time.monotonic() - rendered, 3),
    }
    write_run(destination, summary)
    finish(destination, keep_work=bool(failures))
    return summary


def _run_units(
    plan: Plan, destination: Destination, progress: Progress | None
) -> tuple[dict[str, Receipt], list[Failure]]:
    receipts: dict[str, Receipt] = {}
    failures: list[Failure] = []
    todo: list[Unit] = []
    for unit in plan.units:
        receipt = read_receipt(destination, unit.sample.token, unit.pictures, plan.options.masks)
        if receipt is None:
            todo.append(unit)
        else:
            receipts[unit.sample.token] = receipt
    total = len(plan.units)
    if progress:
        progress(len(receipts), total)
    job = Job(destination, plan.rig, plan.options, plan.toolchain, plan.digest)
    for outcome in _outcomes(plan, job, todo):
        if isinstance(outcome, Failure):
            failures.append(outcome)
        else:
            receipts[outcome.sample_token] = outcome
        if progress:
            progress(len(receipts) + len(failures), total)
    failures.sort(key=lambda failure: failure.sample_token)
    return receipts, failures


def _outcomes(plan: Plan, job: Job, units: list[Unit]) -> Iterator[Receipt | Failure]:
    skip = plan.options.on_error == "skip"
    if plan.options.jobs == 0 or len(units) <= 1:
        for unit in units:
            yield _attempt(job, _frame(plan, unit, skip=skip), skip)
        return
    frames = (_frame(plan, unit, skip=skip) for unit in units)
    work = functools.partial(_attempt_in_worker, job, skip)
    yield from in_workers(work, frames, min(plan.options.jobs, len(units)))


def _frame(plan: Plan, unit: Unit, *, skip: bool) -> Frame | Failure:
    try:
        return plan.frame(unit)
    except UnidriveError as error:
        if not skip:
            raise
        return Failure(unit.sample.token, error.sentence)


def _attempt_in_worker(job: Job, skip: bool, frame: Frame | Failure) -> Receipt | Failure:
    cv2.setNumThreads(1)  # one process per core
    return _attempt(job, frame, skip)


def _attempt(job: Job, frame: Frame | Failure, skip: bool) -> Receipt | Failure:
    if isinstance(frame, Failure):
        return frame
    try:
        return run_unit(job, frame)
    except DatasetError as error:
        if not skip:
            raise
        return Failure(frame.sample_token, error.sentence)
