"""Tables (Markdown) and the paper's figure, of what a run has so far.

python -m benchmarks.cross_rig.report FOLDER [--figure FILE.png]
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from statistics import mean
from typing import Any

from benchmarks.cross_rig import paper
from benchmarks.cross_rig.config import CLASSES, HEIGHTS, LENSES, MAIN, PAPER_RIGS, TRAINED
from benchmarks.cross_rig.retention import Key, Matrix, matrix_of, read_results, retention, spread

BEGIN, END = "<!-- tables -->", "<!-- end of tables -->"
Results = Mapping[Key, Mapping[str, Mapping[str, Mapping[str, Any]]]]


def table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def percent(figure: float) -> str:
    return f"{figure * 100:.1f}"


def matrices(results: Results, setting: str, detector: str, what: str = "mAP") -> list[Matrix]:
    """One matrix a seed, of the seeds that have any row."""
    keys = sorted(
        (key for key in results if (key.setting, key.detector) == (setting, detector)), key=lambda k: k.seed
    )
    found = [matrix_of(results[key], PAPER_RIGS, what) for key in keys]
    return [matrix for matrix in found if matrix]


def headline(results: Results) -> str:
    """Retention by setting; seeds that lack a training rig which another seed has are said by their number."""
    rows = [paper_row("paper, raw", paper.RAW), paper_row("paper, unified", paper.UNIFIED)]
    settings = sorted({(key.setting, key.detector) for key in results}, key=_in_order)
    for setting, detector in settings:
        found = matrices(results, setting, detector)
        if not found:
            continue
        kept = [retention(matrix) for matrix in found]
        worst = min(kept, key=lambda one: one.worst)
        rows.append(
            [
                setting,
                detector,
                f"{len(found)} ({'/'.join(str(len(matrix)) for matrix in found)})",
                spread([one.own for one in kept]),
                spread([one.others for one in kept]),
                f"{spread([one.kept for one in kept], '.0f')} %",
                f"{spread([one.worst for one in kept])} ({' on '.join(worst.worst_pair)})",
                spread([mean(retention(matrix).own for matrix in matrices(results, setting, detector, "NDS"))]),
            ]
        )
    head = ["setting", "detector", "seeds (training rigs)", "own mAP", "other rigs' mAP", "retention", "worst pair"]
    return table([*head, "own NDS"], rows)


def _in_order(pair: tuple[str, str]) -> tuple[bool, int, str]:
    names = [setting.name for setting in MAIN]
    return pair[1] != "lift-splat", names.index(pair[0]) if pair[0] in names else len(names), pair[0]


def paper_row(name: str, matrix: Matrix) -> list[str]:
    one = retention({trained: {rig: row[rig] / 100 for rig in row} for trained, row in matrix.items()})
    pair = " on ".join(one.worst_pair)
    return [
        name,
        "BEVFusion-C",
        "1 (4)",
        percent(one.own),
        percent(one.others),
        f"{one.kept * 100:.0f} %",
        f"{percent(one.worst)} ({pair})",
        "-",
    ]


def full_table(results: Results, setting: str, detector: str) -> str:
    """mAP of each training rig on each test rig, with its spread over seeds."""
    cells: dict[tuple[str, str], list[float]] = defaultdict(list)
    for key, documents in results.items():
        if (key.setting, key.detector) == (setting, detector):
            for trained, row in documents.items():
                for rig, document in row.items():
                    cells[trained, rig].append(document["mAP"])
    trained_on = sorted({trained for trained, _ in cells}, key=lambda rig: (rig not in TRAINED, rig))
    rows = [
        [
            trained,
            *(_cell(cells.get((trained, rig), []), rig == trained) for rig in PAPER_RIGS),
        ]
        for trained in trained_on
    ]
    return table(["trained on", *PAPER_RIGS], rows)


def _cell(figures: list[float], own: bool) -> str:
    text = spread(figures) if figures else "-"
    return f"**{text}**" if own else text


def classes(results: Results, setting: str, detector: str) -> str:
    """AP by class: on the training rig, on the others, and what is kept."""
    own: dict[str, list[float]] = defaultdict(list)
    others: dict[str, list[float]] = defaultdict(list)
    for key, documents in results.items():
        if (key.setting, key.detector) == (setting, detector):
            for trained, row in documents.items():
                for rig in PAPER_RIGS:
                    if trained in PAPER_RIGS and rig in row:
                        for name, figure in row[rig]["AP"].items():
                            (own if rig == trained else others)[name].append(figure)
    rows = [
        [name, percent(mean(own[name])), percent(mean(others[name])), f"{mean(others[name]) / mean(own[name]):.0%}"]
        for name in CLASSES
        if own[name] and others[name] and mean(own[name])
    ]
    return table(["class", "own", "others", "kept"], rows)


def ablation(results: Results, tested: tuple[str, ...]) -> str:
    """6x60's detectors on variants of 6x60, and on itself."""
    rows = []
    for setting in MAIN:
        row = [setting.name]
        for rig in ("6x60", *tested):
            figures = [
                documents["6x60"][rig]["mAP"]
                for key, documents in results.items()
                if (key.setting, key.detector) == (setting.name, "lift-splat") and rig in documents.get("6x60", {})
            ]
            row.append(spread(figures) if figures else "-")
        rows.append(row)
    return table(["setting", "6x60", *tested], rows)


