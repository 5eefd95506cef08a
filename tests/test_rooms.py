"""The house of docs/architecture: which room may import which, and what no room may do.

Reads the sources with `ast`, imports inside functions and under TYPE_CHECKING included.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import unidrive_cli

PACKAGE = Path(unidrive_cli.__file__).parent
FILES = sorted(path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py"))

MAY_IMPORT = {  # besides errors and the room itself
    "errors": "",
    "workers": "",
    "cluster": "",
    "geometry": "",
    "rig": "geometry",
    "tables": "geometry rig",
    "check": "geometry rig tables",
    "warp": "geometry rig",
    "convert": "workers cluster geometry rig tables check warp",
    "merge": "workers cluster geometry rig tables check warp convert",
    "measure": "workers geometry rig tables check warp",
    "optimize": "workers geometry rig tables check warp measure",
    "synth": "workers geometry rig tables warp",
    "report": "workers geometry rig tables check warp measure",
    "machine": "workers cluster geometry rig tables check warp convert synth",
    "cli": "workers cluster geometry rig tables check warp convert merge measure optimize synth report machine",
}
MAY_IMPORT["__main__"] = f"{MAY_IMPORT['cli']} cli"
NOT_IN_GEOMETRY = {"json", "cv2", "logging", "pathlib", "os", "yaml", "ruamel", "msgspec", "io", "nuscenes"}
ONLY_IN_CLI = {"typer", "click"}
CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]*|__[a-z]+__")
TYPE_MAKERS = {"TypeVar", "ParamSpec", "NewType"}
MUTATORS = {"append", "extend", "insert", "remove", "pop", "popitem", "clear", "update", "setdefault", "add"}
DECLARED = {  # the only things alive at module level, each on purpose
    ("cli/main.py", "app"),  # typer collects the commands on it while it is imported
    ("warp/lens_numbers.py", "lens_numbers"),  # memo of a pure function
    ("warp/lens_numbers.py", "numbers_of_all"),  # memo of a pure function
    ("geometry/lenses/distorted.py", "known_lens"),  # memo of a pure function: a lens's border takes a while
    ("warp/planar.py", "_hidden"),  # memo of a pure function
    ("warp/own_car.py", "hidden_of"),  # memo of a pure function
    ("warp/compiled.py", "has_numba"),  # what is installed does not change while a process runs
    ("warp/turbojpeg.py", "_library"),  # a library is loaded once per process
    ("convert/units.py", "renderer_of"),  # memo of a pure function: one renderer per worker process
}


def room_of(file: str) -> str:
    """`geometry/poses.py` is of the room geometry, `errors.py` of errors, `__init__.py` of none."""
    return file.split("/")[0].removesuffix(".py")


def imported(tree: ast.Module) -> Iterator[str]:
    """Dotted names of all imports; `from a import b` gives `a.b`, which may name a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{'.' * node.level}{node.module or ''}.{alias.name}" for alias in node.names)


def import_faults(file: str, tree: ast.Module) -> Iterator[str]:
    room = room_of(file)
    for name in imported(tree):
        top, *rest = name.split(".")
        if name.startswith("."):
            yield f"relative import {name}"
        elif top in ONLY_IN_CLI and room != "cli":
            yield f"{top} outside cli"
        elif room == "geometry" and top in NOT_IN_GEOMETRY:
            yield f"geometry imports {top}"
        elif top == "importlib" and rest[:1] not in (["metadata"], ["resources"]):
            yield f"{name} hides what is imported"
        elif name == "unidrive_cli":
            yield "imports the whole package"
        elif top == "unidrive_cli" and rest[0] not in ("__version__", "errors", room):
            if rest[0] not in MAY_IMPORT:
                yield f"imports the unknown room {rest[0]}"
            elif room not in MAY_IMPORT or rest[0] not in MAY_IMPORT[room].split():
                yield f"{room} imports {rest[0]}"
        elif room == "errors" and top not in ("__future__", "typing", "collections", "difflib"):
            yield f"errors imports {top}"


