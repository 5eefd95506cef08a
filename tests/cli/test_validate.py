"""`unidrive validate`: what it prints, how it ends, what `--fix` changes and what it leaves alone."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

from tests.datasets import SCRIPT, VERSION, Bench, Row, rows, spawn, tree, unidrive
from unidrive_cli.check import mending
from unidrive_cli.tables import dataset as dataset_module
from unidrive_cli.tables import thinned


def break_lists(bench: Bench) -> set[str]:
    """Breaks everything that can be mended; returns the IDs of the rules."""

    def samples(found: list[Row]) -> None:
        first = found[0]
        following = next(row for row in found if row["token"] == first["next"])
        first["next"], following["prev"] = "", ""  # LINK-3

    def annotations(found: list[Row]) -> None:
        one, other = [row for row in found if not row["prev"] and row["next"]][:2]
        one["next"], other["next"] = other["next"], one["next"]  # LINK-1: prev still leads to the right ones

    bench.edit("sample", samples)
    bench.edit("sample_annotation", annotations)
    bench.edit("sample_data", lambda found: found[0].update(prev="nowhere"))
    bench.edit(
        "scene", lambda found: found[1].update(nbr_samples=7, first_sample_token=found[0]["last_sample_token"])
    )
    bench.edit("instance", lambda found: found[2].update(nbr_annotations=0, last_annotation_token=""))
    return {"REF-2", "LINK-1", "LINK-3", "REC-1", "REC-2", "REC-3", "REC-4"}


def broken(document: dict[str, dict[str, int]]) -> set[str]:
    return {rule for rule, count in document["counts"].items() if count}


def test_a_clean_dataset(bench: Bench) -> None:
    before = tree(bench.folder)
    run = unidrive("validate", bench.src)
    assert run.code == 0, run.stdout
    assert run.stdout.endswith("0 findings; 36 rules looked at; opened with nuscenes-devkit\n")
    assert run.stderr == ""
    document = unidrive("validate", bench.src, "--json").json()
    assert (document["schema_version"], document["findings"], document["opened_with_devkit"]) == (1, [], True)
    assert tree(bench.folder) == before


def test_a_converted_dataset_is_clean(default: Path) -> None:
    document = unidrive("validate", default, "--json").json()
    assert document["findings"] == []
    assert document["opened_with_devkit"]


def test_findings_as_json_and_as_text(bench: Bench) -> None:
    bench.edit("sample_annotation", lambda found: [row.update(visibility_token="9") for row in found[:8]])
    run = unidrive("validate", bench.src, "--json")
    assert run.code == 1
    document = run.json()
    assert document["counts"]["REF-1"] == len(document["findings"]) == 8
    token = rows(bench.src, "sample_annotation")[0]["token"]
    assert document["findings"][0] == {
        "rule": "REF-1",
        "severity": "error",
        "where": f"{bench.table('sample_annotation')}, token {token}, field visibility_token",
        "what": "points to '9', which is not in visibility.json.",
    }
    assert not document["opened_with_devkit"]
    assert document["not_checked"] == ["DEV-1"]
    run = unidrive("validate", bench.src)
    assert run.code == 1
    head, *lines = run.stdout.splitlines()
    assert head == "REF-1 error: 8 findings"
    assert [line.startswith("  ") for line in lines] == [True] * 6 + [False]
    assert lines[5] == "  and 3 more"


def test_nothing_to_read(tmp_path: Path, bench: Bench) -> None:
    run = unidrive("validate", tmp_path / "nowhere")
    assert (run.code, run.stdout) == (3, "")
    assert "there is no such folder" in run.said
    for name in ("sensor", "calibrated_sensor", "ego_pose", "sample", "sample_data", "scene"):
        bench.table(name).write_text("[{")
    run = unidrive("validate", bench.src)
    assert (run.code, run.stdout) == (3, "")
    assert "it was truncated" in run.said
    assert unidrive("validate", bench.src, "--version", "v2").code == 2


def test_an_unfinished_conversion(bench: Bench) -> None:
    """Before its tables are there, and with them."""
    assert bench.convert("--part", "1/2").code in (0, 1)
    run = unidrive("validate", bench.dst)
    assert run.code == 3
    assert "has not been finished" in run.said
    bench.converted("--force")
    (bench.dst / "UNFINISHED.txt").write_text("")
    bench_edit(bench.dst, "scene", nbr_samples=9)
    before = tree(bench.dst)
    run = unidrive("validate", bench.dst, "--json", "--fix")
    assert run.code == 1
    assert broken(run.json()) == {"STR-4", "REC-1"}
    assert tree(bench.dst) == before, "--fix leaves an unfinished conversion alone"


def bench_edit(root: Path, table: str, **fields: object) -> None:
    """Changes the first row of a table."""
    found = rows(root, table)
    found[0].update(fields)
    (root / VERSION / f"{table}.json").write_text(json.dumps(found))


@pytest.mark.parametrize("large_bytes", [dataset_module.LARGE_BYTES, 0], ids=["read", "scanned"])
def test_fix_gives_the_tables_back(bench: Bench, monkeypatch: pytest.MonkeyPatch, large_bytes: int) -> None:
    """The painted lists are in the order of time, so mended tables hold what they held before they were broken."""
    monkeypatch.setattr(dataset_module, "LARGE_BYTES", large_bytes)
    whole = {path.stem: json.loads(path.read_text()) for path in (bench.src / VERSION).glob("*.json")}
    expected = break_lists(bench)
    damaged = tree(bench.src)
    assert broken(unidrive("validate", bench.src, "--json").json()) == expected
    assert tree(bench.src) == damaged, "nothing is written without --fix"
    run = unidrive("validate", bench.src, "--fix", "--json")
    assert run.code == 0, run.stdout
    document = run.json()
    assert document["fixed"] == {"sample": 2, "sample_data": 1, "sample_annotation": 2, "scene": 1, "instance": 1}
    assert {path.stem: json.loads(path.read_text()) for path in (bench.src / VERSION).glob("*.json")} == whole
    mended = tree(bench.src)
    for name in document["fixed"]:
        assert mended.pop(f"{VERSION}/{name}.json.bak") == damaged.pop(f"{VERSION}/{name}.json")
        mended.pop(f"{VERSION}/{name}.json")
    assert mended == damaged, "no other file was touched"
    before = tree(bench.src)
    run = unidrive("validate", bench.src, "--fix")
    assert run.code == 0
    assert "fixed" not in run.stdout
    assert tree(bench.src) == before


KILLED_AT_A_RENAME = """
import os, sys
from unidrive_cli.cli.main import app

