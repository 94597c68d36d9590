"""Reference motions that methods are compared with.

`ExactMotion` superposes the coupled modes of a system found by an eigenvalue solver: exact, for some hundred modes.
`FineMotion` is this project's scheme at 32 times the rate of a render, for systems of thousands of modes; how far it
still is from its limit is shown by the same at half that rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy.linalg as sla

from tonewood.lab.accuracy.runs import KernelRun, Scene
from tonewood.lab.methods.problem import Problem
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.arrays import Complexes, Floats

#: samples per second of a reference that has to be computed
FINE_RATE = 32 * 48000


class Motion(Protocol):
    """A free motion from time 0."""

    def displacement(self, fs: float, n: int) -> Floats:
        """(n, n_outputs) m at 0, 1 / fs, 2 / fs, ..."""

    @property
    def convergence(self) -> float:
        """Relative distance from the limit, as far as it is known."""


@dataclass(frozen=True, eq=False)
class ExactMotion:
    """Free motion from a state, superposed from the modes of the whole.

    poles : (k,) 1/s, conjugates included.
    shares : (k, n_outputs) m, contribution of each to the readouts.
    """

    poles: Complexes
    shares: Complexes
    convergence: float = 0.0

    @classmethod
    def of(cls, problem: Problem, start: Floats, freq_upper: float = np.inf) -> ExactMotion:
        """Modes of x' = (A - B S C A^2) x on the states that the constraints allow.

        start : (n, 2), with closed gaps at rest.
        freq_upper : Hz, coupled modes above it are left out.
        """
        m, n = len(problem.B), 2 * problem.n_modes
        A = sla.block_diag(*problem.A)
        F = A - problem.B.reshape(m, n).T @ problem.S @ problem.CA2.reshape(m, n)
        C = problem.C.reshape(m, n)
        free = sla.null_space(np.vstack([C / sla.norm(C), C @ A / sla.norm(C @ A)]), rcond=1e-12)
        poles, vectors = sla.eig(free.T @ F @ free)
        shares = (problem.out.reshape(-1, n) @ free @ vectors).T * sla.solve(vectors, free.T @ start.ravel())[:, None]
        low = np.abs(poles.imag) < 2 * np.pi * freq_upper
        return cls(poles[low], shares[low])

    def displacement(self, fs: float, n: int) -> Floats:
        """See `Motion`."""
        block = 2048
        step = np.exp(np.outer(np.arange(min(block, n)) / fs, self.poles))
        begins = np.exp(np.outer(np.arange(0, n, block) / fs, self.poles))
        out = [step @ (begin[:, None] * self.shares) for begin in begins]
        return np.asarray(np.concatenate(out)[:n].real)

    def basis(self) -> ModalBasis:
        """The coupled modes as one component heard at ``out0``, ``out1``, ..., for a motion from the same start.

        Its left shapes are the modes' shares: a unit impulse at ``start`` makes the motion.
        """
        keep = (self.poles.imag > 0) & np.any(self.shares != 0, axis=1)
        points = {f"out{i}": np.where(keep, column, 0)[keep] for i, column in enumerate(self.shares.T)}
        return ModalBasis.complex(self.poles[keep], points, {name: np.ones(keep.sum()) for name in points})


@dataclass(frozen=True, eq=False)
class FineMotion:
    """The project's scheme at a rate far above that of a render.

    problem, start : system that moves, and its state at the start.
    duration : s.
    rate : Hz.
    """

    problem: Problem
    start: Floats
    duration: float = 1.0
    rate: int = FINE_RATE

    def displacement(self, fs: float, n: int) -> Floats:
        """See `Motion`; `fs` has to divide the rate."""
        every = round(self.rate / fs)
        if abs(every * fs - self.rate) > 1e-6 * self.rate:
            raise ValueError(f"{fs:g} Hz does not divide {self.rate} Hz")
        return self._samples[::every][:n]

    @cached_property
    def convergence(self) -> float:
        """Relative difference, after `duration`, between this and half its rate; a 16th of it is left."""
        coarse = FineMotion(self.problem, self.start, self.duration, self.rate // 2)._samples
        fine = self._samples[::2][: len(coarse)]
        return float(sla.norm(coarse - fine) / sla.norm(fine)) / 15

    @cached_property
    def _samples(self) -> Floats:
        return self.states(round(self.duration * self.rate))

    def states(self, n: int) -> Floats:
        """(n + 1, n_outputs) displacements."""
        return KernelRun(Scene(self.problem, self.start), self.rate).run(n + 1)[0]
