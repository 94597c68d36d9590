"""Folder of files kept between runs; everything in it is safe to delete at any time.

It is the folder that the environment variable ``TONEWOOD_CACHE`` names, else ``$XDG_CACHE_HOME/tonewood``, else
``~/.cache/tonewood``; ``TONEWOOD_CACHE=off`` keeps nothing.
"""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path | None:
    """Path of the folder, which need not exist; None where nothing is kept."""
    named = os.environ.get("TONEWOOD_CACHE", "")
    if named == "off":
        return None
    base = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return Path(named) if named else Path(base or Path.home() / ".cache") / "tonewood"
    except RuntimeError:  # no home folder
        return None
