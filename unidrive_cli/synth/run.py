"""Carries a synthetic drive out: batches over workers, then finalise. The one call behind `unidrive synth`."""

from __future__ import annotations

import contextlib
import hashlib
import json
import platform
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from unidrive_cli import __version__
from unidrive_cli.errors import CheckError, OutputError, RigError, UnidriveError
from unidrive_cli.rig.model import Rig
from unidrive_cli.synth.firing import CAMERA_SWEEPS, LIDAR_SWEEPS
from unidrive_cli.synth.options import RendererChoice, SynthOptions
from unidrive_cli.synth.records import INSTANCE_IDS, SPLITS, fixed_tables, scene_names, scene_tables
from unidrive_cli.synth.renderers import renderer_name
from unidrive_cli.synth.scene import inside_ego_car
from unidrive_cli.synth.units import Batch, Receipt, Target, read_receipt, run_batch
from unidrive_cli.tables.dataset import LIDAR_REFERENCE, Dataset, open_dataset
from unidrive_cli.tables.destination import (
    RUN,
    Destination,
    abandon,
    as_finished,
    begin,
    check_destination,
    check_space,
    finish,
    held,
    resolved_destination,
    sweep,
    writing,
)
from unidrive_cli.tables.devkit import check_devkit
from unidrive_cli.tables.schema import TABLES
from unidrive_cli.tables.table import write_rows
from unidrive_cli.warp.pictures import jpeg_bytes
from unidrive_cli.workers import in_workers

PROVENANCE = "synth.json"
METHOD = 4
"""Version of what the pictures and tables depend on; a change of results raises it."""
_BATCH = 20
_CLOUD_BYTES, _ROWS_BYTES = 690_000, 40_000
_DEPTH_BYTES_PER_PIXEL, _INSTANCE_BYTES_PER_PIXEL = 0.073, 0.0142
Progress = Callable[[int, int], None]
"""Called with (finished samples, all samples)."""


@dataclass(frozen=True, eq=False)
class SynthPlan:
    """What will be made.

    Attributes:
        options, rigs: of the user.
        renderer: `gl` or `rays`, already decided.
        renderer_name: what draws, for people and for the identity.
    """

    options: SynthOptions
    rigs: tuple[Rig, ...]
    renderer: RendererChoice
    renderer_name: str

    def identity(self, rig: Rig) -> dict[str, Any]:
        """What the dataset of one rig depends on; other rigs are no part of it."""
        return {
            "synth": {"method": METHOD, "version": __version__, "renderer": self.renderer_name},
            "rig": {"name": rig.name, "digest": rig.digest},
            "options": self.options.identity(),
            "codec": {"encode": f"opencv {cv2.__version__}"},
        }

    def estimated_bytes(self, rig: Rig, samples: int) -> int:
        """Disk that so many samples through a rig will take, roughly."""
        options = self.options
        pixels = sum(camera.lens.width_px * camera.lens.height_px for camera in rig.cameras)
        planes = int(
            pixels * (options.depth * _DEPTH_BYTES_PER_PIXEL + options.instances * _INSTANCE_BYTES_PER_PIXEL)
        )
        pictures = CAMERA_SWEEPS if options.sweeps else 1
        clouds = LIDAR_SWEEPS if options.sweeps else 1
        return samples * (
            pictures * jpeg_bytes(pixels, options.quality) + planes + clouds * _CLOUD_BYTES + _ROWS_BYTES
        )

    def place(self, root: Path, rig: Rig) -> Path:
        """Where a rig's dataset goes: DST itself, or a folder of the rig's name where there are several."""
        return root if len(self.rigs) == 1 else root / rig.name


@dataclass
class SynthSummary:
    """What was made, per rig.

    Attributes:
        folder: the dataset.
        already_complete: it had been made before; nothing was changed.
    """

    rig: str
    folder: str
    renderer: str
    scenes: int
    samples: int
    pictures: int
    annotations: int
    already_complete: bool


