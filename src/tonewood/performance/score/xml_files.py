"""XML of scores, plain or in a zip archive, without entities and within limits."""

from __future__ import annotations

import zipfile
import zlib
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from tonewood.errors import ScoreError
from tonewood.support.units import number_in

#: bytes of a file, and of a member of an archive
MAX_BYTES = 64 * 2**20
#: largest number in a score
MOST = 1e9
#: raised by zipfile for a file that is no archive, or damaged
_BROKEN_ARCHIVE = (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError, RuntimeError, ValueError)


def parsed(data: bytes, path: Path) -> Element:
    """Parse XML.

    Raises
    ------
    ScoreError : it is not well formed, or declares entities; one line.
    """
    head = data[:4096]
    if b"<!ENTITY" in data[: 1 << 16]:
        raise ScoreError("declares entities; a score needs none", file=path)
    try:
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        what = "not XML" if b"<" not in head else "damaged XML"
        raise ScoreError(f"{what}: {error}", file=path) from None


def member(data: bytes, name: str, path: Path) -> bytes:
    """Read a file of a zip archive.

    Raises
    ------
    ScoreError : the archive is damaged, the file is not in it or too large.
    """
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            if (size := archive.getinfo(name).file_size) > MAX_BYTES:
                raise ScoreError(f"{name} has {size} bytes: {MAX_BYTES} are allowed", file=path)
            return archive.read(name)
    except KeyError:
        raise ScoreError(f"has no {name}", file=path) from None
    except _BROKEN_ARCHIVE as error:
        raise ScoreError(f"damaged archive: {error}", file=path) from None


def members(data: bytes, path: Path) -> list[str]:
    """Names of the files in a zip archive."""
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            return archive.namelist()
    except _BROKEN_ARCHIVE as error:
        raise ScoreError(f"damaged archive: {error}", file=path) from None


def text_of(element: Element | None, path: str, default: str = "") -> str:
    """Text of a descendant."""
    found = None if element is None else element.find(path)
    return default if found is None or found.text is None else found.text.strip()


def number_of(element: Element | None, path: str, default: float) -> float:
    """Number in a descendant's text; the default where there is none or it is none."""
    return as_number(text_of(element, path), default)


def as_number(text: str, default: float) -> float:
    """Number that a text says; the default where it says none, or one beyond `MOST`."""
    number = number_in(text)
    return number if abs(number) <= MOST else default
