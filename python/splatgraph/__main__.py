"""Runs the command line: `python -m splatgraph render scene.ply -o out.png`."""

import sys

from . import _native


def main() -> int:
    """Runs the command line with the process's arguments; returns the exit code."""
    return _native.run(["splatgraph", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
