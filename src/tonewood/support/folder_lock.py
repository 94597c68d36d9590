"""Lock of a folder that one process at a time may use; the operating system frees it when the process ends."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tonewood.errors import OutputError

FILE = ".tonewood.lock"


@contextmanager
def locked(folder: Path, use: str) -> Iterator[None]:
    """Hold the lock of a folder, whatever name or link it is reached by.

    The lock on the file counts, not the file: the file of a killed process does not block others.

    Parameters
    ----------
    folder : made if need be.
    use : the command that uses it, for the error of others.

    Raises
    ------
    OutputError : another process holds the lock, or the folder cannot be written to.
    """
    path = folder / FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = _acquired(path)
    except OSError as fault:
        raise OutputError(f"cannot be written: {fault.strerror}", file=path) from None
    try:
        os.ftruncate(handle, 0)
        os.lseek(handle, 1, os.SEEK_SET)  # Windows locks the first byte for readers, too
        with suppress(OSError):  # on a full disk the name is missing, the lock holds
            os.write(handle, f"{use}, process {os.getpid()}\n".encode())
        yield
    finally:
        with suppress(OSError):
            path.unlink()
        os.close(handle)


def _acquired(path: Path) -> int:
    """Open the file of a lock and take the lock.

    Raises
    ------
    OutputError : another process holds it, or it is no file.
    """
    # its content is written over: never that of a link's target
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    while True:
        handle = os.open(path, flags, 0o644)
        try:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise OutputError("is no file: remove it", file=path)
            if not _take(handle):
                os.lseek(handle, 1, os.SEEK_SET)
                holder = os.read(handle, 200).decode(errors="replace").strip() or "another process"
                raise OutputError(f"is in use by {holder}: stop it first, or take another folder", file=path.parent)
            with suppress(FileNotFoundError):  # the holder before may have removed the file since it was opened
                if os.path.samestat(os.fstat(handle), path.stat()):
                    return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)


def _take(handle: int) -> bool:
    """Take the lock of an open file; returns False where another process holds it."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        except OSError:
            return False
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
