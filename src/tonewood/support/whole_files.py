"""Atomic files: written beside their target, renamed when complete."""

from __future__ import annotations

import os
import secrets
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from tonewood.errors import OutputError


class AtomicFile:
    """Write a file beside its target, and rename it when it is complete.

    An error, or Ctrl-C between any two statements, before `complete` removes the new file and leaves an earlier
    file of the target's name as it was.

    Parameters
    ----------
    path : name of the target; a link leads to the file that is replaced.

    Attributes
    ----------
    path : where to write: an empty file, made here, with the target's suffix.
    discard : removes the new file; does nothing after `complete`.

    Raises
    ------
    OutputError : there is no such folder, it cannot be written to, or the name is that of a folder or a device.
    """

    def __init__(self, path: str | os.PathLike[str]):
        self._named = path
        try:
            self._final = Path(path).resolve()
            folder = self._final.parent
            if not folder.is_dir():
                raise OutputError(f"there is no folder {str(Path(path).parent)!r}", file=path)
            if self._final.is_dir():
                raise OutputError("is a folder", file=path)
            if self._final.exists() and not self._final.is_file():
                raise OutputError("is no file but a device", file=path)
        except (OSError, RuntimeError, ValueError) as fault:  # a name too long or with a zero byte, links in a circle
            raise OutputError(f"cannot be written: {getattr(fault, 'strerror', None) or fault}", file=path) from None
        self.path = folder / f".{self._final.stem}.{secrets.token_hex(4)}.part{self._final.suffix}"
        # known before it exists; called when nobody holds this object any more, or at the end of the program
        self.discard = weakref.finalize(self, remove, self.path)
        try:
            self.path.touch(exist_ok=False)
        except OSError as fault:
            self.discard.detach()  # there is no file; to remove one where nothing can be written would fail again
            raise OutputError(f"cannot be written: {fault.strerror}", file=path) from None

    def complete(self) -> None:
        """Rename the file to its target.

        Raises
        ------
        OutputError : it cannot be renamed.
        """
        try:
            os.replace(self.path, self._final)
        except OSError as fault:
            raise OutputError(f"cannot be written: {fault.strerror}", file=self._named) from None
        self.discard.detach()


def remove(path: Path) -> None:
    """Remove a file, if it is there.

    Raises
    ------
    OutputError : it cannot be removed; not raised while another error is handled, which says more.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as fault:
        if fault.__context__ is None:
            raise OutputError(f"cannot be removed: {fault.strerror}", file=path) from None


@contextmanager
def whole_file(path: str | os.PathLike[str], *, make_folder: bool = False) -> Iterator[BinaryIO]:
    """Open an `AtomicFile` for writing; it gets its name when the ``with`` block ends without an error.

    Parameters
    ----------
    make_folder : make its folder, and those above, if need be.

    Raises
    ------
    OutputError : the disk is full or the place cannot be written; an earlier file of that name is untouched.
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


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file in one go; text as UTF-8; raises the errors of `whole_file`."""
    with whole_file(path) as stream:
        stream.write(content.encode() if isinstance(content, str) else content)
