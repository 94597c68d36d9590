"""One method on one problem at one step length, as arrays for the compiled loop, and quantities read off them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sla

from tonewood import _methods
from tonewood.lab.methods.pole_search import Products, Transfer, nearest_zero
from tonewood.lab.methods.problem import Problem, product, through
from tonewood.physics.modal.propagator import apply
from tonewood.physics.stepping.kernel import instruction_set
from tonewood.support.arrays import Complexes, Floats


@dataclass(frozen=True, eq=False)
class Scheme:
    """One method on one problem at one step length.

    problem : of the method.  dt : s.
    rule : of the compiled loop: flow, adams_bashforth, verlet or newmark.
    coef : (n_coef, n) of every mode.
    scatter : (phases, m, lags, n, n_in) (by phase) of forces into modes.
    reads : (m, n, n_row).  outs : (n_outputs, n, n_out).
    G, K : (phases, m, m).
    out_memory : (phases, n_outputs, m) of the forces just used, in the readouts.
    constants : of the rule.
    begin : state x (n, 2) -> numbers of every mode (n_state, n) and forces (lags, m).
    motion : numbers of every mode (n_state, n) -> x (n, 2).
    """

    problem: Problem
    dt: float
    rule: str
    coef: Floats
    scatter: Floats
    reads: Floats
    outs: Floats
    G: Floats
    K: Floats
    out_memory: Floats
    constants: tuple[float, ...]
    begin: Callable[[Floats], tuple[Floats, Floats]]
    motion: Callable[[Floats], Floats]

    @property
    def phases(self) -> int:
        """Samples until the arrays repeat."""
        return len(self.scatter)

    @property
    def lags(self) -> int:
        """Forces that act in a step."""
        return int(self.scatter.shape[2])

    @cached_property
    def characteristic(self) -> Callable[[complex], Complexes]:
        """Map s -> (phases m, phases m) whose determinant is zero where exp(s t) is a motion of the method."""
        return _CHARACTERISTIC[self.rule](self)

    def poles(self, starts: Complexes, joints: Sequence[int] | None = None) -> Complexes:
        """(k,) poles nearest to given ones; nan where Newton's method diverges; see `pole_search.nearest_zero`.

        joints : for each pole, the connection whose force is large in it.
        """
        # a step of several samples has the unknown forces of each
        which = [None] * len(starts) if joints is None else [int(j) for j in joints]
        return np.array([nearest_zero(self.characteristic, s, j) for s, j in zip(starts, which, strict=True)])


class Layout:
    """Modes of a problem in the state of a compiled loop: each component padded to whole vectors."""

    def __init__(self, problem: Problem):
        pad, self.capacity = _methods.PADDING, 0
        #: component, its modes in the problem, its slots in the state
        self.parts: list[tuple[str, slice, slice]] = []
        for name, modes in problem.starts.items():
            size = -(-(modes.stop - modes.start) // pad) * pad
            self.parts.append((name, modes, slice(self.capacity, self.capacity + size)))
            self.capacity += size

    def state_of(self, numbers: Floats) -> Floats:
        """(k, capacity) from numbers (k, n) of the modes."""
        state = np.zeros((len(numbers), self.capacity))
        for _, modes, slots in self.parts:
            state[:, slots.start : slots.start + modes.stop - modes.start] = numbers[:, modes]
        return state

    def numbers_of(self, state: Floats) -> Floats:
        """Numbers (k, n) of the modes."""
        return np.concatenate(
            [state[:, slots.start : slots.start + modes.stop - modes.start] for _, modes, slots in self.parts], axis=1
        )


def padded(a: Floats, slots: slice) -> Floats:
    """With zeros to the size of some slots in the last direction."""
    out = np.zeros((*a.shape[:-1], slots.stop - slots.start))
    out[..., : a.shape[-1]] = a
    return out


class Runner:
    """A scheme, compiled: steps its own copy of a state."""

    def __init__(self, scheme: Scheme):
        self.scheme, s = scheme, scheme
        m, channels = len(s.reads), len(s.outs)
        self._layout = Layout(s.problem)
        capacity = self._layout.capacity
        self._method = _methods.Method(
            s.rule, instruction_set(), capacity, m, channels, s.phases, s.lags, list(s.constants)
        )
        for _, modes, slots in self._layout.parts:
            links = np.flatnonzero(
                s.reads[:, modes].any(axis=(1, 2)) | s.scatter[:, :, :, modes].any(axis=(0, 2, 3, 4))
            )
            outs = np.flatnonzero(s.outs[:, modes].any(axis=(1, 2)))
            self._method.add_part(
                slots.start,
                padded(s.coef[:, modes], slots),
                padded(s.scatter[:, links][:, :, :, modes].swapaxes(-1, -2), slots),
                padded(s.reads[links][:, modes].swapaxes(-1, -2), slots),
                padded(s.outs[outs][:, modes].swapaxes(-1, -2), slots),
                links.tolist(),
                outs.tolist(),
            )
        self._method.set_solve(*(np.ascontiguousarray(a) for a in (s.G, s.K, s.out_memory)))
        self.state, self.forces = np.zeros((0, capacity)), np.zeros((s.lags, m))

    def start(self, x: Floats) -> None:
        """Put a state (n, 2) in."""
        numbers, forces = self.scheme.begin(x)
        self.state, self.forces = self._layout.state_of(numbers), np.ascontiguousarray(forces, dtype=np.float64)

    def run(self, n: int, every: int = 1) -> tuple[Floats, int]:
        """Advance by n steps.

        Returns (n // every + 1, n_outputs) displacements at every `every`-th step from the present one on, and the step
            at which they stopped being finite, -1 if they did not.
        """
        out = np.zeros((n // every + 1, len(self.scheme.outs)))
        return out, self._method.run(self.state, self.forces, n, every, out)

    @property
    def x(self) -> Floats:
        """(n, 2) the state."""
        return self.scheme.motion(self._layout.numbers_of(self.state))


def multipliers(scheme: Scheme) -> Complexes:
    """Eigenvalues of the step, found by stepping unit vectors of its state; parasitic ones among them."""
    runner, layout = Runner(scheme), Layout(scheme.problem)
    runner.start(np.zeros((scheme.problem.n_modes, 2)))
    shape, forces = layout.numbers_of(runner.state).shape, runner.forces.shape
    size = int(np.prod(shape))
    columns = []
    for unit in np.eye(size + int(np.prod(forces))):
        runner.state, runner.forces = layout.state_of(unit[:size].reshape(shape)), unit[size:].reshape(forces).copy()
        runner.run(scheme.phases)
        columns.append(np.concatenate([layout.numbers_of(runner.state).ravel(), runner.forces.ravel()]))
    return np.asarray(sla.eigvals(np.array(columns).T), dtype=np.complex128)


# ---- characteristic matrices: det = 0 where exp(s t) is a motion ----


Matrix = Callable[[complex], Complexes]


def _flow_characteristic(scheme: Scheme) -> Matrix:
    reads, E, h = scheme.reads, scheme.coef.T.reshape(-1, 2, 2), scheme.dt
    G, K, m = scheme.G, scheme.K, len(scheme.reads)
    if scheme.phases == 1:
        seen = [Transfer.of(reads, scheme.scatter[0, :, lag], E - np.eye(2)) for lag in range(scheme.lags)]

        def matrix(s: complex) -> Complexes:
            z = np.exp(s * h)
            total = sum((transfer(np.expm1(s * h)) * z**-lag for lag, transfer in enumerate(seen)), np.zeros((m, m)))
            return np.asarray(np.eye(m) + K[0] / z + G[0] @ total)

        return matrix
    # two samples to a step: x(2) = E (E x + P0 f0) + P1 f1
    first, second, twice = scheme.scatter[0, :, 0], scheme.scatter[1, :, 0], E @ E - np.eye(2)
    begun, late = apply(E, first), through(reads, E)
    of = [[Transfer.of(rows, columns, twice) for columns in (begun, second)] for rows in (reads, late)]
    at_once = product(reads, first)

    def matrix_of_two(s: complex) -> Complexes:
        u = np.expm1(2 * s * h)
        out = np.eye(2 * m, dtype=np.complex128)
        out[:m, :m] += G[0] @ of[0][0](u)
        out[:m, m:] += G[0] @ of[0][1](u) + K[0] / (1 + u)
        out[m:, :m] += G[1] @ (of[1][0](u) + at_once) + K[1]
        out[m:, m:] += G[1] @ of[1][1](u)
        return out

    return matrix_of_two


def _adams_characteristic(scheme: Scheme) -> Matrix:
    c0, c1, c2 = scheme.constants
    transfer = Transfer.of(scheme.reads, scheme.scatter[0, :, 0], scheme.coef.T.reshape(-1, 2, 2))
    G, eye = scheme.G[0], np.eye(len(scheme.reads))

    def matrix(s: complex) -> Complexes:
        z = np.exp(s * scheme.dt)
        return np.asarray(eye + G @ transfer(np.expm1(s * scheme.dt) * z * z / (c0 * z * z + c1 * z + c2)))

    return matrix


def _verlet_characteristic(scheme: Scheme) -> Matrix:
    h, (w2, loss) = scheme.dt, scheme.coef
    seen, G, eye = Products.of(scheme.reads, scheme.scatter[0, :, 0]), scheme.G[0], np.eye(len(scheme.reads))

    def matrix(s: complex) -> Complexes:
        z, u = np.exp(s * h), np.expm1(s * h)
        D = w2 * (h * h * z / u**2) + loss * (h * (1 / u + 0.5 / z))
        return np.asarray(eye + G @ seen(-D / (1 + D)))

    return matrix


def _newmark_characteristic(scheme: Scheme) -> Matrix:
    c0, c1, c2, c3 = scheme.constants
    cu, cv, ca = scheme.coef
    seen, G, eye = Products.of(scheme.reads, scheme.scatter[0, :, 0]), scheme.G[0], np.eye(len(scheme.reads))

    def matrix(s: complex) -> Complexes:
        z, u = np.exp(s * scheme.dt), np.expm1(s * scheme.dt)
        v = (c2 + c3 * z) / u
        explicit = ca + cu * ((v + c0 + c1 * z) / u) + cv * v
        return np.asarray(eye + G @ seen(explicit / (z - explicit)))

    return matrix


_CHARACTERISTIC: Mapping[str, Callable[[Scheme], Matrix]] = {
    "flow": _flow_characteristic,
    "adams_bashforth": _adams_characteristic,
    "verlet": _verlet_characteristic,
    "newmark": _newmark_characteristic,
}
