"""Energies of many strings at once, from the numbers of their modes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tonewood.physics.coupling.system import Compiled, State, System
from tonewood.physics.stepping.motion import to_motion
from tonewood.support.arrays import Floats


class StringEnergies:
    """Energies of groups of components of real modes.

    system : any with the same components.
    groups : names of the components of each group, such as a string's polarizations and the masses that move at it.
    """

    def __init__(self, system: System, groups: Sequence[Sequence[str]]):
        self._slots = [system.slot(name) for names in groups for name in names]
        self._owner = np.array([i for i, names in enumerate(groups) for _ in names], dtype=np.intp)
        self._n = len(groups)
        # the forms of all components in one array, each with its room in the state
        layout = system.layout
        rooms = [np.arange(layout.capacities[s]) + layout.offsets[s] for s in self._slots]
        self._places = np.concatenate([np.zeros(0, dtype=np.intp), *rooms])
        self._starts = np.cumsum([0, *(len(room) for room in rooms[:-1])]).astype(np.intp)
        self._forms = np.zeros((3, len(self._places)))
        self._compiled: list[Compiled | None] = [None] * len(self._slots)

    def at(self, system: System, state: State) -> Floats:
        """(n_groups,) J of a state of a system that is stepped now."""
        for i, slot in enumerate(self._slots):
            if self._compiled[i] is not (compiled := system.compiled[slot]):
                start, n = self._starts[i], compiled.basis.n_modes
                self._forms[:, start : start + system.layout.capacities[slot]] = 0.0
                self._forms[:, start : start + n] = forms(compiled)
                self._compiled[i] = compiled
        x, y = state.modes[:, self._places]
        xx, xy, yy = self._forms
        each = np.add.reduceat((xx * x + xy * y) * x + yy * y * y, self._starts)
        return np.asarray(np.bincount(self._owner, each, self._n), dtype=np.float64)


def forms(compiled: Compiled) -> tuple[Floats, Floats, Floats]:
    """(n_modes,) xx, xy and yy of the energy of a component's modes, sum xx x^2 + xy x y + yy y^2 (J)."""
    basis = compiled.basis
    one, none = np.ones(basis.n_modes), np.zeros(basis.n_modes)
    (qx, vx), (qy, vy) = (to_motion(basis, np.stack(unit)) for unit in ((one, none), (none, one)))
    k = basis.stiffness
    return 0.5 * (vx**2 + k * qx**2), vx * vy + k * qx * qy, 0.5 * (vy**2 + k * qy**2)
