"""A method on a scene, stepping: this project's kernel, the compiled loop of other methods, Verlet with laws."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from tonewood import _methods
from tonewood.errors import NumericalError
from tonewood.lab.assembled import continuous_force
from tonewood.lab.methods import METHODS
from tonewood.lab.methods.problem import Problem, RealModes
from tonewood.lab.methods.scheme import Layout, Runner, Scheme, padded
from tonewood.physics.coupling.connections import Connection
from tonewood.physics.coupling.inverse import scaled_pinv
from tonewood.physics.coupling.laws import Contact, HardeningSpring
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.modal.propagator import apply
from tonewood.physics.stepping.kernel import KernelStepper, instruction_set
from tonewood.support.arrays import Floats


class Run(Protocol):
    """A motion that a method makes from a state that was let go."""

    def start(self) -> None:
        """Let go."""

    def run(self, n: int, every: int = 1) -> tuple[Floats, bool]:
        """(n // every, n_outputs) displacements from now on, and whether all is finite."""

    def energy(self) -> float:
        """Stored, J."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What a method steps, and from where: a problem, nonlinear connections and strings of rising tension.

    problem : components and rigid connections.
    x : (n, 2) state at the start.
    laws : connections whose laws are `Contact` or `HardeningSpring`; real modes only, as for tensions.
    tensions : strings whose tension rises.
    """

    problem: Problem
    x: Floats
    laws: tuple[Connection, ...] = ()
    tensions: tuple[TensionModulation, ...] = ()

    @cached_property
    def arrays(self) -> Arrays:
        """Of the equation of motion in real modes."""
        return Arrays.of(self)

    @property
    def is_linear(self) -> bool:
        """Whether rigid connections are all there is."""
        return not (self.laws or self.tensions)


class SchemeRun:
    """A method of the compiled loop, on a linear system."""

    def __init__(self, scene: Scene, scheme: Scheme):
        self._scene, self._runner = scene, Runner(scheme)
        self.start()

    def start(self) -> None:
        """See `Run`."""
        self._runner.start(self._scene.x)

    def run(self, n: int, every: int = 1) -> tuple[Floats, bool]:
        """See `Run`."""
        out, fault = self._runner.run(n, every)
        return out[: n // every], fault < 0

    def energy(self) -> float:
        """See `Run`."""
        return self._scene.problem.energy(self._runner.x)


class KernelRun:
    """The kernel of this project.

    residual : whether contacts see the residual compliance of the components.
    """

    def __init__(self, scene: Scene, fs: float, residual: bool = True):
        self._scene = scene
        laws = [
            replace(c, law=replace(law, residual=residual)) for c, law in zip(scene.laws, _laws(scene), strict=True)
        ]
        self.system = scene.problem.system(1 / fs, laws, potentials=scene.tensions)
        self.stepper = KernelStepper(self.system)
        self.start()

    def start(self) -> None:
        """See `Run`."""
        self.state = self.stepper.start()
        self.state.modes[:] = self._scene.problem.state_of(self._scene.x, self.system)

    def run(self, n: int, every: int = 1) -> tuple[Floats, bool]:
        """See `Run`."""
        try:
            return self.stepper.run(self.state, n)[0][::every], True
        except NumericalError:
            return np.full((n // every, len(self.system.readouts)), np.nan), False

    def energy(self) -> float:
        """See `Run`; of nonlinear systems also that in the residual compliance of contacts."""
        if self._scene.is_linear:
            return self._scene.problem.energy(self._scene.problem.x_of(self.state.modes, self.system))
        return stored_energy(self.system, self.state).total


def run_of(method: str, scene: Scene, fs: float, residual: bool = True) -> Run:
    """A scene under a method; nonlinear scenes are stepped by the kernel and by velocity Verlet alone.

    residual : see `KernelRun`.
    """
    if method == "tonewood":
        return KernelRun(scene, fs, residual)
    return (
        SchemeRun(scene, METHODS[method].arrays(scene.problem, 1 / fs)) if scene.is_linear else ExplicitRun(scene, fs)
    )


def _laws(scene: Scene) -> tuple[Contact | HardeningSpring, ...]:
    return tuple(c.law for c in scene.laws if isinstance(c.law, (Contact, HardeningSpring)))


@dataclass(frozen=True, eq=False)
class Arrays:
    """Equation of motion q'' = P (-w2 q - 2 sigma q' - sum EA/2L S k q + phi f), S = sum k q^2.

    modes : frequencies, decay rates, shapes at rigid gaps and readouts.
    law : (l, n) shapes at the gaps of laws.
    weights : (n_tensions, n) k.
    stiffness : (n_tensions,) EA/2L.
    laws : of the gaps.
    G : (r, r) force of rigid connections per acceleration.
    """

    modes: RealModes
    law: Floats
    weights: Floats
    stiffness: Floats
    laws: tuple[Contact | HardeningSpring, ...]
    G: Floats

    @classmethod
    def of(cls, scene: Scene) -> Arrays:
        """Collect them."""
        problem, modes = scene.problem, scene.problem.real
        shapes = {name: basis.right.real for name, basis in problem.components.items()}
        weights, stiffness = np.zeros((len(scene.tensions), problem.n_modes)), []
        for row, t in zip(weights, scene.tensions, strict=True):
            for name in t.components:
                row[problem.starts[name]] = np.asarray(problem.components[name].metadata["tension_part"])
            length = t.length or float(np.asarray(problem.components[t.components[0]].metadata["length"]))
            stiffness.append(t.axial_stiffness / (2 * length))
        law = problem.gather(shapes, [c.terms for c in scene.laws])
        return cls(modes, law, weights, np.array(stiffness), _laws(scene), scaled_pinv(modes.gaps @ modes.gaps.T))

    def acceleration(self, q: Floats, v: Floats) -> Floats:
        """(n,) of a state."""
        m = self.modes
        a = -m.omega2 * q - 2 * m.sigma * v
        for weight, stiffness in zip(self.weights, self.stiffness, strict=True):
            a -= stiffness * float(weight @ q**2) * weight * q
        for phi, law in zip(self.law, self.laws, strict=True):
            a += phi * continuous_force(law, float(phi @ q), float(phi @ v))
        return np.asarray(a - m.gaps.T @ (self.G @ (m.gaps @ a)))

    def energy(self, q: Floats, v: Floats) -> float:
        """Energy of modes, tensions and laws, J."""
        total = 0.5 * float(v @ v + self.modes.omega2 @ q**2)
        for weight, stiffness in zip(self.weights, self.stiffness, strict=True):
            total += stiffness / 4 * float(weight @ q**2) ** 2
        for phi, law in zip(self.law, self.laws, strict=True):
            total += law.energy(law.offset - float(phi @ q))
        return total


class ExplicitRun:
    """Velocity Verlet, compiled, with laws and rising tensions evaluated where the motion is."""

    def __init__(self, scene: Scene, fs: float):
        self._scene, self._fs = scene, fs
        a, self._layout = scene.arrays, Layout(scene.problem)
        r, outs = a.modes.gaps, a.modes.outs
        self._method = _methods.Explicit(
            instruction_set(), self._layout.capacity, 1 / fs, len(r), len(outs), a.stiffness.tolist()
        )
        for one in a.laws:
            numbers = (
                [one.stiffness, one.exponent, one.loss, 0.0]
                if isinstance(one, Contact)
                else [one.stiffness, one.cubic, one.damping, one.quadratic_damping]
            )
            self._method.add_law(isinstance(one, Contact), numbers, one.offset)
        coef = np.stack([a.modes.omega2, 2 * a.modes.sigma, a.weights.sum(axis=0)])
        for name, modes, slots in self._layout.parts:
            which = [np.flatnonzero(rows[:, modes].any(axis=1)) for rows in (r, a.law, outs)]
            rigid, law, out = (
                padded(rows[i][:, modes], slots) for rows, i in zip((r, a.law, outs), which, strict=True)
            )
            links = [i.tolist() for i in which]
            tension = next((i for i, t in enumerate(scene.tensions) if name in t.components), -1)
            self._method.add_part(slots.start, tension, padded(coef[:, modes], slots), rigid, law, out, *links)
        self._method.set_solve(np.ascontiguousarray(a.G), np.ascontiguousarray(r @ a.law.T))
        self.start()

    def start(self) -> None:
        """Let go: q, velocity half a step before, acceleration of the modes by themselves."""
        a, m = self._scene.arrays, self._scene.arrays.modes
        q, v = apply(m.read, self._scene.x).T
        halved = v - a.acceleration(q, v) / (2 * self._fs)
        self.state = self._layout.state_of(np.stack([q, halved, -m.omega2 * q - 2 * m.sigma * v]))

    def run(self, n: int, every: int = 1) -> tuple[Floats, bool]:
        """See `Run`."""
        out = np.zeros((n // every + 1, len(self._scene.problem.outputs)))
        fault = self._method.run(self.state, n, every, out)
        return out[:-1], fault < 0

    def energy(self) -> float:
        """See `Run`."""
        a = self._scene.arrays
        q, w, _ = self._layout.numbers_of(self.state)
        # the velocity half a step on needs the acceleration here
        return a.energy(q, w + a.acceleration(q, w) / (2 * self._fs))
