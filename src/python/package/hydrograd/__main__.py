"""The command line: ``python -m hydrograd optimize``, or ``hydrograd optimize`` where the package's scripts are on the path."""

from __future__ import annotations

import signal
import sys

from . import _native


def main() -> None:
    """Runs the command line and exits."""
    # Python's own handler would wait for the command to return.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.stdout.flush()
    # `study` and `bench` start it again for each of their trainings and rows.
    sys.exit(_native.command_line([sys.executable, "-m", "hydrograd"], sys.argv[1:]))


if __name__ == "__main__":
    main()
