"""`unidrive optimize-rig`: rigs and datasets as cars, the rig file, Ctrl-C, exit codes."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from tests.datasets import SCRIPT, Bench, paint, unidrive
from unidrive_cli.rig.yaml_file import load_rig

SEARCH = """\
name: found
start: intuitive-6
mirror: {CAM_FRONT_RIGHT: CAM_FRONT_LEFT, CAM_BACK_RIGHT: CAM_BACK_LEFT}
free:
  - {of: x, cameras: all, share: true, min: 0, max: 2.5, step: 0.1}
  - {of: hfov, cameras: all, share: true, min: 60, max: 90, step: 1}
  - {of: depth_limit, min: 20, max: 80, step: 5}
evaluations: 40
"""


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return paint(tmp_path_factory.mktemp("painted") / "drive", samples=2)


@pytest.fixture
def search(tmp_path: Path) -> Path:
    path = tmp_path / "search.yaml"
    path.write_text(SEARCH)
    return path


def test_rigs_on_borrowed_boxes(drive: Path, search: Path, tmp_path: Path) -> None:
    out = tmp_path / "rig.yaml"
    run = unidrive("optimize-rig", "4x95", "5x70+110", "--boxes", drive, "--search", search, "--out", out, "--json")
    assert run.code == 0, run.stderr
    document = run.json()
    assert document["schema_version"] == 1
    assert document["corners"] == "own"
    assert [rig["name"] for rig in document["found"]["by_rig"]] == ["4x95", "5x70+110"]
    assert document["found"]["objective"] < document["start"]["objective"]
    assert not document["interrupted"]
    rig = load_rig(out)
    assert (rig.name, rig.depth_limit_m) == ("found", document["depth_limit"])
    head = out.read_text()
    for words in ("optimize-rig", "from intuitive-6: seed 0", "4x95 (", "5x70+110 ("):
        assert words in head
    assert unidrive("inspect-rig", out).code == 0


def test_corners_that_all_cars_see(drive: Path, search: Path, tmp_path: Path) -> None:
    search.write_text(f"{SEARCH}corners: common\n")
    command = ("optimize-rig", "4x95", "6x60", "--boxes", drive, "--search", search, "--evaluations", 8)
    run = unidrive(*command, "--out", tmp_path / "rig.yaml", "--json")
    assert run.code == 0, run.stderr
    document = run.json()
    assert document["corners"] == "common"
    corners = [rig["corners"] for rig in document["found"]["by_rig"]]
    assert corners[0] == corners[1] > 0
    said = unidrive(*command, "--out", tmp_path / "other.yaml")
    assert "common corners that no virtual camera sees: " in said.stdout


def test_a_dataset_brings_its_own_boxes(drive: Path, search: Path, tmp_path: Path) -> None:
    out = tmp_path / "rig.yaml"
    run = unidrive("optimize-rig", drive, "--search", search, "--out", out, "--evaluations", 8)
    assert run.code == 0, run.stderr
    assert "drive" in run.stdout
    assert "objective: " in run.stdout
    capped = unidrive(
        "optimize-rig",
        drive,
        "--search",
        search,
        "--out",
        out,
        "--evaluations",
        8,
        "--max-boxes",
        1,
        "--force",
        "--json",
    )
    assert 0 < capped.json()["found"]["by_rig"][0]["corners"] <= 8


def test_the_same_seed_the_same_bytes_whatever_the_jobs(drive: Path, search: Path, tmp_path: Path) -> None:
    texts = []
    for jobs, seed in ((0, 5), (2, 5), (0, 6)):
        out = tmp_path / f"{jobs}-{seed}.yaml"
        run = unidrive(
            "optimize-rig",
            "4x95",
            "--boxes",
            drive,
            "--search",
            search,
            "--out",
            out,
            "--jobs",
            jobs,
            "--seed",
            seed,
        )
        assert run.code == 0, run.stderr
        texts.append(out.read_text())
    assert texts[0] == texts[1]
    assert texts[0] != texts[2]


def test_ctrl_c_keeps_the_best_and_resume_ends_as_if_nothing_had_been(
    drive: Path, search: Path, tmp_path: Path
) -> None:
    search.write_text(SEARCH.replace("evaluations: 40", "evaluations: 4000"))
    out, log = tmp_path / "rig.yaml", tmp_path / "rig.yaml.search.jsonl"
    command = ("optimize-rig", "4x95", "5x75", "--boxes", drive, "--search", search, "--out", out, "--jobs", 1)
    process = subprocess.Popen([SCRIPT, *map(str, command)], stderr=subprocess.PIPE, text=True)
    while not (log.exists() and log.read_bytes().count(b"\n") > 3):
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert f"interrupted: {out} is the best so far; --resume continues" in said
    assert load_rig(out).name == "found"
    assert "interrupted" in out.read_text()
    done = sum(len(json.loads(line)) for line in log.read_text().splitlines()[1:])
    total = ("--evaluations", done + 20)
    resumed = unidrive(*command, *total, "--resume")
    assert resumed.code == 0, resumed.stderr
    other = tmp_path / "other.yaml"
    undisturbed = unidrive(*command, *total, "--out", other)
    assert undisturbed.code == 0, undisturbed.stderr
    assert other.read_bytes() == out.read_bytes()


def refused(code: int, words: str, *arguments: object) -> None:
    run = unidrive("optimize-rig", *arguments)
    assert run.code == code, run.stderr
    assert words in run.stderr
    assert run.stdout == ""


def test_refusals(drive: Path, search: Path, tmp_path: Path) -> None:
    out = tmp_path / "rig.yaml"
    rest = ("--search", search, "--out", out)
    refused(2, "4x95 has no boxes. Give a dataset that has some with --boxes.", "4x95", *rest)
    refused(2, "Did you mean 4x95?", "4x96", "--boxes", drive, *rest)
    refused(2, "--max-boxes must be at least 1", drive, *rest, "--max-boxes", 0)
    refused(2, "evaluations must be at least 1", drive, *rest, "--evaluations", 0)
    refused(3, "holds no version folder", tmp_path, *rest)
    refused(2, "cannot be read", drive, "--search", tmp_path / "nowhere.yaml", "--out", out)
    refused(4, "cannot be written", drive, "--search", search, "--out", tmp_path / "nowhere" / "rig.yaml")
    assert not out.exists()
    out.write_text("mine")
    refused(4, "exists. --resume continues its search, --force replaces it.", drive, *rest)
    assert out.read_text() == "mine"
    out.rename(tmp_path / "rig.yaml.search.jsonl")
    refused(4, "rig.yaml.search.jsonl: exists. --resume continues its search, --force replaces it.", drive, *rest)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("{of: x, cameras: all, share: true, min: 0, max: 2.5", "{of: z, cameras: all, share: true, min: 0, max: 2",
         "the bounds let a virtual camera stand at 0 m; the ground is at 0 m. Raise the lower bound of z."),
        ("min: 20, max: 80", "min: 1, max: 80", "the bounds let the depth limit be 1 m"),
        ("min: 0, max: 2.5", "min: -60, max: 2.5", "Raise the lower bound of depth_limit."),
    ],
)  # fmt: skip
def test_bounds_that_cannot_be(old: str, new: str, words: str, drive: Path, search: Path, tmp_path: Path) -> None:
    search.write_text(SEARCH.replace(old, new))
    refused(2, words, drive, "--search", search, "--out", tmp_path / "rig.yaml")
    assert not (tmp_path / "rig.yaml").exists()


def test_a_dataset_without_boxes(drive: Path, search: Path, bench: Bench, tmp_path: Path) -> None:
    for table in ("sample_annotation", "instance"):
        bench.table(table).write_text("[]")
    rest = ("--search", search, "--out", tmp_path / "found.yaml", "--evaluations", 8)
    refused(2, "has no boxes. Give a dataset that has some with --boxes.", bench.src, *rest)
    refused(3, "has no annotations, so there are no boxes to borrow", "4x95", "--boxes", bench.src, *rest)
    assert unidrive("optimize-rig", bench.src, "--boxes", drive, *rest).code == 0


@pytest.mark.parametrize(("table", "field"), [("ego_pose", "translation"), ("sample_annotation", "size")])
def test_lengths_that_are_none(table: str, field: str, search: Path, bench: Bench, tmp_path: Path) -> None:
    bench.edit(table, lambda found: found[0].update({field: [1e308, 1, 1]}))
    refused(3, f"{table}.json", bench.src, "--search", search, "--out", tmp_path / "found.yaml")
    refused(3, "metres", "4x95", "--boxes", bench.src, "--search", search, "--out", tmp_path / "found.yaml")


def test_boxes_that_nobody_sees(search: Path, bench: Bench, tmp_path: Path) -> None:
    def lift(found: list[dict[str, Any]]) -> None:
        for row in found:
            row["translation"][2] = 900.0

    bench.edit("sample_annotation", lift)
    refused(2, "sees any of the", bench.src, "--search", search, "--out", tmp_path / "rig.yaml")


def test_fewer_candidates_than_there_are(drive: Path, search: Path, tmp_path: Path) -> None:
    """The rig that is there is the best of them all."""
    command = ("optimize-rig", "4x95", "--boxes", drive, "--search", search, "--out", tmp_path / "rig.yaml")
    assert unidrive(*command, "--evaluations", 30).code == 0
    before = (tmp_path / "rig.yaml").read_bytes()
    refused(
        2, "candidates; 8 would be fewer. Ask for as many, or more.", *command[1:], "--resume", "--evaluations", 8
    )
    assert (tmp_path / "rig.yaml").read_bytes() == before
