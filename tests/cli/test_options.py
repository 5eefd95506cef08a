"""Every option does what it says, and says what it does: on a painted drive of two scenes with two samples each."""

from __future__ import annotations

import json
import os
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.datasets import CHANNELS, SMALL_RIG, VERSION, Bench, rows, rows_of, tree, unidrive
from unidrive_cli import __version__
from unidrive_cli.cli import conversion

SCENES = ("scene-0061", "scene-0103")
SAMPLES = 4
CAMERAS = 6


def options_of(root: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((root / "unidrive.json").read_text())["plan"]["options"]
    return found


def pictures(root: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for channel in CHANNELS for path in (root / "samples" / channel).iterdir()}


# --- where a value comes from -----------------------------------------------------------------------------------


def test_flags_beat_variables_beat_the_config_file_beat_the_defaults(bench: Bench) -> None:
    config = bench.folder / "config.yaml"
    config.write_text("quality: 40\n")
    seen = []
    for index, (flags, env) in enumerate(
        [
            ((), {}),
            (("--config", config), {}),
            (("--config", config), {"UNIDRIVE_QUALITY": "50"}),
            (("--config", config, "--quality", 60), {"UNIDRIVE_QUALITY": "50"}),
            (("--quality", 60, "--config", config), {}),
            ((), {"UNIDRIVE_CONFIG": str(config)}),
            ((), {"UNIDRIVE_QUALITY": "50", "UNIDRIVE_CONFIG": str(config)}),
        ]
    ):
        dst = bench.folder / f"dst-{index}"
        run = bench.convert("--jobs", 0, *flags, dst=dst, env=env)
        assert run.code == 0, run.stderr
        seen.append(options_of(dst)["quality"])
    assert seen == [95, 40, 50, 60, 60, 40, 50]


def test_every_option_has_its_variable(bench: Bench) -> None:
    env = {
        "UNIDRIVE_RIG": "8x50",  # a flag is given, too
        "UNIDRIVE_DEPTH_LIMIT": "40",
        "UNIDRIVE_GROUND_HEIGHT": "0.1",
        "UNIDRIVE_BLEND": "nearest",
        "UNIDRIVE_EGO_MOTION": "false",
        "UNIDRIVE_ANTI_ALIAS": "false",
        "UNIDRIVE_EXPOSURE": "gain",
        "UNIDRIVE_SCENE": " ".join(reversed(SCENES)),
        "UNIDRIVE_SPLIT": "mini_val mini_train",
        "UNIDRIVE_MAX_SAMPLES": "3",
        "UNIDRIVE_CAMERA": "CAM_BACK CAM_FRONT",
        "UNIDRIVE_SWEEPS": "true",
        "UNIDRIVE_MASKS": "none",
        "UNIDRIVE_VISIBILITY": "keep",
        "UNIDRIVE_UNSEEN_BOXES": "drop",
        "UNIDRIVE_MIN_COVERAGE": "0.05",
        "UNIDRIVE_LOW_COVERAGE": "keep",
        "UNIDRIVE_VERSION": VERSION,
        "UNIDRIVE_LAYOUT": "nuscenes",
        "UNIDRIVE_OUTPUT_VERSION": VERSION,
    }
    bench.converted(env=env)
    assert options_of(bench.dst) == {
        "depth_limit_m": 40.0,
        "ground_height_m": 0.1,
        "blend": "nearest",
        "ego_motion": False,
        "anti_alias": False,
        "exposure": "gain",
        "quality": 95,
        "scenes": list(SCENES),
        "splits": ["mini_train", "mini_val"],
        "max_samples": 3,
        "cameras": ["CAM_BACK", "CAM_FRONT"],
        "sweeps": True,
        "masks": "none",
        "visibility": "keep",
        "unseen_boxes": "drop",
        "min_coverage": 0.05,
        "low_coverage": "keep",
        "link": "hardlink",
        "keep_layout": False,
        "output_version": VERSION,
    }
    assert json.loads((bench.dst / "unidrive.json").read_text())["rig"]["name"] == "small"


def test_the_config_file_takes_the_options_as_they_are_written_on_the_command_line(bench: Bench) -> None:
    config = bench.folder / "config.yaml"
    config.write_text(
        f"rig: {bench.rig}\ndepth-limit: 40\nego-motion: false\nscene: [{SCENES[1]}]\nlink: copy\njobs: 0\n"
    )
    run = unidrive("convert", bench.src, bench.dst, "--config", config)
    assert run.code == 0, run.stderr
    found = options_of(bench.dst)
    assert (found["depth_limit_m"], found["ego_motion"], found["scenes"]) == (40.0, False, [SCENES[1]])


def test_json_is_an_option_like_others_in_the_config_file(bench: Bench) -> None:
    config = bench.folder / "config.yaml"
    config.write_text("json: true\n")
    run = bench.convert("--jobs", 0, "--config", config)
    assert run.code == 0, run.stderr
    assert run.json()["counts"]["samples"] == SAMPLES


def test_one_scene_in_the_config_file_is_taken_or_a_list_is_asked_for(bench: Bench) -> None:
    config = bench.folder / "config.yaml"
    config.write_text(f"scene: {SCENES[0]}\n")
    run = bench.convert("--jobs", 0, "--config", config)
    if run.code == 0:
        assert options_of(bench.dst)["scenes"] == [SCENES[0]]
    else:
        assert run.code == 2
        assert "config.yaml" in run.said
        assert "list" in run.said


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("qualty: 3", ("config.yaml", "qualty is not an option of convert", "Did you mean quality?")),
        ("depth_limt: 3", ("Did you mean depth-limit?",)),
        ("zzz: 3", ("zzz is not an option of convert",)),
        ("quality: best", ("quality",)),
        ("quality: 0", ("--quality must be from 1 to 100, got 0",)),
        ("blend: best", ("blend", "angular", "nearest")),
        ("- quality", ("config.yaml", "must be a mapping")),
        ("quality: [", ("config.yaml", "cannot be read")),
        ("quality: 1\nquality: 2", ("config.yaml, line 2", 'duplicate key "quality"')),
    ],
)
def test_a_mistake_in_the_config_file(bench: Bench, text: str, words: tuple[str, ...]) -> None:
    config = bench.folder / "config.yaml"
    config.write_text(text)
    bench.refused(2, *words, options=("--config", config, "--jobs", 0))


