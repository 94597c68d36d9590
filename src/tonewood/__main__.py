"""``python -m tonewood``."""

from tonewood.cli.start import main

main()
