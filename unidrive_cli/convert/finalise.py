"""The end of a conversion: files that go along, tables, verification, provenance."""

from __future__ import annotations

import json
import platform
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np

from unidrive_cli import __version__
from unidrive_cli.convert.links import carried_files, carry
from unidrive_cli.convert.output_tables import Counts, OutputTables
from unidrive_cli.convert.own_cars import own_car_of
from unidrive_cli.convert.plan import Plan, scene_names
from unidrive_cli.convert.sweeps import SWEEP
from unidrive_cli.convert.training_notes import training_notes
from unidrive_cli.convert.units import Receipt
from unidrive_cli.convert.verify import Verified, verify_staged
from unidrive_cli.errors import DatasetError, OutputError
from unidrive_cli.geometry.arrays import Bool
from unidrive_cli.geometry.poses import inverse, quaternion_from_rotation
from unidrive_cli.rig.model import Camera
from unidrive_cli.tables.converted import PROVENANCE, camera_mask_name
from unidrive_cli.tables.destination import FAILED, RUN, TRAINING, Destination, writing
from unidrive_cli.tables.devkit import LABELS, labels_refused
from unidrive_cli.tables.splits import SPLITS, findable, own_splits, trimmed
from unidrive_cli.tables.table import RawRows, write_rows
from unidrive_cli.warp.common import blanks_of
from unidrive_cli.warp.pictures import encode_mask
from unidrive_cli.warp.reduction import Reductions
from unidrive_cli.warp.remap import Source, build_patches, coverage, virtual_views

LOW_COVERAGE = 0.01
_KEPT = ("covered", "picture_bytes", "files_carried", "files_missing", "notes")


@dataclass(frozen=True)
class Failure:
    """A unit that was left out, and why; a sweep is known by its own token in place of the sample's."""

    sample_token: str
    sentence: str

    @property
    def unit(self) -> str:
        """The unit in words."""
        return self.sample_token if self.sample_token.startswith(SWEEP) else f"sample {self.sample_token}"


@dataclass
class Summary:
    """What a conversion did.

    Attributes:
        counts: rows and boxes of the output.
        covered: mean share of covered pixels per virtual camera, in the samples.
        picture_bytes: size of all pictures together.
        files_carried, files_missing: files that go along; files that the source itself lacks.
        failures: units left out.
        notes: what a user should know.
        verified: what the final verification looked at.
        already_complete: DST held this very conversion, finished; nothing was done.
        seconds: by stage.
    """

    counts: Counts
    covered: dict[str, float]
    picture_bytes: int
    files_carried: int
    files_missing: int
    failures: list[Failure]
    notes: list[str]
    verified: Verified | None = None
    already_complete: bool = False
    seconds: dict[str, float] = field(default_factory=dict)


def finalise(plan: Plan, destination: Destination, receipts: dict[str, Receipt], failures: list[Failure]) -> Summary:
    """Turns finished units into a dataset: nothing looks whole before everything is verified.

    Raises:
        OutputError: DST cannot be written.
        CheckError: the verification found something wrong; DST keeps its marker.
    """
    tables = OutputTables(plan, receipts)
    notes: list[str] = []
    staged = destination.work / "tables"
    with writing(destination):
        shutil.rmtree(staged, ignore_errors=True)
        staged.mkdir(parents=True)
        tables.write(_writer(staged))
        extra_files = _extra_tables(plan, tables, staged, notes)
        _splits(plan, scene_names(unit for unit in plan.units if unit.sample.token in receipts), staged, notes)
        carried, missing = _carry_files(plan, destination, tables, extra_files, notes)
        _map_pictures(plan, destination, notes)
        if plan.options.masks == "camera":
            _camera_masks(plan, destination)
        summary = _summary(plan, receipts, tables.counts, carried, missing, failures, notes)
        destination.write(TRAINING, training_notes(plan).encode())
        _list_failures(plan, destination, summary.failures)
        summary.verified = verify_staged(plan, destination, staged)
        final = destination.root / plan.version
        shutil.rmtree(final, ignore_errors=True)
        staged.rename(final)
        destination.write(PROVENANCE, _provenance(plan, summary))
    return summary


