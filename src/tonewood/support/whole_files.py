"""Atomic files: written beside their target, renamed when complete.

While it is written a file is called ``.NAME.0.part.SUFFIX`` and locked (flock) by its writer. The writer's end unlocks
it, however that comes: a file that is not locked is a leftover, and the next writer of the same target removes it.
Several writers of one target take different numbers. Where files cannot be locked, leftovers of killed programs stay.
"""

from __future__ import annotations

import os
import secrets
import weakref
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from tonewood.errors import OutputError

try:
    import fcntl
except ImportError:  # no POSIX
    fcntl = None  # type: ignore[assignment]

#: writers of one target at a time that take small numbers
_PLACES = 8
#: files that this program has completed, which remain where it is interrupted
completed: list[Path] = []
#: device and inode of files that this program reads and must not replace
_read: set[tuple[int, int]] = set()
_FLAGS = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOFOLLOW", 0)


class AtomicFile:
    """Write a file beside its target, and rename it when it is complete.

    An error, or Ctrl-C between any two statements, before `complete` removes the new file and leaves an earlier
    file of the target's name as it was. Leftovers of a killed program are removed by the next one.

    path : name of the target; a link leads to the file that is replaced.
    mode : of the new file, less the bits of the umask.
    path : where to write: an empty file, made here, with the target's suffix. To be written in place: another file of
        this name would not be locked.
    discard : removes the new file; does nothing after `complete`.
    Raises OutputError : there is no such folder, it cannot be written to, or the name is that of a folder or a device.
    """

    def __init__(self, path: str | os.PathLike[str], *, mode: int = 0o666):
        self._named = path
        try:
            self._final = Path(path).resolve()
            folder = self._final.parent
            if not folder.is_dir():
                named = folder if Path(path).is_symlink() else Path(path).parent
                raise OutputError(f"there is no folder {str(named)!r}", file=path)
            if self._final.is_dir():
                raise OutputError("is a folder", file=path)
            if self._final.exists() and not self._final.is_file():
                raise OutputError("is no file but a device", file=path)
            check_unread(path)
        except (OSError, RuntimeError, ValueError) as fault:  # a name too long or with a zero byte, links in a circle
            raise OutputError(f"cannot be written: {getattr(fault, 'strerror', None) or fault}", file=path) from None
        places = _places(self._final)
        #: the file's name and the descriptor that locks it, as soon as there is one
        claimed: dict[Path, int] = {}
        # called when the last reference to this object is gone, or at the end of the program
        self.discard = weakref.finalize(self, _discard, claimed)
        try:
            last = _place(self._final, secrets.token_hex(4))
            self.path = next(candidate for candidate in (*places, last) if _claim(candidate, claimed, mode))
        except OSError as fault:
            raise OutputError(f"cannot be written: {fault.strerror}", file=path) from None
        self._claimed = claimed
        remove_leftovers(self._final)

    def complete(self) -> None:
        """Rename the file to its target. Raises OutputError : it cannot be renamed."""
        try:
            os.replace(self.path, self._final)
        except OSError as fault:
            raise OutputError(f"cannot be written: {fault.strerror}", file=self._named) from None
        self.discard.detach()
        completed.append(self._final)
        _unlock(self._claimed)


def protect(files: Iterable[Path]) -> None:
    """Let no atomic file replace these files, which this program reads; those that are not there are left out."""
    _read.clear()
    for file in files:
        with suppress(OSError, ValueError):
            _read.add(_identity(file))


def check_unread(path: str | os.PathLike[str]) -> None:
    """Refuse to write a file that this program reads, also by a link. Raises OutputError : it is one of `protect`."""
    with suppress(OSError, ValueError):
        if _read and _identity(Path(path)) in _read:
            raise OutputError("would replace a file that is read; give another name", file=path)


def _identity(file: Path) -> tuple[int, int]:
    about = file.stat()
    return about.st_dev, about.st_ino


def check_new_folder(folder: Path) -> None:
    """Refuse a folder to make that is there already, or whose parent is not.

    Raises OutputError : one of these, or the name is too long.
    """
    try:
        there = folder.exists() or folder.is_symlink()
    except OSError as fault:  # a name too long
        raise OutputError(f"cannot be made: {fault.strerror}", file=folder) from None
    if there:
        raise OutputError("is there already; give another name", file=folder)
    if not folder.absolute().parent.is_dir():
        raise OutputError(f"there is no folder {str(folder.parent)!r}", file=folder)


