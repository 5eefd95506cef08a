"""The search file (YAML): where a search starts, what is free, and what is bad."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ruamel.yaml.comments import CommentedMap

from unidrive_cli.errors import RigError, UsageError, did_you_mean
from unidrive_cli.optimize.objective import Penalties
from unidrive_cli.optimize.search import Effort
from unidrive_cli.optimize.space import QUANTITIES, Parameter, Quantity, SearchSpace
from unidrive_cli.rig.model import Rig
from unidrive_cli.rig.yaml_reading import check_keys, error_at, number_of, parse_yaml, read_text, text_of
from unidrive_cli.warp.choices import DEFAULT_DEPTH_LIMIT_M, DEFAULT_GROUND_HEIGHT_M

_KEYS = ("name", "description", "start", "mirror", "free", "corners", "penalties", "evaluations", "population")
_FREE_KEYS = ("of", "cameras", "share", "min", "max", "within", "step")
_PENALTIES = ("uncovered", "unfilled", "worst")
_ALL = "all"
_OWN, _COMMON = "own", "common"


@dataclass(frozen=True, eq=False)
class SearchFile:
    """What a search file says.

    Attributes:
        name, description: of the rig that is found.
        space: the start and the free numbers.
        common: whether only corners that every car sees count.
        penalties: weights of the objective.
        effort: evaluations and population; the seed is an option.
        ground_height_m: of the start rig, or the default.
    """

    name: str
    description: str
    space: SearchSpace
    common: bool
    penalties: Penalties
    effort: Effort
    ground_height_m: float


def load_search(path: Path, rig_named: Callable[[str], Rig]) -> SearchFile:
    """Reads a search file; its format is in docs/optimise.md.

    Args:
        rig_named: gives the rig that `start` names.

    Raises:
        RigError: not a search file; the sentence names the file, the line and the key.
        UsageError: bounds or cameras that cannot be.
    """
    where = str(path)
    document = parse_yaml(read_text(path), where)
    if not isinstance(document, CommentedMap):
        raise RigError(
            "a search file must be a mapping with the keys name, start and free.",
            where=where,
            hint="Its format is in docs/optimise.md.",
        )
    check_keys(document, _KEYS, ("name", "start", "free"), where)
    start = rig_named(text_of(document, "start", where))
    for camera in start.cameras:
        if camera.lens.coefficients:
            raise error_at(document, "start", where, f"must be a virtual rig; {camera.channel} has lens distortion.")
    try:
        mirror = _mirror(document, where)
        space = SearchSpace(
            start,
            DEFAULT_DEPTH_LIMIT_M if start.depth_limit_m is None else start.depth_limit_m,
            tuple(_parameters(document, start, mirror, where)),
            mirror,
        )
        effort = Effort(
            evaluations=_count(document, "evaluations", Effort.evaluations, where),
            population=_count(document, "population", Effort.population, where),
        )
    except UsageError as error:
        raise UsageError(error.what, where=where, hint=error.hint) from error
    ground = DEFAULT_GROUND_HEIGHT_M if start.ground_height_m is None else start.ground_height_m
    name = text_of(document, "name", where)
    description = text_of(document, "description", where) if "description" in document else ""
    return SearchFile(
        name, description, space, _common(document, where), _penalties(document, where), effort, ground
    )


def _mirror(document: CommentedMap, where: str) -> dict[str, str]:
    mirror = document.get("mirror", {})
    if not isinstance(mirror, dict) or not all(isinstance(name, str) for pair in mirror.items() for name in pair):
        raise error_at(document, "mirror", where, "must map channels to the channels that they mirror.")
    return dict(mirror)


def _parameters(document: CommentedMap, start: Rig, mirror: dict[str, str], where: str) -> list[Parameter]:
    entries = document["free"]
    if not isinstance(entries, list) or not entries:
        raise error_at(document, "free", where, "must be a list of free numbers, and hold at least one.")
    parameters: list[Parameter] = []
    for index, entry in enumerate(entries, 1):
        place = f"{where}, free number {index}"
        if not isinstance(entry, CommentedMap):
            raise RigError("must be a mapping with of, cameras, min and max (or within), and step.", where=place)
        check_keys(entry, _FREE_KEYS, ("of",), place)
        of = _quantity(entry, place)
        low, high, relative = _bounds(entry, place)
        step = number_of(entry, "step", place) if "step" in entry else 0.0
        if of == "depth_limit":
            for key in ("cameras", "share"):
                if key in entry:
                    raise error_at(
                        entry, key, place, "does not go with depth_limit, which belongs to the whole rig."
                    )
            groups: list[tuple[str, ...]] = [()]
        else:
            groups = _groups(entry, start, mirror, place)
        parameters.extend(Parameter(of, group, low, high, step, relative) for group in groups)
    return parameters


def _quantity(entry: CommentedMap, where: str) -> Quantity:
    value = entry["of"]
    for quantity in QUANTITIES:
        if quantity == value:
            return quantity
    guess = did_you_mean(str(value)[:60], QUANTITIES) or f"Known are {', '.join(QUANTITIES)}."
    raise error_at(entry, "of", where, f"names no quantity: {value!r:.60}. {guess}")


def _bounds(entry: CommentedMap, where: str) -> tuple[float, float, bool]:
    """Lower and upper bound, and whether they are relative to the start."""
    given = [key for key in ("min", "max", "within") if key in entry]
    if given not in (["min", "max"], ["within"]):
        raise RigError("either min and max, or within, must be given.", where=where)
    if given == ["within"]:
        around = number_of(entry, "within", where)
        if around <= 0:
            raise error_at(entry, "within", where, f"must be a positive number, got {around:g}.")
        return -around, around, True
    return number_of(entry, "min", where), number_of(entry, "max", where), False


def _groups(entry: CommentedMap, start: Rig, mirror: dict[str, str], where: str) -> list[tuple[str, ...]]:
    """The cameras of each free number that an entry makes: one for all of them, or one each."""
    if "cameras" not in entry:
        raise RigError(f"the key cameras is missing: a list of channels, or {_ALL}.", where=where)
    cameras = entry["cameras"]
    if cameras == _ALL:
        channels = [channel for channel in start.channels if channel not in mirror]
    elif isinstance(cameras, list) and cameras and all(isinstance(channel, str) for channel in cameras):
        channels = list(cameras)
    else:
        raise error_at(entry, "cameras", where, f"must be a list of channels, or {_ALL}, got {cameras!r:.60}.")
    share = entry.get("share", False)
    if not isinstance(share, bool):
        raise error_at(entry, "share", where, f"must be true or false, got {share!r:.60}.")
    return [tuple(channels)] if share else [(channel,) for channel in channels]


def _common(document: CommentedMap, where: str) -> bool:
    value = document.get("corners", _OWN)
    if value not in (_OWN, _COMMON):
        raise error_at(document, "corners", where, f"must be {_OWN} or {_COMMON}, got {value!r:.60}.")
    return bool(value == _COMMON)


def _penalties(document: CommentedMap, where: str) -> Penalties:
    given = document.get("penalties", CommentedMap())
    if not isinstance(given, CommentedMap):
        raise error_at(document, "penalties", where, f"must map {', '.join(_PENALTIES)} to numbers.")
    place = f"{where}, penalties"
    check_keys(given, _PENALTIES, (), place)
    values = {}
    for key in given:
        values[str(key)] = number_of(given, key, place)
        if values[str(key)] < 0:
            raise error_at(given, key, place, f"must not be negative, got {values[str(key)]:g}.")
    return Penalties(**values)


def _count(document: CommentedMap, key: str, default: int, where: str) -> int:
    if key not in document:
        return default
    number = number_of(document, key, where)
    if number != int(number):
        raise error_at(document, key, where, f"must be a whole number, got {number:g}.")
    return int(number)
