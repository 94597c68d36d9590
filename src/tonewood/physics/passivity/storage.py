"""Stored energy and dissipation of a passive component as quadratic forms of its modal states.

With z the full state [z; conj(z_pairs)] of the stored one, f the port forces and y' the port velocities,

    E = z^H P z,    dE/dt = f . y' - d,    d = z^H Q z + 2 Re(z^H S f) + f^T R f >= 0.

Written out, A^H P + P A = -Q and P B = (R A)^H / 2 - S (Kalman-Yakubovich-Popov; Willems, Arch. Rational Mech.
Anal. 45 (1972) 321). Bodies with mass at their ports have no direct term, and then S = 0 and R = 0: the dissipation
is a form of the modal states alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tonewood.errors import PassivityError
from tonewood.physics.modal.conjugates import extend, halve, real_form
from tonewood.physics.modal.mobility import port_directions, port_scale
from tonewood.physics.passivity.conditions import UNDAMPED, modal_partners
from tonewood.support.arrays import Complexes, Floats

_EXACT = 1e-8  # share by which P B = (R A)^H / 2 may be missed before the result is refused


@dataclass(frozen=True, eq=False)
class Storage:
    """A storage function and its dissipation; N = n + n_pairs full states.

    P : (N, N) Hermitian positive semidefinite: energy z^H P z, J.
    Q : (N, N) Hermitian positive semidefinite to rounding: power lost z^H Q z, W.
    cross, direct : (N, n_ports) and (n_ports, n_ports) rest of the dissipation (S and R of the module's head), zero
        unless the body has massless real modes.
    kind : ``modal`` (sum over real modes, mechanical energy), ``mechanical``, ``riccati`` or ``repair``.
    """

    P: Complexes
    Q: Complexes
    cross: Complexes
    direct: Floats
    kind: str

    def energy(self, full: Complexes) -> Floats:
        """Energy, J, of full states (N,) or (N, steps)."""
        return np.asarray(np.einsum("i...,ij,j...->...", full.conj(), self.P, full, optimize=True).real)

    def dissipation(self, full: Complexes, force: Floats | None = None) -> Floats:
        """Power lost, W, at full states (N,) or (N, steps) and port forces (n_ports,) or (n_ports, steps)."""
        lost = np.einsum("i...,ij,j...->...", full.conj(), self.Q, full, optimize=True).real
        if force is not None and self.direct.any():
            lost = lost + 2.0 * np.einsum("i...,ij,j...->...", full.conj(), self.cross, force).real
            lost = lost + np.einsum("i...,ij,j...->...", force, self.direct, force)
        return np.asarray(lost)


def storage_matrix(poles: Complexes, right: Complexes, left: Complexes) -> Storage:
    """A storage function of a passive basis.

    * Every mode passive by itself: the sum of the modes' mechanical energies; block-diagonal, instant.
    * Otherwise the mean of the two extreme storage functions of the basis, from the invariant subspaces of a
      Hamiltonian matrix. The direct term being zero, P is known in advance on the span of B and A^-1 B, the states
      after an impulse and under a static force (P B = (R A)^T / 2, P A^-1 B = -R^T / 2: kinetic energy at the ports
      and static compliance). On the rest, velocities of the ports are zero and their damping takes the place of the
      direct term, so that an ordinary Riccati equation of size N - 2 n_ports remains. About 4 s for 200 modes.

    poles : (n,) half list, 1/s.
    right, left : (n_ports, n).
    Raises PassivityError : the basis is not passive; is passive only just (no power is lost at some frequency), so that
        the Riccati equation has no solution of full accuracy; or has a direct term without being a sum of passive
        modes. A repaired basis brings its own storage function.
    """
    poles, right, left, _ = halve(*(np.asarray(a, dtype=np.complex128) for a in (poles, right, left)))
    passive, partner = modal_partners(poles, right, left)
    if passive.all():
        return _of_modes(poles, right, left, partner)
    return _of_complex_modes(poles, right, left)


def lyapunov_dissipation(poles: Complexes, P: Complexes) -> Complexes:
    """Q = -(A^H P + P A) of a Hermitian P over the full list `poles`."""
    return -(poles.conj()[:, None] + poles[None, :]) * P


def _of_modes(poles: Complexes, right: Complexes, left: Complexes, partner: list[int]) -> Storage:
    """Sum of the mechanical energies of modes that are passive by themselves."""
    n, n_ports = poles.size, right.shape[0]
    pairs = np.flatnonzero(poles.imag > 0.0)
    conjugate = dict(zip(pairs.tolist(), range(n, n + pairs.size), strict=True))
    size = n + pairs.size
    P, Q = (np.zeros((size, size), dtype=np.complex128) for _ in range(2))
    cross = np.zeros((size, n_ports), dtype=np.complex128)
    direct = np.zeros((n_ports, n_ports))
    for k in range(n):
        r, l_ = right[:, k], left[:, k]
        strength = complex(r.conj() @ r) and complex(np.sum(r * l_) / (r.conj() @ r))
        if k in partner or strength == 0:
            continue  # the fast half of an overdamped mode is done with the slow one; undriven modes stay at rest
        if k in conjugate:
            # r l^T = -i b phi phi^T with r = turn phi: mass 1 / (2 b omega_d), coordinate q = 2 Re(turn z)
            turn = np.exp(0.5j * np.angle(np.sum(r**2)))
            mass = 1.0 / (2.0 * abs(strength) * poles[k].imag)
            at = np.array([k, conjugate[k]])
            q = np.array([turn, np.conj(turn)])
            rates = np.array([poles[k], np.conj(poles[k])])
        elif partner[k] >= 0:
            j = partner[k]
            mass = 1.0 / (abs(strength) * (poles[j] - poles[k]).real)
            at = np.array([k, j])
            q = np.array([1.0, np.sum(r * right[:, j]) / np.sum(r * r)])
            rates = poles[at]
        else:
            # massless: r l^T = b phi phi^T, a spring |lambda| / b in series with a dashpot 1 / b
            b = strength.real
            speed = poles[k].real / b * r.real
            P[k, k] = 0.5 * abs(poles[k].real) / b
            Q[k, k] = poles[k].real ** 2 / b
            cross[k] = speed * b
            direct += b * np.outer(r.real, r.real)
            continue
        v = q * rates
        stiffness = abs(rates[0] * rates[1])
        P[np.ix_(at, at)] = 0.5 * mass * (np.outer(v.conj(), v) + stiffness * np.outer(q.conj(), q))
        Q[np.ix_(at, at)] = -mass * np.sum(rates).real * np.outer(v.conj(), v)
    return Storage(P, Q, cross, direct, "modal")


def _of_complex_modes(poles: Complexes, right: Complexes, left: Complexes) -> Storage:
    """Storage function of a list of complex modes: undamped ones by themselves, the others by a Riccati equation."""
    scale = port_scale(poles, right, left)[:, None]
    sizes = [np.sqrt((np.abs(shapes / scale) ** 2).sum(axis=0)) for shapes in (right, left)]
    driven_and_seen = (sizes[0] > 0.0) & (sizes[1] > 0.0)  # the others stay at rest or do no work
    undamped = (np.abs(poles.real) <= UNDAMPED * np.abs(poles)) & (poles != 0)
    if np.any((poles.real >= 0.0) & ~undamped):
        raise PassivityError("no storage function: a pole of a list of complex modes grows, or is zero")
    pairs = poles.imag > 0.0
    P = np.zeros((poles.size + int(pairs.sum()),) * 2, dtype=np.complex128)
    for k in np.flatnonzero(undamped & driven_and_seen):
        # P l = (r lambda)^H / 2 with one number for P: l = -i a conj(r), a > 0
        r, l_ = right[:, k] / scale[:, 0], left[:, k] / scale[:, 0]
        a = complex(1j * np.sum(r * l_)).real / sizes[0][k] ** 2
        if not a > 0.0 or float(np.linalg.norm(l_ + 1j * a * r.conj())) > _EXACT * sizes[1][k]:
            raise PassivityError("no storage function: an undamped mode is not passive by itself")
        second = poles.size + int(pairs[:k].sum())
        P[k, k] = P[second, second] = 0.5 * abs(poles[k]) / a
    damped = driven_and_seen & ~undamped
    rows = np.concatenate([damped, damped[pairs]])
    if damped.any():
        P[np.ix_(rows, rows)] = _of_riccati(poles[damped], right[:, damped], left[:, damped])
    n_ports = right.shape[0]
    cross, direct = np.zeros((rows.size, n_ports), dtype=np.complex128), np.zeros((n_ports, n_ports))
    return Storage(P, lyapunov_dissipation(extend(poles, right, left)[0], P), cross, direct, "riccati")


def _of_riccati(poles: Complexes, right: Complexes, left: Complexes) -> Complexes:
    """P over the full list of a damped basis without direct term, as described at `storage_matrix`."""
    scale = port_scale(poles, right, left)
    right, left = right / scale[:, None], left / scale[:, None]
    ports, values = port_directions(right, left)
    right, left = (ports / values).T @ right, (ports / values).T @ left
    # states in which P is about 1/2, time in units of a middle frequency
    unit = float(np.exp(np.mean(np.log(np.abs(poles)))))
    gain = np.sqrt(np.linalg.norm(left, axis=0) / (np.linalg.norm(right, axis=0) * np.abs(poles)))
    form = real_form(poles / unit, right * gain, left / (gain * unit))
    A, B, R, C = form.A, form.B, form.R, form.C
    m = R.shape[0]
    if float(np.linalg.norm(form.D + form.D.T)) > 1e-7 * float(np.linalg.norm(R) * np.linalg.norm(B)):
        raise PassivityError("no storage function: the direct term 2 Re sum r l^T is not zero")

    # known part: on V = [B, A^-1 B], whose complement are the states with ports at rest, Gamma x = 0
    gamma = np.concatenate([C, R])
    V = np.concatenate([B, np.linalg.solve(A, B)], axis=1)
    from tonewood.support.scipy_linalg import sla

    W = sla.null_space(gamma, rcond=1e-12)
    ports_of = gamma @ V  # [[C B, D], [D, -H(0)]]
    least = 1e-12 * float(np.linalg.norm(ports_of))
    if W.shape[1] != A.shape[0] - 2 * m or float(np.linalg.svdvals(ports_of)[-1]) < least:
        raise PassivityError("no storage function: mass or stiffness at the ports is singular")
    coordinates = np.linalg.solve(ports_of, gamma)
    forces = 0.5 * np.concatenate([C, -R]).T @ coordinates
    rest = W.T @ (np.eye(A.shape[0]) - V @ coordinates)

    P = 0.5 * (forces + forces.T)
    if W.shape[1]:
        damping = -0.5 * (C @ A @ B + (C @ A @ B).T)
        P = P + rest.T @ _riccati(rest @ A @ W, rest @ A @ B, 0.5 * C @ A @ W, damping) @ rest
    if float(np.linalg.norm(P @ B - 0.5 * C.T)) > _EXACT * float(np.linalg.norm(C)):
        raise PassivityError("no storage function: masses at the ports are not symmetric")

    lost = -(A.T @ P + P @ A)
    for name, matrix in (("energy", P), ("dissipation", lost)):
        if float(np.linalg.eigvalsh(matrix)[0]) < -_EXACT * float(np.linalg.norm(matrix, 2)):
            raise PassivityError(f"no storage function: its {name} would be negative somewhere")
    gains = np.concatenate([gain, gain[poles.imag > 0.0]])
    return np.asarray(form.to_full @ P @ form.to_full.conj().T / np.outer(gains, gains), dtype=np.complex128)


def _riccati(A: Floats, B: Floats, S: Floats, R: Floats) -> Floats:
    """Mean of the extreme solutions of A^T P + P A + (P B + S^T) R^-1 (B^T P + S) = 0.

    The extreme ones lose nothing in some directions; their mean loses something in all, clear of rounding.
    """
    from tonewood.support.scipy_linalg import sla

    try:
        factor = sla.cho_factor(R)
    except np.linalg.LinAlgError:
        raise PassivityError("no storage function: motion of some port is not damped at high frequencies") from None
    closed = A + B @ sla.cho_solve(factor, S)
    hamiltonian = np.block([[closed, B @ sla.cho_solve(factor, B.T)], [-S.T @ sla.cho_solve(factor, S), -closed.T]])
    n = A.shape[0]
    solutions = []
    for half_plane in ("lhp", "rhp"):
        _, vectors, count = sla.schur(hamiltonian, sort=half_plane)
        if count != n:
            raise PassivityError(
                "no storage function: the basis is passive only just, or not at all; repair it to get one"
            )
        P = np.linalg.solve(vectors[:n, :n].T, vectors[n:, :n].T)
        solutions.append(0.5 * (P + P.T))
    return 0.5 * (solutions[0] + solutions[1])
