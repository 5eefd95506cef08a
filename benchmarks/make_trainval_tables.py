"""Tables of the size of nuScenes trainval: 34,149 samples in 850 scenes, 2,631,083 sample_data rows, and so on.

    python benchmarks/make_trainval_tables.py OUT [--scale S] [--files none|keyframes|all] [--seed N]

Writes OUT/v1.0-trainval with all 13 tables in nuScenes' own row shapes, key order and text (one number a line),
links and counts honest, sweeps included. What they hold is made up, and the same bytes for the same scale and
seed; their rows lie by scene, channel and time. `--scale` makes that share of the scenes.

There are no pictures to see. A conversion's plan asks the disk for every camera key frame's file, its size and the
first kilobytes of one per calibration: `--files keyframes` (default) gives each of them a hard link to a black JPEG,
and leaves out the files of other sensors, about whose names the plan only asks whether they are links. `--files all`
makes links for every row except sweeps of cameras, and takes longer to make and to remove.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

VERSION = "v1.0-trainval"
SCENES, SAMPLES, SAMPLE_DATA = 850, 34_149, 2_631_083
ANNOTATIONS, INSTANCES, LOGS = 1_166_187, 64_386, 68
CAMERAS = ("CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_FRONT_LEFT")
RADARS = ("RADAR_FRONT", "RADAR_FRONT_LEFT", "RADAR_FRONT_RIGHT", "RADAR_BACK_LEFT", "RADAR_BACK_RIGHT")
CHANNELS = (*CAMERAS, "LIDAR_TOP", *RADARS)
YAW_DEG = {
    **dict(zip(CAMERAS, (0.0, -55.0, -110.0, 180.0, 110.0, 55.0), strict=True)),
    "LIDAR_TOP": -90.0,
    **dict(zip(RADARS, (0.0, 90.0, -90.0, 175.0, -175.0), strict=True)),
}
FIRES_US = {channel: 8_000 * (index - 5) for index, channel in enumerate(CAMERAS)}
"""When a key frame of a channel is taken, after the sample's time, microseconds."""
SWEEPS = {"CAM": 5, "LID": 9, "RAD": 5}
"""Sweeps between two key frames; the radars' sixth is there as often as the number of rows asks for it."""
LINKS_PER_FILE = 60_000
"""Below what ext4 allows."""
CATEGORIES = (
    "noise",
    "animal",
    "human.pedestrian.adult",
    "human.pedestrian.child",
    "human.pedestrian.construction_worker",
    "human.pedestrian.personal_mobility",
    "human.pedestrian.police_officer",
    "human.pedestrian.stroller",
    "human.pedestrian.wheelchair",
    "movable_object.barrier",
    "movable_object.debris",
    "movable_object.pushable_pullable",
    "movable_object.trafficcone",
    "static_object.bicycle_rack",
    "vehicle.bicycle",
    "vehicle.bus.bendy",
    "vehicle.bus.rigid",
    "vehicle.car",
    "vehicle.construction",
    "vehicle.emergency.ambulance",
    "vehicle.emergency.police",
    "vehicle.motorcycle",
    "vehicle.trailer",
    "vehicle.truck",
    "flat.driveable_surface",
    "flat.other",
    "flat.sidewalk",
    "flat.terrain",
    "static.manmade",
    "static.other",
    "static.vegetation",
    "vehicle.ego",
)
ATTRIBUTES = [
    "vehicle.moving",
    "vehicle.stopped",
    "vehicle.parked",
    "cycle.with_rider",
    "cycle.without_rider",
    "pedestrian.sitting_lying_down",
    "pedestrian.standing",
    "pedestrian.moving",
]
LOCATIONS = ("singapore-onenorth", "singapore-hollandvillage", "singapore-queenstown", "boston-seaport")