def read_summary(destination: Destination) -> Summary:
    """The summary of a finished destination, from its provenance file.

    Raises:
        OutputError: the file is not ours or was changed.
    """
    path = destination.root / PROVENANCE
    try:
        document = json.loads(path.read_bytes())
        kept = {name: document[name] for name in _KEPT}
        counts = Counts(**document["counts"])
        failures = [Failure(**failure) for failure in document["failures"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OutputError("is not a provenance file of unidrive.", where=str(path), hint="Use --force.") from error
    return Summary(counts=counts, failures=failures, already_complete=True, **kept)


def relative(plan: Plan, sentence: str) -> str:
    """The same words wherever the source lies."""
    return sentence.replace(f"{plan.dataset.root}/", "")


def write_run(destination: Destination, summary: Summary) -> None:
    """Writes `run.json`, the one file that may differ between two runs."""
    run = {
        "seconds": summary.seconds,
        "host": platform.node(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }
    destination.write(RUN, _json(run))


def _writer(folder: Path) -> Callable[[str, RawRows], int]:
    return lambda name, rows: write_rows(folder / f"{name}.json", rows)


def _extra_tables(plan: Plan, tables: OutputTables, folder: Path, notes: list[str]) -> list[str]:
    """Writes the extra tables; returns the files that their rows name."""
    files: list[str] = []
    for name, kept in tables.extra_tables():
        if name == SPLITS:
            continue
        source = plan.dataset.extra_tables[name]
        target = folder / source.path.name
        if name in LABELS and (why := labels_refused(plan.dataset.category)):
            target = folder / f"source_{name}.json"
            notes.append(
                f"{name}.json goes along as {target.name}: nuscenes-devkit would stop at it, because {why}."
            )
        left = len(source.rows or []) - len(kept)
        named = [source.filename(row) for row in kept]
        moved = [{"filename": plan.names[name]} if name and plan.names[name] != name else {} for name in named]
        if left or any(moved):
            rows = ({**row, **change} for row, change in zip(kept, moved, strict=True))
            write_rows(target, (json.dumps(row).encode() for row in rows))
        else:
            shutil.copyfile(source.path, target)
        if left:
            notes.append(
                f"{source.path.name}: {left} rows belong to pictures or samples that are gone, and left with them."
            )
        files.extend(filter(None, named))
    return files


def _splits(plan: Plan, scenes: tuple[str, ...], folder: Path, notes: list[str]) -> None:
    """Writes `splits.json` where the source has one, or the devkit would not find the scenes without it."""
    target, source = folder / f"{SPLITS}.json", plan.dataset.folder / f"{SPLITS}.json"
    try:
        splits = own_splits(plan.dataset)
    except DatasetError as error:
        notes.append(f"{error.sentence} It goes along as it is.")
        shutil.copyfile(source, target)
        return
    written = findable(trimmed(splits, scenes), scenes)
    if written and written == splits:
        shutil.copyfile(source, target)
    elif written:
        target.write_bytes(_json(written))


def _carry_files(
    plan: Plan, destination: Destination, tables: OutputTables, extra_files: list[str], notes: list[str]
) -> tuple[int, int]:
    carried = missing = 0
    example = ""
    maps = {row.filename for row in plan.dataset.map.rows}
    examples = [*plan.units[0].pictures, *(name for sweep in plan.sweeps[:1] for name in sweep.pictures)]
    folders = {name.rpartition("/")[0] for name in examples}
    pictures: set[str] = set()
    for filename in carried_files(plan.dataset, tables.kept_sample_data, extra_files):
        target = plan.names[filename]
        if target.rpartition("/")[0] in folders:
            pictures = pictures or {name for unit in plan.moments for name in unit.pictures}
            if target in pictures:
                continue  # an extra table names a picture in whose place a virtual one is
        if carry(plan.dataset.root / filename, target, destination, plan.options.link):
            carried += 1
        elif filename not in maps:
            missing += 1
            example = example or filename
    if missing:
        notes.append(f"{missing} files of other sensors or tables are missing in the source too, such as {example}.")
    return carried, missing


def _map_pictures(plan: Plan, destination: Destination, notes: list[str]) -> None:
    """nuscenes-devkit refuses a dataset whose map picture is missing: an empty one takes its place."""
    for row in plan.dataset.map.rows:
        if row.filename and not (plan.dataset.root / row.filename).exists():
            is_picture = PurePosixPath(row.filename).suffix.lower() in (".png", ".jpg", ".jpeg")
            empty = encode_mask(np.zeros((10, 10), dtype=np.uint8)) if is_picture else b"\n"
            destination.write(row.filename, empty)
            what = "map picture" if is_picture else "map"
            notes.append(f"The {what} {row.filename} is missing in the source; an empty one was written.")


def _camera_masks(plan: Plan, destination: Destination) -> None:
    """Static coverage: the source's most frequent rig, all cameras at one moment."""
    options = plan.options
    chosen = [
        camera for camera in plan.source_rig.cameras if not options.cameras or camera.channel in options.cameras
    ]
    sources = [
        Source(
            camera.lens,
            inverse(camera.ego_from_cam),
            own_car=own_car_of(plan.own_cars, camera.channel, (camera.lens.width_px, camera.lens.height_px)),
        )
        for camera in chosen
    ]
    views = virtual_views(plan.rig, options.depth_limit_m, options.ground_height_m)
    reductions = Reductions(views, anti_alias=options.anti_alias).of(sources)
    for view, blanks, of_view in zip(views, blanks_of(plan.common_masks, len(views)), reductions, strict=True):
        mask = coverage(view, build_patches(view, sources, options.blend, of_view))
        if blanks:
            blanks.cover(mask)
        destination.write(camera_mask_name(view.camera.channel), encode_mask(mask))


def _summary(
    plan: Plan,
    receipts: dict[str, Receipt],
    counts: Counts,
    carried: int,
    missing: int,
    failures: list[Failure],
    notes: list[str],
) -> Summary:
    kept = [receipts[unit.token] for unit in plan.units if unit.token in receipts]
    kept += [receipts[sweep.token] for sweep in plan.sweeps if sweep.token in receipts]
    shares = np.array([receipt.covered for receipt in kept])
    written = np.array([receipt.picture_bytes for receipt in kept]) > 0
    samples = slice(counts.samples)
    counted = written[samples].sum(axis=0)
    means = np.sum(shares[samples], axis=0, where=written[samples]) / np.maximum(counted, 1)
    covered = {channel: round(float(mean), 4) for channel, mean in zip(plan.rig.channels, means, strict=True)}
    black = [
        channel
        for channel, count in zip(plan.rig.channels, counted.tolist(), strict=True)
        if count and covered[channel] < LOW_COVERAGE
    ]
    notes.extend(_low_coverage_notes(plan, shares < plan.options.min_coverage, written))
    if black:
        notes.append(f"{', '.join(black)}: almost nothing of these pictures is covered; they are black.")
    return Summary(
        counts,
        covered,
        sum(sum(receipt.picture_bytes) for receipt in kept),
        carried,
        missing,
        [Failure(failure.sample_token, relative(plan, failure.sentence)) for failure in failures],
        [relative(plan, note) for note in (*plan.notes, *notes)],
    )


def _low_coverage_notes(plan: Plan, low: Bool, written: Bool) -> list[str]:
    """Says how many pictures are covered less than was asked for, and what became of them.

    Args:
        low: (moments, cameras) which those are.
        written: which pictures are in the dataset.
    """
    counts = zip(plan.rig.channels, low.sum(axis=0).tolist(), strict=True)
    by_camera = ", ".join(f"{channel} {count:,}" for channel, count in counts if count)
    if not by_camera:
        return []
    least = f"{100 * plan.options.min_coverage:g}%"
    text = f"{low.sum():,} of {low.size:,} pictures are covered less than {least} ({by_camera})"
    if plan.options.low_coverage != "drop-picture":
        return [f"{text}, and kept."]
    units, gaps = "samples and sweeps" if plan.sweeps else "samples", np.count_nonzero(~written.all(axis=1))
    return [f"{text}, and left out: {gaps:,} of {len(low):,} {units} lack cameras, at which most trainers stop."]


def _list_failures(plan: Plan, destination: Destination, failures: list[Failure]) -> None:
    """Writes `failures.txt`: sample token, scene and reason, a line each; none where nothing failed."""
    reasons = {failure.sample_token: failure.sentence for failure in failures}
    lines = [
        f"{unit.token}\t{unit.scene.name}\t{' '.join(reasons[unit.token].split())}\n"
        for unit in plan.moments
        if unit.token in reasons
    ]
    if lines:
        destination.write(FAILED, "".join(lines).encode(errors="backslashreplace"))
    else:
        (destination.root / FAILED).unlink(missing_ok=True)


def _provenance(plan: Plan, summary: Summary) -> bytes:
    return _json(
        {
            "schema_version": 1,
            "unidrive": __version__,
            "plan": plan.identity,
            "plan_digest": plan.digest,
            "rig": {
                "name": plan.rig.name,
                "digest": plan.rig.digest,
                "cameras": {camera.channel: _camera(camera) for camera in plan.rig.cameras},
            },
            "counts": asdict(summary.counts),
            "failures": [asdict(failure) for failure in summary.failures],
            **{name: getattr(summary, name) for name in _KEPT},
        }
    )


def _camera(camera: Camera) -> dict[str, Any]:
    lens = camera.lens
    return {
        "width": lens.width_px,
        "height": lens.height_px,
        "intrinsics": [lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px],
        "position": camera.centre_ego.tolist(),
        "rotation": quaternion_from_rotation(camera.ego_from_cam[:3, :3]).tolist(),
    }


def _json(document: dict[str, Any]) -> bytes:
    return (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode()
