"""For the tests of the commands: a tiny painted dataset to break, a tiny rig, and the real command line."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from nuscenes.nuscenes import NuScenes
from typer.main import get_command
from typer.testing import CliRunner

from tests.painted import nuscenes_like_cameras, write_painted
from unidrive_cli.cli.main import app

Row = dict[str, Any]
VERSION = "v1.0-mini"
SCRIPT = str(Path(sys.executable).with_name("unidrive"))
"""The console script of the environment that runs the tests."""
SMALL_RIG = """\
name: small
cameras:
  CAM_FRONT: {width: 64, height: 36, hfov: 80, position: [1.5, 0.0, 1.6], yaw: 0}
  CAM_BACK: {width: 64, height: 36, hfov: 80, position: [0.0, 0.0, 1.6], yaw: 180}
"""
COMMAND = get_command(app)
"""Built once: that takes longer than most refusals."""
CHANNELS = ("CAM_FRONT", "CAM_BACK")


@dataclass(frozen=True)
class Run:
    """How a command ended, whichever way it was started."""

    code: int
    stdout: str
    stderr: str

    @property
    def said(self) -> str:
        """stderr as one line: usage errors come in a box, wrapped to the terminal."""
        return " ".join(self.stderr.replace("│", " ").split())

    def json(self) -> Any:
        """The one object on stdout."""
        return json.loads(self.stdout)


def paint(root: Path, *, scenes: int = 1, samples: int = 3) -> Path:
    """A painted drive of 80x45 pixels a picture."""
    write_painted(root, cameras=nuscenes_like_cameras(0.05), scenes=scenes, samples_per_scene=samples, supersample=1)
    return root


def unidrive(*arguments: object, env: Mapping[str, str | None] | None = None) -> Run:
    """Runs the command line in this process; a traceback or an `unexpected` error is a failure."""
    with CliRunner().isolation(env=env) as (stdout, stderr, *_):
        with pytest.raises(SystemExit) as end:
            COMMAND.main([str(argument) for argument in arguments], prog_name="unidrive")
        sys.stdout.flush()
        sys.stderr.flush()
        run = Run(end.value.code or 0, stdout.getvalue().decode(), stderr.getvalue().decode())  # type: ignore[arg-type]
    _assert_sentences(run.stderr)
    return run


def spawn(
    *arguments: object, cwd: Path | None = None, prefix: tuple[str, ...] = (), timeout: float = 60, **more: Any
) -> Run:
    """Runs the console script in a process of its own."""
    command = [*prefix, SCRIPT, *map(str, arguments)]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=timeout, check=False, **more)
    _assert_sentences(done.stderr)
    return Run(done.returncode, done.stdout, done.stderr)


def _assert_sentences(stderr: str) -> None:
    """No traceback, no warning of a library, and not the sentence for what nobody thought of."""
    for sign in ("Traceback", "unidrive: unexpected ", "Warning: "):
        assert sign not in stderr, stderr


def tree(root: Path, apart: tuple[str, ...] = ()) -> dict[str, str]:
    """What every path below a folder is: a digest, a link's target, or a folder."""
    found = {}
    for path in sorted(root.rglob("*")):
        name = path.relative_to(root).as_posix()
        if path.is_symlink():
            found[name] = f"-> {path.readlink()}"
        elif path.is_file():
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        else:
            found[name] = "folder" if path.is_dir() else "special"
    return {name: what for name, what in found.items() if name.split("/")[0] not in apart}


def rows(root: Path, table: str, version: str = VERSION) -> list[Row]:
    """The rows of a table."""
    found: list[Row] = json.loads((root / version / f"{table}.json").read_text())
    return found


def rows_of(root: Path, modality: str) -> list[Row]:
    """The sample_data rows of the sensors of one modality."""
    sensors = {row["token"] for row in rows(root, "sensor") if row["modality"] == modality}
    calibrations = {row["token"] for row in rows(root, "calibrated_sensor") if row["sensor_token"] in sensors}
    return [row for row in rows(root, "sample_data") if row["calibrated_sensor_token"] in calibrations]


