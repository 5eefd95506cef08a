"""Names and tokens of a synthetic drive: derived, so that a rerun and another rig agree on them."""

from __future__ import annotations

import hashlib
from pathlib import PurePosixPath

from unidrive_cli.synth.options import SynthOptions

DEPTH = "depth"


def token(options: SynthOptions, *names: object) -> str:
    """32 hexadecimal digits that the drive's seed and the names give."""
    text = "\n".join(("unidrive synth", str(options.seed), *map(str, names)))
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def log_name(options: SynthOptions, scene: int) -> str:
    """The logfile of a scene: one log and one town per scene."""
    return f"unidrive-{options.seed}-{scene:04d}"


def map_name(options: SynthOptions, scene: int) -> str:
    """The file of a scene's drivable area."""
    return f"maps/{token(options, 'map', scene)}.png"


def picture_name(log: str, channel: str, timestamp_us: int, is_key_frame: bool) -> str:
    """The file of a picture, in nuScenes' pattern."""
    return f"{'samples' if is_key_frame else 'sweeps'}/{channel}/{log}__{channel}__{timestamp_us}.jpg"


def cloud_name(log: str, channel: str, timestamp_us: int, is_key_frame: bool) -> str:
    """The file of a lidar cloud, in nuScenes' pattern."""
    return f"{'samples' if is_key_frame else 'sweeps'}/{channel}/{log}__{channel}__{timestamp_us}.pcd.bin"


def depth_name(picture: str) -> str:
    """Where the depth picture of a picture is: depth/<CHANNEL>/<the picture's name>.png."""
    path = PurePosixPath(picture)
    return f"{DEPTH}/{path.parent.name}/{path.stem}.png"
