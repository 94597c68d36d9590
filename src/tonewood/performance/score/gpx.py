"""Container of Guitar Pro 6: a file system of sectors, plain (``BCFS``) or compressed (``BCFZ``).

Compressed, after eight bytes (the name and the length, little-endian, of all that follows expanded), comes a stream of
bits, the highest of each byte first. A 0 and two bits n, the lowest first, are followed by n bytes; a 1, four bits w,
and two numbers of w bits, the lowest first, copy as many of the last bytes as the second says, from as far back as the
first. The file system has sectors of 4096 bytes, counted after its name; one that begins with 2 describes a file: its
name, size and sectors.

Source of the format: readers of TuxGuitar and alphaTab, and files.
"""

from __future__ import annotations

import struct
from pathlib import Path

from tonewood.errors import ScoreError

_SECTOR, _FILE = 0x1000, 2
#: places in a file's sector: its name and the length of that, its size, numbers of its sectors
_NAME, _NAME_LENGTH, _SIZE, _SECTORS = 4, 127, 0x8C, 0x94
#: bytes of a compressed file and of an expanded one, and how many times larger this may be from a size on
_MOST_COMPRESSED, _MOST, _MOST_RATIO, _RATIO_FROM = 2**21, 2**25, 300, 2**22
SCORE = "score.gpif"


def gpx_score(data: bytes, path: Path) -> bytes:
    """Return the score of a file of Guitar Pro 6.

    Raises ScoreError : the container is damaged or too large, or has no score.
    """
    if data[:4] == b"BCFZ":
        data = _expanded(data, path)
    if data[:4] != b"BCFS":
        raise ScoreError("damaged Guitar Pro 6 file: no file system in it", file=path)
    system = memoryview(data)[4:]
    at = _SECTOR
    while at + _SECTOR <= len(system) or at + _SECTORS + 4 <= len(system):
        if struct.unpack_from("<i", system, at)[0] == _FILE:
            name = bytes(system[at + _NAME : at + _NAME + _NAME_LENGTH]).split(b"\0")[0]
            if name == SCORE.encode():
                return _file(system, at, path)
        at += _SECTOR
    raise ScoreError(f"has no {SCORE}", file=path)


def _file(system: memoryview, at: int, path: Path) -> bytes:
    """Content of the file that a sector describes."""
    (size,) = struct.unpack_from("<i", system, at + _SIZE)
    out = bytearray()
    offset, end = at + _SECTORS, min(at + _SECTOR, len(system)) - 3
    while offset < end and 0 <= len(out) < size:
        (sector,) = struct.unpack_from("<i", system, offset)
        if sector <= 0:
            break
        out += system[sector * _SECTOR : (sector + 1) * _SECTOR]
        offset += 4
    if size < 0 or len(out) < size:
        raise ScoreError(f"damaged Guitar Pro 6 file: {SCORE} ends early", file=path)
    return bytes(out[:size])


class _Bits:
    """Bits of a stream, the highest of each byte first; `EOFError` at its end."""

    def __init__(self, data: bytes, at: int):
        self._data, self._at, self._left, self._value = data, at, 0, 0

    def take(self, n: int) -> int:
        """Return a number of n bits, the highest first."""
        while self._left < n:
            if self._at >= len(self._data):
                raise EOFError
            self._value = (self._value << 8 | self._data[self._at]) & 0xFFFFFFFF
            self._at += 1
            self._left += 8
        self._left -= n
        return self._value >> self._left & (1 << n) - 1

    def reversed(self, n: int) -> int:
        """Return a number of n bits, the lowest first."""
        bits = self.take(n)
        return int(f"{bits:0{n}b}"[::-1], 2) if n else 0


def _expanded(data: bytes, path: Path) -> bytes:
    """Expand a compressed file; a last chunk that is cut off is left out."""
    if len(data) < 8:
        raise ScoreError("damaged Guitar Pro 6 file: it ends early", file=path)
    if len(data) > _MOST_COMPRESSED:
        raise ScoreError(f"{len(data)} bytes of Guitar Pro 6: {_MOST_COMPRESSED} are allowed", file=path)
    (length,) = struct.unpack_from("<i", data, 4)
    if not 4 <= length <= min(_MOST, max(_MOST_RATIO * len(data), _RATIO_FROM)):
        raise ScoreError(f"damaged Guitar Pro 6 file: {length} bytes, expanded", file=path)
    out, bits = bytearray(), _Bits(data, 8)
    try:
        while len(out) < length:
            if bits.take(1):
                width = bits.take(4)
                back, size = bits.reversed(width), bits.reversed(width)
                if back > len(out):
                    raise ScoreError("damaged Guitar Pro 6 file: it refers to bytes before its beginning", file=path)
                begin = len(out) - back
                out += out[begin : begin + size]
            else:
                for _ in range(bits.reversed(2)):
                    out.append(bits.take(8))
    except EOFError:
        pass
    return bytes(out[:length])
