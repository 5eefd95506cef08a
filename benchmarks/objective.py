"""CPU time of one evaluation of the search's objective: eight rigs, 10,000 boxes each, six virtual cameras.

    python benchmarks/objective.py [--boxes 10000] [--rounds 9]

Prints JSON: the medians in milliseconds, on one core, of the whole evaluation, of its two parts (errors of the
corners; what the rigs fill of the virtual pictures), and of the plain path that works without numba.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable

import numpy as np

from unidrive_cli.geometry import boxes
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.optimize.objective import Car, Objective, Penalties
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.warp.remap import virtual_views

RIGS = ("4x95", "5x75", "5x70+110", "6x60", "6x70", "6x80a", "6x80b", "8x50")
VIRTUAL = "roof-6x70"
DEPTH_LIMIT_M = 50.0


def corners(count: int) -> Float:
    """(count, 8, 3) corners of cars all round, 3 to 60 m away, seeded."""
    random = np.random.default_rng(0)
    distance, azimuth, yaw = random.uniform(3, 60, count), *random.uniform(-np.pi, np.pi, (2, count))
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, :2] = np.stack([np.cos(yaw), -np.sin(yaw)], axis=1)
    poses[:, 1, :2] = np.stack([np.sin(yaw), np.cos(yaw)], axis=1)
    poses[:, :3, 3] = np.stack([distance * np.cos(azimuth), distance * np.sin(azimuth), np.full(count, 0.8)], axis=1)
    return boxes.corners(poses, np.tile([1.9, 4.5, 1.6], (count, 1)))


def median_ms(work: Callable[[], object], rounds: int) -> float:
    """Median CPU time of this process, milliseconds, after one call that does not count."""
    work()
    times = []
    for _ in range(rounds):
        before = time.process_time()
        work()
        times.append(1000 * (time.process_time() - before))
    return round(statistics.median(times), 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--boxes", type=int, default=10_000)
    parser.add_argument("--rounds", type=int, default=9)
    arguments = parser.parse_args()
    seen = corners(arguments.boxes)
    cars = [Car(load_gallery_rig(name), seen) for name in RIGS]
    virtual = load_gallery_rig(VIRTUAL)
    fast, plain = (Objective(cars, Penalties(), 0.0, compiled=way) for way in (True, False))
    views = virtual_views(virtual, DEPTH_LIMIT_M, 0.0)
    document = {
        "boxes": arguments.boxes,
        "triples": sum(rig.pairs for rig in fast(virtual, DEPTH_LIMIT_M).rigs),
        "evaluation_ms": median_ms(lambda: fast(virtual, DEPTH_LIMIT_M), arguments.rounds),
        "errors_ms": median_ms(lambda: fast.corner_sums(views), arguments.rounds),
        "filled_ms": median_ms(lambda: fast.filled(views), arguments.rounds),
        "plain_ms": median_ms(lambda: plain(virtual, DEPTH_LIMIT_M), 2),
    }
    print(json.dumps(document))


if __name__ == "__main__":
    main()
