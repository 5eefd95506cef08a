"""Tables (Markdown) and the paper's figure, of what a run has so far.

python -m benchmarks.cross_rig.report FOLDER [--figure FILE.png] [--into PAGE.md] [--json FILE.json]
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from statistics import mean
from typing import Any

from benchmarks.cross_rig import paper
from benchmarks.cross_rig.config import (
    CLASSES,
    COMMON,
    FLAT,
    FLAT_COMMON,
    HEIGHTS,
    LENSES,
    MAIN,
    OPTIMISED,
    PAPER_RIGS,
    TRAINED,
    VARIANTS,
    VARIANTS_TRAINED,
    VEILED,
)
from benchmarks.cross_rig.retention import Key, Matrix, matrix_of, packed, read_results, retention, spread

BEGIN, END = "<!-- tables -->", "<!-- end of tables -->"
SHOWN = (*MAIN, FLAT, FLAT_COMMON, OPTIMISED, COMMON, VEILED)
"""What the tables compare; variants of it have a table of their own."""
Results = Mapping[Key, Mapping[str, Mapping[str, Mapping[str, Any]]]]


def table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def percent(figure: float) -> str:
    return f"{figure * 100:.1f}"


def tested_rigs(results: Results) -> tuple[str, ...]:
    """Those of the paper's that anything was tested on."""
    tested = {rig for documents in results.values() for row in documents.values() for rig in row}
    return tuple(rig for rig in PAPER_RIGS if rig in tested)


def matrices(
    results: Results, setting: str, detector: str, what: str = "mAP", trained: tuple[str, ...] = PAPER_RIGS
) -> list[Matrix]:
    """One matrix a seed, of the seeds that have most of some training rigs: means of others would not compare."""
    keys = sorted(
        (key for key in results if (key.setting, key.detector) == (setting, detector)), key=lambda k: k.seed
    )
    whole = [matrix_of(results[key], tested_rigs(results), what) for key in keys]
    found = [{rig: row for rig, row in matrix.items() if rig in trained} for matrix in whole]
    most = max(map(len, found), default=0)
    return [matrix for matrix in found if matrix and len(matrix) == most]


HEAD = [
    *("setting", "detector", "seeds (training rigs of each)", "own mAP", "other rigs' mAP", "retention"),
    *("worst pair", "own NDS", "NDS retention"),
]


def headline(results: Results) -> str:
    """Retention by setting, beside the paper's."""
    rows = [paper_row("paper, raw", paper.RAW), paper_row("paper, unified", paper.UNIFIED)]
    for detector in ("lift-splat", "bilinear"):
        rows.extend(retained(setting.name, detector, results, PAPER_RIGS, None) for setting in SHOWN)
    return table(HEAD, [row for row in rows if row])


def variants(results: Results) -> str:
    """Retention of what is varied, beside the main settings with the same training rigs and the same seed."""
    rows = [
        retained(setting.name, "lift-splat", results, VARIANTS_TRAINED, 1) for setting in (*SHOWN[1:], *VARIANTS)
    ]
    return table(HEAD, [row for row in rows if row])


def retained(
    setting: str, detector: str, results: Results, trained: tuple[str, ...], seeds: int | None
) -> list[str]:
    """A row of HEAD; empty where there are no results."""
    found, scores = (matrices(results, setting, detector, what, trained)[:seeds] for what in ("mAP", "NDS"))
    if not found:
        return []
    kept, nds = [retention(matrix) for matrix in found], [retention(matrix) for matrix in scores]
    worst = min(kept, key=lambda one: one.worst)
    return [
        setting,
        detector,
        f"{len(found)} ({', '.join(str(len(matrix)) for matrix in found)})",
        spread([one.own for one in kept]),
        spread([one.others for one in kept]),
        f"{spread([one.kept for one in kept], '.0f')} %",
        f"{spread([one.worst for one in kept])} ({' on '.join(worst.worst_pair)})",
        spread([one.own for one in nds]),
        f"{spread([one.kept for one in nds], '.0f')} %",
    ]


