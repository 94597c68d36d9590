"""Lock of a folder that one process at a time may use; the operating system frees it when the process ends."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from tonewood.errors import OutputError

FILE = ".tonewood.lock"


@contextmanager
def locked(folder: Path, use: str) -> Iterator[None]:
    """Hold the lock of a folder, whatever name or link it is reached by.

    Two locks are taken: on the folder, which holds when somebody removes the file, and on the file `.tonewood.lock` in
    it, which names the holder and holds where a system locks no folders (Windows, some network disks). The locks count,
    not the file: the file of a killed process does not block others.

    folder : made if need be.
    use : the command that uses it, for the error of others.
    Raises OutputError : another process holds the lock, or the folder cannot be written to.
    """
    path = folder / FILE
    with ExitStack() as stack:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _lock_folder(folder, stack)
            handle = _acquired(path)
        except OSError as fault:
            raise OutputError(f"cannot be written: {fault.strerror}", file=path) from None
        stack.callback(os.close, handle)
        stack.callback(_remove, path, handle)
        os.ftruncate(handle, 0)
        os.lseek(handle, 1, os.SEEK_SET)  # Windows locks the first byte for readers, too
        with suppress(OSError):  # on a full disk the name is missing, the lock holds
            os.write(handle, f"{use}, process {os.getpid()}\n".encode())
        yield


def _lock_folder(folder: Path, stack: ExitStack) -> None:
    """Take the lock of the folder itself, where the system has one, until `held` ends.

    Raises OutputError : another process holds it.
    """
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    stack.callback(os.close, handle)
    try:
        free = _take(handle)
    except OSError:  # its file system locks files alone
        return
    if not free:
        try:
            holder = _holder((folder / FILE).read_bytes())
        except OSError:
            holder = _holder(b"")
        raise _in_use(folder, holder)


def _holder(content: bytes) -> str:
    return content[1:201].decode(errors="replace").strip() or "another process"


def _in_use(folder: Path, holder: str) -> OutputError:
    return OutputError(f"is in use by {holder}: stop it first, or take another folder", file=folder)


def _remove(path: Path, handle: int) -> None:
    """Remove the file of a lock, unless it is another one by now."""
    with suppress(OSError):
        if os.path.samestat(os.fstat(handle), path.lstat()):
            path.unlink()


def _acquired(path: Path) -> int:
    """Open the file of a lock and take the lock. Raises OutputError : another process holds it, or it is no file."""
    # its content is written over: never that of a link's target
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    while True:
        handle = os.open(path, flags, 0o644)
        try:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise OutputError("is no file: remove it", file=path)
            if not _take(handle):
                os.lseek(handle, 1, os.SEEK_SET)
                raise _in_use(path.parent, _holder(b"\0" + os.read(handle, 200)))
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
