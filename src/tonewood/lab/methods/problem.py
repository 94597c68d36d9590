"""Problem that every method steps: components held together rigidly, some forces, some displacements to read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike, NDArray

from tonewood.physics.coupling.connections import Connection, Rigid, Term
from tonewood.physics.coupling.inverse import scaled_pinv
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import RealForm, real_form

Floats = NDArray[np.float64]
Array = NDArray[np.float64] | NDArray[np.complex128]


@dataclass(frozen=True)
class Problem:
    """Components and rigid constraints.

    Attributes
    ----------
    components : name -> basis.
    constraints : connections whose law is `Rigid` without offset.
    inputs : driven points, one force (N) each.
    outputs : points whose displacement (m) is read.
    """

    components: Mapping[str, ModalBasis]
    constraints: tuple[Connection, ...]
    inputs: tuple[Term, ...] = ()
    outputs: tuple[Term, ...] = ()

    def __post_init__(self) -> None:
        for c in self.constraints:
            if c.law != Rigid():
                raise ValueError(f"constraint {c.name!r}: these methods know rigid constraints without offset")

    @property
    def forms(self) -> dict[str, RealForm]:
        """Real 2 x 2 blocks of every component."""
        return {name: real_form(basis) for name, basis in self.components.items()}

    @property
    def generator(self) -> Floats:
        """(n, n) A of x' = A x + ..., two numbers per mode, components one after another."""
        return np.asarray(sla.block_diag(*(block for form in self.forms.values() for block in form.A)))

    def rows(self, terms: tuple[tuple[Term, ...], ...]) -> Floats:
        """(len(terms), n) displacement rows of weighted sums of points."""
        return self._assemble(terms, "C")

    def columns(self, terms: tuple[tuple[Term, ...], ...]) -> Floats:
        """(n, len(terms)) x' per force on weighted sums of points."""
        return self._assemble(terms, "B").T

    @property
    def gap_rows(self) -> Floats:
        """(m, n) gaps of the constraints."""
        return self.rows(tuple(c.terms for c in self.constraints))

    @property
    def gap_columns(self) -> Floats:
        """(n, m) x' per constraint force."""
        return self.columns(tuple(c.terms for c in self.constraints))

    @property
    def input_columns(self) -> Floats:
        """(n, n_inputs)."""
        return self.columns(tuple((t,) for t in self.inputs))

    @property
    def impulse_columns(self) -> Floats:
        """(n, n_inputs) state after unit impulses at the inputs, the constraints answering with impulses of theirs."""
        rate = self.gap_rows @ self.generator
        answer = scaled_pinv(rate @ self.gap_columns) @ rate @ self.input_columns
        return np.asarray(self.input_columns - self.gap_columns @ answer)

    @property
    def output_rows(self) -> Floats:
        """(n_outputs, n)."""
        return self.rows(tuple((t,) for t in self.outputs))

    @property
    def residual(self) -> Floats:
        """(m, m) residual compliance that the constraints see, m/N."""
        out = np.zeros((len(self.constraints),) * 2)
        for name, basis in self.components.items():
            weight = np.array([
                [sum(t.factor for t in c.terms if (t.component, t.point) == (name, p)) for p in basis.points]
                for c in self.constraints
            ])  # fmt: skip
            out += weight @ basis.residual @ weight.T
        return out

    def system(self, dt: float) -> System:
        """Return the problem for the project's own stepper."""
        readouts = [
            Readout(f"{i}", "displacement", (Term(t.component, t.point, t.factor),)) for i, t in enumerate(self.outputs)
        ]
        return System.build(self.components, self.constraints, readouts, dt=dt)

    def _assemble(self, terms: tuple[tuple[Term, ...], ...], which: str) -> Floats:
        forms = self.forms
        out = []
        for gap in terms:
            parts = {name: np.zeros((basis.n_modes, 2)) for name, basis in self.components.items()}
            for t in gap:
                parts[t.component] += (
                    t.factor * getattr(forms[t.component], which)[self.components[t.component].index(t.point)]
                )
            out.append(np.concatenate([part.ravel() for part in parts.values()]))
        size = 2 * sum(basis.n_modes for basis in self.components.values())
        return np.array(out).reshape(len(terms), size)


