"""What this machine has for unidrive: versions, codecs, cores, memory, disk, a GL renderer."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from unidrive_cli import __version__
from unidrive_cli.errors import UnidriveError
from unidrive_cli.tables.destination import free_bytes
from unidrive_cli.warp import turbojpeg

PACKAGES = (
    "numpy",
    "opencv-python-headless",
    "simplejpeg",
    "nuscenes-devkit",
    "joblib",
    "duckdb",
    "msgspec",
    "numba",
    "distributed",
)


@dataclass(frozen=True)
class Machine:
    """What was found.

    Attributes:
        unidrive, python, platform: versions.
        packages: versions of libraries; None where one is not installed.
        toolchain: codec and kernel that a conversion would use; they are part of its plan, so all
            machines that work on one conversion need the same.
        toolchain_error: why they cannot be used; empty where they can.
        libturbojpeg: whether the shared library is here.
        cores, usable_cores: of the machine, and those that this process may use.
        memory_bytes, available_bytes: of the machine, and what a new process could have.
        folder, free_bytes: where disk was looked at, and what is free there.
        gl: what draws with GL; empty where nothing does.
        gl_error: why nothing does.
    """

    unidrive: str
    python: str
    platform: str
    packages: dict[str, str | None]
    toolchain: dict[str, Any]
    toolchain_error: str
    libturbojpeg: bool
    cores: int
    usable_cores: int
    memory_bytes: int
    available_bytes: int
    folder: str
    free_bytes: int
    gl: str
    gl_error: str


def look_at_machine(folder: Path) -> Machine:
    """Looks at this machine.

    Args:
        folder: where free disk is wanted; may not exist yet.

    Raises:
        OutputError: a link that leads to itself, or a name that cannot be.
    """
    toolchain, toolchain_error = _toolchain()
    gl, gl_error = _gl()
    return Machine(
        unidrive=__version__,
        python=platform.python_version(),
        platform=platform.platform(),
        packages={name: _version(name) for name in PACKAGES},
        toolchain=toolchain,
        toolchain_error=toolchain_error,
        libturbojpeg=turbojpeg.found(),
        cores=os.cpu_count() or 1,
        usable_cores=len(os.sched_getaffinity(0)),
        memory_bytes=os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        available_bytes=_available_bytes(),
        folder=str(folder.absolute()),
        free_bytes=free_bytes(folder),
        gl=gl,
        gl_error=gl_error,
    )


def _available_bytes() -> int:
    lines = Path("/proc/meminfo").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:"))


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _toolchain() -> tuple[dict[str, Any], str]:
    try:
        from unidrive_cli.warp.render import choose_toolchain

        return choose_toolchain().identity, ""
    except (ImportError, OSError) as error:
        return {}, str(error)


def _gl() -> tuple[str, str]:
    try:
        from unidrive_cli.synth.renderers import renderer_name

        return renderer_name("gl")[1], ""
    except (UnidriveError, ImportError, OSError) as error:
        return "", str(error)