def make_synth_plan(options: SynthOptions, rigs: Sequence[Rig], renderer: RendererChoice) -> SynthPlan:
    """Plans a drive, and refuses what cannot be rendered before anything is written.

    Raises:
        RigError: a camera inside the ego car or below the ground, or two rigs of one name.
        UsageError: more scenes than there are names, or a renderer that cannot be had.
    """
    scene_names(options)
    names = [rig.name.lower() for rig in rigs]
    for rig in rigs:
        if names.count(rig.name.lower()) > 1:
            raise RigError("two rigs have this name (capitals apart), which names their folders.", where=rig.name)
        rig.check_folders([LIDAR_REFERENCE])
        if len(rigs) > 1 and (not rig.name.strip(".") or "/" in rig.name or "\0" in rig.name or len(rig.name) > 100):
            raise RigError("is no name for a folder; several rigs need names that are.", where=rig.name[:100])
        for camera in rig.cameras:
            where = f"{rig.name}, camera {camera.channel}"
            if camera.centre_ego[2] <= 0:
                raise RigError(
                    f"is {-camera.centre_ego[2]:g} m below the ground; it must stand above it.", where=where
                )
            if inside_ego_car(camera.centre_ego):
                raise RigError(
                    "is inside the ego car's body.",
                    where=where,
                    hint="The car is 4.1 m long and 1.7 m wide, its bonnet 0.95 m and its roof 1.45 m high.",
                )
    decided, name = renderer_name(renderer)
    return SynthPlan(options, tuple(rigs), decided, name)


def synthesise(
    plan: SynthPlan,
    root: Path,
    *,
    jobs: int = 0,
    force: bool = False,
    space_check: bool = True,
    progress: Progress | None = None,
) -> list[SynthSummary]:
    """Makes the datasets of a plan; the same call continues one that was stopped.

    Args:
        root: DST.
        jobs: worker processes; 0 works in this process.
        force: replace drives with other options.
        space_check: refuse to start where the estimate exceeds the free space.
        progress: told after every batch of samples.

    Raises:
        UsageError: DST holds a drive with other options.
        OutputError: DST cannot be written or belongs to somebody else.
        RigError: a camera is inside a building.
        CheckError: the verification failed.
    """
    root = resolved_destination(root)
    places = {rig.name: plan.place(root, rig) for rig in plan.rigs}
    same = {
        rig.name: check_destination(places[rig.name], plan.identity(rig), force=force, provenance=PROVENANCE)
        for rig in plan.rigs
    }
    started = time.monotonic()
    summaries = []
    with contextlib.ExitStack() as stack:
        targets = []
        for rig in plan.rigs:
            place = places[rig.name]
            stack.enter_context(held(place))
            destination = Destination(place, provenance=PROVENANCE)
            if same[rig.name] and not force and destination.finished:
                sweep(destination, keep_work=False)
                summaries.append(_finished_summary(destination))
                continue
            begun = begin(place, plan.identity(rig), same=same[rig.name], force=force, provenance=PROVENANCE)
            targets.append(Target(rig, begun))
        try:
            if targets:
                _run_batches(plan, targets, jobs, progress, space_check=space_check)
            for target in targets:
                summaries.append(_finalise(plan, target, time.monotonic() - started))
        except BaseException:
            for target in targets:
                abandon(target.destination)
            raise
    order = [rig.name for rig in plan.rigs]
    return sorted(summaries, key=lambda summary: order.index(summary.rig))


