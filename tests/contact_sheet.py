"""A contact sheet of one sample: the source's cameras above, the virtual ones with their boxes below.

`python -m tests.contact_sheet SRC DST OUT.jpg [--version NAME] [--sample N] [--width PX] [--no-boxes]`
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.geometry_utils import BoxVisibility, view_points

EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
ROWS = (("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT"), ("CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT"))
NEAR_M = 0.1


def draw_box(
    picture: np.ndarray, corners_cam: np.ndarray, intrinsic: np.ndarray, colour: tuple[int, int, int]
) -> None:
    """Draws the edges of a box (3, 8, camera frame) that lie in front of the camera."""
    for start, end in EDGES:
        a, b = corners_cam[:, start], corners_cam[:, end]
        if max(a[2], b[2]) < NEAR_M:
            continue
        if min(a[2], b[2]) < NEAR_M:
            near, far = (a, b) if a[2] < b[2] else (b, a)
            cut = far + (near - far) * (far[2] - NEAR_M) / (far[2] - near[2])
            a, b = cut, far
        line = view_points(np.stack([a, b], axis=1), intrinsic, normalize=True)[:2].T
        ends = [tuple(int(v) for v in np.clip(np.rint(point), -30_000, 30_000)) for point in line]
        cv2.line(picture, ends[0], ends[1], colour, max(picture.shape[1] // 500, 1), cv2.LINE_AA)


def pictures(nusc: NuScenes, sample: dict, width_px: int, boxes: bool) -> Iterator[np.ndarray]:
    """Rows of three pictures each, scaled to `width_px`, with their channel names and boxes."""
    channels = [
        c for c in sample["data"] if nusc.get("sample_data", sample["data"][c])["sensor_modality"] == "camera"
    ]
    known = [c for row in ROWS for c in row]
    order = known if set(known) == set(channels) else sorted(channels)
    for first in range(0, len(order), 3):
        row = []
        for channel in order[first : first + 3]:
            path, seen, intrinsic = nusc.get_sample_data(sample["data"][channel], BoxVisibility.ANY)
            picture = cv2.imread(path)
            for box in seen if boxes else ():
                colour = (60, 200, 255) if "vehicle" in box.name or box.name in ("Car", "Truck") else (90, 255, 90)
                draw_box(picture, box.corners(), intrinsic, colour)
            height_px = round(width_px * picture.shape[0] / picture.shape[1])
            picture = cv2.resize(picture, (width_px, height_px), interpolation=cv2.INTER_AREA)
            cv2.putText(picture, channel, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 3, cv2.LINE_AA)
            cv2.putText(picture, channel, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
            row.append(picture)
        height_px = max(picture.shape[0] for picture in row)
        row += [np.zeros((height_px, width_px, 3), np.uint8)] * (3 - len(row))
        yield np.hstack([np.pad(p, ((0, height_px - p.shape[0]), (0, 0), (0, 0))) for p in row])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("src", type=Path)
    parser.add_argument("dst", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--version", default="v1.0-trainval")
    parser.add_argument("--sample", type=int, default=0)
    parser.add_argument("--width", type=int, default=480)
    parser.add_argument("--no-boxes", action="store_true")
    chosen = parser.parse_args()
    before = NuScenes(chosen.version, str(chosen.src), verbose=False)
    after = NuScenes(chosen.version, str(chosen.dst), verbose=False)
    token = after.sample[chosen.sample]["token"]
    bands = [*pictures(before, before.get("sample", token), chosen.width, False)]
    bands.append(np.full((8, 3 * chosen.width, 3), 255, np.uint8))
    bands.extend(pictures(after, after.get("sample", token), chosen.width, not chosen.no_boxes))
    cv2.imwrite(str(chosen.out), np.vstack(bands))


if __name__ == "__main__":
    main()
