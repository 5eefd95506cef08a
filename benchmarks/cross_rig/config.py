"""All that can be chosen about the benchmark, in one place."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

PAPER_RIGS = ("4x95", "5x75", "6x80a", "6x80b", "6x70", "6x60", "8x50", "5x70+110")
TRAINED = ("6x60", "6x80a", "6x80b", "5x70+110")
"""The four training rigs of the paper's tables."""
SEEDS = (0, 1, 2)
"""Of the four main settings with the Lift-Splat detector; the others have the first."""
LENSES = {"6x60-at-70": 70.0, "6x60-at-80": 80.0}
"""6x60 with other lenses (degrees) and nothing else changed."""
HEIGHTS = {"6x60-at-1.5m": 1.5, "6x60-at-1.8m": 1.8, "6x60-at-2.5m": 2.5}
"""6x60, which stands at 1.6 m, at other heights (metres) and nothing else changed. The roof is at 1.45 m."""
PICTURE = (320, 180)
"""Pixels of rendered pictures, twice the detector's; virtual ones are as wide."""
SEEN = (160, 96)
"""Pixels of what the detector sees."""
STRIDE = 8
"""Pixels of SEEN that one feature stands for, both ways."""
CLASSES = ("car", "truck", "bus", "pedestrian", "motorcycle", "bicycle")
"""The paper's six, under nuScenes' detection names."""
RANGE_M = 25
"""Boxes count up to so far from the ego origin: the circle in the detector's grid."""


@dataclass(frozen=True)
class Setting:
    """What is done to the pictures before the detector sees them.

    Attributes:
        virtual: a shipped virtual rig; the pictures stay as they are where it is empty.
        depth_limit_m: D0; the rig's own default where None.
        common: black what not all of the paper's rigs fill (`--common-with`).
        veiled: the detector learns from pictures in which what one of the paper's rigs does not fill is black, each
            time another one's; it is tested on the same pictures as without.
    """

    name: str
    virtual: str = ""
    depth_limit_m: float | None = None
    common: bool = False
    blend: str = "angular"
    veiled: bool = False

    @property
    def pictures(self) -> str:
        """Names the converted pictures."""
        return self.name.removesuffix("-veiled")


RAW = Setting("raw")
INTUITIVE = Setting("intuitive", "intuitive-6")
OPTIMISED = Setting("optimised", "unidrive-optimised-6")
COMMON = replace(OPTIMISED, name="optimised-common", common=True)
FLEET = Setting("fleet", "unidrive-fleet-6")
FLEET_COMMON = replace(FLEET, name="fleet-common", common=True)
MAIN = (RAW, INTUITIVE, FLEET, FLEET_COMMON)
FLAT = Setting("intuitive-flat", "intuitive-flat-6")
"""The intuitive rig with the shape and D0 that the search for the fleet rig found; only the places are its own."""
FLAT_COMMON = replace(FLAT, name="intuitive-flat-common", common=True)
VEILED = replace(OPTIMISED, name="optimised-veiled", veiled=True)
NEAREST = replace(COMMON, name="optimised-common-nearest", blend="nearest")
DEPTHS = tuple(
    replace(COMMON, name=f"optimised-common-d{depth_m}", depth_limit_m=float(depth_m)) for depth_m in (15, 30, 100)
)
INTUITIVE_COMMON = replace(INTUITIVE, name="intuitive-common", common=True)
VARIANTS = (*DEPTHS, NEAREST, INTUITIVE_COMMON)
VARIANTS_TRAINED = ("6x80a", "6x60")
"""The training rigs of the variants: one that fills the virtual rigs, one that does not."""


@dataclass(frozen=True)
class Drive:
    """A drive that `unidrive synth` makes: the same for all rigs."""

    name: str
    seed: int
    scenes: int
    keyframes: int


@dataclass(frozen=True)
class Training:
    """One detector: what it is, what it learns from, and where it is tested.

    Attributes:
        rigs: several mean that each frame comes from one of them, in turn.
    """

    setting: Setting
    detector: str
    rigs: tuple[str, ...]
    seed: int
    tested: tuple[str, ...]

    @property
    def name(self) -> str:
        return f"{self.setting.name}/{self.detector}/{','.join(self.rigs)}/seed{self.seed}"


@dataclass(frozen=True)
class Config:
    """The whole run.

    Attributes:
        train, test: drives with different seeds; training drives are pieces of one set.
        trainings: in the order in which they are done.
    """

    name: str
    train: tuple[Drive, ...]
    test: Drive
    trainings: tuple[Training, ...]
    iterations: int
    batch: int = 4
    learning_rate: float = 2e-3

    @property
    def train_rigs(self) -> tuple[str, ...]:
        return _unique(rig for training in self.trainings for rig in training.rigs)

    @property
    def test_rigs(self) -> tuple[str, ...]:
        return _unique(rig for training in self.trainings for rig in training.tested)


def _unique(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))


def _matrix(
    settings: tuple[Setting, ...], detector: str, rigs: tuple[str, ...], seed: int, tested: tuple[str, ...]
) -> tuple[Training, ...]:
    return tuple(Training(setting, detector, (rig,), seed, tested) for rig in rigs for setting in settings)


def _tests(rig: str) -> tuple[str, ...]:
    """6x60 is also tested with other lenses and at other heights."""
    return (*PAPER_RIGS, *LENSES, *HEIGHTS) if rig == "6x60" else PAPER_RIGS


def _main(seed: int, settings: tuple[Setting, ...] = MAIN, rigs: tuple[str, ...] = TRAINED) -> tuple[Training, ...]:
    return tuple(training for rig in rigs for training in _matrix(settings, "lift-splat", (rig,), seed, _tests(rig)))


def full(all_eight: bool = False) -> Config:
    """`make cross-rig`: the headline and its seeds, several rigs at once, variants, the other detector."""
    mixed = (RAW, FLEET, FLEET_COMMON, OPTIMISED, COMMON)
    others = tuple(rig for rig in PAPER_RIGS if rig not in TRAINED)
    trainings = (
        *(training for seed in SEEDS for training in _main(seed)),
        *_main(0, (FLAT, FLAT_COMMON, OPTIMISED, COMMON)),
        *(Training(setting, "lift-splat", TRAINED, 0, PAPER_RIGS) for setting in mixed),
        *_matrix(VARIANTS, "lift-splat", VARIANTS_TRAINED, 0, PAPER_RIGS),
        *_matrix((VEILED,), "lift-splat", TRAINED, 0, PAPER_RIGS),
        *_matrix(MAIN, "bilinear", TRAINED, 0, PAPER_RIGS),
        *(_main(0, rigs=others) if all_eight else ()),
    )
    train = (Drive("train0", 100, 10, 6), Drive("train1", 101, 50, 6))
    return Config("full", train, Drive("test", 200, 20, 5), trainings, iterations=1200)


def quick() -> Config:
    """`make cross-rig-quick`: the collapse and the way out of it, on two training and four test rigs."""
    tested = ("6x80a", "6x70", "4x95", "6x60")
    trainings = _matrix((RAW, FLEET, FLEET_COMMON), "lift-splat", ("6x80a", "6x60"), 0, tested)
    return Config("quick", (Drive("train0", 100, 12, 5),), Drive("test", 200, 6, 5), trainings, iterations=300)
