"""Rings from the path data of scalable vector graphics: the commands M L H V C S Q T Z, absolute and relative.

Source: Scalable Vector Graphics 1.1, 2nd ed. (W3C, 2011), section 8.3. Arcs (A) are not read: drawing programs write
them as curves when a shape is converted to a path.
"""

from __future__ import annotations

import math
import re

import numpy as np

from tonewood.support.arrays import Floats

_TOKEN = re.compile(r"[A-Za-z]|[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
#: numbers that a command takes
_TAKES = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "Z": 0}
#: sides that a curve becomes
_SIDES = 64


def svg_ring(data: str) -> Floats:
    """Return the (n, 2) ring of the first closed part of a path, in the path's own units and axes.

    Parameters
    ----------
    data : attribute ``d`` of the path.

    Raises
    ------
    ValueError : a command is unknown or lacks numbers, or the path has fewer than three points.
    """
    words = _TOKEN.findall(data)
    points: list[complex] = []
    now, handle, command, k = 0j, 0j, "", 0
    while k < len(words):
        if words[k].isalpha():
            command, k = words[k], k + 1
        kind = command.upper()
        if kind not in _TAKES:
            raise ValueError(f"command {command or words[k]!r} of a path is not read; {', '.join(_TAKES)} are")
        if kind == "Z" or (kind == "M" and points):
            break
        numbers = words[k : k + _TAKES[kind]]
        if len(numbers) < _TAKES[kind] or any(word.isalpha() for word in numbers):
            raise ValueError(f"command {command!r} of a path takes {_TAKES[kind]} numbers")
        k += _TAKES[kind]
        values = [float(word) for word in numbers]
        if not all(map(math.isfinite, values)):
            raise ValueError("a path's numbers are finite")
        base = now if command.islower() else 0j
        if kind in "HV":
            step = values[0] if kind == "H" else 1j * values[0]
            rest = 0j if command.islower() else (1j * now.imag if kind == "H" else complex(now.real))
            ends = [base + step + rest]
        else:
            ends = [base + complex(x, y) for x, y in zip(values[::2], values[1::2], strict=True)]
        smooth = 2 * now - handle
        controls = {"S": [smooth, *ends], "T": [smooth, *ends]}.get(kind, ends)
        if kind in "CSQT":
            points += _curve([now, *controls])
            handle = controls[-2]
        else:
            points.append(ends[-1])
            handle = ends[-1]
        now = ends[-1]
        command = {"M": "L", "m": "l"}.get(command, command)
    if len(points) > 1 and abs(points[-1] - points[0]) < 1e-9 * max(1.0, abs(points[0])):
        points.pop()
    if len(points) < 3:
        raise ValueError("a path needs three points or more")
    return np.array([(p.real, p.imag) for p in points])


def _curve(controls: list[complex]) -> list[complex]:
    """Points of a Bezier curve of degree 2 or 3 without its first one."""
    t = np.arange(1, _SIDES + 1) / _SIDES
    n = len(controls) - 1
    terms = [math.comb(n, i) * (1 - t) ** (n - i) * t**i * c for i, c in enumerate(controls)]
    return [complex(z) for z in np.sum(terms, axis=0)]
