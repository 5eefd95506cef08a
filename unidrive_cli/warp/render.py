"""The seam between a unit of work and its kernels: source files in, virtual pictures and coverage masks out."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import cv2
import simplejpeg

from unidrive_cli.errors import UsageError
from unidrive_cli.rig.model import Rig
from unidrive_cli.warp import turbojpeg
from unidrive_cli.warp.choices import Codec, Kernel, WarpChoices
from unidrive_cli.warp.common import CommonMasks
from unidrive_cli.warp.compiled import has_numba
from unidrive_cli.warp.remap import Mask, Source


@dataclass(frozen=True, eq=False)
class VirtualPicture:
    """One picture of a virtual rig.

    Attributes:
        jpeg: the file.
        mask: (H, W) uint8, 255 where a source sees the pixel; the renderer may write over it in the next frame.
        covered_px: how many pixels that are.
    """

    jpeg: bytes
    mask: Mask
    covered_px: int

    @property
    def covered(self) -> float:
        """Share of the pixels that a source sees."""
        return self.covered_px / self.mask.size


class Renderer(Protocol):
    """Renders a virtual rig from whatever sources each frame has."""

    def render(
        self, paths: Sequence[Path], sources: Sequence[Source], quality: int, hint: str
    ) -> Iterator[VirtualPicture]:
        """The pictures of one frame, in the rig's order.

        Args:
            paths, sources: file and camera of each source picture.
            quality: of the JPEG files, 1 to 100.
            hint: what to do about a source picture that is missing or broken.

        Raises:
            PictureError: a source picture is missing, broken or of another size; before the first picture.
        """


@dataclass(frozen=True)
class Toolchain:
    """What the bytes of the pictures depend on besides the plan.

    Attributes:
        kernel: `numba`, the fused kernel on YUV planes, or `opencv`.
        codec: `libturbojpeg`, which decodes to planes, or `simplejpeg`, which does not; with the kernel
            `opencv` pictures are decoded by simplejpeg and encoded by OpenCV.
    """

    kernel: Literal["numba", "opencv"]
    codec: Literal["libturbojpeg", "simplejpeg"]

    @property
    def identity(self) -> dict[str, str | dict[str, str]]:
        """Names and versions, for the plan's digest and the provenance file."""
        if self.kernel == "opencv":
            codec = {"decode": f"simplejpeg {simplejpeg.__version__}", "encode": f"opencv {cv2.__version__}"}
        else:
            name = self.codec if self.codec == "libturbojpeg" else f"simplejpeg {simplejpeg.__version__}"
            codec = {"decode": name, "encode": name}
        codec["masks"] = f"zlib {zlib.ZLIB_RUNTIME_VERSION}"
        return {"kernel": "opencv-fixed-point" if self.kernel == "opencv" else "numba-planes", "codec": codec}


def choose_toolchain(kernel: Kernel = "auto", codec: Codec = "auto") -> Toolchain:
    """The fastest that is here, or what was asked for.

    Raises:
        UsageError: that is not here.
    """
    numba = has_numba()
    if kernel == "numba" and not numba:
        raise UsageError("--kernel numba needs the package numba.", hint="pip install 'unidrive[fast]'.")
    if kernel == "opencv" or not numba:
        if codec == "libturbojpeg":
            raise UsageError(
                "--codec libturbojpeg works with --kernel numba only.",
                hint="" if numba else "pip install 'unidrive[fast]'.",
            )
        return Toolchain("opencv", "simplejpeg")
    if codec == "libturbojpeg" and not turbojpeg.found():
        raise UsageError(
            "--codec libturbojpeg needs the library libturbojpeg, which was not found.",
            hint="Debian and Ubuntu have it as libturbojpeg0, or libturbojpeg.",
        )
    turbo = codec == "libturbojpeg" or (codec == "auto" and turbojpeg.found())
    return Toolchain("numba", "libturbojpeg" if turbo else "simplejpeg")


def prepare(toolchain: Toolchain) -> None:
    """Compiles the kernel where that was not done yet, so that worker processes find it on the disk."""
    if toolchain.kernel == "numba":
        from unidrive_cli.warp import fused

        fused.warm_up()


def open_renderer(
    toolchain: Toolchain, rig: Rig, choices: WarpChoices, common: CommonMasks | None = None
) -> Renderer:
    """The renderer of a virtual rig.

    Args:
        common: blackens what is not common.

    Raises:
        RigError: a virtual camera below the ground, or a depth limit below its height.
    """
    if toolchain.kernel == "opencv":
        from unidrive_cli.warp.opencv_kernel import OpenCVRenderer

        return OpenCVRenderer(rig, choices, common)
    from unidrive_cli.warp.planar import PlanarRenderer

    return PlanarRenderer(rig, choices, toolchain.codec, common)
