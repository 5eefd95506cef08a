"""The search: CMA-ES with margin on the grid of the free numbers (UniDrive section 3.4), restarted while it may."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cmaes import CMAwM

from unidrive_cli.errors import OutputError, UsageError
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.optimize.objective import Objective
from unidrive_cli.optimize.space import SearchSpace

_SIGMA = 0.25
"""First standard deviation, in parts of each parameter's range."""
_LARGEST_SEED = 2**32 - 1


@dataclass(frozen=True)
class Effort:
    """How long and how a search goes.

    Attributes:
        seed: another seed, another course.
        evaluations: candidates in all; the last generation is finished.
        population: candidates per generation of the first start, 0 for the library's choice; it doubles
            with each restart.
    """

    seed: int = 0
    evaluations: int = 4000
    population: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.seed < _LARGEST_SEED // 2:
            raise UsageError(f"--seed must be from 0 to {_LARGEST_SEED // 2 - 1}, got {self.seed}.")
        if self.evaluations < 1:
            raise UsageError(f"evaluations must be at least 1, got {self.evaluations}.")
        if self.population < 0 or 0 < self.population < 4:
            raise UsageError(f"population must be at least 4 (or 0 for a default), got {self.population}.")


@dataclass(frozen=True, eq=False)
class Best:
    """The best candidate of a search so far.

    Attributes:
        values: (n,) the free numbers.
        total: their objective.
        evaluations, generations, restarts: how far the search is.
    """

    values: Float
    total: float
    evaluations: int
    generations: int
    restarts: int


class Search:
    """A search that advances by generations and can be continued from its log.

    The log holds the objective of every candidate. Candidates follow from the seed and from what was told
    before, so a resumed search asks for the same ones and takes their objective from the log.
    """

    def __init__(self, space: SearchSpace, objective: Objective, effort: Effort, jobs: int = 0) -> None:
        """
        Args:
            jobs: candidates evaluated at once, in threads; the result does not depend on it.
        """
        self._space, self._objective, self._effort, self._jobs = space, objective, effort, jobs
        self._low = np.array([parameter.low for parameter in space.parameters])
        self._range = np.array([parameter.highest for parameter in space.parameters]) - self._low
        self._steps = np.array([parameter.step for parameter in space.parameters]) / self._range
        self._random = np.random.default_rng(effort.seed)
        self._known: dict[bytes, float] = {}
        self._evaluations = self._generations = self._restarts = 0
        self._optimizer = self._started((space.start_values - self._low) / self._range)
        self._values, self._total = space.start_values, np.inf

    def run(self, log: Path, *, resume: bool, identity: str) -> Iterator[Best]:
        """Yields the best so far, first the start itself, then after each generation.

        Args:
            log: a line for each generation, written as the search goes on.
            resume: continue from the log where there is one.
            identity: digest of all that the course depends on.

        Raises:
            UsageError: the log is of another search.
            OutputError: the log cannot be written.
            RigError, GeometryError: the space holds a rig that cannot be.
        """
        recorded = _read_log(log, identity) if resume else []
        if sum(map(len, recorded[:-1])) >= self._effort.evaluations:
            raise UsageError(
                f"{log} holds {sum(map(len, recorded)):,} candidates; {self._effort.evaluations:,} would be fewer.",
                hint="Ask for as many, or more.",
            )
        self._total = self._total_of(self._values)
        yield self._best
        lines = [{"search": identity}, *recorded]
        write_whole(log, "".join(json.dumps(line) + "\n" for line in lines))
        with _writing(log), self._evaluator() as evaluate, log.open("a", encoding="utf-8") as stream:
            while self._evaluations < self._effort.evaluations:
                asked = [self._optimizer.ask() for _ in range(self._optimizer.population_size)]
                candidates = [self._space.on_grid(self._low + grid * self._range) for grid, _ in asked]
                if recorded:
                    totals = recorded.pop(0)
                    if len(totals) != len(candidates):
                        raise _not_this(log)
                else:
                    totals = evaluate(candidates)
                    stream.write(json.dumps(totals) + "\n")
                    stream.flush()
                self._tell(asked, candidates, totals)
                yield self._best

    @property
    def _best(self) -> Best:
        return Best(self._values, self._total, self._evaluations, self._generations, self._restarts)

    def _tell(self, asked: list[tuple[Float, Float]], candidates: list[Float], totals: list[float]) -> None:
        for candidate, total in zip(candidates, totals, strict=True):
            self._known[candidate.tobytes()] = total
            if total < self._total:
                self._values, self._total = candidate, total
        self._optimizer.tell([(told, total) for (_, told), total in zip(asked, totals, strict=True)])
        self._evaluations += len(totals)
        self._generations += 1
        if self._optimizer.should_stop():
            self._restarts += 1
            self._optimizer = self._started(self._random.uniform(0, 1, len(self._low)))

    def _started(self, mean: Float) -> CMAwM:
        first = self._effort.population or 4 + int(3 * np.log(len(mean)))
        return CMAwM(
            mean=mean,
            sigma=_SIGMA,
            bounds=np.tile([0.0, 1.0], (len(mean), 1)),
            steps=self._steps,
            seed=self._effort.seed + self._restarts,
            population_size=first * 2**self._restarts,
        )

    def _total_of(self, values: Float) -> float:
        numbers = values.tolist()
        return self._objective(self._space.rig(numbers), self._space.depth_limit_m(numbers)).total

    @contextmanager
    def _evaluator(self) -> Iterator[Callable[[Sequence[Float]], list[float]]]:
        def evaluate(candidates: Sequence[Float]) -> list[float]:
            unknown = list({key: c for c in candidates if (key := c.tobytes()) not in self._known}.values())
            totals = (pool.map if pool else map)(self._total_of, unknown)
            self._known.update((known.tobytes(), total) for known, total in zip(unknown, totals, strict=True))
            return [self._known[candidate.tobytes()] for candidate in candidates]

        pool = ThreadPoolExecutor(self._jobs) if self._jobs > 1 else None
        try:
            yield evaluate
        finally:
            if pool:
                pool.shutdown(cancel_futures=True)


def _read_log(log: Path, identity: str) -> list[list[float]]:
    """The objectives of each finished generation; a line that a crash has cut off is left out."""
    try:
        lines = log.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return []
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{log} cannot be read.", hint="Leave out --resume to start anew.") from error
    records = []
    for line in lines:
        try:
            records.append(json.loads(line))
        except ValueError:
            break
    if not records or not isinstance(records[0], dict) or records[0].get("search") != identity:
        raise _not_this(log)
    generations = records[1:]
    if not all(isinstance(line, list) and all(isinstance(total, float) for total in line) for line in generations):
        raise _not_this(log)
    return generations


def _not_this(log: Path) -> UsageError:
    return UsageError(
        f"{log} is of another search: other sources, another search file, other options or another version.",
        hint="Leave out --resume to start anew.",
    )


def write_whole(path: Path, text: str) -> None:
    """Writes a whole file, or nothing.

    Raises:
        OutputError: it cannot be written.
    """
    partial = path.with_name(path.name + ".partial")
    with _writing(path):
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}.", where=str(path)) from error
