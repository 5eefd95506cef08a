"""Training a detector on frames, and what it finds in others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch.nn import functional

from benchmarks.cross_rig.config import CLASSES
from benchmarks.cross_rig.detector import DETECTORS, Detector
from benchmarks.cross_rig.frames import DEPTHS_M, NO_DEPTH, Frame, Rig
from benchmarks.cross_rig.targets import Float32, Found, Targets, decode, encode, turned

_TURN_RAD = np.deg2rad(22.5)
_NUMBERS_WEIGHT = 0.5


@dataclass(frozen=True, eq=False)
class Seen:
    """A rig, its frames, and what may be drawn over them while a detector learns, one each time (C, 1, H, W)."""

    rig: Rig
    frames: Sequence[Frame]
    veils: Sequence[Float32] = ()


def train(kind: str, data: Sequence[Seen], iterations: int, batch: int, rate: float, seed: int) -> Detector:
    """A detector after so many batches; each batch is of one rig, rigs in turn.

    Depth, where it is learned, is also told by the lidar (as BEVDepth does). Augmented by flipped pictures and by
    a turned or mirrored grid, calibration following. All this in all settings alike; where there are veils, one is
    drawn over each frame.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    detector: Detector = DETECTORS[kind]()
    optimiser = torch.optim.AdamW(detector.parameters(), lr=rate, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=iterations, pct_start=0.2)
    orders = [_shuffled(rng, len(seen.frames)) for seen in data]
    detector.train()
    for step in range(iterations):
        turn = step % len(data)
        chosen = [data[turn].frames[next(orders[turn])] for _ in range(batch)]
        turns = np.stack([_random_turn(rng) for _ in chosen])
        mirrored = torch.from_numpy(rng.random(batch) < 0.5)
        shown = [frame.pictures for frame in chosen]
        if veils := data[turn].veils:
            shown = [(one * veils[rng.integers(len(veils))]).astype(np.uint8) for one in shown]
        pictures = torch.from_numpy(np.stack(shown))
        targets = [
            encode(frame.classes, turned(frame.boxes, by), len(CLASSES))
            for frame, by in zip(chosen, turns, strict=True)
        ]
        heat, numbers, features = detector(pictures, data[turn].rig, mirrored, torch.from_numpy(turns))
        loss = _loss(heat, numbers, targets)
        if detector.learns_depth:
            said = features[:, :, : len(DEPTHS_M)].permute(0, 1, 3, 4, 2).flatten(0, 3)
            measured = torch.from_numpy(np.stack([frame.depth for frame in chosen])).long().flatten()
            loss = loss + functional.cross_entropy(said, measured, ignore_index=NO_DEPTH)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(detector.parameters(), 5.0)
        optimiser.step()
        schedule.step()
    detector.eval()
    return detector


def find(detector: Detector, seen: Seen) -> list[Found]:
    """Classes, scores and ego boxes (n, 7) of each frame."""
    still = torch.eye(2)[None]
    found = []
    with torch.inference_mode():
        for frame in seen.frames:
            pictures = torch.from_numpy(frame.pictures)[None]
            heat, numbers, _ = detector(pictures, seen.rig, torch.zeros(1, dtype=torch.bool), still)
            found.append(decode(heat[0].sigmoid().numpy(), numbers[0].numpy()))
    return found


def _shuffled(rng: np.random.Generator, count: int) -> Iterator[int]:
    while True:
        yield from rng.permutation(count)


def _random_turn(rng: np.random.Generator) -> Float32:
    angle = rng.uniform(-_TURN_RAD, _TURN_RAD)
    side = rng.choice([-1.0, 1.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    mirrored: Float32 = (turn @ np.diag([1.0, side])).astype(np.float32)
    return mirrored


def _loss(heat: torch.Tensor, numbers: torch.Tensor, targets: Sequence[Targets]) -> torch.Tensor:
    """Focal loss of the heat (CornerNet's), and the mean absolute error of the numbers at the centres."""
    wanted = torch.from_numpy(np.stack([target.heat for target in targets]))
    centres = wanted == 1
    count = centres.sum().clamp(min=1)
    score = heat.sigmoid()
    hit = -(functional.logsigmoid(heat) * (1 - score) ** 2)[centres].sum()
    miss = -(functional.logsigmoid(-heat) * score**2 * (1 - wanted) ** 4)[~centres].sum()
    said = [numbers[n].flatten(1).T[torch.from_numpy(target.cells)] for n, target in enumerate(targets)]
    right = torch.from_numpy(np.concatenate([target.numbers for target in targets]))
    away = (torch.cat(said) - right).abs().sum() / max(len(right), 1)
    return (hit + miss) / count + _NUMBERS_WEIGHT * away
