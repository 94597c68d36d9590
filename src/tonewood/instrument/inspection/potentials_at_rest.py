"""What laws and potentials of plugins do to small motion: a force at rest, and a stiffness that belongs to the modes.

The tuner knows the modes alone, and no part of `connections`. With H = d2V/dy2 at rest, small motion has the
frequencies of omega^2 + H. In larger motion the gradient is compared with differences of V: nothing else would tell
that one of them is wrong, because the step keeps the balance of energies with any gradient.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.instrument.model.assembly import Model
from tonewood.physics.coupling.connections import Connection, SpringDashpot
from tonewood.physics.coupling.laws.base import PotentialLaw
from tonewood.physics.coupling.potentials.user import ModalPotential, PotentialEnergy
from tonewood.support.arrays import Floats
from tonewood.support.units import cents

#: J of the motion in one mode with which H is measured: a fourth power of stiff rubber is not seen in it
_ENERGY = 1e-16
#: cents, and J, from which on a potential is said to act on small motion
TOLERANCE_CENTS, _AT_REST = 1.0, 1e-12
#: N, from which on a connection is said to push at rest
_FORCE = 1e-9
#: m, deflection that shows whether a law acts on a string at rest
_NUDGE = 1e-9
#: J of the modes in the motion in which the gradient is compared; step of a difference, and error that is reported
_MOTION, _STEP, _WRONG = 1e-4, 1e-4, 1e-3


@dataclass(frozen=True, slots=True)
class SmallMotion:
    """A potential near rest.

    name : of the potential.
    freq_modes, freq : Hz, lowest frequency of its components by their modes alone, and with the potential.
    energy : J, that the force at rest sets free.
    effect : name of the effect that may leave the potential out; empty without one.
    wrong : number of a coordinate at which the gradient is wrong, dV/dy and the difference of V there; or None.
    """

    name: str
    freq_modes: float
    freq: float
    energy: float
    effect: str
    wrong: tuple[int, float, float] | None = None

    @property
    def cents(self) -> float:
        """From the modes' frequency to that of small motion."""
        return cents(self.freq / self.freq_modes) if self.freq > 0.0 else -np.inf

    @property
    def doubt(self) -> str | None:
        """What is worth a warning, in one line."""
        if self.wrong is not None:
            k, slope, difference = self.wrong
            return (
                f"{self.name}: its gradient is not that of its V: dV/dy of coordinate {k} is {slope:.4g}, differences "
                f"of V give {difference:.4g}"
            )
        if abs(self.cents) > TOLERANCE_CENTS:
            small = "is unstable" if self.freq == 0.0 else f"sounds at {self.freq:.6g} Hz ({self.cents:+.1f} cents)"
            return (
                f"{self.name}: small motion {small}, the modes alone at {self.freq_modes:.6g} Hz, to which strings "
                "are tuned: the quadratic part of V belongs to the modes (`basis`)"
            )
        if self.energy > _AT_REST:
            return f"{self.name}: V pushes at rest, which sets {self.energy:.2g} J free: its gradient at 0 should be 0"
        return None


def small_motions(model: Model) -> list[SmallMotion]:
    """Measure each potential of a plugin's own near rest, by differences of its gradient."""
    system, out = model.system, []
    for index, potential in enumerate(system.potentials):
        if isinstance(potential, ModalPotential):
            bases = [system.compiled[system.slot(name)].basis for name in potential.components]
            energy: PotentialEnergy = system.joined(index)
            squares = np.concatenate([b.stiffness[:n] for b, n in zip(bases, energy.sizes, strict=True)])
            out.append(_near_rest(potential, energy, squares))
    return out


def forces_at_rest(model: Model) -> dict[str, float]:
    """Connection -> N with which its law pushes while nothing moves."""
    forces = {
        c.name: float(c.law.force(c.law.offset, c.law.offset, model.system.dt)[0])
        for c in model.system.connections
        if isinstance(c.law, PotentialLaw)
    }
    return {name: force for name, force in forces.items() if abs(force) > _FORCE}


