"""Seeded mutations of tables, rigs and pictures, and the command line run on them.

    python -m tests.fuzzing 20000 [FIRST_SEED]

Whatever is broken, a command must end within ten seconds of CPU time with a documented exit code and a sentence,
leave the source as it was, and write nothing outside its destination. `Bench.convert` looks at the last two.
"""

from __future__ import annotations

import contextlib
import copy
import json
import random
import shutil
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.datasets import VERSION, Bench, paint, unidrive
from unidrive_cli.warp.render import choose_toolchain, prepare

EXIT_CODES = (0, 1, 2, 3, 4)
MOST_CPU_SECONDS, MOST_SECONDS = 10, 120
TABLES = (
    "sensor", "calibrated_sensor", "ego_pose", "sample", "sample_data", "scene", "sample_annotation", "instance",
    "category", "attribute", "visibility", "log", "map",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 3, 10**18, -(10**30), 1e308, -0.0, 0.5, float("nan"), float("inf"), "", " ", "0",
    "..", "../../outside", "/etc/passwd", "samples/../../../outside", "a" * 10_000, "a\0b", "é\u202e\U0001f600",
    "CAM_FRONT", "v1.0-mini", ".unidrive/plan.json", [], [0], [0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0],
    [float("nan")] * 4, [1e200] * 3, [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0] * 3] * 3, {}, {"token": "x"},
    [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
)  # fmt: skip
TEXTS = (
    "", "null", "[]", "{}", "0", '"text"', "[[]]", "[null]", "[{}]", "{", "[" * 10_000, '{"a":' * 5_000, "\ufeff[]",
    "[NaN]", "[1e999]", "[" + "9" * 1_000_000 + "]", '[{"token": "a", "token": "b"}]', "[1,]", "\0\0\0", "<html>",
)  # fmt: skip
RIG_VALUES = (
    "", "null", "nan", ".inf", "-1", "0", "1e9", "1e400", "180", "99999999999999999999", "[]", "[1, 2]", "[a, b, c]",
    "{}", "yes", "2026-01-01", "!!python/object:os.system x", "&a [*a]", "*nobody", "'a\\0b'", "{hfov: 3}",
    "../../x",
)  # fmt: skip
BOMB = "a: &a [x, x, x, x, x, x, x, x]\n" + "".join(
    f"{chr(98 + n)}: &{chr(98 + n)} [{', '.join('*' + chr(97 + n) for _ in range(8))}]\n" for n in range(8)
)


def mutate(bench: Bench, chance: random.Random) -> str:
    """Breaks something about a bench in one to three places, and says what."""
    kinds: tuple[Callable[[Bench, random.Random], str], ...] = (
        _field, _field, _field, _field, _rows, _text, _bytes, _file_name, _rig, _rig, _picture, _picture, _links,
    )  # fmt: skip
    done = []
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        with contextlib.suppress(OSError):  # what the last one broke cannot be broken again
            done.append(chance.choice(kinds)(bench, chance))
    return "; ".join(done)


def _read(bench: Bench, name: str) -> Any:
    try:
        return json.loads(bench.table(name).read_text())
    except (ValueError, RecursionError, OSError):
        return None


def _field(bench: Bench, chance: random.Random) -> str:
    name = chance.choice(TABLES)
    found = _read(bench, name)
    if not (isinstance(found, list) and found and isinstance(found[0], dict)):
        return f"{name} is broken already"
    row = chance.choice(found)
    if not isinstance(row, dict) or not row:
        return f"{name} has no fields"
    key = chance.choice(sorted(row))
    what = chance.choice(("value", "value", "value", "missing", "of another row", "inside"))
    if what == "missing":
        del row[key]
    elif what == "of another row":
        row[key] = copy.deepcopy(chance.choice(found).get(key))
    elif what == "inside" and isinstance(row[key], list) and row[key]:
        row[key][chance.randrange(len(row[key]))] = chance.choice(VALUES)
    else:
        row[key] = chance.choice(VALUES)
    bench.table(name).write_text(json.dumps(found))
    return f"{name}.{key}: {what} {str(row.get(key))[:40]!r}"


def _rows(bench: Bench, chance: random.Random) -> str:
    name = chance.choice(TABLES)
    found = _read(bench, name)
    if not (isinstance(found, list) and found):
        return f"{name} is broken already"
    what = chance.choice(("doubled", "gone", "all gone", "shuffled", "null", "deep"))
    place = chance.randrange(len(found))
    if what == "doubled":
        found.append(copy.deepcopy(found[place]))
    elif what == "gone":
        del found[place]
    elif what == "all gone":
        found.clear()
    elif what == "shuffled":
        chance.shuffle(found)
    else:
        found[place] = None if what == "null" else [[[[[found[place]]]]]]
    bench.table(name).write_text(json.dumps(found))
    return f"{name}: a row {what}"


