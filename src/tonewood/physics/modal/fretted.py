"""A string pressed to a fret: its shape, its rise of tension and its pitch.

The string is drawn straight over nut, crowns of frets, finger and saddle. From the open path Lambda_0 to Lambda_n, that
of a stop, it stretches by Q; the tension rises by EA Q and the mass per length falls. A fret clamps it, the saddle does
not, so that it speaks as if it were sqrt(EI / T) shorter and hinged at both ends:

    Q = (Lambda_n - Lambda_0) / (Lambda_0 + behind),    T_n = T_0 + EA Q,    l_n = |crown_n - saddle| - sqrt(EI / T_n)
    f_n = 1 / (2 l_n) sqrt(T_n (1 + Q) / mu) sqrt(1 + pi^2 EI / (T_n l_n^2))

To second order in sqrt(EI / T) / l this is the clamped and hinged string of N. H. Fletcher, J. Acoust. Soc. Am. 36
(1964) 203, and the model of M. F. Anderson and R. G. Beausoleil, *Classical Guitar Intonation and Compensation* (2021).
Valid for heights that are small against the length.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tonewood.support.arrays import Floats
from tonewood.support.units import cents

_Point = tuple[float, float]

#: the finger lies at most this share of the space behind its fret away from it
_FINGER_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class FretboardGeometry:
    """Nut, frets and saddle under one string, seen from the side.

    scale_length : m, from which places are counted: 0 at the nut's end of it.
    places : m, of the frets from the first on, rising.
    crowns : m, heights of the frets over the plane that all heights are counted from.
    nut_height, saddle_height : m, of the string there over the same plane.
    nut_setback : m, by which the nut lies farther from the saddle than the end of the scale; less than 0 is nearer.
    saddle_setback : m, by which the saddle lies farther from the nut than the other end of the scale.
    finger : m, position of the finger behind the fret.
    press_depth : m below the crown to which the finger presses the string at least.
    behind : m, length of the string behind nut and saddle that shares the stretch.
    """

    scale_length: float
    places: tuple[float, ...]
    crowns: tuple[float, ...]
    nut_height: float
    saddle_height: float
    nut_setback: float = 0.0
    saddle_setback: float = 0.0
    finger: float = 0.0
    press_depth: float = 0.0
    behind: float = 0.0

    @property
    def nut(self) -> _Point:
        """Place and height of the string on the nut, m."""
        return -self.nut_setback, self.nut_height

    @property
    def saddle(self) -> _Point:
        """Place and height of the string on the saddle, m."""
        return self.scale_length + self.saddle_setback, self.saddle_height

    @property
    def frets(self) -> list[_Point]:
        """Place and height of every crown, m."""
        return list(zip(self.places, self.crowns, strict=True))

    def pressed(self, stop: int) -> PressedString:
        """Return the shape of the string at a stop, 0 for the open one."""
        frets = self.frets
        if stop == 0:
            path = _over([self.nut, *frets, self.saddle])
            return PressedString(_length(path), math.dist(path[-2], path[-1]), self._fret_at(path[-2]))
        fret = frets[stop - 1]
        front = _over([fret, *frets[stop:], self.saddle])
        before = self.nut if stop == 1 else frets[stop - 2]
        away = min(self.finger, _FINGER_SHARE * (fret[0] - before[0]))
        slope = (front[1][1] - fret[1]) / (front[1][0] - fret[0])
        # the same force presses the string less deep in a shorter gap
        depth = self.press_depth * (fret[0] - before[0]) / self.places[0] if away > 0 else 0.0
        finger = (fret[0] - away, fret[1] - max(slope * away, depth))
        back = _over([self.nut, *frets[: stop - 1], finger])
        whole = _length(back) + math.dist(finger, fret) + _length(front)
        return PressedString(whole, math.dist(front[-2], front[-1]), self._fret_at(front[-2]))

    def _fret_at(self, point: _Point) -> int:
        return self.frets.index(point) + 1 if point in self.frets else 0


@dataclass(frozen=True, slots=True)
class PressedString:
    """A string at one stop, seen from the side.

    whole : m, from nut to saddle over all that it touches.
    length : m, from the last fret that it touches to the saddle.
    fret : number of that fret, 0 for the nut; another one than the stop's where a fret stands out.
    """

    whole: float
    length: float
    fret: int


@dataclass(frozen=True, slots=True)
class FrettedString:
    """A string over a fretboard.

    board : geometry.
    tension : N, of the open string.
    bending_stiffness : EI, N m^2.
    axial_stiffness : EA, N, in slow stretch.
    """

    board: FretboardGeometry
    tension: float
    bending_stiffness: float
    axial_stiffness: float

    def stretch(self, stop: int) -> float:
        """Return Q of a stop, by which the string is longer than when it is open."""
        opened = self.board.pressed(0).whole
        return (self.board.pressed(stop).whole - opened) / (opened + self.board.behind)

    def raised(self, stop: int, tension: float | None = None) -> float:
        """Return the tension of a stop, N, the loss of mass per length counted as tension: (T + EA Q) (1 + Q).

        tension : N, of the open string, in place of its own.
        """
        stretch = self.stretch(stop)
        return ((self.tension if tension is None else tension) + self.axial_stiffness * stretch) * (1 + stretch)

    def length(self, stop: int) -> float:
        """Return the length of the string hinged at both ends that speaks as this one does at a stop, m."""
        return self.board.pressed(stop).length - math.sqrt(self.bending_stiffness / self.raised(stop))

    def ratio(self, stop: int) -> float:
        """Return the pitch of a stop over that of the open string, on a rigid saddle."""
        return self._speed(stop) / self._speed(0)

    def _speed(self, stop: int) -> float:
        """Frequency times twice the root of the mass per length."""
        length, tension = self.length(stop), self.raised(stop)
        return math.sqrt(tension * (1 + math.pi**2 * self.bending_stiffness / (tension * length**2))) / length

    def moved(self, nut_setback: float, saddle_setback: float) -> FrettedString:
        """Return the string with other setbacks (m), tuned to the same pitch: its tension goes with length squared."""
        board = replace(self.board, nut_setback=nut_setback, saddle_setback=saddle_setback)
        longer = board.pressed(0).length / self.board.pressed(0).length
        return replace(self, board=board, tension=self.tension * longer**2)

    def cents(self, ratios: Sequence[float]) -> Floats:
        """Return cents of the stops from the first on above the target pitches.

        ratios : pitch of each stop over that of the open string.
        Returns (len(ratios),)
        """
        return np.array([cents(self.ratio(n) / ratio) for n, ratio in enumerate(ratios, 1)])


def compensated(string: FrettedString, ratios: Sequence[float], *, nut: bool = True) -> FrettedString:
    """Return the string with the setbacks at which its stops are nearest to their pitches, by least squares.

    ratios : pitch of each stop over that of the open string, from the first stop on: those that count.
    nut : whether the nut moves too, or the saddle alone.
    Raises ValueError : no setbacks within a tenth of the scale are found.
    """
    board = string.board
    at = np.array([board.nut_setback, board.saddle_setback])
    free = [0, 1] if nut else [1]
    step = 1e-6 * board.scale_length
    for _ in range(20):
        errors = string.moved(*at).cents(ratios)
        slopes = np.array([(string.moved(*(at + step * np.eye(2)[i])).cents(ratios) - errors) / step for i in free])
        change = np.linalg.lstsq(slopes.T, -errors, rcond=None)[0]
        at[free] += change
        if np.abs(at).max() > 0.1 * board.scale_length:
            break
        if np.abs(change).max() < 1e-9:
            return string.moved(*at)
    raise ValueError("no nut and saddle within a tenth of the scale even out these stops")


def _over(points: Sequence[_Point]) -> list[_Point]:
    """Shortest path from the first point to the last over those between: their upper hull."""
    path: list[_Point] = []
    for x, z in points:
        while len(path) > 1 and (path[-1][1] - path[-2][1]) * (x - path[-2][0]) <= (z - path[-2][1]) * (
            path[-1][0] - path[-2][0]
        ):
            path.pop()
        path.append((x, z))
    return path


def _length(path: Sequence[_Point]) -> float:
    return sum(math.dist(a, b) for a, b in pairwise(path))