def test_a_config_file_that_is_not_there(bench: Bench) -> None:
    bench.refused(2, "nowhere.yaml", "cannot be read", options=("--config", bench.folder / "nowhere.yaml"))


def test_a_bad_variable_is_a_usage_error(bench: Bench) -> None:
    bench.refused(2, "--quality", env={"UNIDRIVE_QUALITY": "best"})
    bench.refused(2, "--depth-limit", "got nan", env={"UNIDRIVE_DEPTH_LIMIT": "nan"})


def test_the_rigs_own_defaults_are_below_the_flags(bench: Bench) -> None:
    bench.rig.write_text("depth_limit: 33\nground_height: 0.2\n" + SMALL_RIG)
    bench.converted()
    found = options_of(bench.dst)
    assert (found["depth_limit_m"], found["ground_height_m"]) == (33.0, 0.2)
    bench.converted("--depth-limit", 44, "--force")
    found = options_of(bench.dst)
    assert (found["depth_limit_m"], found["ground_height_m"]) == (44.0, 0.2)


# --- what is printed --------------------------------------------------------------------------------------------


def test_dry_run_writes_nothing(bench: Bench) -> None:
    run = bench.convert("--dry-run")
    assert run.code == 0
    assert not bench.dst.exists()
    assert "4 samples in 2 scenes" in run.stdout
    assert "24 source pictures" in run.stdout
    assert "8 pictures" in run.stdout
    assert "nothing was written" in run.stdout