def _text(bench: Bench, chance: random.Random) -> str:
    name, text = chance.choice(TABLES), chance.choice(TEXTS)
    bench.table(name).write_text(text)
    return f"{name}: the text {text[:20]!r}"


def _bytes(bench: Bench, chance: random.Random) -> str:
    name = chance.choice(TABLES)
    data = bytearray(bench.table(name).read_bytes())
    what = chance.choice(("cut", "changed", "gone", "folder"))
    if what == "cut":
        del data[chance.randrange(len(data) + 1) :]
    for _ in range(chance.randrange(1, 6) if what == "changed" and data else 0):
        data[chance.randrange(len(data))] = chance.randrange(256)
    bench.table(name).unlink()
    if what == "folder":
        bench.table(name).mkdir()
    elif what != "gone":
        bench.table(name).write_bytes(data)
    return f"{name}: bytes {what}"


def _file_name(bench: Bench, chance: random.Random) -> str:
    name = chance.choice(("sample_data", "map"))
    found = _read(bench, name)
    if not (isinstance(found, list) and found and all(isinstance(row, dict) for row in found)):
        return f"{name} is broken already"
    value = chance.choice([value for value in VALUES if isinstance(value, str)])
    for row in found if chance.random() < 0.2 else [chance.choice(found)]:
        row["filename"] = value
    bench.table(name).write_text(json.dumps(found))
    return f"{name}.filename {value[:30]!r}"


def _rig(bench: Bench, chance: random.Random) -> str:
    text = bench.rig.read_text(errors="replace")
    what = chance.choice(("value", "value", "key", "cut", "line", "bomb", "bytes"))
    if what in ("value", "key"):
        places = [at for at in range(len(text)) if text[at] == ":"] or [0]
        at = chance.choice(places)
        end = min((text.find(mark, at) for mark in ",}\n" if text.find(mark, at) >= 0), default=len(text))
        if what == "value":
            text = text[: at + 1] + " " + chance.choice(RIG_VALUES) + text[end:]
        else:
            text = text[:at] + chance.choice(("x", "_", "", "hfov", "\t")) + text[at:]
    elif what == "cut":
        text = text[: chance.randrange(len(text) + 1)]
    elif what == "line":
        lines = text.splitlines()
        lines.insert(chance.randrange(len(lines) + 1), chance.choice((*RIG_VALUES, *lines)))
        text = "\n".join(lines)
    elif what == "bomb":
        text = BOMB + text
    data = text.encode()
    if what == "bytes":
        changed = bytearray(data)
        for _ in range(chance.randrange(1, 4) if data else 0):
            changed[chance.randrange(len(changed))] = chance.randrange(256)
        data = bytes(changed)
    bench.rig.write_bytes(data)
    return f"rig: {what}"


def _picture(bench: Bench, chance: random.Random) -> str:
    path = chance.choice(sorted((bench.src / "samples").rglob("*.jpg")) or [bench.src / "samples" / "x.jpg"])
    data = bytearray(path.read_bytes()) if path.is_file() else bytearray()
    what = chance.choice(("cut", "changed", "gone", "empty", "other size", "huge", "png", "grey", "folder", "loop"))
    path.unlink(missing_ok=True)
    if what == "gone":
        return f"{path.name}: gone"
    if what == "folder":
        path.mkdir()
    elif what == "loop":
        path.symlink_to(chance.choice((path.name, "/etc/hostname", "../../..")))
    elif what == "huge" and data:
        at = max(data.find(b"\xff\xc0"), data.find(b"\xff\xc2"))
        data[at + 5 : at + 9] = b"\xea\x60\xea\x60"  # 60,000 x 60,000
        path.write_bytes(data)
    elif what in ("other size", "grey", "png"):
        shape = (33, 60, 3) if what == "other size" else (45, 80) if what == "grey" else (45, 80, 3)
        picture = np.full(shape, 90, dtype=np.uint8)
        path.write_bytes(cv2.imencode(".png" if what == "png" else ".jpg", picture)[1].tobytes())
    else:
        if what == "cut":
            del data[chance.randrange(len(data) + 1) :]
        for _ in range(chance.randrange(1, 9) if what == "changed" and data else 0):
            data[chance.randrange(len(data))] = chance.randrange(256)
        path.write_bytes(b"" if what == "empty" else data)
    return f"{path.name}: {what}"


