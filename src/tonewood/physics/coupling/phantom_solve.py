"""Longitudinal forces of strings that are driven one way, over one step (`phantoms`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.coupling.phantoms import DELAY, MOST_MODES, DrivenLongitudinal, PhantomShare
from tonewood.physics.coupling.system import System
from tonewood.physics.modal.propagator import apply

Floats = NDArray[np.float64]


class PhantomForces:
    """The longitudinal forces of the strings of a system, sample by sample."""

    def __init__(self, system: System):
        self.on = [i for i, on in enumerate(system.phantoms_on) if on]
        self.strings = [system.phantoms[i] for i in self.on]
        #: by string: body's slot, (n_modes, 2) state added by 1 N held over a step, slots of the polarizations
        self.targets = [system.slot(string.onto[0][0]) for string in self.strings]
        self.vectors = [force_vector(system, string) for string in self.strings]
        self.slots = [[system.slot(name) for name in string.components] for string in self.strings]
        self.parts = [[_share(system, slot) for slot in slots] for slots in self.slots]

    def advance(self, x: Sequence[Floats], memory: Floats) -> Floats:
        """(n_on,) N, forces over the step that begins with states x by component slot.

        Parameters
        ----------
        memory : (n_strings, MEMORY) of the state; moved by one sample.
        """
        forces = np.zeros(len(self.on))
        for q, i in enumerate(self.on):
            parts, row = self.parts[q], memory[i]
            order, steps = len(parts[0].steps), parts[0].steps
            s = sum((p.squares(x[slot]) for slot, p in zip(self.slots[q], parts, strict=True)), np.zeros(order + 1))
            a, moving = row[DELAY : DELAY + order], row[DELAY + MOST_MODES : DELAY + MOST_MODES + order]
            e = a + s[1:]
            forces[q] = row[0]
            row[: DELAY - 1] = row[1:DELAY].copy()
            row[DELAY - 1] = self.strings[q].axial_stiffness * (s[0] + e.sum())
            a[:], moving[:] = steps[:, 0] * e + steps[:, 1] * moving - s[1:], steps[:, 2] * e + steps[:, 3] * moving
        return forces


def force_vector(system: System, string: DrivenLongitudinal) -> Floats:
    """(n_modes, 2) state that a longitudinal force of 1 N, held over a step, adds to the component it acts on."""
    compiled = system.compiled[system.slot(string.onto[0][0])]
    # not rows of W: a string whose transverse end is rigid makes no port of the point on which its tension acts
    points = [compiled.basis.index(point) for _, point, _ in string.onto]
    inputs = apply(compiled.held, compiled.form.B[points])
    return np.asarray(sum(share * row for (_, _, share), row in zip(string.onto, inputs, strict=True)))


def _share(system: System, slot: int) -> PhantomShare:
    part = system.compiled[slot].phantom
    if part is None:
        raise ValueError(f"{system.names[slot]} was compiled without its stretch")
    return part