def test_dry_run_as_json_counts(bench: Bench, default: Path) -> None:
    document = bench.convert("--dry-run", "--json").json()
    assert not bench.dst.exists()
    counted = {key: document[key] for key in ("samples", "scenes", "pictures", "source_pictures", "annotations")}
    assert counted == {
        "samples": SAMPLES,
        "scenes": len(SCENES),
        "pictures": SAMPLES * len(CHANNELS),
        "source_pictures": SAMPLES * CAMERAS,
        "annotations": len(rows(bench.src, "sample_annotation")),
    }
    assert document["rig"] == "small"
    assert 0 < document["estimated_bytes"] < document["free_bytes"]
    assert bench.convert("--dry-run", "--json", "--scene", SCENES[0]).json()["samples"] == SAMPLES // 2


def test_dry_run_refuses_what_the_run_would_refuse(bench: Bench) -> None:
    bench.converted()
    bench.refused(2, "quality 95, now 50", options=("--quality", 50, "--dry-run"))
    (bench.folder / "dst-mine").mkdir()
    (bench.folder / "dst-mine" / "mine.txt").write_text("mine")
    bench.refused(4, "was not made by unidrive", options=("--dry-run",), dst=bench.folder / "dst-mine")
    bench.picture().unlink()
    bench.refused(3, "is missing", options=("--dry-run",), dst=bench.folder / "dst-new")


def test_dry_run_leaves_what_force_would_replace(bench: Bench) -> None:
    bench.converted()
    before = tree(bench.dst)
    assert bench.convert("--quality", 50, "--force", "--dry-run").code == 0
    assert tree(bench.dst) == before


def test_json_is_one_object_on_stdout(bench: Bench) -> None:
    run = bench.convert("--json")
    assert run.code == 0
    assert run.stdout.count("\n") == 1
    document = run.json()
    counts = document["counts"]
    assert counts["samples"] == SAMPLES
    assert counts["annotations"] == len(rows(bench.src, "sample_annotation"))
    assert counts["tables"]["sample_data"] == len(rows(bench.dst, "sample_data"))
    assert counts["boxes_2d"] == len(rows(bench.dst, "image_annotations"))
    assert sorted(document["covered"]) == sorted(CHANNELS)
    assert document["failures"] == []
    assert document["already_complete"] is False
    assert document["picture_bytes"] == sum(map(len, pictures(bench.dst).values()))
    assert document["verified"]["pictures_present"] == SAMPLES * len(CHANNELS)
    again = bench.convert("--json").json()
    assert again["already_complete"] is True
    assert (again["counts"], again["covered"]) == (counts, document["covered"])


def test_an_error_leaves_stdout_empty_with_json_too(bench: Bench) -> None:
    bench.refused(2, "--quality", options=("--json", "--quality", 0))
    bench.refused(3, "no such folder", options=("--json",), src=bench.folder / "nowhere")


def test_debug_shows_where_an_error_was_found(bench: Bench) -> None:
    with pytest.raises(AssertionError, match="Traceback"):
        bench.convert("--debug", "--quality", 0)


def test_the_version() -> None:
    run = unidrive("--version")
    assert (run.code, run.stdout) == (0, f"unidrive {__version__}\n")


@pytest.mark.parametrize("flag", ["--help", "-h"])
@pytest.mark.parametrize(
    ("command", "words"),
    [
        ((), ("convert", "inspect-rig", "measure", "--version")),
        (("convert",), ("SRC", "DST", "--rig", "--depth-limit", "--on-error", "--force", "--json", "--dry-run")),
        (("inspect-rig",), ("RIG_OR_DATASET", "--scene", "--json")),
        (("measure",), ("SRC...", "--truth", "--rig", "--source", "--scene", "--camera", "--png", "--json")),
    ],
)
def test_help(command: tuple[str, ...], words: tuple[str, ...], flag: str) -> None:
    run = unidrive(*command, flag, env={"COLUMNS": "200", "NO_COLOR": "1"})
    assert run.code == 0
    assert [word for word in words if word not in run.stdout] == []


