"""Text of a file that a person wrote: UTF-8, or an error that says which encoding it seems to have; JSON."""

from __future__ import annotations

import codecs
import json
import os
from typing import Any

from tonewood.errors import TonewoodError

_SAVE = "save the file as UTF-8"
#: UTF-32 first: its little-endian mark begins with that of UTF-16
_MARKS = (
    (codecs.BOM_UTF32_LE, "UTF-32"), (codecs.BOM_UTF32_BE, "UTF-32"),
    (codecs.BOM_UTF16_LE, "UTF-16"), (codecs.BOM_UTF16_BE, "UTF-16"),
)  # fmt: skip
#: characters, and zero bytes among them, from which an encoding without a mark is known
_SAMPLE, _SHARE = 200, 0.2


def decoded(raw: bytes, *, file: str | os.PathLike[str], error: type[TonewoodError] = TonewoodError) -> str:
    """Decode UTF-8, with one byte-order mark or none.

    raw : content of the file, whole.
    file : named in errors.
    error : class of the error raised.
    Raises TonewoodError
        It has another encoding, several byte-order marks, or zero bytes; the line says which, and what to do.
    """
    reason = other_encoding(raw)
    if not reason:
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError as fault:
            raise error(_not_utf_8(raw, fault.start), file=file) from None
        if text.startswith("\ufeff"):
            marks = len(text) - len(text.lstrip("\ufeff")) + 1
            reason = f"begins with {marks} byte-order marks, one is allowed: {_SAVE}, without a mark"
        elif (zero := raw.find(b"\0")) >= 0:
            reason = f"byte {zero}{_line(raw, zero)} is zero: this is no text"
    if reason:
        raise error(reason, file=file)
    return text


def other_encoding(raw: bytes) -> str:
    """Name the encoding of a file that seems to be UTF-16 or UTF-32, as the reason of an error; else an empty text."""
    if not raw:
        return ""
    for mark, name in _MARKS:
        if raw.startswith(mark):
            return f"is {name}, not UTF-8: {_SAVE}"
    sample = raw[: 4 * _SAMPLE]
    zeros = [sample[start::4].count(0) for start in range(4)]
    # characters up to U+FFFF have two zero bytes of four in UTF-32, on one side
    if len(sample) % 4 == 0 and len(sample) // 4 in (min(zeros[:2]), min(zeros[2:])):
        return f"seems to be UTF-32 without a byte-order mark, not UTF-8: {_SAVE}"
    # Latin letters, digits and signs have one zero byte of two in UTF-16, on one side
    odd, even = zeros[1] + zeros[3], zeros[0] + zeros[2]
    if min(odd, even) == 0 and max(odd, even) > _SHARE * len(sample) / 2:
        return f"seems to be UTF-16 without a byte-order mark, not UTF-8: {_SAVE}"
    return ""


def _not_utf_8(raw: bytes, at: int) -> str:
    shown = raw[at : at + 1].decode("cp1252", "replace")
    guess = f" ({shown!r} in Windows-1252)" if shown.isprintable() and shown != "\ufffd" else ""
    return f"byte {at}{_line(raw, at)} is not UTF-8{guess}: {_SAVE}"


def _line(raw: bytes, at: int) -> str:
    return f" (line {raw.count(bytes([10]), 0, at) + 1})"


def one_line(text: str) -> str:
    """Return a text as one line: breaks and characters that are not printed become single spaces."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def json_value(text: str | bytes) -> Any:
    """Return the value of a JSON text.

    Raises ValueError : it is none, or one object has two values for one key, of which Python's reader drops the first.
    Raises RecursionError : it is nested too deep.
    """
    return json.loads(text, object_pairs_hook=_object)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"the key {next(key for key in keys if keys.count(key) > 1)!r} stands twice in one object")
    return out