def mixed(results: Results) -> str:
    """One detector for four rigs at once: mAP on these and on the four that it never saw."""
    rows = []
    for setting in SHOWN:
        documents = results.get(Key(setting.name, "lift-splat", 0), {}).get(",".join(TRAINED), {})
        if all(rig in documents for rig in PAPER_RIGS):
            seen = mean(documents[rig]["mAP"] for rig in TRAINED)
            new = mean(documents[rig]["mAP"] for rig in PAPER_RIGS if rig not in TRAINED)
            rows.append([setting.name, percent(seen), percent(new), f"{new / seen:.0%}"])
    return table(["setting", "its four rigs", "the other four", "kept"], rows)


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
            *(_cell(cells.get((trained, rig), []), rig in trained.split(",")) for rig in tested_rigs(results)),
        ]
        for trained in trained_on
    ]
    return table(["trained on", *tested_rigs(results)], rows)


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
    for setting in SHOWN:
        row = [setting.name]
        for rig in ("6x60", *tested):
            figures = [
                documents["6x60"][rig]["mAP"]
                for key, documents in results.items()
                if (key.setting, key.detector) == (setting.name, "lift-splat") and rig in documents.get("6x60", {})
            ]
            row.append(spread(figures) if figures else "-")
        if any(cell != "-" for cell in row[2:]):
            rows.append(row)
    return table(["setting", "6x60", *tested], rows)


def sections(results: Results) -> Iterator[str]:
    yield f"## Retention\n\n{headline(results)}"
    for detector in ("lift-splat", "bilinear"):
        for setting in dict.fromkeys(key.setting for key in results if key.detector == detector):
            yield f"## {setting}, {detector}: mAP\n\n{full_table(results, setting, detector)}"
    others = (
        *((f"{each.name}, lift-splat: AP by class", classes(results, each.name, "lift-splat")) for each in MAIN),
        ("Depth limit, blend, common coverage", variants(results)),
        ("Four rigs at once", mixed(results)),
        ("Lenses", ablation(results, tuple(LENSES))),
        ("Heights", ablation(results, tuple(HEIGHTS))),
    )
    for title, found in others:
        if found.count("\n") > 1:
            yield f"## {title}\n\n{found}"


def draw(results: Results, path: Path) -> None:
    """The paper's figure: one heat map a main setting, all with one scale."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    rigs = tested_rigs(results)
    grids: dict[str, dict[str, list[float]]] = {}
    for setting in MAIN:
        found = matrices(results, setting.name, "lift-splat")
        trained = [rig for rig in PAPER_RIGS if any(rig in matrix for matrix in found)]
        if trained:
            grids[setting.name] = {
                rig: [mean(matrix[rig][test] for matrix in found if rig in matrix) * 100 for test in rigs]
                for rig in trained
            }
    top = max(value for grid in grids.values() for row in grid.values() for value in row)
    figure, axes = pyplot.subplots(
        1, len(grids), figsize=(4.6 * len(grids), 3.2), layout="constrained", squeeze=False
    )
    for axis, (name, grid) in zip(axes[0], grids.items(), strict=True):
        axis.imshow(list(grid.values()), vmin=0, vmax=top, cmap="viridis", aspect="auto")
        axis.set_title(name)
        axis.set_xticks(range(len(rigs)), rigs, rotation=45, ha="right")
        axis.set_yticks(range(len(grid)), grid)
        axis.set_xlabel("tested on")
        for y, row in enumerate(grid.values()):
            for x, value in enumerate(row):
                axis.text(x, y, f"{value:.0f}", ha="center", va="center", color="w" if value < 0.7 * top else "k")
    axes[0][0].set_ylabel("trained on (mAP)")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--figure", type=Path, help="draw the heat maps (needs matplotlib)")
    parser.add_argument(
        "--into", type=Path, help="put the tables between this page's marks instead of printing them"
    )
    parser.add_argument("--json", type=Path, help="put all results into one file")
    chosen = parser.parse_args()
    if chosen.json:
        chosen.json.write_text(json.dumps(packed(chosen.work), indent=0) + "\n")
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