left, rename = iter(range(int(sys.argv[1]))), os.replace
os.replace = lambda *names: os._exit(9) if next(left, None) is None else rename(*names)
app(["validate", sys.argv[2], "--fix"])
"""


@pytest.mark.parametrize("renames", range(5))
def test_fix_that_is_killed_is_continued(bench: Bench, renames: int) -> None:
    """Killed before the first, second, ... table takes its place: each is the old one or the mended one."""
    whole = {path.name: path.read_bytes() for path in (bench.src / VERSION).glob("*.json")}
    break_lists(bench)
    killed = subprocess.run([sys.executable, "-c", KILLED_AT_A_RENAME, str(renames), bench.src], check=False)
    assert killed.returncode == 9
    for path in (bench.src / VERSION).glob("*.json"):
        json.loads(path.read_bytes())
    assert unidrive("validate", bench.src, "--fix").code == 0
    again = {path.name: json.loads(path.read_bytes()) for path in (bench.src / VERSION).glob("*.json")}
    assert again == {name: json.loads(data) for name, data in whole.items()}
    assert not list((bench.src / VERSION).glob("*.part"))


def test_fix_changes_no_other_name_of_a_file(bench: Bench) -> None:
    """Another dataset that shares the tables by hard links keeps them; older copies are kept too."""
    bench.edit("scene", lambda found: found[0].update(nbr_samples=7))
    shared = bench.folder / "scene-of-another.json"
    os.link(bench.table("scene"), shared)
    before = shared.read_bytes()
    old = bench.table("scene").with_name("scene.json.bak")
    old.write_text("old")
    assert unidrive("validate", bench.src, "--fix").code == 0
    assert shared.read_bytes() == before
    assert old.read_text() == "old"
    assert old.with_name("scene.json.bak1").read_bytes() == before


def test_fix_leaves_linked_tables_alone(bench: Bench) -> None:
    """A version folder that is a link belongs to another dataset."""
    bench.edit("scene", lambda found: found[0].update(nbr_samples=7))
    elsewhere = bench.folder / "elsewhere"
    (bench.src / VERSION).rename(elsewhere)
    (bench.src / VERSION).symlink_to(elsewhere)
    before = tree(bench.folder)
    run = unidrive("validate", bench.src, "--fix")
    assert run.code == 3
    assert "is a link" in run.said
    assert tree(bench.folder) == before


@pytest.mark.parametrize(
    ("table", "fields"),
    [("sample_data", {"timestamp": 9e15}), ("sample", {"scene_token": "nowhere"})],
    ids=["against the order of time", "dangling token"],
)
def test_fix_leaves_alone_what_may_be_either(bench: Bench, table: str, fields: dict[str, object]) -> None:
    bench_edit(bench.src, table, **fields)
    before = tree(bench.src)
    assert unidrive("validate", bench.src, "--fix").code == 1
    assert tree(bench.src) == before


def test_what_cannot_be_fixed_stays_a_finding(bench: Bench) -> None:
    bench.edit("scene", lambda found: found[0].update(nbr_samples=7, name="mine"))
    run = unidrive("validate", bench.src, "--fix", "--json")
    assert run.code == 1
    assert run.json()["fixed"] == {"scene": 1}
    assert broken(run.json()) == {"REC-8"}


def test_a_split_of_ones_own(bench: Bench) -> None:
    bench.edit("scene", lambda found: found[0].update(name="mine"))
    bench.table("splits").write_text(json.dumps({"train": ["mine"]}))
    assert unidrive("validate", bench.src).code == 0
    bench.table("splits").write_text(json.dumps(["mine"]))
    assert broken(unidrive("validate", bench.src, "--json").json()) == {"REC-8"}


def test_the_console_script_prints_the_rules() -> None:
    run = spawn("validate", "--rules")
    assert run.code == 0
    assert run.stdout == (Path(__file__).parents[2] / "docs" / "rules.md").read_text()


@pytest.mark.parametrize(("field", "value"), [("visibility_token", 4), ("num_lidar_pts", True)])
def test_types_in_large_tables(bench: Bench, monkeypatch: pytest.MonkeyPatch, field: str, value: object) -> None:
    bench.edit("sample_annotation", lambda found: [row.update({field: value}) for row in found])
    said = []
    for large in (dataset_module.LARGE_BYTES, 0):
        monkeypatch.setattr(dataset_module, "LARGE_BYTES", large)
        run = unidrive("validate", bench.src, "--json")
        assert run.code == 1
        said.append([finding for finding in run.json()["findings"] if finding["rule"] == "STR-2"])
    assert said[0] == said[1] != []


def test_ctrl_c_between_two_tables(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    break_lists(bench)
    rewrite, done = mending._rewrite, list[Path]()

    def once(path: Path, *more: Any) -> None:
        if done:
            raise KeyboardInterrupt
        done.append(path)
        rewrite(path, *more)

    monkeypatch.setattr(mending, "_rewrite", once)
    run = unidrive("validate", bench.src, "--fix")
    assert run.code == 130
    assert "Nothing was written" not in run.stderr
    assert "have what they were beside them (.bak)" in run.stderr
    assert done[0].with_name(f"{done[0].name}.bak").exists()


def test_a_full_temporary_folder(bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The devkit opens some scenes of a large dataset, in tables of their own."""
    monkeypatch.setattr(thinned, "DEVKIT_SCENES", 1)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3000, limits[1]))
    try:
        run = unidrive("validate", bench.src)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert run.code == 4
    assert f"{tmp_path}: the tables of 1 scenes, which nuscenes-devkit is to open, cannot be written" in run.stderr
    assert "Set TMPDIR to a folder with more room." in run.stderr


def test_what_is_said_has_no_room(bench: Bench) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [SCRIPT, "validate", bench.src], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 4
    assert done.stderr.startswith("unidrive: standard output: cannot be written: No space left on device.")
    assert done.stderr.count("\n") == 1


def test_nobody_listens(bench: Bench) -> None:
    assert subprocess.run(["bash", "-c", '"$0" validate "$1" >&-', SCRIPT, bench.src], check=False).returncode == 0
