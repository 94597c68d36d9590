"""Entry point of the program: signals first, imports then."""

from __future__ import annotations

import os

from tonewood.cli.stopping import stopping


def main() -> None:
    """Run the command line and exit."""
    stopping.begin()
    # Python looks for the modules of worker processes in the current folder otherwise: a bundle's files are data
    os.environ["PYTHONSAFEPATH"] = "1"
    from tonewood.cli.main import run

    try:
        run()
    except SystemExit as end:
        stopping.command_ends(end.code if isinstance(end.code, int) else int(end.code is not None))
        raise