class Writer:
    """A table as nuScenes writes it: `json.dump(rows, indent=0)`."""

    def __init__(self, folder: Path, name: str) -> None:
        self._stream = (folder / f"{name}.json").open("w", encoding="ascii", buffering=1 << 20)
        self._first = True

    def text(self, rows: list[str]) -> None:
        """Rows that are JSON text already."""
        if rows:
            self._stream.write(("[\n" if self._first else ",\n") + ",\n".join(rows))
            self._first = False

    def rows(self, rows: list[dict[str, Any]]) -> None:
        self.text([json.dumps(row, indent=0) for row in rows])

    def close(self) -> None:
        self._stream.write("[]" if self._first else "\n]")
        self._stream.close()


def shares(total: int, parts: int) -> list[int]:
    """`total` in `parts` whole numbers that differ by one at most."""
    edges = [total * part // parts for part in range(parts + 1)]
    return [after - before for before, after in itertools.pairwise(edges)]


class Maker:
    """Makes the tables, scene by scene."""

    def __init__(self, root: Path, scale: float, seed: int, files: str) -> None:
        self._random = np.random.default_rng(seed)
        self._root, self._files = root, files
        self._folder = root / VERSION
        self._folder.mkdir(parents=True)
        self._scenes = max(round(SCENES * scale), 1)
        self._samples = shares(max(round(SAMPLES * scale), 2 * self._scenes), self._scenes)
        gaps = sum(count - 1 for count in self._samples)
        fixed = len(CHANNELS) * sum(self._samples) + gaps * sum(SWEEPS[channel[:3]] for channel in CHANNELS)
        extra = min(max(round(SAMPLE_DATA * scale) - fixed, 0), gaps * len(RADARS))
        self._extra_sweeps = iter(shares(extra, gaps * len(RADARS)))
        self._annotations = shares(round(ANNOTATIONS * scale), self._scenes)
        self._instances = shares(round(INSTANCES * scale), self._scenes)
        self._tables = {name: Writer(self._folder, name) for name in TABLES}
        self._inode, self._links = Path(), LINKS_PER_FILE

    def make(self) -> None:
        self._small_tables()
        for index in range(self._scenes):
            self._scene(index)
        for table in self._tables.values():
            table.close()

    def _tokens(self, count: int) -> list[str]:
        text = self._random.bytes(16 * count).hex()
        return [text[start : start + 32] for start in range(0, 32 * count, 32)]

    def _small_tables(self) -> None:
        self._sensors = dict(zip(CHANNELS, self._tokens(len(CHANNELS)), strict=True))
        kinds = {"CAM": "camera", "LID": "lidar", "RAD": "radar"}
        self._tables["sensor"].rows(
            [
                {"token": token, "channel": channel, "modality": kinds[channel[:3]]}
                for channel, token in self._sensors.items()
            ]
        )
        self._categories = self._tokens(len(CATEGORIES))
        self._tables["category"].rows(
            [
                {"token": token, "name": name, "description": f"Made up: {name}.", "index": index}
                for index, (token, name) in enumerate(zip(self._categories, CATEGORIES, strict=True))
            ]
        )
        self._attributes = self._tokens(len(ATTRIBUTES))
        self._tables["attribute"].rows(
            [
                {"token": token, "name": name, "description": f"Made up: {name}."}
                for token, name in zip(self._attributes, ATTRIBUTES, strict=True)
            ]
        )
        bands = (("1", "0", "40"), ("2", "40", "60"), ("3", "60", "80"), ("4", "80", "100"))
        self._tables["visibility"].rows(
            [
                {
                    "description": f"visibility of whole object is between {low} and {high}%",
                    "token": token,
                    "level": f"v{low}-{high}",
                }
                for token, low, high in bands
            ]
        )
        logs = min(LOGS, self._scenes)
        self._logs = self._tokens(logs)
        self._logfiles = [f"n{5 + index % 9:03}-2018-{1 + index // 28:02}-{1 + index % 28:02}-11-22-45+0800"
                          for index in range(logs)]  # fmt: skip
        self._tables["log"].rows(
            [
                {
                    "token": token,
                    "logfile": logfile,
                    "vehicle": logfile[:4],
                    "date_captured": logfile[5:15],
                    "location": LOCATIONS[index % len(LOCATIONS)],
                }
                for index, (token, logfile) in enumerate(zip(self._logs, self._logfiles, strict=True))
            ]
        )
        maps = self._tokens(len(LOCATIONS))
        self._tables["map"].rows(
            [
                {
                    "category": "semantic_prior",
                    "token": token,
                    "filename": f"maps/{token}.png",
                    "log_tokens": self._logs[index :: len(LOCATIONS)],
                }
                for index, token in enumerate(maps)
            ]
        )
        (self._root / "maps").mkdir()
        for token in maps:
            cv2.imwrite(str(self._root / "maps" / f"{token}.png"), np.zeros((10, 10), np.uint8))
        self._rigs = [[self._calibration(channel) for channel in CHANNELS] for _ in range(3)]

    def _calibration(self, channel: str) -> dict[str, Any]:
        """All of a calibrated_sensor row but its tokens."""
        camera = channel.startswith("CAM")
        half = np.radians(YAW_DEG[channel]) / 2
        rotation = np.array([np.cos(half), 0, 0, np.sin(half)])
        if camera:
            w, z = rotation[0], rotation[3]
            rotation = np.array([w + z, z - w, w - z, -w - z]) / 2
        rotation += self._random.normal(0, 0.003, 4)
        rotation /= np.linalg.norm(rotation)
        translation = np.array([1.0, 0.0, 1.5]) + self._random.normal(0, 0.1, 3)
        focal, cx, cy = self._random.normal((1260, 810, 495), (10, 8, 5)).tolist()
        return {
            "translation": [round(number, 11) for number in translation.tolist()],
            "rotation": rotation.tolist(),
            "camera_intrinsic": [[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]] if camera else [],
        }

    def _scene(self, index: int) -> None:
        count = self._samples[index]
        token, log = self._tokens(1)[0], index * len(self._logs) // self._scenes
        start_us = 1_532_402_000_000_000 + 60_000_000 * index
        times_us = start_us + 500_000 * np.arange(count)
        samples = self._tokens(count)
        before, after = ["", *samples[:-1]], [*samples[1:], ""]
        self._tables["scene"].rows(
            [
                {
                    "token": token,
                    "log_token": self._logs[log],
                    "nbr_samples": count,
                    "first_sample_token": samples[0],
                    "last_sample_token": samples[-1],
                    "name": f"scene-{index + 1:04}",
                    "description": "Made up, parked cars, turn left",
                }
            ]
        )
        self._tables["sample"].rows(
            [
                {"token": own, "timestamp": time, "prev": prev, "next": following, "scene_token": token}
                for own, time, prev, following in zip(samples, times_us.tolist(), before, after, strict=True)
            ]
        )
        heading, speed = self._random.uniform(0, 2 * np.pi), self._random.uniform(0, 12)
        centre = self._random.uniform(300, 2000, 2)
        for channel, calibration in zip(CHANNELS, self._tokens(len(CHANNELS)), strict=True):
            content = self._rigs[index % len(self._rigs)][CHANNELS.index(channel)]
            self._tables["calibrated_sensor"].rows(
                [{"token": calibration, "sensor_token": self._sensors[channel], **content}]
            )
            self._channel(channel, calibration, self._logfiles[log], samples, times_us, (centre, heading, speed))
        self._boxes(index, samples, centre)

    def _channel(
        self,
        channel: str,
        calibration: str,
        logfile: str,
        samples: list[str],
        times_us: np.ndarray,
        drive: tuple[np.ndarray, float, float],
    ) -> None:
        """sample_data and ego_pose rows of one channel in one scene."""
        clocks, owners, keys = [], [], []
        for place, time in enumerate(times_us.tolist()):
            sweeps = 0
            if place:
                sweeps = SWEEPS[channel[:3]] + (next(self._extra_sweeps) if channel in RADARS else 0)
            step = 500_000 / (sweeps + 1)
            shift = FIRES_US.get(channel, 0)
            clocks += [round(time + shift - step * back) for back in range(sweeps, -1, -1)]
            owners += [samples[place]] * (sweeps + 1)
            keys += [False] * sweeps + [True]
        tokens = self._tokens(len(clocks))
        suffix, kind, height, width = (
            ("jpg", "jpg", 900, 1600) if channel in CAMERAS else ("pcd.bin", "pcd", 0, 0)
            if channel == "LIDAR_TOP" else ("pcd", "pcd", 0, 0)
        )  # fmt: skip
        tail = f"/{channel}/{logfile}__{channel}__"
        names = [f"{'samples' if key else 'sweeps'}{tail}{clock}.{suffix}"
                 for key, clock in zip(keys, clocks, strict=True)]  # fmt: skip
        self._tables["sample_data"].text(
            [
                f'{{\n"token": "{token}",\n"sample_token": "{owner}",\n"ego_pose_token": "{token}",\n'
                f'"calibrated_sensor_token": "{calibration}",\n"timestamp": {clock},\n"fileformat": "{kind}",\n'
                f'"is_key_frame": {"true" if key else "false"},\n"height": {height},\n"width": {width},\n'
                f'"filename": "{name}",\n"prev": "{prev}",\n"next": "{following}"\n}}'
                for token, owner, clock, key, name, prev, following in zip(
                    tokens, owners, clocks, keys, names, ["", *tokens[:-1]], [*tokens[1:], ""], strict=True
                )
            ]
        )
        self._ego_poses(tokens, clocks, drive, int(times_us[0]))
        for name, key in zip(names, keys, strict=True):
            if (self._files == "all" and (key or channel not in CAMERAS)) or (
                self._files == "keyframes" and key and channel in CAMERAS
            ):  # fmt: skip
                self._link(name)

    def _ego_poses(
        self, tokens: list[str], clocks: list[int], drive: tuple[np.ndarray, float, float], start_us: int
    ) -> None:
        centre, heading, speed = drive
        seconds = (np.array(clocks) - start_us) / 1e6
        yaw = heading + 0.02 * seconds
        noise = self._random.normal(0, 0.002, (len(clocks), 2))
        rotations = np.column_stack([np.cos(yaw / 2), noise, np.sin(yaw / 2)])
        rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
        places = centre + speed * seconds[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
        self._tables["ego_pose"].text(
            [
                f'{{\n"token": "{token}",\n"timestamp": {clock},\n"rotation": [\n{w!r},\n{x!r},\n{y!r},\n{z!r}\n],\n'
                f'"translation": [\n{px!r},\n{py!r},\n0.0\n]\n}}'
                for token, clock, (w, x, y, z), (px, py) in zip(
                    tokens, clocks, rotations.tolist(), places.tolist(), strict=True
                )
            ]
        )

    def _boxes(self, index: int, samples: list[str], centre: np.ndarray) -> None:
        """Instances with their annotations in consecutive samples."""
        lengths = self._lengths(self._annotations[index], self._instances[index], len(samples))
        rows: list[tuple[int, str]] = []
        instances = []
        for length, token in zip(lengths, self._tokens(len(lengths)), strict=True):
            first = int(self._random.integers(0, len(samples) - length + 1))
            tokens = self._tokens(length)
            kind = int(self._random.integers(1, 24))
            instances.append(
                {
                    "token": token,
                    "category_token": self._categories[kind],
                    "nbr_annotations": length,
                    "first_annotation_token": tokens[0],
                    "last_annotation_token": tokens[-1],
                }
            )
            rows += self._annotation_rows(samples, centre, token, tokens, first)
        rows.sort(key=lambda row: row[0])
        self._tables["instance"].rows(instances)
        self._tables["sample_annotation"].text([text for _, text in rows])

    def _annotation_rows(
        self, samples: list[str], centre: np.ndarray, instance: str, tokens: list[str], first: int
    ) -> Iterator[tuple[int, str]]:
        count = len(tokens)
        size = [round(number, 3) for number in self._random.uniform((0.6, 0.6, 1), (2.2, 5, 2.2)).tolist()]
        x, y = (centre + self._random.uniform(-50, 50, 2) + self._random.normal(0, 0.3, (count, 2))).T.tolist()
        z = self._random.uniform(0.5, 2)
        yaw = self._random.uniform(0, np.pi)
        w, up = float(np.cos(yaw / 2)), float(np.sin(yaw / 2))
        attribute = f'[\n"{self._attributes[int(self._random.integers(0, 8))]}"\n]'
        seen = self._random.integers(1, 5, count).tolist()
        lidar = self._random.geometric(0.08, count).tolist()
        for place, token in enumerate(tokens):
            prev = tokens[place - 1] if place else ""
            following = tokens[place + 1] if place + 1 < count else ""
            yield (
                first + place,
                f'{{\n"token": "{token}",\n"sample_token": "{samples[first + place]}",\n'
                f'"instance_token": "{instance}",\n"visibility_token": "{seen[place]}",\n'
                f'"attribute_tokens": {attribute},\n"translation": [\n{x[place]!r},\n{y[place]!r},\n{z!r}\n],\n'
                f'"size": [\n{size[0]!r},\n{size[1]!r},\n{size[2]!r}\n],\n'
                f'"rotation": [\n{w!r},\n0.0,\n0.0,\n{up!r}\n],\n"prev": "{prev}",\n"next": "{following}",\n'
                f'"num_lidar_pts": {lidar[place]},\n"num_radar_pts": {lidar[place] % 3}\n}}',
            )

    def _lengths(self, total: int, count: int, most: int) -> list[int]:
        """How many annotations each instance has: from 1 to `most`, `total` together."""
        lengths = np.ones(count, dtype=np.int64)
        rest = total - count
        while rest > 0:
            open_to_more = np.flatnonzero(lengths < most)
            chosen = open_to_more[self._random.integers(0, len(open_to_more), max(min(rest, count) // 2, 1))]
            grown = np.minimum(lengths[chosen] + 1 + self._random.integers(0, 6), most)
            for instance, length in zip(chosen.tolist(), grown.tolist(), strict=True):
                step = min(length - int(lengths[instance]), rest)
                if step > 0:
                    lengths[instance] += step
                    rest -= step
        return [int(length) for length in lengths]

    def _link(self, name: str) -> None:
        if self._links >= LINKS_PER_FILE:
            self._inode = self._root / "linked" / f"{len(list((self._root / 'linked').glob('*')))}.jpg"
            self._inode.parent.mkdir(exist_ok=True)
            cv2.imwrite(str(self._inode), np.zeros((900, 1600), np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 10])
            self._links = 0
        path = f"{self._root}/{name}"
        try:
            os.link(self._inode, path)
        except FileNotFoundError:
            os.makedirs(os.path.dirname(path), exist_ok=True)  # noqa: PTH103, PTH120
            os.link(self._inode, path)
        self._links += 1


TABLES = [
    "attribute",
    "calibrated_sensor",
    "category",
    "ego_pose",
    "instance",
    "log",
    "map",
    "sample",
    "sample_annotation",
    "sample_data",
    "scene",
    "sensor",
    "visibility",
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--files", default="keyframes", choices=("none", "keyframes", "all"))
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    if chosen.out.exists():
        parser.error(f"{chosen.out} exists")
    Maker(chosen.out, chosen.scale, chosen.seed, chosen.files).make()


if __name__ == "__main__":
    main()