class Bench:
    """An empty folder with a dataset to break (`src`), a rig file and a destination, and the command line.

    Every run checks that SRC stays as it was, and that nothing but DST appears in the folder.
    """

    def __init__(self, folder: Path, painted: Path) -> None:
        self.folder = folder
        self.src = Path(shutil.copytree(painted, folder / "src"))
        self.dst = folder / "dst"
        self.rig = folder / "rig.yaml"
        self.rig.write_text(SMALL_RIG)

    def edit(self, table: str, change: Callable[[list[Row]], object]) -> None:
        """Changes the rows of a table of SRC in place."""
        found = rows(self.src, table)
        change(found)
        self.table(table).write_text(json.dumps(found))

    def table(self, name: str) -> Path:
        """The file of a table of SRC."""
        return self.src / VERSION / f"{name}.json"

    def picture(self, sample: int = 0, channel: str = "CAM_FRONT") -> Path:
        """A picture of SRC."""
        names = sorted(row["filename"] for row in rows_of(self.src, "camera") if f"/{channel}/" in row["filename"])
        return self.src / names[sample]

    def convert(
        self,
        *options: object,
        src: Path | None = None,
        dst: Path | None = None,
        rig: object = None,
        env: Mapping[str, str | None] | None = None,
    ) -> Run:
        """Runs `unidrive convert` in this process."""
        target = self.dst if dst is None else dst
        before, around = tree(self.src), self._around(target)
        jobs = () if "--jobs" in options or "--config" in options else ("--jobs", 0)
        arguments = (self.src if src is None else src, target, "--rig", rig or self.rig, *jobs, *options)
        run = unidrive("convert", *arguments, env=env)
        assert tree(self.src) == before, "SRC was changed"
        assert self._around(target) == around, "something was written outside of DST"
        return run

    def refused(self, code: int, *words: str, **how: Any) -> Run:
        """Runs `convert`, which must stop with an exit code and a sentence with these words, and write nothing."""
        target = how.get("dst") or self.dst
        existed, before = os.path.exists(target), tree(target)  # noqa: PTH110 (a name may be too long for Path)
        run = self.convert(*how.pop("options", ()), **how)
        assert run.code == code, run.stdout + run.stderr
        for word in words:
            assert word in run.said, f"{word!r} is not in {run.said!r}"
        assert run.stdout == ""
        assert tree(target) == before, "DST was touched"
        assert os.path.exists(target) == existed  # noqa: PTH110
        return run

    def converted(self, *options: object, **how: Any) -> Run:
        """Runs `convert`, which must finish; the devkit must open what it wrote."""
        run = self.convert(*options, **how)
        assert run.code == 0, run.stdout + run.stderr
        assert_consistent(how.get("dst") or self.dst)
        return run

    def _around(self, target: Path) -> dict[str, str]:
        inside = target.is_relative_to(self.folder) and target != self.folder
        known = (target.relative_to(self.folder).parts[0],) if inside else ()
        return tree(self.folder, apart=(self.src.name, *known))


def assert_consistent(root: Path, version: str = VERSION) -> NuScenes:
    """Opens a finished dataset with nuscenes-devkit and walks every chain in it, there and back."""
    assert not (root / "UNFINISHED.txt").exists()
    assert not (root / ".unidrive").exists()
    assert not list(root.rglob("*.part"))
    nusc = NuScenes(version=version, dataroot=str(root), verbose=False)

    def chain(table: str, token: str) -> list[Row]:
        walked: list[Row] = []
        while token:
            row = nusc.get(table, token)
            assert row["prev"] == (walked[-1]["token"] if walked else "")
            walked.append(row)
            token = row["next"]
        return walked

    walked = 0
    for scene in nusc.scene:
        samples = chain("sample", scene["first_sample_token"])
        assert [row["scene_token"] for row in samples] == [scene["token"]] * scene["nbr_samples"]
        assert samples[-1]["token"] == scene["last_sample_token"]
        walked += len(samples)
    assert walked == len(nusc.sample)
    annotated = 0
    for instance in nusc.instance:
        annotations = chain("sample_annotation", instance["first_annotation_token"])
        assert len(annotations) == instance["nbr_annotations"]
        assert (annotations[-1]["token"] if annotations else "") == instance["last_annotation_token"]
        annotated += len(annotations)
    assert annotated == len(nusc.sample_annotation)
    starts = [row["token"] for row in nusc.sample_data if not row["prev"]]
    assert sum(len(chain("sample_data", token)) for token in starts) == len(nusc.sample_data)
    for row in nusc.sample_data:
        assert nusc.get("sample", row["sample_token"])
        assert (root / row["filename"]).is_file()
        nusc.get("ego_pose", row["ego_pose_token"])
    for sample in nusc.sample:
        for token in sample["data"].values():
            nusc.get_sample_data(token)
    return nusc


def in_own_mounts(script: str, folder: Path) -> Run:
    """Runs a shell script in a mount namespace of its own."""
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-m", "true"], check=False).returncode:
        pytest.skip("no mount namespace can be made here")
    done = subprocess.run(
        ["unshare", "-m", "sh", "-ec", script],
        cwd=folder,
        env={**os.environ, "UNIDRIVE_KERNEL": "opencv"},  # the other one takes a second to load
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert "Traceback" not in done.stderr
    assert "unidrive: unexpected" not in done.stderr
    return Run(done.returncode, done.stdout, done.stderr)