def call_faults(file: str, tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            if node.func.id == "print" and room_of(file) != "cli":
                yield f"print outside cli, line {node.lineno}"
            if node.func.id == "__import__":
                yield f"__import__ hides what is imported, line {node.lineno}"


def module_level(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Statements that run at import, those inside if, try and with included."""
    for statement in body:
        yield statement
        if not isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            for field in ("body", "orelse", "finalbody"):
                yield from module_level(getattr(statement, field, []))
            for handler in getattr(statement, "handlers", []):
                yield from module_level(handler.body)


def state_faults(file: str, tree: ast.Module) -> Iterator[str]:
    alive = ast.List, ast.Dict, ast.Set, ast.ListComp, ast.DictComp, ast.SetComp, ast.GeneratorExp, ast.Call
    constants = set()
    for statement in module_level(tree.body):
        if isinstance(statement, ast.AugAssign):
            yield f"module-level change, line {statement.lineno}"
        if isinstance(statement, ast.FunctionDef):
            memo = any("cache" in ast.unparse(decorator) for decorator in statement.decorator_list)
            if memo and (file, statement.name) not in DECLARED:
                yield f"memo {statement.name} keeps state"
        if not isinstance(statement, ast.Assign | ast.AnnAssign):
            continue
        targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
        names = {node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)}
        constants |= names
        value = statement.value
        makes_type = (
            isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id in TYPE_MAKERS
        )
        if isinstance(value, alive) and not makes_type:
            for name in sorted(names):
                if not CONSTANT.fullmatch(name) and (file, name) not in DECLARED:
                    yield f"module-level state {name}"
    for node in ast.walk(tree):
        if isinstance(node, ast.Global):
            yield f"global {', '.join(node.names)}"
        changed = None
        if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store | ast.Del):
            changed = node.value
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in MUTATORS:
            changed = node.func.value
        if isinstance(changed, ast.Name) and changed.id in constants and CONSTANT.fullmatch(changed.id):
            yield f"changes the constant {changed.id}, line {node.lineno}"


def faults(file: str, source: str) -> list[str]:
    """All that is against the rules of the house in one module."""
    tree = ast.parse(source)
    found = [] if file == "__init__.py" or room_of(file) in MAY_IMPORT else [f"unknown room {room_of(file)}"]
    return [*found, *import_faults(file, tree), *call_faults(file, tree), *state_faults(file, tree)]


def test_every_room_that_exists_is_looked_at() -> None:
    assert len(FILES) > 30
    known = {"errors", "geometry", "rig", "tables", "check", "warp", "convert", "measure", "cli"}
    assert known <= set(map(room_of, FILES))


def test_the_table_itself_walks_one_way() -> None:
    """No circle: what a room may import comes before it, and may import no more than the room itself may."""
    rooms = list(MAY_IMPORT)
    for room, allowed in MAY_IMPORT.items():
        for other in allowed.split():
            assert rooms.index(other) < rooms.index(room)
            assert set(MAY_IMPORT[other].split()) <= set(allowed.split())


@pytest.mark.parametrize("file", FILES)
def test_keeps_the_rules_of_the_house(file: str) -> None:
    assert faults(file, (PACKAGE / file).read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("file", "source", "fault"),
    [
        ("warp/a.py", "from unidrive_cli.tables.table import Table", "warp imports tables"),
        ("warp/a.py", "def f():\n    import unidrive_cli.tables", "warp imports tables"),
        ("warp/a.py", "from unidrive_cli import tables", "warp imports tables"),
        ("rig/a.py", "if TYPE_CHECKING:\n    from unidrive_cli.warp.remap import Patch", "rig imports warp"),
        ("convert/a.py", "from unidrive_cli.cli.shared import guarded", "convert imports cli"),
        ("report/a.py", "from unidrive_cli.convert.plan import Plan", "report imports convert"),
        ("__init__.py", "from unidrive_cli.cli.main import run", "__init__ imports cli"),
        ("geometry/a.py", "from ..rig import model", "relative import ..rig.model"),
        ("errors.py", "import numpy", "errors imports numpy"),
        ("geometry/a.py", "import json", "geometry imports json"),
        ("geometry/a.py", "from pathlib import Path", "geometry imports pathlib"),
        ("geometry/a.py", "import os.path as p", "geometry imports os"),
        ("rig/a.py", "from importlib import import_module", "importlib.import_module hides what is imported"),
        ("rig/a.py", "import unidrive_cli", "imports the whole package"),
        ("tables/a.py", "import typer", "typer outside cli"),
        ("convert/a.py", "def f():\n    print('x')", "print outside cli, line 2"),
        ("shed/a.py", "", "unknown room shed"),
        ("shed.py", "", "unknown room shed"),
        ("convert/a.py", "from unidrive_cli.shed import x", "imports the unknown room shed"),
        ("warp/a.py", "cache = {}", "module-level state cache"),
        ("warp/a.py", "seen: set[str] = set()", "module-level state seen"),
        ("warp/a.py", "try:\n    pass\nexcept OSError:\n    rows = [1]", "module-level state rows"),
        ("warp/a.py", "TABLE = {}\ndef f():\n    TABLE['a'] = 1", "changes the constant TABLE, line 3"),
        ("warp/a.py", "_SEEN = set()\ndef f():\n    _SEEN.add(1)", "changes the constant _SEEN, line 3"),
        ("warp/a.py", "count = 0\ndef f():\n    global count\n    count += 1", "global count"),
        ("warp/a.py", "COUNT = 0\nCOUNT += 1", "module-level change, line 2"),
        ("warp/a.py", "@functools.lru_cache\ndef f(): ...", "memo f keeps state"),
    ],
)
def test_the_checker_catches_a_planted_fault(file: str, source: str, fault: str) -> None:
    assert faults(file, source) == [fault]


@pytest.mark.parametrize(
    ("file", "source"),
    [
        ("geometry/a.py", "from unidrive_cli.errors import GeometryError\nimport numpy as np"),
        ("cli/a.py", "import typer\nfrom unidrive_cli.convert.plan import Plan\nprint(1)"),
        ("convert/a.py", "from unidrive_cli import __version__, errors"),
        ("warp/a.py", "T = TypeVar('T')\n_BITS = [1]\nFloat = npt.NDArray[np.float64]\nsizes = (1, 2)"),
        ("warp/a.py", "def f():\n    rows = []\n    rows.append(1)\n    rows[0] = 2"),
    ],
)
def test_the_checker_lets_good_modules_pass(file: str, source: str) -> None:
    assert faults(file, source) == []
