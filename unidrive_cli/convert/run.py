"""Carries a plan out: units over workers, then finalise. The calls behind `unidrive convert` and `finalise`."""

from __future__ import annotations

import contextlib
import functools
import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2

from unidrive_cli.convert.finalise import Failure, Summary, finalise, read_summary, relative, write_run
from unidrive_cli.convert.links import check_names_apart
from unidrive_cli.convert.options import Options
from unidrive_cli.convert.parts import Part
from unidrive_cli.convert.plan import Moment, Plan
from unidrive_cli.convert.sweeps import Sweep
from unidrive_cli.convert.units import Frame, Job, Receipt, check_machine, read_receipt, receipt_name, run_unit
from unidrive_cli.convert.verify import verify
from unidrive_cli.errors import CheckError, DatasetError, UnidriveError, UsageError
from unidrive_cli.tables.converted import WORK, mask_name
from unidrive_cli.tables.destination import (
    RECEIPTS,
    Destination,
    abandon,
    begin,
    check_apart,
    check_destination,
    check_space,
    finish,
    held,
    join,
    resolved_destination,
    sweep,
    to_disk,
)
from unidrive_cli.workers import in_workers, start_server

Progress = Callable[[int, int], None]
"""Called with (finished units, all units)."""
Work = Callable[[Frame | Failure], Receipt | Failure]
Executor = Callable[[Work, Sequence[Moment], Iterable[Frame | Failure]], Iterator[Receipt | Failure]]
FAILURES = "failures"
"""Below the work folder: what could not be converted, for `finalise` and for another try."""
_PARTS_HINT = "Run the parts that have not ended (or `unidrive convert` without --part), then finalise."
_ONLY_FAILED_HINT = "The same command without --only-failed converts them."


@dataclass(frozen=True)
class PartSummary:
    """What was done of a conversion's share.

    Attributes:
        part: `i/n`.
        samples: how many samples, and sweeps, the share has.
        failures: units of it that were left out.
        left: samples, and sweeps, of the whole conversion that are not converted yet.
        already_complete: DST is finished; nothing was done.
    """

    part: str
    samples: int
    failures: list[Failure]
    left: int
    already_complete: bool = False


def prepare_workers(options: Options) -> None:
    """Lets what workers need be loaded beside the planning."""
    if options.jobs and options.backend == "processes":
        start_server([*(["unidrive_cli.warp.prepared"] if options.kernel != "opencv" else []), __name__])


