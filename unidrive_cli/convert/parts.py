"""Parts of a conversion for the tasks of a batch system's array job: which samples are whose."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass

from unidrive_cli.convert.plan import Moment
from unidrive_cli.errors import UsageError


@dataclass(frozen=True)
class Part:
    """One of `count` shares of a plan's units.

    Attributes:
        number: 1 to `count`.
        count: how many parts there are.
    """

    number: int
    count: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.count:
            raise UsageError(f"--part must be i/n with i from 1 to n, got {self}.")

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def of(self, units: Sequence[Moment]) -> list[Moment]:
        """This part's share; the shares of all parts are all units, each once.

        Whole scenes where there are enough of them, so that a part reads neighbouring files; runs of
        samples otherwise. Shares are consecutive and of about the same number of samples.

        Args:
            units: the plan's, by scene and time.
        """
        scenes = [list(group) for _, group in itertools.groupby(units, key=lambda unit: unit.scene.token)]
        pieces = scenes if len(scenes) >= self.count else [[unit] for unit in units]
        cuts = _cuts([len(piece) for piece in pieces], self.count)
        return [unit for piece in pieces[cuts[self.number - 1] : cuts[self.number]] for unit in piece]


def part_of(text: str) -> Part:
    """The part that `i/n` names.

    Raises:
        UsageError: it names none.
    """
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text)
    if not found:
        raise UsageError(f"--part must be i/n, such as 1/8 for the first of eight, got {text!r}.")
    return Part(int(found[1]), int(found[2]))


def _cuts(sizes: Sequence[int], count: int) -> list[int]:
    """Where a row of pieces is cut: count + 1 indices, each the nearest to an even share.

    No share is empty where there are enough pieces.
    """
    if len(sizes) < count:
        return [len(sizes) * number // count for number in range(count + 1)]
    ends = [0, *itertools.accumulate(sizes)]
    cuts = [0]
    for number in range(1, count):
        wanted = ends[-1] * number / count
        nearest = min(range(len(ends)), key=lambda index: abs(ends[index] - wanted))
        cuts.append(min(max(nearest, cuts[-1] + 1), len(sizes) - (count - number)))
    return [*cuts, len(sizes)]
