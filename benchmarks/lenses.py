"""What lens distortion of the sources costs: CPU time of drawing a sample's virtual pictures, against pinholes.

    python benchmarks/lenses.py [--rounds N]

Six cameras all round (6x80a) with each lens in turn, into roof-6x70, by the fused kernel alone (nothing decoded or
encoded), interleaved. Prints for each lens the ratio to pinholes of the same camera matrix (median of the rounds'
ratios), and the milliseconds of the fastest round.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Sequence

import numpy as np

from unidrive_cli.geometry.lenses import Lens, Pinhole, lens_of
from unidrive_cli.geometry.poses import inverse
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.rig.model import Rig
from unidrive_cli.warp.planar import Atlas, Canvas
from unidrive_cli.warp.remap import Source, virtual_views

LENSES: dict[str, tuple[str, list[float]] | None] = {
    "pinhole": None,
    "opencv, 5 coefficients": ("opencv", [-0.05, 0.01, 4e-4, -2e-4, -0.002]),
    "opencv, 8 coefficients": ("opencv", [0.5, 0.2, 1e-4, 1e-4, 0.01, 0.6, 0.25, 0.02]),
    "opencv, 12 coefficients": ("opencv", [-0.05, 0.01, 4e-4, -2e-4, -0.002, 0, 0, 0, 1e-3, -2e-3, 1e-3, 1e-4]),
    "fisheye": ("fisheye", [-0.02, 0.003, -0.001, 1e-4]),
    "opencv, 14 coefficients (tilted)": ("opencv", [-0.05, 0.01, *[0.0] * 10, 0.02, -0.03]),
}


def bent(lens: Lens, distortion: tuple[str, list[float]] | None) -> Lens:
    assert isinstance(lens, Pinhole)
    return lens if distortion is None else lens_of(lens, *distortion)


def sources_of(rig: Rig, distortion: tuple[str, list[float]] | None) -> list[Source]:
    return [Source(bent(camera.lens, distortion), inverse(camera.ego_from_cam)) for camera in rig.cameras]


def draw(canvases: Sequence[Canvas], atlas: Atlas, sources: Sequence[Source]) -> float:
    """CPU seconds."""
    start = time.process_time()
    for canvas in canvases:
        canvas.draw(atlas, sources, nearest=False)
    return time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15)
    rounds = parser.parse_args().rounds
    rig = load_gallery_rig("6x80a")
    sources = {name: sources_of(rig, distortion) for name, distortion in LENSES.items()}
    atlas = Atlas(tuple((camera.lens.width_px, camera.lens.height_px) for camera in rig.cameras))
    atlas.memory[:] = np.random.default_rng(0).integers(0, 255, atlas.memory.size)
    canvases = [Canvas(view) for view in virtual_views(load_gallery_rig("roof-6x70"), 50.0, 0.0)]
    for those in sources.values():
        draw(canvases, atlas, those)
    seconds: dict[str, list[float]] = {name: [] for name in sources}
    for _ in range(rounds):
        for name, those in sources.items():
            seconds[name].append(draw(canvases, atlas, those))
    for name, taken in seconds.items():
        ratio = statistics.median(a / b for a, b in zip(taken, seconds["pinhole"], strict=True))
        print(f"{name:34} {ratio:5.2f} {min(taken) * 1e3:8.1f} ms")


if __name__ == "__main__":
    main()