def _run_batches(
    plan: SynthPlan, targets: Sequence[Target], jobs: int, progress: Progress | None, *, space_check: bool
) -> None:
    options = plan.options
    total, done = options.scenes * options.keyframes, 0
    batches, needed_bytes = [], 0
    length = min(_BATCH, -(-total // max(jobs, 1)))
    for scene in range(options.scenes):
        missing = []
        for sample in range(options.keyframes):
            lacking = tuple(target for target in targets if read_receipt(target.destination, scene, sample) is None)
            if lacking:
                missing.append((sample, lacking))
                needed_bytes += sum(plan.estimated_bytes(target.rig, 1) for target in lacking)
            else:
                done += 1
        for first in range(0, len(missing), length):
            batches.append(Batch(options, plan.renderer, scene, tuple(missing[first : first + length])))
    if space_check:
        check_space(targets[0].destination, needed_bytes)
    if progress:
        progress(done, total)
    if jobs == 0 or len(batches) <= 1:
        for batch in batches:
            for _ in run_batch(batch):
                done += 1
                if progress:
                    progress(done, total)
        return
    for finished in in_workers(_whole_batch, batches, jobs):
        done += finished
        if progress:
            progress(done, total)


def _whole_batch(batch: Batch) -> int:
    cv2.setNumThreads(1)  # one process per core
    return sum(1 for _ in run_batch(batch))


def _finalise(plan: SynthPlan, target: Target, seconds: float) -> SynthSummary:
    """Turns receipts into a dataset: the tables come last, verified."""
    options, destination, rig = plan.options, target.destination, target.rig
    staged = destination.work / "tables"
    splits = scene_names(options)
    names = [name for split in splits.values() for name in split]
    with writing(destination):
        shutil.rmtree(staged, ignore_errors=True)
        staged.mkdir(parents=True)
        scenes = [
            scene_tables(options, rig, scene, names[scene], _receipts(plan, target, scene))
            for scene in range(options.scenes)
        ]
        fixed = fixed_tables(options, rig)
        for table in (*TABLES, *([INSTANCE_IDS] if options.instances else [])):
            write_rows(
                staged / f"{table}.json",
                (row for part in (fixed, *(scene.rows for scene in scenes)) for row in part.get(table, ())),
            )
        (staged / f"{SPLITS}.json").write_bytes(json.dumps(splits, indent=1).encode() + b"\n")
        annotations = sum(scene.annotations for scene in scenes)
        samples = options.scenes * options.keyframes
        with as_finished(destination, staged, options.version) as root:
            dataset = _verify(root, plan, samples, annotations)
        final = destination.root / options.version
        shutil.rmtree(final, ignore_errors=True)
        staged.rename(final)
        pictures = sum(row.fileformat == "jpg" for row in dataset.sample_data.rows)
        summary = SynthSummary(
            rig.name,
            str(destination.root),
            plan.renderer_name,
            options.scenes,
            samples,
            pictures,
            annotations,
            False,
        )
        destination.write(PROVENANCE, _provenance(plan, rig, summary))
        run = {
            "seconds": round(seconds, 3),
            "host": platform.node(),
            "platform": platform.platform(),
            "python": platform.python_version(),
            "numpy": np.__version__,
        }
        destination.write(RUN, _json(run))
    finish(destination, keep_work=False)
    return summary


def _receipts(plan: SynthPlan, target: Target, scene: int) -> list[Receipt]:
    receipts = []
    for sample in range(plan.options.keyframes):
        receipt = read_receipt(target.destination, scene, sample)
        if receipt is None:
            raise OutputError(
                f"files of sample {sample} of scene {scene} have gone while the drive was rendered.",
                where=str(target.destination.root),
                hint="Run the same command again.",
            )
        receipts.append(receipt)
    return receipts


def _verify(root: Path, plan: SynthPlan, samples: int, annotations: int) -> Dataset:
    """Reads the tables again, looks for every file, and lets nuscenes-devkit open the dataset.

    Raises:
        CheckError: something is wrong.
    """
    try:
        dataset = open_dataset(root, plan.options.version)
        for row in dataset.sample_data.rows:
            dataset.sensor_of(row)
            if not dataset.path_of(row).is_file():
                raise CheckError(f"{row.filename} was written and is not there.")
    except UnidriveError as error:
        raise CheckError(f"the drive that was written is broken: {error}") from error
    if len(dataset.sample.rows) != samples:
        raise CheckError(f"the drive that was written has {len(dataset.sample.rows)} samples, not {samples}.")
    check_devkit(root, plan.options.version, annotations)
    return dataset


def _provenance(plan: SynthPlan, rig: Rig, summary: SynthSummary) -> bytes:
    identity = plan.identity(rig)
    digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
    counts = {name: getattr(summary, name) for name in ("scenes", "samples", "pictures", "annotations")}
    return _json(
        {"schema_version": 1, "unidrive": __version__, "plan": identity, "plan_digest": digest, "counts": counts}
    )


def _finished_summary(destination: Destination) -> SynthSummary:
    path = destination.root / PROVENANCE
    try:
        document = json.loads(path.read_bytes())
        plan, counts = document["plan"], document["counts"]
        return SynthSummary(
            plan["rig"]["name"], str(destination.root), plan["synth"]["renderer"], **counts, already_complete=True
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OutputError("is not a provenance file of unidrive.", where=str(path), hint="Use --force.") from error


def _json(document: dict[str, Any]) -> bytes:
    return json.dumps(document, indent=1, sort_keys=True).encode() + b"\n"