def sections(results: Results) -> Iterator[str]:
    yield f"## Retention\n\n{headline(results)}"
    for detector in ("lift-splat", "bilinear"):
        for setting in dict.fromkeys(key.setting for key in results if key.detector == detector):
            yield f"## {setting}, {detector}: mAP\n\n{full_table(results, setting, detector)}"
    for each in MAIN:
        yield f"## {each.name}, lift-splat: AP by class\n\n{classes(results, each.name, 'lift-splat')}"
    yield f"## Lenses\n\n{ablation(results, tuple(LENSES))}"
    yield f"## Heights\n\n{ablation(results, tuple(HEIGHTS))}"


def draw(results: Results, path: Path) -> None:
    """The paper's figure: one heat map a setting; raw, intuitive, optimised, and optimised with common coverage."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(MAIN), figsize=(5.2 * len(MAIN), 3.6), layout="constrained")
    for axis, setting in zip(axes, MAIN, strict=True):
        found = matrices(results, setting.name, "lift-splat")
        trained = [rig for rig in PAPER_RIGS if any(rig in matrix for matrix in found)]
        grid = [
            [mean(matrix[rig][test] for matrix in found if rig in matrix) * 100 for test in PAPER_RIGS]
            for rig in trained
        ]
        if not grid:
            continue
        axis.imshow(grid, vmin=0, vmax=70, cmap="viridis", aspect="auto")
        axis.set_title(setting.name)
        axis.set_xticks(range(len(PAPER_RIGS)), PAPER_RIGS, rotation=45, ha="right")
        axis.set_yticks(range(len(trained)), trained)
        axis.set_xlabel("tested on")
        for y, row in enumerate(grid):
            for x, value in enumerate(row):
                axis.text(x, y, f"{value:.0f}", ha="center", va="center", color="w" if value < 45 else "k")
    axes[0].set_ylabel("trained on")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--figure", type=Path, help="draw the heat maps (needs matplotlib)")
    parser.add_argument(
        "--into", type=Path, help="put the tables between this page's marks instead of printing them"
    )
    chosen = parser.parse_args()
    results = read_results(chosen.work)
    text = "\n\n".join(sections(results))
    if chosen.into:
        before, rest = chosen.into.read_text().split(BEGIN)
        chosen.into.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{rest.split(END)[1]}")
    else:
        print(text)
    if chosen.figure:
        draw(results, chosen.figure)


if __name__ == "__main__":
    main()
