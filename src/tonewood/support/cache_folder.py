"""Folder of files kept between runs; everything in it is safe to delete at any time.

It is the folder that the environment variable ``TONEWOOD_CACHE`` names, else ``$XDG_CACHE_HOME/tonewood``, else
``~/.cache/tonewood``; ``TONEWOOD_CACHE=off`` keeps nothing. It is made with mode 0700. A folder that belongs to
somebody else, or that others may write to, is not used: a file of it decides on samples.

A file begins with a line of 4 words: ``tonewood-cache/1``, its kind, its key and the SHA-256 of the bytes that follow.
A file whose line or hash does not fit is damaged, cut short, renamed or of another version: its content is computed
again and written over it, with a warning. So is that of a file to which others may write. Nothing
in it is ever unpickled.
"""

from __future__ import annotations

import hashlib
import os
import stat
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from tonewood.errors import CacheFolderWarning, DamagedCacheWarning, OutputError
from tonewood.support.whole_files import AtomicFile

T = TypeVar("T")

_VERSION = "tonewood-cache/1"
#: longest file that is read
_MOST_BYTES = 1 << 30


def cache_folder() -> Path | None:
    """Path of the folder, which need not exist; None where nothing is kept."""
    named = os.environ.get("TONEWOOD_CACHE", "")
    if named.strip().lower() == "off":
        return None
    base = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return Path(named) if named else Path(base or Path.home() / ".cache") / "tonewood"
    except RuntimeError:  # no home folder
        return None


def read_kept(kind: str, key: str, decode: Callable[[bytes], T]) -> T | None:
    """Read a file written by `keep`.

    kind : of content, a word: the suffix of the file.
    key : hash of all that decides on the content, 64 hexadecimal digits.
    decode : content -> value; whatever it raises tells of a damaged file.
    Returns The value; None where there is none, or a damaged one, which a warning names.
    """
    folder = cache_folder()
    if folder is None or not _is_own(folder):
        return None
    path = _path(folder, kind, key)
    try:
        # never a link; a pipe does not block
        flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        with open(path, "rb", opener=lambda name, _: os.open(name, flags)) as stream:
            status = os.fstat(stream.fileno())
            if _others_write(status):
                _warn_damaged(path, _open_to_others(status))
                return None
            fits = stat.S_ISREG(status.st_mode) and _is_users(status) and status.st_size <= _MOST_BYTES
            data = stream.read() if fits else b""
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as fault:
        _warn_damaged(path, "a link" if path.is_symlink() else getattr(fault, "strerror", None) or str(fault))
        return None
    heading, _, content = data.partition(b"\n")
    if heading != _heading(kind, key, content):
        _warn_damaged(path, "damaged, or not the file of this name")
        return None
    try:
        return decode(content)
    except Exception as fault:  # of this version, and yet: whatever a decoder raises
        _warn_damaged(path, f"damaged ({type(fault).__name__})")
        return None


def keep(kind: str, key: str, content: bytes) -> None:
    """Write a file for `read_kept`, whole or not at all; where it cannot be written it costs time alone."""
    folder = cache_folder()
    if folder is None or len(content) >= _MOST_BYTES:
        return
    try:
        if not folder.exists():
            folder.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(mode=0o700, exist_ok=True)
        path = _path(folder, kind, key)
        if not _is_own(folder):
            return
        with suppress(FileNotFoundError):
            # an `AtomicFile` would replace the target of a link. One look: another process may write the file meanwhile
            if not stat.S_ISREG(path.lstat().st_mode):
                path.unlink()
        file = AtomicFile(path, mode=0o600)  # whatever the umask: who has opened it may write for ever
        try:
            with file.path.open("wb") as stream:
                stream.write(_heading(kind, key, content) + b"\n" + content)
            file.complete()
        finally:
            file.discard()
    except (OSError, ValueError, OutputError):
        pass


def _path(folder: Path, kind: str, key: str) -> Path:
    return folder / f"{key[:32]}.{kind}"


def _heading(kind: str, key: str, content: bytes) -> bytes:
    return f"{_VERSION} {kind} {key} {hashlib.sha256(content).hexdigest()}".encode()


def _warn_damaged(path: Path, reason: str) -> None:
    # here, not where it is called from: a text is shown once
    warnings.warn(f"{path}: {reason}; it is computed again", DamagedCacheWarning, stacklevel=1)


def _is_users(status: os.stat_result) -> bool:
    """Whether a file or folder belongs to the user; where a system has no such numbers, its own rules hold."""
    return not hasattr(os, "geteuid") or status.st_uid == os.geteuid()


def _others_write(status: os.stat_result) -> bool:
    return hasattr(os, "geteuid") and bool(status.st_mode & 0o022)


def _open_to_others(status: os.stat_result) -> str:
    return f"can be written to by others (mode {stat.S_IMODE(status.st_mode):04o})"


def _is_own(folder: Path) -> bool:
    """Whether a folder exists, belongs to the user and cannot be written by others; warns where it is another's."""
    try:
        link, status = folder.lstat(), folder.stat()  # a link, and its target
    except (OSError, ValueError):
        return False
    if not stat.S_ISDIR(status.st_mode):
        reason = "is no folder"
    elif not (_is_users(link) and _is_users(status)):
        reason = "belongs to another user"
    elif _others_write(status):
        reason = _open_to_others(status)
    else:
        return True
    advice = "nothing is kept: give TONEWOOD_CACHE a folder of your own with mode 0700, or off"
    warnings.warn(f"{folder}: {reason}; {advice}", CacheFolderWarning, stacklevel=1)
    return False
