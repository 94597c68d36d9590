"""XML of scores, plain or in a zip archive: read piece by piece within limits, without a DTD of its own."""

from __future__ import annotations

import re
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from io import BytesIO
from pathlib import Path
from typing import NoReturn
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from tonewood.errors import ScoreError
from tonewood.performance.score.limits import Allowance, number

#: bytes of a file, and of a member of an archive, which may be so many times larger than its archive from a size on
MAX_BYTES, _MOST_RATIO, _RATIO_FROM = 64 * 2**20, 300, 2**22
#: files in an archive
_MOST_MEMBERS = 10_000
#: elements, one within the other, and characters of a text and a tag; characters of a name, and different names
MAX_ELEMENTS, _DEEPEST, _LONGEST = 1_000_000, 100, 2**21
_LONGEST_NAME, _MOST_NAMES = 500, 10_000
#: elements, attributes and texts that are kept at a time: some 100 bytes each
_MOST_KEPT = 1_600_000
#: bytes of an empty text
_SHORT = sys.getsizeof("")
#: bytes that are parsed at a time
_CHUNK = 1 << 16
#: largest number in a score
MOST = 1e9
#: ways in which files of scores are compressed; others can grow without limit
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
#: raised by zipfile for a file that is no archive, or damaged
_BROKEN_ARCHIVE = (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError, RuntimeError, ValueError)

#: (elements that are open, the root first; the element that ends) -> whether it is read and can be forgotten
Cell = Callable[[list[Element], Element], bool]


def parsed(pieces: Iterable[bytes], path: Path, cell: Cell | None = None) -> Element:
    """Parse XML.

    pieces : of the file's bytes, in order.
    path : for errors.
    cell : called at the end of each child of a child of the root; the element is removed from the tree where it
        returns True.
    Raises ScoreError : it is not well formed, has a DTD of its own or entities, or is beyond a limit; one line.
    """
    tree: _Tree | None = None
    head = b""
    try:
        for piece in pieces:
            if tree is None:
                piece = piece.lstrip(b" \r\n\t")  # some write a blank line before the declaration
                head = piece[:4096]
                tree = _Tree(path, cell, _encoding(head))
            tree.feed(piece)
        return (tree or _Tree(path, cell, None)).close()
    except (expat.ExpatError, ValueError, LookupError) as error:
        what = "not XML" if b"<" not in head else "damaged XML"
        raise ScoreError(f"{what}: {error}", file=path) from None


def _encoding(head: bytes) -> str | None:
    """UTF-8 where a document of single bytes declares UTF-16; None where its declaration holds."""
    declared = re.match(rb"(?:\xef\xbb\xbf)?<\?xml[^>]{0,100}encoding\s*=\s*[\"']utf-?16", head, re.IGNORECASE)
    return "utf-8" if declared else None


