"""What a user can choose about a conversion."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from typing import Any, Literal

from unidrive_cli.errors import UsageError
from unidrive_cli.warp.choices import Codec, Kernel, WarpChoices

Masks = Literal["frame", "camera", "none"]
Link = Literal["hardlink", "symlink", "copy"]
VerifyLevel = Literal["sample", "full"]
VisibilityRule = Literal["lower", "keep"]
UnseenBoxes = Literal["keep", "drop"]
LowCoverage = Literal["drop-camera", "drop-picture", "keep"]
OnError = Literal["stop", "skip"]
Backend = Literal["processes", "dask"]
_TAKEN = ("samples", "sweeps", "data", "maps", "map", "can_bus", "lidarseg", "panoptic")


def check_version_name(name: str, option: str) -> None:
    """Refuses a name that the version folder of an output cannot have.

    Args:
        option: that gave it.

    Raises:
        UsageError: it cannot be a folder, or is another one.
    """
    from unidrive_cli.tables.destination import RESERVED  # for which msgspec is loaded

    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", name) is None or name in (*RESERVED, *_TAKEN):
        raise UsageError(f"{option} {name}: that cannot be a version folder.", hint="v1.0-trainval can.")


@dataclass(frozen=True)
class Options(WarpChoices):
    """Options of `convert`, after the rig's own defaults were taken into account: those of the warp, and these.

    Attributes:
        quality: JPEG quality, 1 to 100.
        scenes, splits, cameras: names; all where empty. A scene must have one of the names and be in one of
            the splits.
        max_samples: only so many samples, the first by scene and time; all where None.
        sweeps: whether the pictures between the key frames are rendered too.
        source_mask: folder with pictures of where the source cameras show the own car; none where empty. What they
            hold belongs to the plan.
        masks: one coverage mask per picture, one per virtual camera, or none.
        visibility: `lower` it where the virtual rig shows less of a box, or `keep`.
        unseen_boxes: `keep` boxes that no virtual pixel shows, with the lowest visibility, or `drop`.
        min_coverage: least share of a virtual picture, 0 to 1, that sources see.
        low_coverage: what happens below it: `drop-camera` drops virtual cameras that stay below it in the mean of
            all samples, `drop-picture` single pictures; `keep` keeps all. What is kept is reported.
        link: how files that do not change come into the output.
        on_error: `stop` at the first broken sample, or `skip` it.
        verify: `sample` of the pictures decoded at the end, and scenes opened with nuscenes-devkit, or `full`.
        jobs: worker processes; 0 works in this process.
        kernel, codec: what warps, and what decodes and encodes; what they come to belongs to the plan.
        backend: `processes` on this machine, or `dask`, the workers of a cluster.
        scheduler: address of the Dask scheduler; empty without `dask`.
        keep_layout: write the source's own layout, where that is possible, instead of nuScenes'.
        output_version: the version folder of the output; what the source's layout makes of its own where empty.
        space_check: refuse to start where the estimate exceeds the free space.
    """

    quality: int = 95
    scenes: tuple[str, ...] = ()
    splits: tuple[str, ...] = ()
    max_samples: int | None = None
    cameras: tuple[str, ...] = ()
    sweeps: bool = False
    source_mask: str = ""
    masks: Masks = "frame"
    visibility: VisibilityRule = "lower"
    unseen_boxes: UnseenBoxes = "keep"
    min_coverage: float = 0.0
    low_coverage: LowCoverage = "drop-camera"
    link: Link = "hardlink"
    on_error: OnError = "stop"
    verify: VerifyLevel = "sample"
    jobs: int = 0
    kernel: Kernel = "auto"
    codec: Codec = "auto"
    backend: Backend = "processes"
    scheduler: str = ""
    keep_layout: bool = False
    output_version: str = ""
    space_check: bool = True

    def __post_init__(self) -> None:
        if not 1 <= self.quality <= 100:
            raise UsageError(f"--quality must be from 1 to 100, got {self.quality}.")
        super().__post_init__()
        if self.max_samples is not None and self.max_samples < 1:
            raise UsageError(f"--max-samples must be 1 or more, got {self.max_samples}.")
        if self.output_version:
            check_version_name(self.output_version, "--output-version")
        if self.output_version and self.keep_layout:
            raise UsageError("--output-version and --keep-layout exclude each other.")
        if not 0 <= self.min_coverage <= 1:
            raise UsageError(f"--min-coverage must be a share from 0 to 1, got {self.min_coverage:g}.")
        if self.jobs < 0:
            raise UsageError(f"--jobs must be 0 or more, got {self.jobs}.")
        if self.backend == "dask" and not self.scheduler:
            raise UsageError("--backend dask needs the address of a scheduler.", hint="Give it with --scheduler.")
        if self.scheduler and self.backend != "dask":
            raise UsageError(f"--scheduler {self.scheduler} needs --backend dask.")

    def drops_picture(self, covered: float) -> bool:
        """Whether a virtual picture with this covered share is left out."""
        return self.low_coverage == "drop-picture" and covered < self.min_coverage

    def identity(self) -> dict[str, Any]:
        """The options that the output depends on, for the plan's digest and the provenance file."""
        apart = (
            "jobs",
            "verify",
            "on_error",
            "backend",
            "scheduler",
            "kernel",
            "codec",
            "space_check",
            "source_mask",
        )
        chosen = {field.name: getattr(self, field.name) for field in fields(self) if field.name not in apart}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in chosen.items()}