def test_no_command_shows_the_help() -> None:
    run = unidrive()
    assert run.code in (0, 2)
    assert "inspect-rig" in run.stdout + run.stderr


@pytest.mark.parametrize("arguments", [("no-such-command",), ("convert",), ("convert", "src"), ("inspect-rig",)])
def test_a_command_line_that_is_not_whole(arguments: tuple[str, ...]) -> None:
    run = unidrive(*arguments)
    assert (run.code, run.stdout) == (2, "")
    assert "Usage" in run.stderr or "No such command" in run.said


def test_a_rig_must_be_named(bench: Bench) -> None:
    run = unidrive("convert", bench.src, bench.dst)
    assert run.code == 2
    assert "--rig" in run.said


# --- masks ------------------------------------------------------------------------------------------------------


def mask_files(root: Path) -> list[str]:
    return sorted(path.relative_to(root).as_posix() for path in (root / "masks").rglob("*.png"))


def test_one_mask_a_picture(default: Path) -> None:
    names = [row["filename"] for row in rows_of(default, "camera")]
    assert len(names) == SAMPLES * len(CHANNELS)
    expected = [name.replace("samples/", "masks/").replace(".jpg", ".png") for name in names]
    assert mask_files(default) == sorted(expected)
    for name, picture in zip(expected, names, strict=True):
        mask = cv2.imread(str(default / name), cv2.IMREAD_UNCHANGED)
        assert mask.shape == (36, 64)
        assert len(np.unique(mask)) <= 2
        assert cv2.imread(str(default / picture))[mask == 0].max(initial=0) < 60  # black, but for JPEG's ringing


def test_one_mask_a_camera(bench: Bench, default: Path) -> None:
    bench.converted("--masks", "camera")
    assert mask_files(bench.dst) == ["masks/CAM_BACK.png", "masks/CAM_FRONT.png"]
    for channel in CHANNELS:
        static = cv2.imread(str(bench.dst / "masks" / f"{channel}.png"), cv2.IMREAD_UNCHANGED) > 0
        for path in (default / "masks" / channel).iterdir():  # of one moment; the car drives 0.4 m in between
            moment = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) > 0
            assert static.shape == moment.shape
            assert (static == moment).mean() > 0.9
    assert pictures(bench.dst) == pictures(default)


def test_no_masks(bench: Bench, default: Path) -> None:
    bench.converted("--masks", "none")
    assert not (bench.dst / "masks").exists()
    assert pictures(bench.dst) == pictures(default)


# --- files that go along ----------------------------------------------------------------------------------------


def carried(bench: Bench) -> list[str]:
    names = [row["filename"] for row in rows_of(bench.src, "lidar")] + [
        row["filename"] for row in rows(bench.src, "map")
    ]
    assert len(names) == SAMPLES + len(SCENES) + 1  # one sweep a scene, one map
    return names


def test_hard_links(bench: Bench) -> None:
    bench.converted("--link", "hardlink")
    for name in carried(bench):
        assert (bench.dst / name).samefile(bench.src / name)
        assert not (bench.dst / name).is_symlink()
    for name in pictures(bench.dst):
        path = next((bench.dst / "samples").rglob(name))
        assert path.stat().st_nlink == 1


def test_symbolic_links(bench: Bench) -> None:
    bench.converted("--link", "symlink")
    for name in carried(bench):
        assert (bench.dst / name).is_symlink()
        assert (bench.dst / name).resolve() == (bench.src / name).resolve()


