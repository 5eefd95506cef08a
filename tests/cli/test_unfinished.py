"""An unfinished dataset is never taken for one, by no command and in no role."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.datasets import VERSION, Bench, unidrive

SEARCH = Path(__file__).parents[2] / "rigs" / "searches" / "unidrive-optimised-6.yaml"


@pytest.fixture(params=["UNFINISHED.txt", ".unidrive"])
def unfinished(request: pytest.FixtureRequest, bench: Bench, default: Path) -> Path:
    """Tables and pictures are all there, as in a finished dataset that is just being mended or verified."""
    folder = Path(shutil.copytree(default, bench.folder / "dst-begun"))
    (folder / request.param).mkdir()
    return folder


@pytest.mark.parametrize(
    "command",
    [
        "inspect-rig {begun}",
        "inspect-rig 6x60 --against {begun}",
        "measure {begun} --rig 6x60",
        "measure {src} --rig {begun}",
        "measure {begun} --truth {src}",
        "measure {src} --rig 6x60 --truth {begun}",
        "optimize-rig {begun} --search {search} --out {out}",
        "optimize-rig 6x60 --boxes {begun} --search {search} --out {out}",
        "synth {out} --rig {begun}",
        "convert {begun} {out} --rig 6x60",
        "convert {src} {out} --rig {begun}/{version}",
        "convert {src} {out} --rig {begun}",
        "convert {src} {out} --rig 6x60 --common-with {begun}",
        "merge {begun} {src} --out {out}",
    ],
)
def test_every_command_refuses_it(bench: Bench, unfinished: Path, command: str) -> None:
    places = {"begun": unfinished, "src": bench.src, "out": bench.dst, "search": SEARCH, "version": VERSION}
    run = unidrive(*command.format_map(places).split())
    assert run.code == 3, run.said
    assert "has not been finished" in run.said
    assert not bench.dst.exists()
