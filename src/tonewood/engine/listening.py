"""What all strings do in every band, at once: forces on their bridges, what is heard of them, their energies.

Arrays of all components lie one after another, as their modes do in the state; they are renewed only where a component
is held or stepped in another way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tonewood.coupling.system import Compiled, State
from tonewood.engine.rungs import BANDS, Part
from tonewood.instrument.assembly import Model
from tonewood.modal.modes import ModalBasis
from tonewood.stepping.motion import to_motion

Floats = NDArray[np.float64]

#: mean of |sin|: a velocity seen at any moment is this share of its amplitude
_MEAN = 2 / math.pi
#: 1/s, and its inverse: bounds of decays that are told apart
_AT_ONCE = 1e9


class Listening:
    """Looks at the motion of all strings' components.

    Parameters
    ----------
    model : of the engine.
    components : of its strings, C of them.
    n_bins : F, of `Transfer`.

    Attributes
    ----------
    gathers, spread : (C,) of each part, see `Part`.
    decay, lasting : (C, BANDS) 1/s, slowest decay of each band, and s, one over it; 0 where it has no mode.
    loudest : (n_readouts, C, BANDS) of the readouts per N of a held mode.
    reach, kick : (C, BANDS) of each part, see `Part`.
    """

    def __init__(self, model: Model, components: Sequence[str], n_bins: int):
        self.model, self.components, self._n_bins = model, tuple(components), n_bins
        system = model.system
        n, r = len(self.components), len(system.readouts)
        self._slots = [system.slot(c) for c in self.components]
        sizes = [system.capacities[s] for s in self._slots]
        self._starts = np.cumsum([0, *sizes[:-1]]).astype(np.intp)
        self._sizes = sizes
        total = sum(sizes)
        self._places = np.concatenate(
            [np.arange(system.capacities[s]) + system.offsets[s] for s in self._slots] or [np.zeros(0, dtype=np.intp)]
        )
        #: q = turn[0] x and q' = turn[1] x + turn[2] y, stiffness
        self._turn, self._stiffness = np.zeros((3, total)), np.zeros(total)
        self._speed, self._weights, self._freq = np.zeros(total), np.zeros((1 + r, total)), np.zeros(total)
        #: components' bins, one after another
        self._bins = np.zeros(total, dtype=np.intp)
        #: twice the energy of a held mode per square of its size
        self._square = np.zeros(total)
        self._total = np.zeros((2 + r, total + 1))
        self._ends = np.zeros((n, BANDS + 1), dtype=np.intp)
        #: held modes of bands of few modes, at their places, and how many of each component
        self._few, self._bent, self._freq_few = np.zeros(0, dtype=np.intp), np.zeros(0), np.zeros(0)
        self._known: list[tuple[Compiled, Part | None, int] | None] = [None] * n
        #: of each component: modes, picks of their velocities and where they go; places, picks and where of few ones
        self._picks: dict[int, tuple[slice, Floats, Floats, NDArray[np.intp], Floats]] = {}
        self._reads: list[tuple[slice, Floats, Floats, Floats, Floats]] = []
        self.gathers, self.spread = np.zeros(n), np.zeros(n)
        self.reach, self.kick = np.zeros((n, BANDS)), np.zeros((n, BANDS))
        self.decay, self.lasting, self.loudest = (
            np.full((n, BANDS), _AT_ONCE),
            np.zeros((n, BANDS)),
            np.zeros((r, n, BANDS)),
        )

    def set(self, i: int, compiled: Compiled, part: Part | None, level: int) -> None:
        """Component i is stepped like this, at this level of sleep; None where none of it can sleep."""
        known = self._known[i]
        if known is not None and known[0] is compiled and known[1] is part and known[2] == level:
            return
        self._known[i] = compiled, part, level
        start, n = self._starts[i], compiled.basis.n_modes
        here, modes = slice(start, start + self._sizes[i]), slice(start, start + n)
        self._turn[:, here], self._weights[:, here] = 0.0, 0.0
        self._stiffness[here] = self._speed[here] = self._square[here] = 0.0
        self._turn[:, modes], self._stiffness[modes] = _turning(compiled.basis), compiled.basis.stiffness
        self._ends[i] = start
        self._picks.pop(i, None)
        self.gathers[i] = self.spread[i] = 0.0
        self.reach[i] = self.kick[i] = 0.0
        self.decay[i], self.lasting[i], self.loudest[:, i] = _AT_ONCE, 0.0, 0.0
        if part is not None:
            pick = part.picks(self.components[i], self.model, level)
            m = len(pick)
            few = part.few[:m]
            held = slice(start, start + m)
            self._weights[:, held] = np.vstack([part.push[:m], part.heard[:, :m]]) * np.where(few, 1.0, 1.0 / _MEAN)
            # the square of a velocity is half of that of its amplitude, in the mean
            self._square[held] = np.where(few, 1.0, 2.0)
            self._freq[held] = part.held.freq_rad[:m]
            self._bins[held] = i * self._n_bins + part.bins[:m]
            self._ends[i] += np.minimum(part.counts, m)
            places = start + np.flatnonzero(few)
            self._picks[i] = modes, pick, self._speed[held], places, np.ascontiguousarray(pick[few])
            self.gathers[i], self.spread[i] = part.compliance, part.spread
            self.reach[i], self.kick[i] = part.reach, part.kick
            there = np.isfinite(part.decay)
            self.decay[i, there] = np.clip(part.decay[there], 1 / _AT_ONCE, _AT_ONCE)
            self.lasting[i, there] = 1 / self.decay[i, there]
            self.loudest[:, i] = part.loudest
        self._few = np.concatenate([few for *_, few, _ in self._picks.values()] or [self._few[:0]])
        self._bent, self._freq_few, self._reads = np.zeros(len(self._few)), self._freq[self._few], []
        at = 0
        for modes, pick, speed, few_here, bending in self._picks.values():
            self._reads.append((modes, pick, speed, bending, self._bent[at : at + len(few_here)]))
            at += len(few_here)

    def look(self, state: State) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Forces of bands on the bridge (C, BANDS) and of bins (C, F), N, what is heard of bands (R, C, BANDS), twice
        their energies (C, BANDS) and the energies of all modes (C,), J.

        Sums of amplitudes. Where a band has many modes they are told by their velocities alone, in the mean over a
        period: slow motions of the bridge bend high modes, too, but hardly move them.
        """
        x, y = np.asarray(state.modes[:, self._places], dtype=np.float64)
        q, v = self._turn[0] * x, self._turn[1] * x + self._turn[2] * y
        energy = 0.5 * np.add.reduceat(v * v + self._stiffness * (q * q), self._starts)
        speed, bent = self._speed, self._bent
        for modes, pick, moving, bending, bends in self._reads:
            np.dot(pick, v[modes], out=moving)
            np.dot(bending, q[modes], out=bends)
        size = np.abs(speed)
        size[self._few] = np.hypot(speed[self._few], self._freq_few * bent)
        weighted = self._weights * size
        spectrum: Floats = np.bincount(self._bins, weighted[0], len(self.components) * self._n_bins).astype(np.float64)
        np.cumsum(weighted, axis=1, out=self._total[1:, 1:])
        np.cumsum(self._square * size * size, out=self._total[0, 1:])
        at = self._total[:, self._ends]
        each = at[:, :, :-1] - at[:, :, 1:]
        return each[1], spectrum.reshape(len(self.components), -1), each[2:], each[0], energy


def _turning(basis: ModalBasis) -> Floats:
    """(3, n) factors: q = t0 x and q' = t1 x + t2 y of real modes."""
    one, none = np.ones(basis.n_modes), np.zeros(basis.n_modes)
    (q, vx), (_, vy) = (to_motion(basis, np.stack(unit)) for unit in ((one, none), (none, one)))
    return np.stack([q, vx, vy])
