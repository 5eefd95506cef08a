"""What gives the pictures their bytes besides dataset, rig and options: it must be the same on all machines."""

from __future__ import annotations

from typing import Any

import cv2
import simplejpeg

KERNEL = "opencv-fixed-point"


def toolchain() -> dict[str, Any]:
    """Codec and kernel that this process would use; part of the plan, and compared by every worker.

    The one place that decides it: a faster kernel or codec is named here where it is chosen.
    """
    return {
        "codec": {"decode": f"simplejpeg {simplejpeg.__version__}", "encode": f"opencv {cv2.__version__}"},
        "kernel": KERNEL,
    }