def _place(target: Path, number: object) -> Path:
    return target.parent / f".{target.stem}.{number}.part{target.suffix}"


def _places(target: Path) -> list[Path]:
    """Names of incomplete files."""
    return [_place(target, i) for i in range(_PLACES)]


def _claim(path: Path, claimed: dict[Path, int], mode: int) -> bool:
    """Make and lock a file; False where another writer has it."""
    remove_leftover(path)
    try:
        claimed[path] = lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | _FLAGS, mode)
    except FileExistsError:
        return False
    if fcntl is None:
        os.close(lock)
        claimed[path] = -1
        return True
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:  # a writer that looks for leftovers has locked it, and is about to remove it
        mine = False
    except OSError:  # locks are not known here
        mine = True
    else:
        mine = _is_at(path, lock)
    if mine:
        return True
    os.close(claimed.pop(path))
    return False


def _is_at(path: Path, lock: int) -> bool:
    """Whether a file still has its name."""
    try:
        return os.path.samestat(os.fstat(lock), os.stat(path, follow_symlinks=False))
    except OSError:
        return False


def remove_leftover(path: Path) -> None:
    """Remove an incomplete file, unless a program that still runs is its writer. Raises OutputError : as `remove`."""
    if fcntl is None:
        return
    try:
        lock = os.open(path, os.O_RDWR | os.O_NONBLOCK | _FLAGS)
    except OSError:  # it is not there, or somebody else's
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # its writer has locked it, or locks are not known here
        pass
    else:
        if _is_at(path, lock):
            remove(path)
    finally:
        os.close(lock)


def remove_leftovers(target: Path) -> None:
    """Remove the incomplete files of a target, unless programs that still run are their writers."""
    for path in _places(target.resolve()):
        remove_leftover(path)


def _discard(claimed: dict[Path, int]) -> None:
    try:
        for path, lock in claimed.items():
            if lock < 0 or _is_at(path, lock):
                remove(path)
            else:
                remove_leftover(path)
    finally:
        _unlock(claimed)


def _unlock(claimed: dict[Path, int]) -> None:
    while claimed:
        if (lock := claimed.popitem()[1]) >= 0:
            os.close(lock)


def remove(path: Path) -> None:
    """Remove a file, if it is there.

    Raises OutputError : it cannot be removed; not raised while another error is handled, which says more.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as fault:
        if fault.__context__ is None:
            raise OutputError(f"cannot be removed: {fault.strerror}", file=path) from None


@contextmanager
def whole_file(path: str | os.PathLike[str], *, make_folder: bool = False) -> Iterator[BinaryIO]:
    """Open an `AtomicFile` for writing; it gets its name when the ``with`` block ends without an error.

    make_folder : make its folder, and those above, if need be.
    Raises OutputError : the disk is full or the place cannot be written; an earlier file of that name is untouched.
    """
    try:
        if make_folder:
            Path(path).parent.mkdir(parents=True, exist_ok=True)
        file = AtomicFile(path)
        try:
            with file.path.open("wb") as stream:
                yield stream
            file.complete()
        finally:
            file.discard()
    except OSError as fault:
        raise OutputError(f"cannot be written: {fault.strerror or fault}", file=path) from None


@contextmanager
def folder_whole(folder: Path) -> Iterator[None]:
    """Remove a new folder again if the ``with`` block that fills it fails. Raises OutputError : it cannot be made."""
    try:
        yield
    except BaseException as fault:
        from shutil import rmtree

        rmtree(folder, ignore_errors=True)
        if isinstance(fault, OSError):
            raise OutputError(f"cannot be made: {fault.strerror or fault}", file=folder) from None
        raise


def write_whole(path: str | os.PathLike[str], content: str | bytes, *, make_folder: bool = False) -> None:
    """Write a file in one go; text as UTF-8; `make_folder` and errors as of `whole_file`."""
    with whole_file(path, make_folder=make_folder) as stream:
        stream.write(content.encode() if isinstance(content, str) else content)
