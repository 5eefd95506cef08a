"""Which renderer draws a stage: GL where the machine has it, rays on the CPU otherwise."""

from __future__ import annotations

from typing import Literal

from unidrive_cli.errors import UnidriveError, UsageError
from unidrive_cli.synth.gl_renderer import GlRenderer, gl_missing, gl_name, open_context
from unidrive_cli.synth.ray_renderer import RAYS_NAME, RayRenderer
from unidrive_cli.synth.stage import Renderer, Stage

__all__ = ["gl_missing", "open_renderer", "renderer_name"]


def open_renderer(stage: Stage, which: Literal["auto", "gl", "rays"] = "auto") -> Renderer:
    """A renderer of the stage; call its `close` when done.

    Args:
        which: "gl", "rays", or "auto": GL where it can be had.

    Raises:
        UsageError: `which` is "gl" and no GL context can be made.
        UnidriveError: rays are needed and embreex is not installed.
    """
    if which != "rays":
        try:
            return GlRenderer(stage)
        except UnidriveError as error:
            if which == "gl":
                raise UsageError(error.what, hint=error.hint) from error
            if gl_missing() is None:
                raise
    return RayRenderer(stage)


def renderer_name(which: Literal["auto", "gl", "rays"]) -> tuple[Literal["gl", "rays"], str]:
    """Which renderer `open_renderer` would open here, and what draws there, for people.

    Raises:
        UsageError: `which` is "gl" and no GL context can be made.
    """
    if which != "rays":
        try:
            context = open_context()
        except UnidriveError as error:
            if which == "gl":
                raise UsageError(error.what, hint=error.hint) from error
        else:
            name = gl_name(context)
            context.release()
            return "gl", name
    return "rays", RAYS_NAME
