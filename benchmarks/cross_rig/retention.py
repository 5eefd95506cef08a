"""What is left of a detector on other rigs, from the result files."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import mean, stdev
from typing import Any

Matrix = Mapping[str, Mapping[str, float]]
"""A figure for each training rig and each test rig."""


@dataclass(frozen=True)
class Retention:
    """Means over training rigs.

    Attributes:
        own: on the training rig itself.
        others: on all other rigs, each training rig counted alike.
        worst: the lowest figure on another rig.
        worst_pair: that training and test rig.
    """

    own: float
    others: float
    worst: float
    worst_pair: tuple[str, str]

    @property
    def kept(self) -> float:
        """Off-diagonal mean over diagonal mean."""
        return self.others / self.own if self.own else 0.0


def retention(matrix: Matrix) -> Retention:
    """Of a matrix in which each training rig was tested on itself and on at least one other rig."""
    others = {(trained, rig): row[rig] for trained, row in matrix.items() for rig in row if rig != trained}
    worst_pair = min(others, key=lambda pair: (others[pair], pair))
    return Retention(
        own=mean(row[trained] for trained, row in matrix.items()),
        others=mean(mean(row[rig] for rig in row if rig != trained) for trained, row in matrix.items()),
        worst=others[worst_pair],
        worst_pair=worst_pair,
    )


def spread(figures: list[float], form: str = ".1f", times: float = 100.0) -> str:
    """Mean and, of several, sample standard deviation: `93.1 ± 2.0`."""
    text = format(mean(figures) * times, form)
    return text if len(figures) < 2 else f"{text} ± {format(stdev(figures) * times, form)}"


@dataclass(frozen=True)
class Key:
    """What a detector is, beside the rigs it learned from."""

    setting: str
    detector: str
    seed: int


def read_results(work: Path) -> dict[Key, dict[str, dict[str, dict[str, Any]]]]:
    """Result documents by key, training rig(s) and test rig."""
    found: dict[Key, dict[str, dict[str, dict[str, Any]]]] = defaultdict(dict)
    for name, by_rig in packed(work).items():
        setting, detector, trained, seed = name.split("/")
        found[Key(setting, detector, int(seed.removeprefix("seed")))][trained] = by_rig
    return found


def packed(work: Path) -> dict[str, dict[str, Any]]:
    """All result documents of a run, by training and test rig."""
    root = work / "results"
    found: dict[str, dict[str, Any]] = defaultdict(dict)
    for path in sorted(root.glob("*/*/*/seed*/*.json")):
        found[path.parent.relative_to(root).as_posix()][path.stem] = json.loads(path.read_text())
    return found


def matrix_of(documents: Mapping[str, Mapping[str, Mapping[str, Any]]], rigs: tuple[str, ...], what: str) -> Matrix:
    """One figure of the documents, for training rigs that were tested on all of some rigs."""
    return {
        trained: {rig: row[rig][what] for rig in rigs}
        for trained, row in documents.items()
        if trained in rigs and all(rig in row for rig in rigs)
    }
