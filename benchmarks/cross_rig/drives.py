"""The drives: rendered by `unidrive synth`'s own function, converted by `unidrive convert`'s own.

FOLDER/<drive>/<rig> is a rendered dataset, FOLDER/<drive>-<setting>/<rig> a converted one. Cameras fire together,
as in the paper's simulator, so that rigs differ in their cameras only; every drive may be continued.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.cross_rig.config import HEIGHTS, LENSES, PAPER_RIGS, PICTURE, RAW, Drive, Setting
from unidrive_cli.convert.common import Common
from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import make_plan
from unidrive_cli.convert.run import convert
from unidrive_cli.geometry.arrays import Bool
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.rig.model import Rig
from unidrive_cli.synth.options import SynthOptions
from unidrive_cli.synth.run import PROVENANCE, make_synth_plan, synthesise
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.warp.choices import DEFAULT_DEPTH_LIMIT_M
from unidrive_cli.warp.common import common_masks
from unidrive_cli.warp.remap import virtual_views


def small_rig(name: str) -> Rig:
    """A shipped rig, or one of the ablations', with pictures of the benchmark's width."""
    rig = load_gallery_rig(name.split("-at-")[0] if name in LENSES | HEIGHTS else name)
    cameras = []
    for camera in rig.cameras:
        pose = camera.ego_from_cam.copy()
        pose[2, 3] = HEIGHTS.get(name, pose[2, 3])
        height = round(PICTURE[0] * camera.lens.height_px / camera.lens.width_px)
        lens = Pinhole.from_hfov(LENSES.get(name, camera.lens.hfov_deg), PICTURE[0], height)
        cameras.append(replace(camera, lens=lens, ego_from_cam=pose))
    return replace(rig, name=name, cameras=tuple(cameras))


def coverage(setting: Setting) -> tuple[Bool, ...]:
    """What each of the paper's rigs fills of the virtual pictures: (C, H, W), cameras ordered by their names."""
    virtual = small_rig(setting.virtual)
    order = np.argsort(virtual.channels)
    views = virtual_views(virtual, _depth_limit_m(setting, virtual), 0.0)
    return tuple(np.stack(common_masks(views, [small_rig(rig)], 0.0).masks())[order] > 0 for rig in PAPER_RIGS)


def _depth_limit_m(setting: Setting, virtual: Rig) -> float:
    return setting.depth_limit_m or virtual.depth_limit_m or DEFAULT_DEPTH_LIMIT_M


def rendered(folder: Path, drive: Drive, rig: str) -> Path:
    return folder / drive.name / rig


def converted(folder: Path, drive: Drive, setting: Setting, rig: str) -> Path:
    """Where the pictures of a setting are; the rendered ones for `raw`."""
    return folder / f"{drive.name}-{setting.pictures}" / rig if setting != RAW else rendered(folder, drive, rig)


def render(folder: Path, drive: Drive, rigs: tuple[str, ...], jobs: int) -> None:
    """One drive through several rigs; what is there already stays."""
    missing = [small_rig(rig) for rig in rigs if not (rendered(folder, drive, rig) / PROVENANCE).is_file()]
    if not missing:
        return
    options = SynthOptions(drive.seed, drive.scenes, drive.keyframes, firing="together", val_share=1.0)
    plan = make_synth_plan(options, missing, "auto")
    (folder / drive.name).mkdir(parents=True, exist_ok=True)
    root = folder / drive.name if len(missing) > 1 else rendered(folder, drive, missing[0].name)
    synthesise(plan, root, jobs=jobs)
    for rig in missing:
        (rendered(folder, drive, rig.name) / PROVENANCE).write_text("finished\n")


def convert_drive(folder: Path, drive: Drive, setting: Setting, rig: str) -> str:
    """One dataset through one virtual rig, verified, in this process; says what was done."""
    done = converted(folder, drive, setting, rig)
    virtual = small_rig(setting.virtual)
    options = Options(depth_limit_m=_depth_limit_m(setting, virtual), blend=setting.blend)  # type: ignore[arg-type]
    common = Common(tuple(map(small_rig, PAPER_RIGS)), sweep_m=0.0) if setting.common else None
    convert(make_plan(open_dataset(rendered(folder, drive, rig)), virtual, options, common), done)
    return f"converted {done.relative_to(folder)}"
