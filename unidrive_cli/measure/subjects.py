"""What is measured: the pictures that a converted dataset holds, or pictures rendered here and now."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from unidrive_cli.errors import DatasetError, UsageError
from unidrive_cli.geometry.arrays import Bool
from unidrive_cli.measure.fidelity import near_seams
from unidrive_cli.rig.model import Camera, Rig
from unidrive_cli.tables.converted import camera_mask_name, is_converted, mask_name, read_conversion
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.moments import cameras_of, lens_and_cam_from_ego, reference_of
from unidrive_cli.tables.rig_of_dataset import picture_size_of, rig_of_dataset
from unidrive_cli.tables.schema import Sample, SampleData
from unidrive_cli.warp.choices import WarpChoices
from unidrive_cli.warp.exposure import Exposure, even_out
from unidrive_cli.warp.opencv_kernel import ViewTables
from unidrive_cli.warp.pictures import Picture, read_mask, read_picture, size_of_file
from unidrive_cli.warp.reduction import Copies, Reductions
from unidrive_cli.warp.remap import Source, build_patches, dominant_sources, virtual_views


@dataclass(frozen=True, eq=False)
class Shown:
    """One virtual picture.

    Attributes:
        camera: its virtual camera.
        moment: the row of the subject's dataset whose time and ego pose the picture has.
        picture: (H, W, 3) uint8, BGR.
        covered: (H, W) where a source saw the pixel.
        seams: (H, W) where another source becomes the dominant one; None where that is not known.
    """

    camera: Camera
    moment: SampleData
    picture: Picture
    covered: Bool
    seams: Bool | None


class Subject(Protocol):
    """Gives the virtual pictures of a dataset's samples, whatever they come from."""

    @property
    def dataset(self) -> Dataset:
        """The dataset whose samples are shown."""

    @property
    def rig(self) -> Rig:
        """The virtual rig."""

    @property
    def notes(self) -> list[str]:
        """What a user should know, one sentence each."""

    def shown(self, sample: Sample) -> Iterator[Shown]:
        """The virtual pictures of a sample, in the rig's order."""


class ConvertedPictures:
    """The pictures and masks that `unidrive convert` has written."""

    def __init__(self, dataset: Dataset, source: Dataset | None = None) -> None:
        """
        Args:
            dataset: the converted dataset.
            source: the one it was made from; without it seams are not known.

        Raises:
            UsageError: not a converted dataset.
            DatasetError: unfinished, without masks, or made from another source.
        """
        if not is_converted(dataset.root):
            raise UsageError(
                f"{dataset.root} is no converted dataset (it has no unidrive.json).",
                hint="Give the virtual rig with --rig to render it here and now, or convert it first.",
            )
        self.dataset = dataset
        self.rig, self.notes = rig_of_dataset(dataset)
        conversion = read_conversion(dataset.root)
        self._options = conversion.options
        if self._options.masks == "none":
            raise DatasetError(
                "was converted with --masks none, so what is covered is not known.",
                where=str(dataset.root),
                hint="Convert it with masks, or measure its source with --rig.",
            )
        if source is not None and source.digest != conversion.source.digest:
            raise DatasetError(
                f"is not what {dataset.root} was converted from: its tables differ.", where=str(source.folder)
            )
        self._source = source
        if source is None:
            self.notes.append("Seams are not measured: they need the dataset that was converted (--source SRC).")
        options = self._options
        self._views = virtual_views(self.rig, options.depth_limit_m, options.ground_height_m)

    def shown(self, sample: Sample) -> Iterator[Shown]:
        rows = cameras_of(self.dataset, sample, reference_of(self.dataset, sample))
        sources = None
        if self._source is not None:
            chosen = self._options.cameras or self._source.camera_channels()
            original = self._source.sample.get(sample.token, self.dataset.sample.place(sample, "token"))
            sources = _sources(self._source, original, chosen, ego_motion=self._options.ego_motion)[1]
        for view in self._views:
            camera = view.camera
            row = rows.get(camera.channel)
            if row is None:
                place = self.dataset.sample.place(sample, "token")
                if self._options.low_coverage == "drop-picture":
                    raise DatasetError(
                        f"the sample has no picture of {camera.channel}: --low-coverage drop-picture left it out.",
                        where=place,
                        hint="Measure the source with --rig.",
                    )
                raise DatasetError(f"the sample has no picture of {camera.channel}.", where=place)
            size = camera.lens.width_px, camera.lens.height_px
            mask = camera_mask_name(camera.channel) if self._options.masks == "camera" else mask_name(row.filename)
            seams = None
            if sources is not None:
                seams = near_seams(dominant_sources(view, build_patches(view, sources, "nearest")))
            yield Shown(
                camera,
                row,
                read_picture(self.dataset.path_of(row), size),
                read_mask(self.dataset.root / mask, size),
                seams,
            )


class RenderedPictures:
    """Pictures rendered in memory from a dataset's cameras, as `unidrive convert` would before it encodes them."""

    def __init__(self, dataset: Dataset, rig: Rig, choices: WarpChoices, cameras: Collection[str] = ()) -> None:
        """
        Args:
            cameras: channels to render from; all where empty.

        Raises:
            UsageError: an unknown camera.
            DatasetError: no cameras.
            RigError: a virtual camera below the ground, or a depth limit below its height.
        """
        self.dataset = dataset
        self.rig = rig
        self.notes: list[str] = []
        self._channels = dataset.camera_channels(cameras)
        if not self._channels:
            raise DatasetError("holds no cameras to render from.", where=str(dataset.folder))
        self._choices = choices
        self._views = virtual_views(rig, choices.depth_limit_m, choices.ground_height_m)
        self._exposure = Exposure(self._views) if choices.exposure == "gain" else None
        self._reductions = Reductions(self._views, anti_alias=choices.anti_alias)
        if is_converted(dataset.root):
            self.notes.append(f"{dataset.root} is a converted dataset; its virtual pictures are rendered once more.")

    def shown(self, sample: Sample) -> Iterator[Shown]:
        reference = reference_of(self.dataset, sample)
        paths, sources = _sources(self.dataset, sample, self._channels, ego_motion=self._choices.ego_motion)
        pictures = [
            read_picture(path, (source.lens.width_px, source.lens.height_px))
            for path, source in zip(paths, sources, strict=True)
        ]
        if self._exposure:
            even_out(self._exposure, sources, pictures)
        copies = Copies(pictures)
        for view, reductions in zip(self._views, self._reductions.of(sources), strict=True):
            patches = build_patches(view, sources, self._choices.blend, reductions)
            tables = ViewTables(view, patches, reductions)
            seams = near_seams(dominant_sources(view, patches))
            yield Shown(view.camera, reference, tables.render(copies), tables.mask > 0, seams)


def _sources(
    dataset: Dataset, sample: Sample, channels: Collection[str], *, ego_motion: bool
) -> tuple[list[Path], list[Source]]:
    """Files and cameras of a sample's pictures of those channels, seen from the car at the sample's reference."""
    reference = reference_of(dataset, sample)
    global_from_ego = dataset.global_from_ego(reference)
    paths, sources = [], []
    for channel, row in cameras_of(dataset, sample, reference).items():
        if channel in channels:
            size = picture_size_of(dataset, row, size_of_file)
            camera = lens_and_cam_from_ego(dataset, row, size, global_from_ego, ego_motion=ego_motion)
            paths.append(dataset.path_of(row))
            sources.append(Source(*camera))
    return paths, sources
