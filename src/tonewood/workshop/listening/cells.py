"""Answers arranged by listener and cell, a combination of levels, and the columns of a model of the cells."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tonewood.support.arrays import Floats
from tonewood.workshop.listening import strata
from tonewood.workshop.listening.means import unique

Rows = Sequence[Mapping[str, Any]]


def cells_of(
    rows: Rows, factors: Sequence[str], levels: Mapping[str, Sequence[str]], random: Sequence[str]
) -> Cells | None:
    """Arrange answers; None where no fixed factor varies or listeners are fewer than three.

    Levels of fixed factors that a single listener rated are left out: what they are worth could not be told from who
    that listener is.

    levels : factor -> its levels, the first being that of the reference.
    """
    rows, single = shared(rows, [f for f in factors if f not in random])
    used = [f for f in factors if f not in random and len({row[f] for row in rows}) > 1]
    sampled = [f for f in factors if f in random and len({row[f] for row in rows}) > 1]
    who = unique([str(row["listener"]) for row in rows])
    if not used or len(who) < 3:
        return None
    rated = {f: {str(row[f]) for row in rows} for f in used}
    return Cells(rows, used, sampled, {f: [v for v in levels[f] if v in rated[f]] for f in used}, who, single)


def shared(rows: Rows, factors: Sequence[str]) -> tuple[Rows, tuple[str, ...]]:
    """Answers to levels that several listeners rated, and the names of the other levels."""
    left: list[str] = []
    while True:
        who: dict[tuple[str, str], set[str]] = {}
        for row in rows:
            for f in factors:
                who.setdefault((f, str(row[f])), set()).add(str(row["listener"]))
        single = {cell for cell, names in who.items() if len(names) < 2}
        if not single:
            return rows, tuple(left)
        left += [f"{f}={level}" for f, level in sorted(single)]
        rows = [row for row in rows if not any((f, str(row[f])) in single for f in factors)]


class Cells:
    """Answers by listener, random sound and cell of the fixed factors; `single` levels are left out."""

    def __init__(
        self,
        rows: Rows,
        used: Sequence[str],
        sampled: Sequence[str],
        levels: Mapping[str, Sequence[str]],
        who: list[str],
        single: tuple[str, ...] = (),
    ):
        self.single = single
        cells = [tuple(str(row[f]) for f in used) for row in rows]
        self.cells = sorted(set(cells), key=lambda cell: [levels[f].index(v) for f, v in zip(used, cell, strict=True)])
        items = [tuple(str(row[f]) for f in sampled) for row in rows]
        self.sounds = unique(items)
        index = {cell: i for i, cell in enumerate(self.cells)}
        listeners = {name: i for i, name in enumerate(who)}
        item = {name: i for i, name in enumerate(self.sounds)}
        self.value = np.array([row["value"] for row in rows], dtype=np.float64)
        self.cell = np.array([index[cell] for cell in cells])
        self.listener = np.array([listeners[str(row["listener"])] for row in rows])
        self.sound = np.array([item[name] for name in items])
        self.levels, self.used, self.sampled, self.who = levels, list(used), tuple(sampled), who
        shape = (len(who), len(self.sounds), len(self.cells))
        flat = np.ravel_multi_index((self.listener, self.sound, self.cell), shape)
        count = np.bincount(flat, minlength=math.prod(shape)).reshape(shape)
        self.complete = bool(np.all(count > 0))
        with np.errstate(invalid="ignore"):
            self.means = np.bincount(flat, self.value, math.prod(shape)).reshape(shape) / count

    def cell_sd(self) -> float:
        """Standard deviation of the answers within a cell."""
        where = self.cell * len(self.sounds) + self.sound
        _, at, counts = np.unique(where, return_inverse=True, return_counts=True)
        means = np.bincount(at, self.value) / counts
        free = len(self.value) - len(counts)
        return math.sqrt(float(np.sum((self.value - means[at]) ** 2)) / free) if free > 0 else 0.0

    def columns(self, contrasts: strata.Contrasts) -> dict[strata.EffectName, Any]:
        """Columns (cells, q) of each effect in the model."""
        codes = {f: np.array([self.levels[f].index(cell[i]) for cell in self.cells]) for i, f in enumerate(self.used)}
        coded: dict[str, Any] = {f: strata.coded(codes[f], len(self.levels[f])) for f in codes}
        return {
            e: coded[e[0]] if len(e) == 1
            else np.einsum("ki,kj->kij", coded[e[0]], coded[e[1]]).reshape(len(self.cells), -1)
            for e in contrasts.bases
        }  # fmt: skip

    def design(self, contrasts: strata.Contrasts) -> Floats:
        """Columns (cells, p) of the model, the mean first."""
        return np.hstack([np.ones((len(self.cells), 1)), *self.columns(contrasts).values()])
