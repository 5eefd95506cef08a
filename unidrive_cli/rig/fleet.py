"""The fleet file (YAML): one virtual rig for several cars, and what they have in common."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from ruamel.yaml.comments import CommentedMap

from unidrive_cli.rig.model import Rig
from unidrive_cli.rig.yaml_reading import check_keys, error_at, optional_number, parse_yaml, read_text, text_of

MAX_SOURCES = 64
_KEYS = ("name", "description", "virtual", "sources", "depth_limit", "ground_height", "common")
_MARKS = ("virtual", "sources")
"""Keys that a rig file does not have."""


@dataclass(frozen=True, eq=False)
class Fleet:
    """A virtual rig and the cars that share it.

    Attributes:
        name: for people.
        virtual: the virtual rig, with the fleet's depth limit and ground height where it gives them.
        sources: the cars' rigs.
        common: whether pictures show only what every car can fill.
    """

    name: str
    virtual: Rig
    sources: tuple[Rig, ...]
    common: bool


def is_fleet_file(path: Path) -> bool:
    """Whether a YAML file has a key that only fleet files have.

    Raises:
        RigError: it cannot be read, or is not YAML.
    """
    document = parse_yaml(read_text(path), str(path))
    return isinstance(document, CommentedMap) and any(key in document for key in _MARKS)


def load_fleet(path: Path, rig_named: Callable[[str], Rig]) -> Fleet:
    """The fleet of a YAML file in the format of docs/rig-files.md.

    Args:
        rig_named: gives the rig that a RIG in the file names: a shipped rig's name, or the path of a rig file
            or a dataset folder, already resolved against the file's folder.

    Raises:
        RigError: not a fleet file; the sentence names the file, the line and the key.
    """
    where = str(path)
    document = parse_yaml(read_text(path), where)
    check_keys(document, _KEYS, ("name", "virtual", "sources"), where)
    names = document["sources"]
    if not isinstance(names, list) or not names or not all(isinstance(name, str | int | float) for name in names):
        raise error_at(document, "sources", where, "must be a list of rigs, and hold at least one.")
    if len(names) > MAX_SOURCES:
        raise error_at(document, "sources", where, f"holds {len(names)} rigs; at most {MAX_SOURCES} are accepted.")
    common = document.get("common", True)
    if not isinstance(common, bool):
        raise error_at(document, "common", where, f"must be true or false, got {common!r:.60}.")
    depth_limit_m = optional_number(document, "depth_limit", where)
    if depth_limit_m is not None and depth_limit_m <= 0:
        raise error_at(
            document, "depth_limit", where, f"must be a positive number of metres, got {depth_limit_m:g}."
        )
    ground_height_m = optional_number(document, "ground_height", where)
    virtual = rig_named(_resolved(text_of(document, "virtual", where), path))
    for camera in virtual.cameras:
        if camera.lens.coefficients:
            what = f"must be a rig of pinholes; {camera.channel} of {virtual.name} has lens distortion."
            raise error_at(document, "virtual", where, what)
    return Fleet(
        text_of(document, "name", where),
        replace(
            virtual,
            depth_limit_m=virtual.depth_limit_m if depth_limit_m is None else depth_limit_m,
            ground_height_m=virtual.ground_height_m if ground_height_m is None else ground_height_m,
        ),
        tuple(rig_named(_resolved(str(name), path)) for name in names),
        common,
    )


def _resolved(name: str, fleet_file: Path) -> str:
    """A path as it is seen from the fleet file's folder; a name stays unless a file or folder there has it."""
    beside = fleet_file.parent / name
    looks_like_path = "/" in name or beside.suffix in (".yaml", ".yml")
    return str(beside) if looks_like_path or beside.is_dir() else name
