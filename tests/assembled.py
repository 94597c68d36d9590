"""Mechanical systems in physical coordinates, solved with scipy and none of the project's own numerics.

Reference for the tests of modes, steppers and energies: mass, damping and stiffness matrices of several parts,
joined by rows over their degrees of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.system import Injection, Readout
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import real_form


@dataclass(frozen=True)
class Part:
    """M u'' + C u' + K u = f of one component."""

    M: np.ndarray
    C: np.ndarray
    K: np.ndarray

    @property
    def n(self) -> int:
        return len(self.M)

    def real_basis(self, points=None):
        """Modal basis of a proportionally damped part; points name dofs, by default n0, n1, ..."""
        omega2, shapes = sla.eigh(self.K, self.M)
        damping = shapes.T @ self.C @ shapes
        off = damping - np.diag(np.diag(damping))
        assert np.abs(off).max(initial=0.0) <= 1e-9 * max(np.abs(damping).max(initial=0.0), 1e-300), "not proportional"
        rows = self.rows(points) @ shapes
        omega = np.sqrt(np.maximum(omega2, 0.0))
        omega[omega < 1e-7 * omega.max()] = 0.0  # rigid-body modes come out as rounding
        return ModalBasis.real(omega, np.diag(damping) / 2, dict(zip(points or self.names, rows, strict=True)))

    def complex_basis(self, points=None):
        """Modal basis of any damping; psi normalised so that Pi = psi^T (C + 2 lambda M) psi stands in the norm."""
        n = self.n
        A, _ = self.state_matrices(np.zeros((0, n)))
        poles, vectors = sla.eig(A)
        real = np.abs(poles.imag) < 1e-9 * np.abs(poles)
        poles = np.where(real, poles.real, poles)
        keep = np.flatnonzero(poles.imag >= 0)
        keep = keep[np.argsort(np.abs(poles[keep]))]
        lam, psi = poles[keep], vectors[:n, keep]
        norm = np.einsum("ik,ij,jk->k", psi, self.C, psi) + 2 * lam * np.einsum("ik,ij,jk->k", psi, self.M, psi)
        rows = self.rows(points) @ psi
        return ModalBasis.complex(lam, dict(zip(points or self.names, rows, strict=True)), norm=norm)

    @property
    def names(self):
        return [f"n{i}" for i in range(self.n)]

    def rows(self, points=None):
        """Unit rows of the named dofs."""
        return np.eye(self.n)[[int(p[1:]) for p in points or self.names]]

    def state_matrices(self, rows):
        """A, B of (u, v)' = A (u, v) + B f with f acting along `rows`."""
        n = self.n
        A = np.block([[np.zeros((n, n)), np.eye(n)], [-sla.solve(self.M, self.K), -sla.solve(self.M, self.C)]])
        return A, np.concatenate([np.zeros((n, len(rows))), sla.solve(self.M, np.asarray(rows).T)])

    def receptance(self, freq):
        """(n, n) dynamic compliance at `freq`, Hz."""
        w = 2 * np.pi * freq
        return sla.inv(-(w**2) * self.M + 1j * w * self.C + self.K)


def chain(n, seed, *, fixed=True, stiffness=4e5, mass=1.0, mass_damping=1.0, stiffness_damping=1e-6):
    """Uneven masses on uneven springs, Rayleigh damping; held by a spring at its first mass, or free."""
    rng = np.random.default_rng(seed)
    k = stiffness * rng.uniform(0.5, 2.0, n)
    link = np.eye(n) - np.eye(n, k=-1)
    if not fixed:
        k[0] = 0.0
    K = link.T @ np.diag(k) @ link
    M = np.diag(mass * rng.uniform(0.5, 2.0, n))
    return Part(M, mass_damping * M + stiffness_damping * K, K)


def uneven(n, seed, *, zeta=0.02, **options):
    """A chain whose dashpots are not proportional to anything."""
    rng = np.random.default_rng(seed + 1000)
    part = chain(n, seed, **options)
    link = np.eye(n) - np.eye(n, k=-1)
    scale = 2 * zeta * np.sqrt(part.K.diagonal() * part.M.diagonal())
    return Part(part.M, link.T @ np.diag(scale * rng.uniform(0.0, 2.0, n)) @ link, part.K)


def merged(*parts):
    """Several parts side by side in one set of matrices."""
    return Part(*(np.asarray(sla.block_diag(*(getattr(p, name) for p in parts))) for name in "MCK"))


def joined(part, gaps):
    """The same part with the gaps held at zero for good: T with u = T y, and the part in y."""
    T = sla.null_space(np.asarray(gaps))
    return T, Part(T.T @ part.M @ T, T.T @ part.C @ T, T.T @ part.K @ T)


def held_force_matrices(part, rows, dt):
    """E, W of one step with forces along `rows` held constant."""
    A, B = part.state_matrices(rows)
    n, m = B.shape
    big = sla.expm(np.block([[A, B], [np.zeros((m, n + m))]]) * dt)
    return big[:n, :n], big[:n, n:]


