"""The `unidrive` program: what the console script and `python -m unidrive_cli` start."""

from __future__ import annotations

import sys


def main() -> None:
    """Runs the command line; Ctrl-C while it is still being loaded ends it as one in the middle does."""
    try:
        from unidrive_cli.cli.main import app

        app(prog_name="unidrive")
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
