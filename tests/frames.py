"""Renders samples through the package the way `convert` does, up to the pictures before JPEG."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import make_plan
from unidrive_cli.rig.model import Rig
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.warp.opencv_kernel import OpenCVRenderer, ViewTables
from unidrive_cli.warp.pictures import read_picture
from unidrive_cli.warp.reduction import Copies


@dataclass
class Rendered:
    """One sample: pictures and tables by virtual channel, source pictures in the order of `channels`."""

    sample_token: str
    pictures: dict[str, np.ndarray]
    tables: dict[str, ViewTables]
    sources: dict[str, np.ndarray]


def render_samples(
    root: Path, rig: Rig, version: str | None = None, token: str | None = None, **options: object
) -> list[Rendered]:
    """All samples of a dataset, or the one with a token, through a rig."""
    dataset = open_dataset(root, version)
    plan = make_plan(dataset, rig, Options(**options))
    chosen = plan.options
    renderer = OpenCVRenderer(rig, chosen)
    rendered = []
    for unit in plan.units:
        if token not in (None, unit.sample.token):
            continue
        frame = plan.frame(unit)
        sources = [
            read_picture(Path(path), (source.lens.width_px, source.lens.height_px))
            for path, source in zip(frame.paths, frame.sources, strict=True)
        ]
        tables = renderer.tables(frame.sources)
        rendered.append(
            Rendered(
                unit.sample.token,
                {c: view.render(Copies(sources)) for c, view in zip(rig.channels, tables, strict=True)},
                dict(zip(rig.channels, tables, strict=True)),
                {
                    dataset.sensor_of(row).channel: picture
                    for row, picture in zip(unit.sources, sources, strict=True)
                },
            )
        )
    return rendered


def psnr_db(picture: np.ndarray, truth: np.ndarray) -> float:
    """PSNR of 8-bit pictures, or of the pixels (n, 3) of them."""
    error = np.mean((picture.astype(np.float64) - truth) ** 2)
    return float("inf") if error == 0 else float(10 * np.log10(255.0**2 / error))
