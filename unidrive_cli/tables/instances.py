"""Instance pictures: beside each picture of a synthetic drive, what each of its pixels shows.

A 16-bit PNG with one channel: 0 sky, 1 ground, 2 structures, from 16 on one number per actor.
"""

from __future__ import annotations

from pathlib import PurePosixPath

INSTANCES = "instances"
SKY = 0
GROUND = 1
"""Road, pavement, verge."""
STRUCTURES = 2
"""Buildings, trees, poles."""
FIRST_OBJECT = 16


def instance_name(picture_name: str) -> str:
    """Where the instance picture of a picture is: instances/<CHANNEL>/<the picture's name>.png."""
    path = PurePosixPath(picture_name)
    return f"{INSTANCES}/{path.parent.name}/{path.stem}.png"