def _links(bench: Bench, chance: random.Random) -> str:
    """A folder that leads elsewhere, or is none."""
    name = chance.choice(("maps", "samples/LIDAR_TOP", "samples/CAM_FRONT", VERSION))
    folder = bench.src / name
    if folder.is_symlink() or not folder.is_dir():
        return f"{name} is gone already"
    shutil.rmtree(folder)
    what = chance.choice(("out", "itself", "file", "gone"))
    if what == "out":
        elsewhere = bench.folder / "elsewhere"
        elsewhere.mkdir(exist_ok=True)
        folder.symlink_to(elsewhere)
    elif what == "itself":
        folder.symlink_to(folder.name)
    elif what == "file":
        folder.write_text("no folder")
    return f"{name}: {what}"


def commands(bench: Bench, chance: random.Random) -> Iterator[Callable[[], Any]]:
    """What is run on a broken bench: the conversion always, and one other command."""
    options = chance.choice(
        ((), (), ("--on-error", "skip"), ("--masks", "camera"), ("--dry-run",), ("--link", "copy"))
    )
    if (bench.src / VERSION).is_dir():
        yield lambda: bench.convert(*options)
    else:
        yield lambda: unidrive("convert", bench.src, bench.dst, "--rig", bench.rig, "--jobs", 0)
    yield chance.choice(
        (
            lambda: unidrive("inspect-rig", bench.rig),
            lambda: unidrive("inspect-rig", bench.src),
            lambda: unidrive("measure", bench.src, "--rig", bench.rig, "--jobs", 0),
            lambda: unidrive("convert", bench.src, bench.dst, "--rig", "6x60", "--jobs", 0),
        )
    )


def fuzz(painted: Path, folder: Path, seed: int) -> str:
    """One case in an empty folder; says what was broken.

    Raises:
        AssertionError: a command did not end as it must.
    """
    chance = random.Random(seed)
    bench = Bench(folder, painted)
    broken = mutate(bench, chance)
    for command in commands(bench, chance):
        try:
            with _not_for_ever():
                run = command()
        except Exception as error:
            raise AssertionError(f"seed {seed} ({broken}): {error}") from error
        assert run.code in EXIT_CODES, f"seed {seed} ({broken}): exit code {run.code}, {run.said}"
        assert run.code == 0 or run.said, f"seed {seed} ({broken}): exit code {run.code} and no sentence"
    return broken


@contextlib.contextmanager
def _not_for_ever() -> Iterator[None]:
    """Ends what works or waits for too long; the second limit is wide, for a machine that is busy elsewhere."""

    def stop(number: int, frame: object) -> None:
        raise TimeoutError("not done in time")

    limits = (
        (signal.SIGPROF, signal.ITIMER_PROF, MOST_CPU_SECONDS),
        (signal.SIGALRM, signal.ITIMER_REAL, MOST_SECONDS),
    )
    before = [signal.signal(number, stop) for number, _, _ in limits]
    for _, timer, seconds in limits:
        signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        for (number, timer, _), handler in zip(limits, before, strict=True):
            signal.setitimer(timer, 0)
            signal.signal(number, handler)


def to_break(root: Path) -> Path:
    """A dataset of one sample; the kernel is compiled meanwhile, which takes longer than a case may."""
    prepare(choose_toolchain())
    return paint(root, samples=1)


def main(count: int, first: int = 0) -> int:
    """Runs so many cases; the exit code is 1 if any failed."""
    failed = 0
    with tempfile.TemporaryDirectory() as place:
        painted = to_break(Path(place) / "painted")
        for seed in range(first, first + count):
            folder = Path(place) / "case"
            folder.mkdir()
            try:
                fuzz(painted, folder, seed)
            except AssertionError as error:
                failed += 1
                print(error, file=sys.stderr, flush=True)
                if "--traceback" in sys.argv:
                    traceback.print_exc()
            shutil.rmtree(folder)
            if (seed - first + 1) % 200 == 0:
                print(f"{seed - first + 1} of {count} cases, {failed} failed", file=sys.stderr, flush=True)
    print(json.dumps({"cases": count, "first_seed": first, "failed": failed}))
    return 1 if failed else 0


if __name__ == "__main__":
    numbers = [int(argument) for argument in sys.argv[1:] if argument.isdigit()]
    sys.exit(main(*numbers))
