"""Pictures through any lens: a pinhole's are rendered as they are, others rendered wide and warped."""

from __future__ import annotations

from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.lenses import Lens, Pinhole
from unidrive_cli.synth.stage import Depth, Instances, Picture, Renderer, View


class Shots:
    """Takes pictures of one renderer's stage."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer

    def picture(self, lens: Lens, global_from_cam: Float, actors: Float, shown: Bool, samples: int) -> Picture:
        """(H, W, 3) uint8 BGR; the arguments are those of `View`."""
        assert isinstance(lens, Pinhole)
        return self._renderer.picture(View(lens, global_from_cam, actors, shown), samples)

    def instances(self, lens: Lens, global_from_cam: Float, actors: Float, shown: Bool) -> tuple[Instances, Depth]:
        """Ids and depths of what each pixel's centre shows."""
        assert isinstance(lens, Pinhole)
        return self._renderer.instances(View(lens, global_from_cam, actors, shown))
