"""Carries a merge out. The calls behind `unidrive merge`."""

from __future__ import annotations

import json
import platform
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from unidrive_cli import __version__
from unidrive_cli.convert.links import carry
from unidrive_cli.convert.verify import Verified, verify_dataset
from unidrive_cli.errors import OutputError, PictureError
from unidrive_cli.merge.drives import parts_of
from unidrive_cli.merge.notes import failures_of, training_text
from unidrive_cli.merge.plan import MergePlan, Part
from unidrive_cli.merge.tables import MergedTables
from unidrive_cli.tables.converted import PROVENANCE, camera_mask_name, mask_name, refuse_unfinished
from unidrive_cli.tables.dataset import Dataset, open_dataset
from unidrive_cli.tables.destination import (
    FAILED,
    RUN,
    TRAINING,
    Destination,
    as_finished,
    begin,
    check_apart,
    check_destination,
    check_space,
    finish,
    held,
    resolved_destination,
    same_device,
    sweep,
    writing,
)
from unidrive_cli.tables.splits import SPLITS

Progress = Callable[[int, int], None]
"""Called with (files that are there, all files)."""
NAMES = "DST", "--out"
"""What the command calls a dataset and the merged one."""
_FILES_A_REPORT = 100
_KEPT = ("scenes", "samples", "pictures", "annotations", "boxes_2d", "files_missing", "notes")


@dataclass
class MergeSummary:
    """What merging did.

    Attributes:
        scenes, samples, pictures, annotations, boxes_2d: of the merged dataset.
        files_missing: files that the datasets themselves lack.
        notes: what a user should know.
        verified: what the final verification looked at.
        already_complete: DST held this very dataset, finished; nothing was done.
        seconds: what it took.
    """

    scenes: int
    samples: int
    pictures: int
    annotations: int
    boxes_2d: int
    files_missing: int
    notes: list[str]
    verified: Verified | None = None
    already_complete: bool = False
    seconds: dict[str, float] = field(default_factory=dict)


def merge(
    plan: MergePlan,
    destination_root: Path,
    *,
    force: bool = False,
    space_check: bool = True,
    progress: Progress | None = None,
) -> MergeSummary:
    """Makes one dataset of several, as planned; the same call continues what was stopped.

    Args:
        destination_root: DST; must not exist, be empty, or hold this very dataset.
        force: replace another dataset of ours.
        space_check: refuse a disk on which the pictures that must be copied have no room.

    Raises:
        UsageError: DST inside one of the datasets, or it holds another dataset of ours.
        OutputError: DST cannot be written or belongs to somebody else.
        DatasetError: a dataset has changed since it was planned.
        CheckError: the verification failed.
    """
    started = time.monotonic()
    for part in plan.parts:
        check_apart(part.source.root, destination_root, NAMES)
    root = resolved_destination(destination_root)
    same = check_destination(root, plan.identity, force=force)
    with held(root):
        if same and not force and Destination(root).finished:
            sweep(Destination(root), keep_work=False)
            summary = _read_summary(root)
            summary.verified = verify_dataset(root, plan.version, plan.digest, whole=plan.verify == "full")
            return summary
        if space_check and not same:
            check_space(Destination(root), _copied_bytes(plan, root))
        destination = begin(root, plan.identity, same=same, force=force)
        with writing(destination, "When that is mended, the same command continues."):
            summary = _merged(plan, destination, progress)
            summary.seconds = {"merge": round(time.monotonic() - started, 3)}
            run = {"seconds": summary.seconds, "host": platform.node(), "platform": platform.platform()}
            destination.write(RUN, _json(run | {"python": platform.python_version()}))
        finish(destination, keep_work=False)
    return summary


def _copied_bytes(plan: MergePlan, root: Path) -> int:
    """What the pictures take that cannot be linked."""
    return sum(
        part.source.made.picture_bytes
        for part in plan.parts
        if plan.link == "copy" or (plan.link == "hardlink" and not same_device(part.source.root, root))
    )


def _merged(plan: MergePlan, destination: Destination, progress: Progress | None) -> MergeSummary:
    """Files, then tables, verified before they are in their place."""
    staged = destination.work / "tables"
    shutil.rmtree(staged, ignore_errors=True)
    staged.mkdir(parents=True)
    carrier = _Carrier(plan, destination, progress)
    with MergedTables(plan, staged) as tables:
        for part in plan.parts:
            refuse_unfinished(part.source.root)
            dataset = open_dataset(part.source.root, part.version)
            carrier.carry_all(part, dataset)
            tables.add(part, dataset)
            del dataset  # before the next one is opened
    for name, path in plan.loose.items():
        shutil.copyfile(path, staged / f"{name}.json")
    if plan.splits:
        (staged / f"{SPLITS}.json").write_bytes(_json(plan.splits))
    _write_notes(plan, destination)
    notes = list(plan.notes)
    if carrier.missing:
        notes.append(f"{carrier.missing} files are missing in the datasets too, such as {carrier.example}.")
    summary = MergeSummary(
        sum(part.scenes for part in plan.parts),
        sum(part.samples for part in plan.parts),
        sum(part.pictures for part in plan.parts),
        tables.counts["sample_annotation"],
        tables.counts["image_annotations"],
        carrier.missing,
        notes,
    )
    with as_finished(destination, staged, plan.version) as root:
        summary.verified = verify_dataset(root, plan.version, plan.digest, whole=plan.verify == "full")
    final = destination.root / plan.version
    shutil.rmtree(final, ignore_errors=True)
    staged.rename(final)
    destination.write(PROVENANCE, _json(_provenance(plan, tables.counts, summary)))
    return summary


