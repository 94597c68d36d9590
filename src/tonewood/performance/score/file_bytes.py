"""The bytes of a score's file, within a limit."""

from __future__ import annotations

import stat
from pathlib import Path

from tonewood.errors import ScoreError


def file_bytes(path: Path, limit: int) -> bytes:
    """Read a file of at most `limit` bytes.

    Raises ScoreError : it is no regular file, too large, or cannot be read; one line.
    """
    try:
        info = path.stat()
        if not stat.S_ISREG(info.st_mode):
            raise ScoreError("not a regular file", file=path)
        if info.st_size > limit:
            raise ScoreError(f"{info.st_size} bytes: {limit} are allowed", file=path)
        return path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise ScoreError(getattr(error, "strerror", None) or str(error), file=path) from None
