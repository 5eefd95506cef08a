"""Time until a command has said something: `unidrive --help` and its like, as one JSON object.

    python benchmarks/startup.py [ROUNDS]

Every command runs in a process of its own; rounds are interleaved. The median counts, and `python -c pass` says what
the interpreter alone takes on this machine.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time

UNIDRIVE = "import sys; sys.argv[0] = 'unidrive'; from unidrive_cli.__main__ import main; main()"
COMMANDS = {
    "python -c pass": ("pass",),
    "unidrive --help": (UNIDRIVE, "--help"),
    "unidrive --version": (UNIDRIVE, "--version"),
    "unidrive convert --help": (UNIDRIVE, "convert", "--help"),
}


def seconds(arguments: tuple[str, ...]) -> tuple[float, float]:
    """Wall and CPU time of one run."""
    before, start = os.times(), time.perf_counter()
    subprocess.run([sys.executable, "-c", *arguments], stdout=subprocess.DEVNULL, check=True)
    wall, after = time.perf_counter() - start, os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return wall, cpu


def main(rounds: int) -> None:
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in COMMANDS}
    for _ in range(rounds):
        for name, arguments in COMMANDS.items():
            times[name].append(seconds(arguments))
    found = {
        name: {
            "wall_s": {"median": round(statistics.median(wall), 3), "max": round(max(wall), 3)},
            "cpu_s": {"median": round(statistics.median(cpu), 3)},
        }
        for name, (wall, cpu) in ((name, tuple(zip(*runs, strict=True))) for name, runs in times.items())
    }
    print(json.dumps({"rounds": rounds, "python": sys.version.split()[0], "commands": found}, indent=1))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