class _Tree:
    """Tree of a document's elements, by the handlers of expat."""

    def __init__(self, path: Path, cell: Cell | None, encoding: str | None):
        self._path, self._cell, self._builder = path, cell, TreeBuilder()
        self._open: list[Element] = []
        self._elements = Allowance(MAX_ELEMENTS, "elements", path)
        self._different = Allowance(_MOST_NAMES, "different names of elements and attributes", path)
        #: name as expat has it -> as elements have it: one text for all of them
        self._names: dict[str, str] = {}
        self._kept = self._kept_before = self._text = self._fed = 0
        self._parser = parser = expat.ParserCreate(encoding, "}")
        parser.buffer_text = True
        parser.StartElementHandler, parser.EndElementHandler = self._start, self._end
        parser.CharacterDataHandler = self._data
        parser.StartDoctypeDeclHandler = self._doctype
        parser.EntityDeclHandler = parser.UnparsedEntityDeclHandler = parser.ExternalEntityRefHandler = self._entity
        parser.SkippedEntityHandler = self._entity

    def feed(self, data: bytes) -> None:
        """Parse the next bytes."""
        for at in range(0, len(data), _CHUNK):
            piece = data[at : at + _CHUNK]
            self._parser.Parse(piece, False)
            self._fed += len(piece)
            if self._fed - self._parser.CurrentByteIndex > _LONGEST:
                raise ScoreError(f"a tag or comment of more than {_LONGEST} bytes", file=self._path)

    def close(self) -> Element:
        """Return the root."""
        self._parser.Parse(b"", True)
        return self._builder.close()

    def _doctype(self, name: str, system: str | None, public: str | None, internal: int) -> None:
        """The name of a public DTD is read over: it is never fetched."""
        if internal:
            self._entity()

    def _entity(self, *_: object) -> NoReturn:
        raise ScoreError("declares or uses entities, or has a DTD of its own; a score needs none", file=self._path)

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._elements.take()
        if len(self._open) >= _DEEPEST:
            raise ScoreError(f"elements more than {_DEEPEST} deep", file=self._path)
        if len(self._open) == 2:
            self._kept_before = self._kept
        for name in (tag, *attributes):
            if name not in self._names:
                self._add(name)
        self._keep(4 + len(attributes) + sum(map(_extra, attributes.values())) if attributes else 1)
        self._text = 0
        self._open.append(self._builder.start(self._names[tag], attributes))

    def _add(self, name: str) -> None:
        if len(name) > _LONGEST_NAME:  # with its namespace, which expat writes out in each of them
            raise ScoreError(f"a name of more than {_LONGEST_NAME} characters", file=self._path)
        self._different.take()
        self._names[name] = "{" + name if "}" in name else name

    def _data(self, text: str) -> None:
        self._keep(1 + _extra(text))
        self._text += len(text)
        if self._text > _LONGEST:
            raise ScoreError(f"a text of more than {_LONGEST} characters", file=self._path)
        self._builder.data(text)

    def _keep(self, n: int) -> None:
        self._kept += n
        if self._kept > _MOST_KEPT:
            raise ScoreError(f"more than {_MOST_KEPT} elements, attributes and texts", file=self._path)

    def _end(self, tag: str) -> None:
        self._text = 0
        element = self._builder.end(tag)
        self._open.pop()
        if len(self._open) == 2 and self._cell is not None and self._cell(self._open, element):
            del self._open[-1][-1]
            self._kept = self._kept_before


def _extra(text: str) -> int:
    """64 bytes of memory that a text takes beyond a short one: up to four a character, by its widest."""
    return sys.getsizeof(text) - _SHORT >> 6


def member(data: bytes, name: str, path: Path) -> Iterator[bytes]:
    """Yield the bytes of a file of a zip archive in pieces, as they are expanded.

    Raises ScoreError : the archive is damaged, the file is not in it or too large.
    """
    most = min(MAX_BYTES, max(_MOST_RATIO * len(data), _RATIO_FROM))
    try:
        with _archive(data, path) as archive:
            info = archive.getinfo(name)
            if info.compress_type not in _METHODS:
                raise ScoreError(f"{name} is compressed in an unusual way: deflate is allowed", file=path)
            room = Allowance(most, f"bytes in {name}", path)
            with archive.open(info) as file:
                while piece := file.read(_CHUNK):
                    room.take(len(piece))
                    yield piece
    except KeyError:
        raise ScoreError(f"has no {name}", file=path) from None
    except _BROKEN_ARCHIVE as error:
        raise ScoreError(f"damaged archive: {error}", file=path) from None


def members(data: bytes, path: Path) -> list[str]:
    """Names of the files in a zip archive."""
    try:
        with _archive(data, path) as archive:
            return archive.namelist()
    except _BROKEN_ARCHIVE as error:
        raise ScoreError(f"damaged archive: {error}", file=path) from None


def _archive(data: bytes, path: Path) -> zipfile.ZipFile:
    """Open an archive, its entries counted before they are read."""
    if data.count(b"PK\x01\x02") > _MOST_MEMBERS:
        raise ScoreError(f"more than {_MOST_MEMBERS} files in the archive", file=path)
    return zipfile.ZipFile(BytesIO(data))


def text_of(element: Element | None, path: str, default: str = "") -> str:
    """Text of a descendant."""
    child = None if element is None else element.find(path)
    return default if child is None or child.text is None else child.text.strip()


def number_of(element: Element | None, path: str, default: float, low: float = -MOST, high: float = MOST) -> float:
    """Number in a descendant's text; the default where there is none, or none within bounds."""
    value = number(text_of(element, path), low, high)
    return default if value is None else value