def run_exact(part, rows, forces, dt, start=None):
    """(steps + 1, 2 n) states of the continuous system under forces (steps, len(rows)) held over each step."""
    E, W = held_force_matrices(part, rows, dt)
    x = np.zeros(len(E)) if start is None else np.asarray(start, dtype=float)
    out = [x]
    for f in forces:
        x = E @ x + W @ f
        out.append(x)
    return np.array(out)


def run_held(part, gaps, laws, rows, forces, dt, start=None, residual=None):
    """The same with connection forces that are constant over each step too, as the scheme assumes.

    laws: Rigid or SpringDashpot for each row of `gaps`; residual: (m, m) compliance of the gaps.
    Returns states (steps + 1, 2 n) and connection forces (steps, m).
    """
    m, n = len(gaps), part.n
    gaps = np.asarray(gaps).reshape(m, n)
    R = np.zeros((m, m)) if residual is None else residual
    E, W = held_force_matrices(part, np.concatenate([gaps, np.asarray(rows).reshape(-1, n)]), dt)
    read = np.concatenate([gaps, np.zeros((m, n))], axis=1)
    push, drive = W[:, :m], W[:, m:]
    Z = read @ push
    left, of_free, of_old, right = np.zeros((m, m)), np.zeros(m), np.zeros(m), np.zeros(m)
    for j, law in enumerate(laws):
        if isinstance(law, Rigid):
            yields = R[j, j] > 0
            left[j] = Z[j] + 2 * R[j]
            of_free[j], of_old[j] = 1.0, float(yields)
            right[j] = (1.0 + yields) * law.offset
        else:
            assert isinstance(law, SpringDashpot)
            new, old = law.stiffness / 2 + law.damping / dt, law.stiffness / 2 - law.damping / dt
            left[j] = np.eye(m)[j] + new * Z[j]
            of_free[j], of_old[j] = new, old
            right[j] = law.stiffness * law.offset
    scale = np.abs(left).max(axis=1, keepdims=True)  # rigid rows are in m/N, springs in 1
    x = np.zeros(2 * n) if start is None else np.asarray(start, dtype=float)
    states, connection = [x], []
    for f in forces:
        free = E @ x + drive @ f
        wanted = right - of_free * (read @ free) - of_old * (read @ x)
        c = sla.lstsq(left / scale, wanted / scale[:, 0])[0] if m else np.zeros(0)
        x = free + push @ c
        states.append(x)
        connection.append(c)
    return np.array(states), np.array(connection).reshape(len(forces), m)


def connect(name, parts, row, law=None):
    """A Connection from a row over the dofs of all `parts` (name -> Part), in their order."""
    terms, start = [], 0
    for component, part in parts.items():
        for i in range(part.n):
            if row[start + i] != 0.0:
                terms.append(Term(component, f"n{i}", float(row[start + i])))
        start += part.n
    return Connection(name, tuple(terms), law or Rigid())


def held_force(basis, component, point, forces, dt, start=0):
    """An Injection of a force that is constant over each step."""
    A, B = (getattr(real_form(basis), which) for which in "AB")
    columns = np.zeros((basis.n_modes, 2))
    for k, (a, b) in enumerate(zip(A, B[basis.index(point)], strict=True)):
        scale = np.array([1.0, max(np.sqrt(abs(a[1, 0])), 1e-3) if a[0, 0] == 0 else 1.0])  # blocks: (q, q')
        big = np.zeros((3, 3))
        big[:2, :2], big[:2, 2] = a * scale[None, :] / scale[:, None], b / scale
        columns[k] = sla.expm(big * dt)[:2, 2] * scale
    return Injection(component, start, columns[None], np.asarray(forces, dtype=float)[None])


def motion_readouts(parts):
    """Displacement, then velocity, of every dof of every part."""
    return [
        Readout(f"{quantity} {name}.n{i}", quantity, (Term(name, f"n{i}"),))
        for quantity in ("displacement", "velocity")
        for name, part in parts.items()
        for i in range(part.n)
    ]


def step_map(system, make):
    """(n, n) matrix of one step of a stepper on the states of the modes, found by stepping unit states."""
    used = np.concatenate([
        offset + np.arange(c.basis.n_modes) for offset, c in zip(system.layout.offsets, system.compiled, strict=True)
    ])  # fmt: skip
    stepper, columns = make(system), []
    for number in (0, 1):
        for i in used:
            state = system.start()
            state.modes[number, i] = 1.0
            stepper.run(state, 1)
            columns.append(state.modes[:, used].ravel())
    return np.array(columns).T


def poles_of(step, dt, above=1e-6):
    """Poles in the upper half plane, by frequency, that a step map gives; multipliers near 0 and -1 are left out.

    A rigid joint without residual compliance has one of each: its gap is held, and its force may alternate.
    """
    multipliers = sla.eigvals(step)
    poles = np.log(multipliers[np.abs(multipliers) > above]) / dt
    poles = poles[(poles.imag > 0) & (poles.imag < 0.999 * np.pi / dt)]
    return poles[np.argsort(poles.imag)]
