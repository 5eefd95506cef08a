"""The pieces of a run: each is done once, and in processes of its own."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.cross_rig.config import Config, Drive, Setting, Training
from benchmarks.cross_rig.drives import convert_drive, converted, coverage, render

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(4 << 30),
    "MALLOC_TOP_PAD_": str(64 << 20),
}
"""Environment of the processes: torch's second thread would only wait, and freed memory is kept for the next batch.
Together that is nearly half of the CPU time of a training."""


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.part")
    part.write_text(json.dumps(document, indent=1))
    part.replace(path)


def say(text: str) -> None:
    print(time.strftime("%H:%M:%S"), text, flush=True)


def result_path(work: Path, training: str, rig: str) -> Path:
    return work / "results" / training / f"{rig}.json"


def unpack(work: Path, known: dict[str, dict[str, dict[str, Any]]]) -> None:
    """Puts results (by training and rig) where those of a run are, beside those that are there."""
    for name, by_rig in known.items():
        for rig, document in by_rig.items():
            path = result_path(work, name, rig)
            if not path.is_file():
                write_json(path, document)


def learn_and_score(work: Path, config: Config, training: Training) -> str:
    """Trains one detector, unless its weights are there, and scores it on each rig where it was not yet."""
    import torch

    from benchmarks.cross_rig.detector import DETECTORS
    from benchmarks.cross_rig.frames import read_frames, veil
    from benchmarks.cross_rig.learning import Seen, find, train
    from benchmarks.cross_rig.scoring import score

    torch.set_num_threads(1)
    data = work / "data"
    weights = work / "weights" / f"{training.name}.pt"
    started = time.process_time()
    if weights.is_file():
        detector = DETECTORS[training.detector]()
        detector.load_state_dict(torch.load(weights, weights_only=True))
        detector.eval()
    else:
        seen = []
        veils = tuple(map(veil, coverage(training.setting))) if training.setting.veiled else ()
        for rig in training.rigs:
            pieces = [read_frames(converted(data, drive, training.setting, rig)) for drive in config.train]
            seen.append(Seen(pieces[0][0], [frame for _, frames in pieces for frame in frames], veils))
        detector = train(
            training.detector, seen, config.iterations, config.batch, config.learning_rate, training.seed
        )
        weights.parent.mkdir(parents=True, exist_ok=True)
        part = weights.with_suffix(".part")
        torch.save(detector.state_dict(), part)
        part.replace(weights)
    trained_s = time.process_time() - started
    said = []
    for rig in training.tested:
        result = result_path(work, training.name, rig)
        if result.is_file():
            continue
        root = converted(data, config.test, training.setting, rig)
        rig_seen, frames = read_frames(root)
        document = score(root, frames, find(detector, Seen(rig_seen, frames)))
        write_json(result, {**document, "training_cpu_s": round(trained_s, 1)})
        said.append(f"{rig} {document['mAP']:.3f}")
    return f"{training.name}: {', '.join(said)} ({time.process_time() - started:.0f} s of CPU time)"


def in_processes(tasks: Iterable[Callable[[], str]], workers: int) -> None:
    """Runs tasks in order, so many at once."""
    os.environ.update(ONE_THREAD)
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for done in [pool.submit(task) for task in tasks]:
            say(done.result())


def conversions(data: Path, config: Config) -> list[tuple[Drive, Setting, str]]:
    """What is still to be converted, in the order in which trainings need it."""
    needed = (
        (drive, replace(training.setting, name=training.setting.pictures, veiled=False), rig)
        for training in config.trainings
        for drives, rigs in ((config.train, training.rigs), ((config.test,), training.tested))
        for drive in drives
        for rig in rigs
        if training.setting.virtual
    )
    return [one for one in dict.fromkeys(needed) if not (converted(data, *one) / "unidrive.json").is_file()]


def run(work: Path, config: Config, workers: int) -> None:
    todo = [t for t in config.trainings if not all(result_path(work, t.name, rig).is_file() for rig in t.tested)]
    config = replace(config, trainings=tuple(todo))
    data = work / "data"
    for drive in config.train:
        render(data, drive, config.train_rigs, workers)
        say(f"rendered {drive.name}")
    render(data, config.test, config.test_rigs, workers)
    say(f"rendered {config.test.name}")
    in_processes((partial(convert_drive, data, *one) for one in conversions(data, config)), workers)
    in_processes((partial(learn_and_score, work, config, training) for training in todo), workers)
