"""Entry point of the program: signals first, imports then."""

from __future__ import annotations

from tonewood.cli.stopping import stopping


def main() -> None:
    """Run the command line and exit."""
    stopping.begin()
    from tonewood.cli.main import run

    try:
        run()
    except SystemExit as end:
        stopping.command_ends(end.code if isinstance(end.code, int) else int(end.code is not None))
        raise
