"""Targets of a design and its free parameters, read from a YAML file or the command line.

targets:                                  free:
- T1 = 200                                body.thickness: 2.0e-3 .. 3.0e-3       # the value itself
- A0 <= 100                               body.braces.fan_*.height: x 0.7 .. 1.4  # all of them by one factor
- mode 3 >= 290                           body.braces.bar_low.*.0: + -0.02 .. 0.02  # moved by one distance, m
- mobility saddle_E2 80..1000 >= -30
- no wolf F3..A3
- mass <= 0.200
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.scales import note_number
from tonewood.support.units import number_in
from tonewood.support.validation_messages import did_you_mean
from tonewood.support.yaml_io import load_yaml

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_TARGET = re.compile(rf"(?P<what>.+?)\s*(?P<sense><=|>=|=)\s*(?P<value>{_NUMBER})")
_MOBILITY = re.compile(rf"mobility\s+(?P<at>\S+)\s+(?P<low>{_NUMBER})\s*\.\.\s*(?P<high>{_NUMBER})")
_WOLF = re.compile(r"no\s+wolf\s+(?P<low>\S+?)\s*\.\.\s*(?P<high>\S+)")
_FREE = re.compile(rf"(?P<kind>[x+]?)\s*(?P<low>{_NUMBER})\s*(?:\.\.|:)\s*(?P<high>{_NUMBER})")
_ALLOWED = (
    "T1 = 200, A0 <= 100, mode 3 >= 290 (Hz), mass <= 0.2 (kg), mobility POINT 80..1000 >= -30 (dB re 1 m/s/N) and "
    "no wolf F3..A3 are allowed"
)
#: most of each
_MOST = 40
#: bounds are tested this share of the range inside: a mass must be above 0, and may have the bound 0
_INWARDS = 1e-6


@dataclass(frozen=True, slots=True)
class Target:
    """One figure that a design should have.

    text : as it was written.
    kind : ``freq``, ``mobility``, ``wolf`` or ``mass``.
    sense : ``=``, ``<=`` or ``>=``.
    value : Hz, dB re 1 m/s/N, kg; 0 of a wolf.
    mode : ``A0``, ``T1`` or a number from 1, of a frequency.
    at : point of a mobility.
    band : Hz, of a mobility or a wolf.
    """

    text: str
    kind: str
    sense: str
    value: float
    mode: str = ""
    at: str = ""
    band: tuple[float, float] = (0.0, 0.0)

    def off(self, figure: float) -> float:
        """How far a figure is from the target, 0 where it is reached: cents, dB or percent of the mass."""
        if self.kind == "freq":
            error = 1200 * math.log2(max(figure, 1e-9) / self.value)
        else:
            error = 100 * (figure / self.value - 1) if self.kind == "mass" else figure - self.value
        if self.sense == "=":
            return error
        return max(error, 0.0) if self.sense == "<=" else min(error, 0.0)

    @property
    def unit(self) -> str:
        """Unit of `off`."""
        return {"freq": "cents", "mass": "%", "mobility": "dB", "wolf": "cents"}[self.kind]

    @property
    def weight(self) -> float:
        """What counts as one unit of error: about what a good listener or a balance notices."""
        return {"freq": 17.0, "mass": 1.0, "mobility": 1.0, "wolf": 50.0}[self.kind]

    @property
    def tolerance(self) -> float:
        """Error with which it counts as reached: half of what is noticed."""
        return 0.5 * self.weight


@dataclass(frozen=True, slots=True)
class Free:
    """A parameter that a design may change.

    name : as it was written.
    paths : keys of the bundle that it sets.
    base : their values now.
    kind : empty for the value itself, ``x`` for a factor on all of them, ``+`` for a distance added.
    low, high : its bounds.
    """

    name: str
    paths: tuple[str, ...]
    base: tuple[float, ...]
    kind: str
    low: float
    high: float

    @property
    def start(self) -> float:
        """Its value now, within the bounds."""
        now = {"": self.base[0], "x": 1.0, "+": 0.0}[self.kind]
        return min(max(now, self.low), self.high)

    def overrides(self, value: float) -> dict[str, float]:
        """Path -> value of the bundle."""
        if self.kind == "x":
            return {p: b * value for p, b in zip(self.paths, self.base, strict=True)}
        return {p: value + (b if self.kind == "+" else 0.0) for p, b in zip(self.paths, self.base, strict=True)}


def read_task(path: Path) -> tuple[list[str], dict[str, str]]:
    """Lines of targets and of free parameters from a YAML file. Raises TonewoodError : it holds anything else."""
    values = load_yaml(path)
    for key in values:
        if key not in ("targets", "free"):
            hint = did_you_mean(str(key), ["targets", "free"])
            raise TonewoodError(f"is no key; {hint}targets and free are allowed", file=path, key=str(key))
    targets, free = values.get("targets") or [], values.get("free") or {}
    if not isinstance(targets, list) or not all(isinstance(line, str) for line in targets):
        raise TonewoodError(f"a list of lines is wanted; {_ALLOWED}", file=path, key="targets")
    if not isinstance(free, dict) or not all(isinstance(line, str) for line in free.values()):
        raise TonewoodError("PATH: LOW .. HIGH is wanted", file=path, key="free")
    return list(targets), {str(key): str(line) for key, line in free.items()}


def parse_targets(lines: Sequence[str], instrument: Instrument) -> list[Target]:
    """Targets from their lines. Raises TonewoodError : a line is none, or names what this instrument does not have."""
    if not 0 < len(lines) <= _MOST:
        raise TonewoodError(f"there are {len(lines)}; 1 to {_MOST} are allowed: {_ALLOWED}", key="targets")
    return [_target(line, instrument) for line in lines]


def _target(line: str, instrument: Instrument) -> Target:
    text = " ".join(line.split())
    if wolf := _WOLF.fullmatch(text):
        if not instrument.resonators:
            raise TonewoodError(f"{text!r}: this is a body without strings", key="targets")
        low, high = (_pitch(wolf[end], text) for end in ("low", "high"))
        if low > high:
            raise TonewoodError(f"{text!r}: the lower note first is allowed", key="targets")
        return Target(text, "wolf", "<=", 0.0, band=(low, high))
    match = _TARGET.fullmatch(text)
    if match is None:
        raise TonewoodError(f"{text!r} is no target; {_ALLOWED}", key="targets")
    what, sense, value = match["what"], match["sense"], float(match["value"])
    if mobility := _MOBILITY.fullmatch(what):
        points = instrument.body.points()
        if mobility["at"] not in points:
            hint = did_you_mean(mobility["at"], points)
            raise TonewoodError(f"{text!r}: {hint}there are {', '.join(points)}", key="targets")
        band = (float(mobility["low"]), float(mobility["high"]))
        if not 5.0 <= band[0] < band[1] <= 3000.0:
            raise TonewoodError(f"{text!r}: a band within 5 to 3000 Hz is allowed", key="targets")
        return Target(text, "mobility", sense, value, at=mobility["at"], band=band)
    if what == "mass" and value > 0:
        return Target(text, "mass", sense, value)
    number = re.fullmatch(r"mode\s+([1-9]\d?)", what)
    if (what in ("A0", "T1") or number) and 5.0 <= value <= 3000.0:
        return Target(text, "freq", sense, value, mode=number[1] if number else what)
    raise TonewoodError(f"{text!r} is no target; {_ALLOWED}, frequencies from 5 to 3000 Hz", key="targets")


def _pitch(word: str, text: str) -> float:
    """Hz of a note or a number of Hz."""
    if not math.isnan(number := number_in(word)):
        return number
    try:
        return float(440.0 * 2 ** ((note_number(word) - 69) / 12))
    except TonewoodError as fault:
        raise TonewoodError(f"{text!r}: {fault.reason}", key="targets") from None


def parse_free(lines: Mapping[str, str], instrument: Instrument) -> list[Free]:
    """Free parameters from their lines.

    Raises TonewoodError : a path leads to no number, bounds are none or ones that the bundle does not allow, or two
        parameters set one key.
    """
    if not 0 < len(lines) <= _MOST:
        raise TonewoodError(f"there are {len(lines)}; 1 to {_MOST} are allowed, PATH: LOW .. HIGH", key="free")
    leaves = dict(_leaves(instrument.resolved.get("body"), "body"))
    parameters: list[Free] = []
    for path, bounds in lines.items():
        match = _FREE.fullmatch(" ".join(bounds.split()))
        if match is None or not float(match["low"]) < float(match["high"]):
            reason = f"{bounds!r} is not LOW .. HIGH, x LOW .. HIGH (a factor) or + LOW .. HIGH (added), LOW below HIGH"
            raise TonewoodError(reason, key=path)
        chosen = {p: v for p, v in leaves.items() if _under(p, path)}
        if not chosen:
            hint = did_you_mean(path, leaves)
            raise TonewoodError(f"leads to no number of the body; {hint}see `tonewood schema`", key=path)
        parameter = Free(
            path, tuple(chosen), tuple(chosen.values()), match["kind"], float(match["low"]), float(match["high"])
        )
        if not parameter.kind and len(set(parameter.base)) > 1:
            raise TonewoodError("are several numbers: x LOW .. HIGH or + LOW .. HIGH keep their differences", key=path)
        inwards = _INWARDS * (parameter.high - parameter.low)
        for bound, value in ((parameter.low, parameter.low + inwards), (parameter.high, parameter.high - inwards)):
            try:
                instrument.replace(parameter.overrides(value))
            except TonewoodError as fault:
                where = "" if fault.key in (None, path) else f"{fault.key}: "
                raise TonewoodError(f"its bound {bound:g} cannot be: {where}{fault.reason}", key=path) from None
        for other in parameters:
            if both := set(other.paths) & set(parameter.paths):
                raise TonewoodError(f"sets {min(both)}, which {other.name} sets as well", key=path)
        parameters.append(parameter)
    return parameters


def _under(path: str, pattern: str) -> bool:
    """Whether a path is one that a pattern means, or below it."""
    words, pattern_words = path.split("."), pattern.split(".")
    return len(words) >= len(pattern_words) and all(map(fnmatchcase, words, pattern_words))


def _leaves(value: Any, path: str) -> Iterator[tuple[str, float]]:
    """Paths of all numbers."""
    if isinstance(value, bool) or value is None:
        return
    if isinstance(value, int | float):
        yield path, float(value)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _leaves(item, f"{path}.{key}")
    elif isinstance(value, list | tuple):
        for i, item in enumerate(value):
            yield from _leaves(item, f"{path}.{i}")
