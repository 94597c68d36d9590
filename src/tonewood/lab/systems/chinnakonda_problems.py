"""The thesis' two systems (Chinnakonda 2007, chapter 3) and their motions by matrix exponentials.

*Two masses* (Fig. 3.1): masses of 1 kg in a row between walls, three springs of 4 pi^2 N/m, dashpots c1 = c2 = c and
c3 = 0, driven by opposite forces of 10 N at 1.5 Hz. Light damping is c = 4 pi/50 N s/m, very heavy c = 4 pi.

*Stiff system* (Fig. 3.10): the first spring 1e4 times as stiff, the third left out; free motion from u = (1, 10). The
first mode, near 1 Hz, stands for those that matter, the second, near 100 Hz, for a spurious one of a discretised
continuum.

The eigenproblems are the generalised ones, A - lambda B and K^ - lambda M^; the thesis prints them as standard ones.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from tonewood.lab.assembled import Matrices, driven_motion, state_matrix
from tonewood.lab.interpolatory import P1, Response, Update, respond
from tonewood.lab.nonproportionality import reduced, reduction_shapes
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.synthesis import basis_from_matrices, initial_state
from tonewood.physics.stepping.forcing import Segment
from tonewood.support.arrays import Floats

SPRING = 4 * np.pi**2
#: N s/m
LIGHT, HEAVY = 4 * np.pi / 50, 4 * np.pi
#: N, Hz, s
AMPLITUDE, DRIVE_FREQ, DURATION = 10.0, 1.5, 10.0
OMEGA = 2 * np.pi * DRIVE_FREQ
DOFS = ("mass 1", "mass 2")
FORCES: dict[str, Callable[[Floats], Floats]] = {
    "mass 1": lambda t: np.asarray(AMPLITUDE * np.sin(OMEGA * t)),
    "mass 2": lambda t: np.asarray(-AMPLITUDE * np.sin(OMEGA * t)),
}
AMPLITUDES = {"mass 1": AMPLITUDE, "mass 2": -AMPLITUDE}


def two_masses(c: float) -> Matrices:
    """M, C, K of the two masses."""
    return Matrices(
        np.eye(2), c * np.array([[2.0, -1.0], [-1.0, 1.0]]), SPRING * np.array([[2.0, -1.0], [-1.0, 2.0]])
    )  # fmt: skip


def basis_of(system: Matrices) -> ModalBasis:
    """Modes of a system of two masses, with a point at each."""
    return basis_from_matrices(*system, DOFS)


def sampled_forces(times: ArrayLike) -> Floats:
    """(n, 2) N, the driving forces."""
    t = np.atleast_1d(np.asarray(times, dtype=np.float64))
    return np.stack([force(t) for force in FORCES.values()], axis=1)


def exact_driven(system: Matrices, dt: float, n: int) -> Floats:
    """(n, 2) m from rest under the harmonic forces: powers of the exponential of system and oscillator together."""
    A = np.zeros((6, 6))
    A[:4, :4] = state_matrix(system)
    A[2:4, 4] = sla.solve(system.M, [AMPLITUDE, -AMPLITUDE])
    A[4, 5], A[5, 4] = OMEGA, -OMEGA
    step, x = sla.expm(A * dt), np.zeros((1, 6))
    x[0, 5] = 1.0
    while len(x) < n:
        x = np.concatenate([x, x @ step.T])
        step = step @ step
    return np.asarray(x[:n, :2])


def driven_error(update: Update, c: float, steps_per_period: int) -> tuple[Floats, Floats, Floats]:
    """Error of an update over 10 s.

    c : N s/m.
    steps_per_period : samples per period of the force, 1/1.5 s.
    Returns times : (n,) s.  errors : (n, 2) m, exact minus update.  size : (2,) m, largest exact displacement of each
        mass.
    """
    system = two_masses(c)
    dt = 1 / DRIVE_FREQ / steps_per_period
    n = round(DURATION / dt) + 1
    response = respond(update, basis_of(system), FORCES, np.arange(n) * dt)
    exact = exact_driven(system, dt, n)
    error = exact[:: update.span][: len(response.times)] - response.displacement
    return response.times, error, np.abs(exact).max(axis=0)


def relative_errors(update: Update, c: float, resolutions: tuple[int, ...] = (20, 40, 80, 160)) -> Floats:
    """Largest error of mass 1 relative to its largest displacement at each number of steps per period."""
    out = []
    for steps in resolutions:
        _, error, size = driven_error(update, c, steps)
        out.append(np.abs(error[:, 0]).max() / size[0])
    return np.array(out)


def stiff_system(c: float, *, proportional: bool) -> Matrices:
    """The stiff system with C = diag(c, c) or [[2c, -c], [-c, c]]."""
    k1, k2 = 1e4 * SPRING, SPRING
    pattern = np.eye(2) if proportional else np.array([[2.0, -1.0], [-1.0, 1.0]])
    return Matrices(np.eye(2), c * pattern, np.array([[k1 + k2, -k2], [-k2, k2]]))


STIFF_START = np.array([1.0, 10.0])
#: N s/m of Fig. 3.10: mass-proportional, non-proportional
STIFF_DAMPING = {True: 4 * np.pi / 10, False: 4 * np.pi / 5}


def two_step(system: Matrices, n_modes: int, times: ArrayLike, start: ArrayLike) -> Response:
    """Real modal reduction first, complex modes of the reduced system second (the thesis' algorithm, p. 17).

    Returns Response with displacements at the physical dofs.
    """
    small, P = reduced(system, n_modes), reduction_shapes(system, n_modes)
    basis = basis_from_matrices(*small, [f"q{k}" for k in range(n_modes)])
    none = np.zeros(n_modes)
    state = initial_state(basis, small.M, small.C, P.T @ system.M @ np.asarray(start), none)
    response = respond(P1, basis, {}, times, state)
    return Response(response.times, response.state, response.displacement @ P.T, response.velocity @ P.T)


def damped_chain() -> Matrices:
    """Twelve masses of 1 kg between walls on springs of 1000 N/m; 20 N s/m from the third to the ground."""
    n = 12
    K = 1000.0 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    C = np.zeros((n, n))
    C[2, 2] = 20.0
    return Matrices(np.eye(n), C, K)


def every_kind_of_mode() -> dict[str, Matrices]:
    """Systems of two masses whose modes are of each kind; all go through the same `basis_of` and `respond`."""
    one, spring = np.eye(2), SPRING * np.array([[2.0, -1.0], [-1.0, 2.0]])
    free = SPRING * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return {
        "under-damped": two_masses(LIGHT),
        "over-damped": two_masses(40 * np.pi),
        "critically damped": Matrices(one, 4 * np.pi * one, spring),
        "repeated poles": Matrices(one, LIGHT * one, SPRING * one),
        "rigid body, undamped": Matrices(one, LIGHT * free / SPRING, free),
        "rigid body, damped": Matrices(one, np.diag([1.0, 0.0]), free),
        "coinciding real poles, non-proportional": _coinciding(),
    }


def _coinciding() -> Matrices:
    # in coordinates (a, b) a critical oscillator and a dashpot-coupled one, mixed: C is not proportional
    T = np.array([[1.0, 0.3, -0.2], [0.1, 1.0, 0.4], [0.2, -0.5, 1.0]])
    M, C, K = np.eye(3), np.zeros((3, 3)), np.zeros((3, 3))
    C[0, 0], K[0, 0] = 4.0, 4.0
    C[1:, 1:] = [[1.0, -1.0], [-1.0, 1.0]]
    K[1:, 1:] = [[5.0, -2.0], [-2.0, 3.0]]
    return Matrices(T.T @ M @ T, T.T @ C @ T, T.T @ K @ T)


def ramp_difference(system: Matrices, update: Update) -> float:
    """Largest difference between an update and the exact motion under a broken line of forces on the first mass.

    From a motion that is not at rest; relative to the largest displacement.
    """
    size, n, dt = len(system.M), 61, 0.05
    pieces = (Segment(0.0, 20 * dt, 0.0, 3.0), Segment(20 * dt, 60 * dt, 60 * dt, -5.0))
    x0, v0 = np.linspace(0.5, -1.0, size), np.linspace(1.0, 2.0, size)
    times = np.arange(n) * dt
    exact = driven_motion(system, np.eye(size)[0], pieces, dt, n, np.concatenate([x0, v0]))[:, :size]
    basis = basis_from_matrices(*system, [str(k) for k in range(size)])
    state = initial_state(basis, system.M, system.C, x0, v0)
    corners = times[[0, 20, 60]], [0.0, 60 * dt, -140 * dt]
    displacement = respond(update, basis, {"0": lambda t: np.interp(t, *corners)}, times, state).displacement
    return float(np.abs(displacement - exact[:: update.span]).max() / np.abs(exact).max())
