"""The rigs that ship with unidrive: the files of the top-level `rigs/` folder."""

from __future__ import annotations

from pathlib import Path

from unidrive_cli.errors import RigError, did_you_mean
from unidrive_cli.rig.model import Rig
from unidrive_cli.rig.yaml_file import load_rig


def gallery_folder() -> Path:
    """Where the rig files are: inside an installed wheel, or beside the package in a checkout."""
    package = Path(__file__).resolve().parents[1]
    shipped = package / "rigs"
    return shipped if shipped.is_dir() else package.parent / "rigs"


def gallery_names() -> list[str]:
    """Names of the shipped rigs, sorted."""
    return sorted(path.stem for path in gallery_folder().glob("*.yaml"))


def load_gallery_rig(name: str) -> Rig:
    """The shipped rig of that name.

    Raises:
        RigError: there is none; the sentence suggests the nearest name and lists them all.
    """
    names = gallery_names()
    if name not in names:
        raise RigError(
            "is neither a rig file, nor a dataset folder, nor a shipped rig.",
            where=name[:200],
            hint=f"{did_you_mean(name, names)} Shipped rigs: {', '.join(names)}.".strip(),
        )
    return load_rig(gallery_folder() / f"{name}.yaml")