def touched_at_rest(model: Model) -> dict[str, list[str]]:
    """Part of `connections` -> strings that it holds or damps while nothing moves; the tuner leaves it out."""
    out: dict[str, list[str]] = {}
    for c in model.system.connections:
        if c.role == "attached" and c.part in model.instrument.attachments and _acts_at_rest(c, model.system.dt):
            strings = out.setdefault(c.part, [])
            if c.owner not in strings:
                strings.append(c.owner)
    return out


def touched_lines(touched: Mapping[str, Sequence[str]]) -> list[str]:
    """One line about each part that the figures of strings leave out although it touches them at rest.

    touched : see `touched_at_rest`.
    """
    return [
        f"{part}, which touches {', '.join(names)} at rest: pitch and decay of the sound differ from those stated here"
        for part, names in touched.items()
    ]


def left_out_lines(model: Model) -> list[str]:
    """`touched_lines` of a model, for those who read no figures of `touched_at_rest`."""
    return [f"left out: {line}" for line in touched_lines(touched_at_rest(model))]


def _acts_at_rest(connection: Connection, dt: float) -> bool:
    """Whether its force changes with small motion about rest."""
    law = connection.law
    if isinstance(law, SpringDashpot):
        return law.stiffness > 0.0 or law.damping > 0.0
    if not isinstance(law, PotentialLaw):
        return False
    at = (law.offset - _NUDGE, law.offset, law.offset + _NUDGE)
    return len({law.force(p, p, dt)[0] for p in at}) > 1


def _near_rest(potential: ModalPotential, energy: PotentialEnergy, squares: Floats) -> SmallMotion:
    """As `small_motions`, with omega^2 of the coordinates."""
    moving = np.flatnonzero(squares > 0.0)
    if not moving.size:
        return SmallMotion(potential.name, 1.0, 1.0, 0.0, potential.effect)
    slope = energy.called(np.zeros(len(squares)))[1][moving]
    hessian = np.empty((moving.size, moving.size))
    for row, k in enumerate(moving):
        y = np.zeros(len(squares))
        y[k] = np.sqrt(2 * _ENERGY / squares[k])
        hessian[row] = (energy.called(y)[1] - energy.called(-y)[1])[moving] / (2 * y[k])
    stiffness = np.diag(squares[moving]) + 0.5 * (hessian + hessian.T)
    lowest = float(np.linalg.eigvalsh(stiffness)[0])
    freqs = np.sqrt([squares[moving].min(), max(lowest, 0.0)]) / (2 * np.pi)
    free = 0.5 * float(slope @ np.linalg.solve(stiffness, slope)) if lowest > 0.0 else 0.0
    wrong = _wrong_slope(energy, squares, moving)
    return SmallMotion(potential.name, float(freqs[0]), float(freqs[1]), free, potential.effect, wrong)


def _wrong_slope(energy: PotentialEnergy, squares: Floats, moving: NDArray[np.intp]) -> tuple[int, float, float] | None:
    """Coordinate at which dV/dy differs most from differences of V, with both, as the kernel calls them."""
    y = np.zeros(len(squares))
    y[moving] = np.sqrt(2 * _MOTION / moving.size / squares[moving]) * (-1.0) ** np.arange(moving.size)
    value, slope = energy.stepped(y)
    differences = np.zeros(len(squares))
    for k in moving:
        step = np.zeros(len(squares))
        step[k] = _STEP * y[k]
        differences[k] = (energy.stepped(y + step)[0] - energy.stepped(y - step)[0]) / (2 * step[k])
    errors = np.abs((slope - differences) * y)
    rounding = 100 * np.finfo(float).eps * abs(value) / _STEP
    worst = int(np.argmax(errors))
    if errors[worst] <= _WRONG * np.abs(differences * y).max() + rounding:
        return None
    return worst, float(slope[worst]), float(differences[worst])
