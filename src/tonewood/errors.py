"""Errors meant for people: one line that names the file, the key, the value and the values allowed.

Every error a user can cause derives from `TonewoodError`; the command line prints its one line on stderr and exits
with code 2 (1 where every note was dropped). A programming mistake is not one of these and keeps its traceback.
"""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f]")
#: characters of a reason; a damaged file may be quoted, but not at length
_LONGEST = 800


class DroppedNotesWarning(UserWarning):
    """Some notes of a score cannot be played; the render's `dropped` lists them."""


class OldFormatWarning(FutureWarning):
    """A file of an earlier schema was read; the next version will refuse it. The text names the command to run."""


class CacheFolderWarning(UserWarning):
    """The folder of files kept between runs belongs to somebody else, or others can write to it: nothing is kept."""


class DamagedCacheWarning(UserWarning):
    """A file that is kept between runs is damaged or another one; its contents are computed again."""


class TonewoodError(Exception):
    """A fault the user can mend, in one line.

    Parameters
    ----------
    reason : the fault and the values allowed.
    file : the file at fault, if there is one.
    key : dotted path of the key at fault, e.g. ``strings.E2.tension``.
    line : number of the file's line at fault, from 1.
    also : other faults of the same file, each a line of its own.
    """

    #: of the command line
    exit_code = 2

    def __init__(
        self,
        reason: str,
        *,
        file: str | os.PathLike[str] | None = None,
        key: str | None = None,
        line: int | None = None,
        also: Iterable[TonewoodError] = (),
    ):
        text = " ".join(reason.split())
        self.reason = text if len(text) <= _LONGEST else f"{text[: _LONGEST // 2]} [...] {text[-_LONGEST // 2 :]}"
        self.file = None if file is None else os.fspath(file)
        self.key, self.line, self.also = key, line, tuple(also)
        location = None if line is None else f"line {line}"
        shown = None if key is None else self.shown_key(key)
        line_of_text = ": ".join(part for part in (self.file, location, shown, self.reason) if part)
        # bytes of a file's name that are no UTF-8 can be printed, and written to a report; terminals follow no text
        printed = line_of_text.encode(errors="backslashreplace").decode()
        super().__init__(printed if printed.isprintable() else _CONTROL.sub(lambda m: repr(m[0])[1:-1], printed))

    @staticmethod
    def shown_key(key: str) -> str:
        """Return a key as the line names it."""
        return key

    @property
    def all(self) -> tuple[TonewoodError, ...]:
        """The fault itself and those of `also`."""
        return (self, *self.also)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle with the keywords, so that the line survives a worker process."""
        return (_rebuild, (type(self), self.reason, self.file, self.key, self.line, self.also))


def kind_of(value: object) -> str:
    """Name of a value's type with the article that sentences need: ``an int``, ``a Score``, ``None``."""
    name = type(value).__name__
    return "None" if value is None else f"{'an' if name[0].lower() in 'aeiou' else 'a'} {name}"


def words_of(error: BaseException) -> str:
    """``ValueError: its text`` on one line, of an exception of anybody's code, whose text may raise another one."""
    try:
        text = " ".join(str(error).split())
    except Exception:  # the text of somebody's exception may fail in any way; its type still says something
        text = ""
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _rebuild(
    cls: type[TonewoodError],
    reason: str,
    file: str | None,
    key: str | None,
    line: int | None,
    also: tuple[TonewoodError, ...],
) -> TonewoodError:
    return cls(reason, file=file, key=key, line=line, also=also)


def together(faults: Sequence[TonewoodError], *, file: str | os.PathLike[str] | None = None) -> TonewoodError:
    """Return one error of several: the first, with the others in `also`; `file` for those that name none."""
    each = [
        type(one)(one.reason, file=one.file or file, key=one.key, line=one.line)
        for fault in faults
        for one in fault.all
    ]
    first = each[0]
    return type(first)(first.reason, file=first.file, key=first.key, line=first.line, also=each[1:])


class BundleError(TonewoodError):
    """An instrument bundle, its tables or a parameter in it cannot be used."""


class PluginError(TonewoodError):
    """A plugin is missing, twice there, or breaks its contract."""


class ScoreError(TonewoodError):
    """A score, scale or tuning file cannot be read or played."""


class NothingPlayedError(ScoreError):
    """No note of a score can be played: nothing would sound. The command line exits with code 1."""

    exit_code = 1


class PassivityError(TonewoodError):
    """A modal basis would create energy; carries where and how much in its line."""


class NumericalError(TonewoodError):
    """The state stopped being finite, or a solve failed: names component and time."""


class OutputError(TonewoodError):
    """A sound file or device cannot be written."""