def test_symbolic_links_hold_wherever_the_command_was_given(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(bench.folder)
    arguments = ("src", "dst", "--rig", "rig.yaml", "--jobs", 0, "--link", "symlink")
    assert unidrive("convert", *arguments).code == 0
    monkeypatch.chdir("/")
    assert all((bench.dst / name).samefile(bench.src / name) for name in carried(bench))


def test_copies(bench: Bench) -> None:
    bench.converted("--link", "copy")
    for name in carried(bench):
        path = bench.dst / name
        assert not path.is_symlink()
        assert not path.samefile(bench.src / name)
        assert path.stat().st_nlink == 1
        assert path.read_bytes() == (bench.src / name).read_bytes()


def test_hard_links_across_disks_become_copies(bench: Bench) -> None:
    memory = Path("/dev/shm")
    if not memory.is_dir() or memory.stat().st_dev == bench.folder.stat().st_dev or not os.access(memory, os.W_OK):
        pytest.skip("no second disk to write to")
    other = memory / f"unidrive-test-{os.getpid()}"
    try:
        bench.converted("--link", "hardlink", dst=other)
        for name in carried(bench):
            assert (other / name).read_bytes() == (bench.src / name).read_bytes()
            assert (other / name).stat().st_nlink == 1
    finally:
        shutil.rmtree(other, ignore_errors=True)


def test_links_of_the_source_are_not_passed_on_as_links(bench: Bench) -> None:
    """A file that is a link inside the dataset becomes a file, not a link that points nowhere."""
    name = carried(bench)[0]
    (bench.src / "store.bin").write_bytes((bench.src / name).read_bytes())
    (bench.src / name).unlink()
    (bench.src / name).symlink_to(Path("../../store.bin"))
    bench.converted("--link", "hardlink")
    assert not (bench.dst / name).is_symlink()
    assert (bench.dst / name).read_bytes() == (bench.src / "store.bin").read_bytes()


# --- annotations ------------------------------------------------------------------------------------------------


def visibility_of(root: Path) -> dict[str, int]:
    return {row["token"]: int(row["visibility_token"]) for row in rows(root, "sample_annotation")}


def test_visibility_is_lowered_never_raised(bench: Bench, default: Path) -> None:
    """Two 80-degree cameras show less than the six of the source, whose every box is of level 4."""
    before, after = visibility_of(bench.src), visibility_of(default)
    assert set(before.values()) == {4}
    assert before.keys() == after.keys()
    assert all(after[token] <= before[token] for token in before)
    lowered = sum(after[token] < before[token] for token in before)
    assert lowered == json.loads((default / "unidrive.json").read_text())["counts"]["visibility_lowered"] > 0


def test_visibility_can_be_kept(bench: Bench, default: Path) -> None:
    bench.converted("--visibility", "keep")
    assert visibility_of(bench.dst) == visibility_of(bench.src)
    assert pictures(bench.dst) == pictures(default)


def unseen(root: Path) -> set[str]:
    """Annotations of which no virtual picture has a 2D box."""
    shown = {row["sample_annotation_token"] for row in rows(root, "image_annotations")}
    return {row["token"] for row in rows(root, "sample_annotation")} - shown


def test_unseen_boxes_are_kept_with_the_lowest_visibility(bench: Bench, default: Path) -> None:
    levels = visibility_of(default)
    assert unseen(default)
    assert {levels[token] for token in unseen(default)} == {1}


def test_unseen_boxes_can_be_dropped(bench: Bench, default: Path) -> None:
    bench.converted("--unseen-boxes", "drop")
    assert unseen(bench.dst) == set()
    assert visibility_of(bench.dst).keys() == visibility_of(default).keys() - unseen(default)
    counts = json.loads((bench.dst / "unidrive.json").read_text())["counts"]
    assert counts["boxes_dropped"] == counts["boxes_unseen"] == len(unseen(default))


# --- what is rendered -------------------------------------------------------------------------------------------


def test_only_one_scene(bench: Bench, default: Path) -> None:
    bench.converted("--scene", SCENES[1])
    (scene,) = rows(bench.dst, "scene")
    assert scene["name"] == SCENES[1]
    kept = {row["token"] for row in rows(bench.src, "sample") if row["scene_token"] == scene["token"]}
    assert {row["token"] for row in rows(bench.dst, "sample")} == kept
    for table in ("sample_data", "sample_annotation"):
        assert {row["sample_token"] for row in rows(bench.dst, table)} == kept
    assert pictures(bench.dst).items() < pictures(default).items()
    counts = Counter(row["sample_token"] in kept for row in rows(bench.src, "sample_annotation"))
    assert len(rows(bench.dst, "sample_annotation")) == counts[True]


def test_both_scenes_by_name_are_all_of_them(bench: Bench, default: Path) -> None:
    bench.converted("--scene", SCENES[1], "--scene", SCENES[0])
    for table in ("scene", "sample", "sample_data", "sample_annotation", "instance"):
        assert rows(bench.dst, table) == rows(default, table)
    assert pictures(bench.dst) == pictures(default)


def test_only_one_camera(bench: Bench) -> None:
    """CAM_BACK looks backwards with 89 degrees: the front picture stays black, the other is nearly full."""
    run = bench.converted("--camera", "CAM_BACK", "--json")
    covered = run.json()["covered"]
    assert covered["CAM_FRONT"] == 0
    assert covered["CAM_BACK"] > 0.9
    for path in (bench.dst / "samples" / "CAM_FRONT").iterdir():
        assert cv2.imread(str(path)).max() == 0
    assert not any("CAM_FRONT/" in row["filename"] for row in rows(bench.dst, "image_annotations"))


def test_all_cameras_by_name_are_all_of_them(bench: Bench, default: Path) -> None:
    names = [row["channel"] for row in rows(bench.src, "sensor") if row["modality"] == "camera"]
    assert len(names) == CAMERAS
    bench.converted(*(word for name in names for word in ("--camera", name)))
    assert pictures(bench.dst) == pictures(default)


@pytest.mark.parametrize(
    "options",
    [
        ("--blend", "nearest"),
        ("--no-ego-motion",),
        ("--depth-limit", 5),
        ("--ground-height", -0.3),
        ("--exposure", "gain"),
    ],
)
def test_options_of_the_warp_change_the_pictures(bench: Bench, default: Path, options: tuple[object, ...]) -> None:
    bench.converted(*options)
    assert pictures(bench.dst).keys() == pictures(default).keys()
    assert pictures(bench.dst) != pictures(default)


def test_the_quality_is_that_of_the_files(bench: Bench, default: Path) -> None:
    """libjpeg's tables: at quality 50 they are the standard's own, whose luminance table begins with 16."""
    bench.converted("--quality", 50)
    for data in pictures(bench.dst).values():
        start = data.index(b"\xff\xdb") + 5
        assert data[start] == 16
    for data in pictures(default).values():
        assert data[data.index(b"\xff\xdb") + 5] == 2  # 16 * 10 / 100, rounded


@pytest.mark.parametrize("option", ["--jobs", "-j"])
def test_workers_change_no_byte(bench: Bench, default: Path, option: str) -> None:
    arguments = ("--rig", bench.rig, option, 2)
    assert unidrive("convert", bench.src, bench.dst, *arguments).code == 0
    assert tree(bench.dst, apart=("run.json",)) == tree(default, apart=("run.json",))


def test_where_things_lie_changes_no_byte(bench: Bench, default: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(bench.folder)
    assert unidrive("convert", "src/", "./dst", "--rig", "rig.yaml", "--jobs", 0, "--verify", "full").code == 0
    assert tree(bench.dst, apart=("run.json",)) == tree(default, apart=("run.json",))


def test_verify_full_decodes_every_picture(bench: Bench) -> None:
    assert bench.converted("--verify", "full", "--json").json()["verified"]["pictures_decoded"] == 8


def test_an_empty_config_file_changes_nothing(bench: Bench) -> None:
    config = bench.folder / "config.yaml"
    config.write_text("# quality: 90\n")
    assert bench.convert("--jobs", 0, "--dry-run", "--config", config).code == 0


@pytest.mark.parametrize(("share", "text"), [(1.0, "100%"), (0.9996, "99%"), (0.29, "29%"), (0.0, "0%")])
def test_what_is_not_whole_is_not_called_so(share: float, text: str) -> None:
    assert conversion._percent(share) == text