@dataclass(frozen=True, eq=False)
class StepMap:
    """One step of a linear method: x(n+1) = T x(n) + now u(n) + next u(n+1),  y(n) = output x(n).

    Attributes
    ----------
    dt : s.
    T : (k, k) real or complex; multi-step methods keep their past in x.
    now, next : (k, n_inputs) x per force at the beginning and at the end of the step.
    output : (n_outputs, k).
    embed : (k, n) puts a state of `Problem.generator` into x.
    """

    dt: float
    T: Array
    now: Array
    next: Array
    output: Array
    embed: Array

    def run(self, forces: ArrayLike, start: ArrayLike | None = None) -> Floats:
        """Displacements at t = 0, dt, 2 dt, ...

        Parameters
        ----------
        forces : (n, n_inputs) N at the same times.
        start : (n_state,) state of `Problem.generator`, rest if left out.

        Returns
        -------
        (n, n_outputs) m.
        """
        rest = np.zeros(self.embed.shape[1])
        return self.advance(self.embed @ (rest if start is None else np.asarray(start, dtype=np.float64)), forces)[0]

    def advance(self, x: Array, forces: ArrayLike) -> tuple[Floats, Array]:
        """Displacements (n, n_outputs) from the state x (k,) on, and the state at the last of them."""
        u = np.asarray(forces, dtype=np.float64)
        known = u[:-1] @ self.now.T + u[1:] @ self.next.T
        out = np.empty((len(u), len(self.output)))
        out[0] = (self.output @ x).real
        for n, scatter in enumerate(known, start=1):
            x = self.T @ x + scatter
            out[n] = (self.output @ x).real
        return out, x

    def spectrum(self, freq: ArrayLike, start: ArrayLike) -> NDArray[np.complex128]:
        """(n_freq, n_outputs) sum over all samples of y(n) exp(-2 pi i f n dt) dt, of the free motion from `start`."""
        z = np.exp(2j * np.pi * np.atleast_1d(np.asarray(freq, dtype=np.float64)) * self.dt)
        x = self.embed @ np.asarray(start, dtype=np.float64)
        eye = np.eye(len(self.T))
        return np.array([self.output @ sla.solve(eye - self.T / zk, x) * self.dt for zk in z])

    def multipliers(self) -> NDArray[np.complex128]:
        """(k,) eigenvalues of T."""
        return np.asarray(sla.eigvals(self.T), dtype=np.complex128)

    def spectral_radius(self) -> float:
        """Largest |multiplier|; above 1 the method is unstable at this step."""
        return float(np.max(np.abs(self.multipliers())))

    def poles(self) -> NDArray[np.complex128]:
        """(k,) poles in 1/s that the method gives in place of the true ones; parasitic ones among them."""
        multipliers = self.multipliers()
        return np.asarray(np.log(multipliers[multipliers != 0]) / self.dt, dtype=np.complex128)


def system_map(system: System, now: Floats | None = None, later: Floats | None = None) -> StepMap:
    """The step of a compiled `System` as a matrix, from the arrays that the steppers use.

    Parameters
    ----------
    system : its readouts must be displacements.
    now, later : (n_state, n_inputs) state added within the step by unit forces at its two ends.
    """
    ports = [len(c.ports) for c in system.compiled]
    E = sla.block_diag(*(block for c in system.compiled for block in c.E))
    gap = np.concatenate([
        (not one_way) * (system.incidence(i) @ c.rows[: ports[i]].reshape(ports[i], -1))
        for i, (c, one_way) in enumerate(zip(system.compiled, system.driven, strict=True))
    ], axis=1)  # fmt: skip
    scatter = np.concatenate([
        c.W.reshape(ports[i], -1).T @ system.incidence(i).T for i, c in enumerate(system.compiled)
    ])  # fmt: skip
    size = len(E)
    correct = np.eye(size) - scatter @ system.solve.G @ gap
    output = np.zeros((len(system.readouts), size))
    start = 0
    for c, p in zip(system.compiled, ports, strict=True):
        stop = start + 2 * c.basis.n_modes
        for row, channel in zip(c.rows[p:].reshape(-1, stop - start), c.readouts, strict=True):
            output[channel, start:stop] += row
        start = stop
    none = np.zeros((size, 0))
    return StepMap(
        system.dt,
        correct @ E - scatter @ system.solve.G @ (system.solve.gamma[:, None] * gap),
        none if now is None else correct @ now,
        none if later is None else correct @ later,
        output,
        np.eye(size),
    )
