"""``python -m tonewood``."""

from tonewood.cli.main import run

run()