def convert(
    plan: Plan,
    destination_root: Path,
    *,
    force: bool = False,
    only_failed: bool = False,
    progress: Progress | None = None,
) -> Summary:
    """Converts a dataset as planned; the same call continues a conversion that was stopped.

    Args:
        destination_root: DST; must not exist, be empty, or hold this very conversion.
        force: replace a conversion with other options.
        only_failed: try the samples again that failed in DST, and no others.
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
    started = time.monotonic()
    root, same = _checked(plan, destination_root, force=force)
    if only_failed and not same:
        raise UsageError(f"{root} holds no conversion of which samples could have failed.")
    executor = _executor(plan)
    with held(root):
        if same and not force and Destination(root).finished:
            summary = read_summary(Destination(root))
            if not summary.failures:
                return _verified_again(plan, root, summary)
        destination = begin(root, plan.identity, same=same, force=force)
        try:
            if only_failed:
                failed = [unit for unit in plan.moments if _recorded(destination, unit)]
                _run_units(plan, failed, destination, executor, progress)
                return _finalised_as_recorded(plan, destination, started, _ONLY_FAILED_HINT)
            receipts, failures = _run_units(plan, plan.moments, destination, executor, progress)
            return _finalised(plan, destination, receipts, failures, time.monotonic() - started)
        except BaseException:
            abandon(destination)
            raise


def convert_part(plan: Plan, destination_root: Path, part: Part, *, progress: Progress | None = None) -> PartSummary:
    """Converts a share of the units and does not finalise; other parts may do the same, on other machines.

    Args:
        destination_root: DST; must not exist, be empty, or hold this very conversion.
        progress: told after every unit, about the share.

    Raises:
        UsageError, OutputError, PictureError, DatasetError: as `convert`.
    """
    root, same = _checked(plan, destination_root, force=False)
    executor = _executor(plan)
    units = part.of(plan.moments)
    with held(root, shared=True):
        if same and Destination(root).finished and not read_summary(Destination(root)).failures:
            return PartSummary(str(part), len(units), [], 0, already_complete=True)
        destination = join(root, plan.identity)
        _, failures = _run_units(plan, units, destination, executor, progress)
        to_disk(root)
        done = {path.name for path in (destination.work / RECEIPTS).glob("*.json")}
        left = sum(Path(receipt_name(unit.token)).name not in done for unit in plan.moments)
        return PartSummary(str(part), len(units), failures, left)


def finalise_parts(plan: Plan, destination_root: Path) -> Summary:
    """Turns a DST whose parts are all done into a dataset.

    Returns:
        What was done. A DST that is finished already is verified again and left as it is.

    Raises:
        UsageError: DST holds nothing to finalise, or a conversion with other options.
        OutputError: DST cannot be written, belongs to somebody else, or parts are at work there.
        CheckError: samples are not converted yet, or the verification failed.
    """
    started = time.monotonic()
    root, same = _checked(plan, destination_root, force=False)
    if not same:
        raise UsageError(
            f"{root} holds no conversion that could be finalised.", hint="`unidrive convert` makes one."
        )
    with held(root):
        if Destination(root).finished:
            return _verified_again(plan, root, read_summary(Destination(root)))
        destination = begin(root, plan.identity, same=True, force=False)
        return _finalised_as_recorded(plan, destination, started, _PARTS_HINT)


def _checked(plan: Plan, destination_root: Path, *, force: bool) -> tuple[Path, bool]:
    """DST resolved, and whether it already holds this very conversion, whole or in part."""
    check_apart(plan.dataset.root, destination_root)
    root = resolved_destination(destination_root)
    return root, check_destination(root, plan.identity, force=force)


def _verified_again(plan: Plan, root: Path, summary: Summary) -> Summary:
    sweep(Destination(root), keep_work=bool(summary.failures))
    summary.verified = verify(plan, root)
    return summary


def _finalised_as_recorded(plan: Plan, destination: Destination, started: float, hint: str) -> Summary:
    """Finalises what receipts and records of failures say; refuses where a sample has neither.

    Args:
        started: on the monotonic clock.
        hint: what to do where samples were not tried yet.
    """
    receipts, missing = _receipts(plan, plan.moments, destination)
    failures = [failure for unit in missing if (failure := _recorded(destination, unit))]
    if missing and (len(failures) < len(missing) or plan.options.on_error == "stop"):
        raise _missing_error(destination.root, missing, failures, hint)
    return _finalised(plan, destination, receipts, failures, time.monotonic() - started)


def _finalised(
    plan: Plan, destination: Destination, receipts: dict[str, Receipt], failures: list[Failure], seconds: float
) -> Summary:
    started = time.monotonic()
    if not any(unit.token in receipts for unit in plan.units):
        raise CheckError(f"not one sample could be converted; the first: {failures[0].sentence}")
    failures = [*failures, *_orphans(plan, destination, receipts)]
    summary = finalise(plan, destination, receipts, failures)
    summary.seconds = {"units": round(seconds, 3), "finalise": round(time.monotonic() - started, 3)}
    write_run(destination, summary)
    finish(destination, keep_work=bool(failures))
    return summary


def _orphans(plan: Plan, destination: Destination, receipts: dict[str, Receipt]) -> list[Failure]:
    """Leaves out, with their files, the sweeps whose sample is left out; takes them out of the receipts."""
    failures = []
    for moment in plan.sweeps:
        if moment.token in receipts and moment.sample.token not in receipts:
            del receipts[moment.token]
            for name in moment.pictures:
                (destination.root / name).unlink(missing_ok=True)
                (destination.root / mask_name(name)).unlink(missing_ok=True)
            failures.append(_record(destination, Failure(moment.token, "its sample is left out.")))
    return failures


def _failure_name(token: str) -> str:
    return f"{WORK}/{FAILURES}/{Path(receipt_name(token)).name}"


def _record(destination: Destination, failure: Failure) -> Failure:
    destination.write(_failure_name(failure.sample_token), json.dumps(asdict(failure)).encode())
    return failure


def _recorded(destination: Destination, unit: Moment) -> Failure | None:
    with contextlib.suppress(OSError, ValueError, TypeError):
        record = (destination.root / _failure_name(unit.token)).read_bytes()
        return Failure(**json.loads(record))
    return None


def _missing_error(root: Path, missing: Sequence[Moment], failures: Sequence[Failure], hint: str) -> CheckError:
    first = ", ".join(f"{unit.token} of {unit.scene.name}" for unit in missing[:3])
    more = ", ..." if len(missing) > 3 else ""
    if len(failures) == len(missing):
        hint = f"All of them failed ({failures[0].sentence}); --on-error skip leaves them out."
    noun = "moment" if any(isinstance(unit, Sweep) for unit in missing) else "sample"
    samples = f"1 {noun} is" if len(missing) == 1 else f"{len(missing)} {noun}s are"
    return CheckError(f"{samples} not converted yet: {first}{more}.", where=str(root), hint=hint)


def _receipts(
    plan: Plan, units: Sequence[Moment], destination: Destination
) -> tuple[dict[str, Receipt], list[Moment]]:
    """The receipts of the units that are done, by token, and the units that are not."""
    receipts: dict[str, Receipt] = {}
    missing: list[Moment] = []
    for unit in units:
        receipt = read_receipt(destination, unit.token, unit.pictures, plan.options.masks)
        if receipt is None:
            missing.append(unit)
        else:
            receipts[unit.token] = receipt
    return receipts, missing


def _run_units(
    plan: Plan, units: Sequence[Moment], destination: Destination, executor: Executor, progress: Progress | None
) -> tuple[dict[str, Receipt], list[Failure]]:
    receipts, missing = _receipts(plan, units, destination)
    failures: list[Failure] = []
    if progress:
        progress(len(receipts), len(units))
    if missing:
        check_names_apart(plan.dataset, destination)
        if plan.options.space_check:
            check_space(destination, plan.estimated_bytes(len(missing)))
    common = plan.common_masks if missing else None
    job = Job(destination, plan.rig, plan.options, plan.toolchain, plan.digest, common)
    skip = plan.options.on_error == "skip"
    work = functools.partial(_attempt, job, plan.dataset.folder, skip)
    frames = (_frame(plan, unit, skip=skip) for unit in missing)
    for outcome in executor(work, missing, frames) if missing else ():
        if isinstance(outcome, Failure):
            failures.append(_record(destination, replace(outcome, sentence=relative(plan, outcome.sentence))))
        else:
            receipts[outcome.token] = outcome
            (destination.root / _failure_name(outcome.token)).unlink(missing_ok=True)
        if progress:
            progress(len(receipts) + len(failures), len(units))
    failures.sort(key=lambda failure: failure.sample_token)
    return receipts, failures


def _executor(plan: Plan) -> Executor:
    """What carries the units out.

    Raises:
        UsageError: a cluster is asked for, and the extra for it is not installed or SRC is a relative path.
    """
    options = plan.options
    if options.backend == "dask":
        if not plan.dataset.root.is_absolute():
            raise UsageError(f"with --backend dask SRC must be an absolute path, got {plan.dataset.root}.")
        try:
            from unidrive_cli.cluster import in_cluster
        except ImportError as error:
            raise UsageError(
                f"--backend dask needs a package that is not installed ({error}).",
                hint="pip install 'unidrive[dask]'",
            ) from error
        return lambda work, units, frames: in_cluster(functools.partial(_in_worker, work), frames, options.scheduler)

    def here(work: Work, units: Sequence[Moment], frames: Iterable[Frame | Failure]) -> Iterator[Receipt | Failure]:
        if options.jobs == 0 or len(units) == 1:
            return map(work, frames)
        return in_workers(functools.partial(_in_worker, work), frames, min(options.jobs, len(units)))

    return here


def _frame(plan: Plan, unit: Moment, *, skip: bool) -> Frame | Failure:
    try:
        return plan.frame(unit)
    except UnidriveError as error:
        if not skip:
            raise
        return Failure(unit.token, error.sentence)


def _in_worker(work: Work, frame: Frame | Failure) -> Receipt | Failure:
    cv2.setNumThreads(1)  # one process per core
    return work(frame)


def _attempt(job: Job, source: Path, skip: bool, frame: Frame | Failure) -> Receipt | Failure:
    if isinstance(frame, Failure):
        return frame
    check_machine(job, source)
    try:
        return run_unit(job, frame)
    except DatasetError as error:
        if not skip:
            raise
        return Failure(frame.token, error.sentence)