class _Carrier:
    """Brings the files of the datasets into DST."""

    def __init__(self, plan: MergePlan, destination: Destination, progress: Progress | None) -> None:
        self._plan = plan
        self._destination = destination
        self._progress = progress
        self._done = 0
        self._all = sum(part.files + len(part.carried) for part in plan.parts)
        if plan.masks == "frame":
            self._all += sum(part.pictures for part in plan.parts)
        self.missing = 0
        self.example = ""

    def carry_all(self, part: Part, dataset: Dataset) -> None:
        """Brings the files of one dataset.

        Raises:
            PictureError: a picture is missing.
        """
        root, maps = part.source.root, {row.filename for row in dataset.map.rows}
        for old, new, is_picture in self._files(part, dataset):
            if carry(root / old, new, self._destination, self._plan.link):
                pass
            elif is_picture:
                raise PictureError(
                    "the picture is missing.", where=str(root / old), hint="Convert the dataset again."
                )
            elif old not in maps:
                self.missing += 1
                self.example = self.example or old
            self._done += 1
            if self._progress and (self._done % _FILES_A_REPORT == 0 or self._done == self._all):
                self._progress(self._done, self._all)

    def _files(self, part: Part, dataset: Dataset) -> Iterator[tuple[str, str, bool]]:
        """(name, name in DST, whether it is a picture) of every file of a dataset."""
        yield from ((old, new, False) for old, new in part.carried)
        kind = part.source.made.options["masks"]
        if self._plan.masks == "camera":
            names = [camera_mask_name(channel) for channel in part.source.made.rig["cameras"]]
            yield from ((name, name, False) for name in names)
        for row, is_picture in zip(parts_of(dataset.sample_data), dataset.of_cameras.tolist(), strict=True):
            new = part.renaming.data_file(row.filename)
            yield row.filename, new, is_picture
            yield from ((name, part.renaming.data_file(name), False) for name in row.files[1:])
            if is_picture and self._plan.masks == "frame":
                mask = mask_name(row.filename)
                if kind == "camera":
                    mask = camera_mask_name(dataset.sensor_of_calibration[row.calibrated_sensor_token].channel)
                yield mask, mask_name(new), False


def _write_notes(plan: MergePlan, destination: Destination) -> None:
    destination.write(TRAINING, training_text(plan).encode())
    failures = "".join(f"{token}\t{scene}\t{reason}\n" for token, scene, reason in failures_of(plan))
    if failures:
        destination.write(FAILED, failures.encode(errors="backslashreplace"))
    else:
        (destination.root / FAILED).unlink(missing_ok=True)


def _provenance(plan: MergePlan, tables: dict[str, int], summary: MergeSummary) -> dict[str, Any]:
    made = [part.source.made for part in plan.parts]
    samples = [part.samples for part in plan.parts]
    counted = dict.fromkeys(name for one in made for name, value in one.counts.items() if isinstance(value, int))
    covered = {
        channel: round(sum(one.covered[channel] * n for one, n in zip(made, samples, strict=True)) / sum(samples), 4)
        for channel in made[0].covered
        if all(channel in one.covered for one in made)
    }
    return {
        "schema_version": 1,
        "unidrive": __version__,
        "plan": plan.identity,
        "plan_digest": plan.digest,
        "rig": made[0].rig,
        "merged": [{"plan_digest": leaf.plan_digest, "source_digest": leaf.source_digest} for leaf in _leaves(plan)],
        "datasets": [
            {
                "plan_digest": part.source.made.plan_digest,
                "tables_digest": part.tables_digest,
                "scenes": part.scenes,
                "samples": part.samples,
                "renamed_scenes": part.renaming.scenes,
                "new_tokens": sorted(part.renaming.moved),
                "suffix": part.renaming.suffix,
            }
            for part in plan.parts
        ],
        "counts": {name: sum(int(one.counts.get(name, 0)) for one in made) for name in counted} | {"tables": tables},
        "failures": [{"sample_token": token, "sentence": reason} for token, _, reason in failures_of(plan)],
        "covered": covered,
        "picture_bytes": sum(one.picture_bytes for one in made),
        **{name: value for name, value in asdict(summary).items() if name in _KEPT},
    }


def _leaves(plan: MergePlan) -> Iterator[Any]:
    for part in plan.parts:
        yield from part.source.made.leaves


def _read_summary(root: Path) -> MergeSummary:
    path = root / PROVENANCE
    try:
        document = json.loads(path.read_bytes())
        return MergeSummary(**{name: document[name] for name in _KEPT}, already_complete=True)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OutputError("is not a provenance file of unidrive.", where=str(path), hint="Use --force.") from error


def _json(document: dict[str, Any]) -> bytes:
    return (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode()
