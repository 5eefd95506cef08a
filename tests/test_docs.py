"""What the documents say is true: code runs, files and options that they name are there."""

from __future__ import annotations

import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.datasets import VERSION, paint, rows
from tests.painted import nuscenes_like_cameras, write_painted
from unidrive_cli.cli.main import app
from unidrive_cli.optimize.objective import Penalties
from unidrive_cli.optimize.search_file import load_search
from unidrive_cli.rig.fleet import load_fleet
from unidrive_cli.rig.gallery import gallery_names, load_gallery_rig
from unidrive_cli.rig.yaml_file import parse_rig
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.layouts import known
from unidrive_cli.tables.lenses import read_lenses

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def code_blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        assert (page.parent / target).exists(), target


def test_the_readme_names_every_shipped_rig() -> None:
    text = (ROOT / "README.md").read_text()
    assert [name for name in gallery_names() if f"`{name}`" not in text] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_options_that_are_named_exist(page: Path) -> None:
    commands = [str(command.name) for command in app.registered_commands]
    assert {"convert", "finalise", "inspect-rig", "measure", "synth", "doctor"} <= set(commands)
    helps = "".join(CliRunner().invoke(app, [name, "--help"], env={"COLUMNS": "300"}).output for name in commands)
    helps = re.sub(r"\x1b\[[0-9;]*m", "", helps)
    pages_own = {
        name
        for file in (ROOT / "benchmarks").rglob("*.py")
        for name in re.findall(r"--[a-z][a-z-]+", file.read_text())
    }
    others = r"^(?:#SBATCH|dask|sbatch)\b.*|`(?:dask|sbatch)\b[^`\n]*`|`--n(?:workers|threads)`"
    text = re.sub(others, "", page.read_text(), flags=re.MULTILINE)
    for option in set(re.findall(r"--[a-z][a-z-]+", text)) - pages_own:
        assert option in helps, option


def test_the_array_job_of_the_docs_runs(tmp_path: Path) -> None:
    """Both scripts as they stand, as SLURM would run them: once per task, then the one that depends on them."""
    source, destination = tmp_path / "src", tmp_path / "dst"
    write_painted(source, cameras=nuscenes_like_cameras(scale=0.05), samples_per_scene=2)
    parts, finalise = (
        text for text in code_blocks(ROOT / "docs" / "cluster.md", "sh") if text.startswith("#!/bin/bash")
    )
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    env = {**os.environ, "PATH": path, "SRC": str(source), "DST": str(destination), "SLURM_ARRAY_TASK_COUNT": "2"}
    for script, task in ((parts, "1"), (parts, "2"), (finalise, "")):
        assert not (destination / "unidrive.json").exists()
        subprocess.run(["bash", "-c", script], env={**env, "SLURM_ARRAY_TASK_ID": task}, check=True, timeout=120)
    assert (destination / "unidrive.json").is_file()


def test_make_targets_that_the_readme_names_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"\bmake ([a-z-]+)\b(?= |`|\n)", (ROOT / "README.md").read_text())) <= targets


def test_the_lens_file_of_the_docs_is_valid(tmp_path: Path) -> None:
    (text,) = code_blocks(ROOT / "docs" / "lenses.md", "yaml")
    (tmp_path / "lenses.yaml").write_text(text)
    lenses = read_lenses(tmp_path / "lenses.yaml")
    assert {channel: lens.model for channel, lens in lenses.items()} == {
        "CAM_FRONT": "opencv",
        "CAM_BACK": "fisheye",
    }


def test_the_rig_file_of_the_docs_is_valid() -> None:
    text, with_lenses, _ = code_blocks(ROOT / "docs" / "rig-files.md", "yaml")
    lenses = [camera.lens for camera in parse_rig(with_lenses, "docs/rig-files.md").cameras]
    assert [lens.model for lens in lenses] == ["opencv", "fisheye"]
    rig = parse_rig(text, "docs/rig-files.md")
    assert rig.channels == ("CAM_FRONT", "CAM_BACK")
    assert rig.cameras[1].yaw_pitch_roll_deg[0] == pytest.approx(180)


def test_the_fleet_file_of_the_docs_is_valid(tmp_path: Path) -> None:
    (*_, text) = code_blocks(ROOT / "docs" / "rig-files.md", "yaml")
    (tmp_path / "fleet.yaml").write_text(text)
    asked: list[str] = []
    fleet = load_fleet(tmp_path / "fleet.yaml", lambda name: asked.append(name) or load_gallery_rig("6x60"))
    assert asked == [f"{tmp_path}/fleet-rig.yaml", "/data/sedan", f"{tmp_path}/van.yaml"]
    assert (fleet.common, fleet.virtual.depth_limit_m) == (True, 40)


def test_the_search_file_of_the_docs_is_valid(tmp_path: Path) -> None:
    (text,) = code_blocks(ROOT / "docs" / "optimise.md", "yaml")
    (tmp_path / "search.yaml").write_text(text)
    found = load_search(tmp_path / "search.yaml", load_gallery_rig)
    assert found.penalties == Penalties()
    assert len(found.space.parameters) == 4 + 1 + 1 + 1


def test_the_layout_of_the_docs_is_a_whole_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With its line it finds its datasets out and mends them, and leaves all others to the rest."""
    (code,) = code_blocks(ROOT / "docs" / "adding.md", "python")
    (tmp_path / "harbour.py").write_text(code)
    layout = runpy.run_path(str(tmp_path / "harbour.py"))["HarbourLayout"]()
    monkeypatch.setattr(known, "LAYOUTS", (layout, *known.LAYOUTS))
    root = paint(tmp_path / "drive", scenes=2, samples=1)
    assert open_dataset(root).layout.title == "nuScenes"
    (root / VERSION / "recorder.json").write_text("[]")
    scenes = rows(root, "scene")
    scenes[1]["name"] = ""
    (root / VERSION / "scene.json").write_text(json.dumps(scenes))
    dataset = open_dataset(root)
    assert dataset.layout is layout
    assert [row.name for row in dataset.scene.rows] == [scenes[0]["name"], "harbour-0002"]
    assert dataset.notes == ["1 scenes have no name; they get numbers."]


def test_the_docs_name_every_layout() -> None:
    text = (ROOT / "docs" / "layouts.md").read_text()
    assert [layout.name for layout in known.LAYOUTS if f"| `{layout.name}` |" not in text] == []


def test_the_python_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_painted(tmp_path / "demo-out" / "source", cameras=nuscenes_like_cameras(scale=0.05), samples_per_scene=1)
    (code,) = code_blocks(ROOT / "README.md", "python")
    (tmp_path / "example.py").write_text(code)
    runpy.run_path(str(tmp_path / "example.py"), run_name="__main__")
    assert (tmp_path / "demo-out" / "from-python" / "unidrive.json").is_file()
