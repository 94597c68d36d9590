"""Random non-proportionally damped bodies and strings for the passivity tests, from mass, damping and stiffness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from tonewood.errors import PassivityError
from tonewood.physics.modal.conjugates import extend
from tonewood.physics.passivity.storage import Storage

#: mean damping ratios of the three kinds of test body
DAMPING = {"light": 0.003, "medium": 0.015, "heavy": 0.06}


@dataclass(frozen=True)
class Body:
    """M, C, K, the port rows, and the complex modes found from them by scipy, sorted by frequency."""

    M: np.ndarray
    C: np.ndarray
    K: np.ndarray
    ports: np.ndarray
    poles: np.ndarray  # one of each pair, and real poles
    shapes: np.ndarray  # all dofs
    norm: np.ndarray  # 1 / Pi

    @property
    def modes(self):
        """(poles, right, left) of the ports, complete."""
        r = self.ports @ self.shapes
        return self.poles, r, r * self.norm

    def truncated(self, share=0.5):
        """The lower modes only."""
        n = round(share * self.poles.size)
        poles, r, l_ = self.modes
        return poles[:n], r[:, :n], l_[:, :n]

    def mobility(self, omega):
        """Mobility of the ports from the matrices themselves."""
        dynamic = [self.K + 1j * w * self.C - w**2 * self.M for w in omega]
        return np.array(
            [1j * w * self.ports @ linalg.solve(d, self.ports.T) for w, d in zip(omega, dynamic, strict=True)]
        )


def full_state(poles, z):
    """The full state [z; conj(z_pairs)] of the stored one."""
    return np.concatenate([z, np.conj(z[poles.imag != 0.0])])


def mechanical_storage(poles, right, left, M, C, K):
    """Mechanical energy of a structure from a complete list of its complex modes.

    E = (v^T M v + u^T K u) / 2 and d = v^T C v with u = sum 2 Re(r z), v = sum 2 Re(lambda r z).
    """
    lam, psi, psi_left = extend(poles, right, left)
    speed = psi * lam
    P = 0.5 * (speed.conj().T @ M @ speed + psi.conj().T @ K @ psi)
    supplied = 0.5 * speed.conj().T
    if linalg.norm(P @ psi_left.T - supplied) > 1e-8 * linalg.norm(supplied):
        raise PassivityError("the modes are not the complete list of these mass, damping and stiffness matrices")
    n_dof = psi.shape[0]
    cross = np.zeros((lam.size, n_dof), dtype=np.complex128)
    return Storage(P, speed.conj().T @ C @ speed, cross, np.zeros((n_dof, n_dof)), "mechanical")


def body(seed, zeta=0.015, n_dof=40, n_ports=3, low=80.0, high=8000.0, dashpots=6, mass=0.005):
    """Masses in a random stiffness net, its frequencies between low and high (Hz), and a few random dashpots.

    The dashpots couple all modes, in proportion to sqrt(omega_i omega_j); a tenth of the damping is proportional, so
    that every motion is damped.
    """
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((n_dof, n_dof))
    M = mass * (np.eye(n_dof) + 0.3 * X @ X.T / n_dof)
    omega = 2 * np.pi * np.sort(rng.uniform(low, high, n_dof))
    V, _ = linalg.qr(rng.standard_normal((n_dof, n_dof)))
    to_modes = linalg.sqrtm(M).real @ V
    G = rng.standard_normal((n_dof, dashpots))
    half = np.sqrt(2 * zeta * omega)
    modal_damping = half[:, None] * (0.9 * G @ G.T / dashpots + 0.1 * np.eye(n_dof)) * half
    K = to_modes @ np.diag(omega**2) @ to_modes.T
    C = to_modes @ modal_damping @ to_modes.T
    ports = linalg.qr(rng.standard_normal((n_dof, n_ports)), mode="economic")[0].T
    return solve(M, 0.5 * (C + C.T), 0.5 * (K + K.T), ports)


def solve(M, C, K, ports):
    """Complex modes of M, C, K with scipy, normalised with Pi = psi^T (C + 2 lambda M) psi."""
    n = M.shape[0]
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-linalg.solve(M, K), -linalg.solve(M, C)]])
    lam, vec = linalg.eig(A)
    keep = np.flatnonzero(lam.imag >= 0)
    keep = keep[np.argsort(np.abs(lam[keep]))]
    lam, psi = lam[keep], vec[:n, keep]
    pi = np.einsum("ik,ij,jk->k", psi, C, psi) + 2 * lam * np.einsum("ik,ij,jk->k", psi, M, psi)
    return Body(M, C, K, ports, lam, psi, 1.0 / pi)


def string_end(tension, density, length=0.65, n_sines=30, sigma=2.0, eta=1e-5):
    """A string fixed at the far end, free at the bridge: sines and one static ramp, loss sigma + eta omega.

    Returns (poles, right, left) at the bridge end.
    """
    n = np.arange(1, n_sines + 1)
    M = np.diag(np.r_[np.full(n_sines, density * length / 2), density * length / 3])
    M[:-1, -1] = M[-1, :-1] = density * length * (-1.0) ** (n + 1) / (n * np.pi)
    K = np.diag(np.r_[tension * (n * np.pi / length) ** 2 * length / 2, tension / length])
    omega2, V = linalg.eigh(K, M)
    omega = np.sqrt(omega2)
    decay = sigma + eta * omega
    damped = np.sqrt(omega2 - decay**2)
    end = V[-1][None, :].astype(complex)
    return -decay + 1j * damped, end, end * (-0.5j / damped)


STRINGS = [string_end(80.0, 6e-3), string_end(75.0, 2e-3), string_end(70.0, 0.7e-3)]


def state_space(poles, right, left):
    """Real A, B, R of a list of modes, state (Re z, Im z) of each; real poles keep a dead imaginary part."""
    n, m = poles.size, right.shape[0]
    A, B, R = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, m)), np.zeros((m, 2 * n))
    for k, pole in enumerate(poles):
        c = 2.0 if pole.imag else 1.0
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[pole.real, -pole.imag], [pole.imag, pole.real]]
        B[2 * k], B[2 * k + 1] = left[:, k].real, left[:, k].imag
        R[:, 2 * k], R[:, 2 * k + 1] = c * right[:, k].real, -c * right[:, k].imag
    return A, B, R


def held_step(A, B, dt):
    """exp(A dt) and the gain of a force held over the step, from one matrix exponential."""
    n, m = B.shape
    big = linalg.expm(np.block([[A, B], [np.zeros((m, n + m))]]) * dt)
    return big[:n, :n], big[:n, n:]


def coupled_map(ports, strings, dt, residual):
    """One step of a body with a string fixed to each port: position-level constraint, force held over the step.

    With residual compliance R at the joints, f = -(Z + 2R)^-1 (gap unconstrained + gap before).

    Returns the map of the states (Re z, Im z) of body and strings, and the gaps' rows.
    """
    rows, E, W = [], [], []
    for j, part in enumerate([ports, *strings]):
        A, B, R = state_space(*part)
        side = np.eye(len(strings)) if j == 0 else -np.eye(len(strings))[:, [j - 1]]
        step, gain = held_step(A, B, dt)
        rows.append(side @ R)
        E.append(step)
        W.append(gain @ side.T)
    step, gap, gain = linalg.block_diag(*E), np.concatenate(rows, axis=1), np.concatenate(W)
    return step - gain @ linalg.solve(gap @ gain + 2 * residual, gap @ (step + np.eye(len(step)))), gap


def energy_form(poles, P):
    """z^H P z of the full state as a form of (Re z, Im z)."""
    x = np.eye(2 * poles.size)
    full = full_state(poles, x[0::2] + 1j * x[1::2])
    return (full.conj().T @ P @ full).real


def growth(step):
    """Spectral radius less one."""
    return float(np.abs(linalg.eigvals(step)).max()) - 1.0


def static_compliance(poles, right, left):
    c = np.where(poles.imag == 0, 1.0, 2.0)
    H = -((right * (c / poles)) @ left.T).real
    return 0.5 * (H + H.T)


def power_balance(modes, storage, rng, duration=2e-3, steps=200):
    """(residual of the balance, energy, loss) over steps of a held random force, motion by a matrix exponential.

    dE = f (y+ - y) - integral of d; the loss is integrated by Gauss points inside each step.
    """
    poles, right, left = modes
    A, B, R = state_space(poles, right, left)
    n, m = B.shape
    big = np.block([[A, B], [np.zeros((m, n + m))]])
    dt = duration / steps
    nodes, weights = np.polynomial.legendre.leggauss(10)
    inside = [linalg.expm(big * dt * 0.5 * (1 + x))[:n] for x in nodes]
    step = linalg.expm(big * dt)[:n]
    x, residuals, energies, losses = rng.standard_normal(n), [], [], []
    x[1::2] *= poles.imag != 0
    x /= np.sqrt(storage.energy(full_state(poles, x[0::2] + 1j * x[1::2])))
    force = rng.standard_normal((steps, m)) / np.sqrt(steps) * 30
    for f in force:
        start = np.concatenate([x, f])
        states = np.array([part @ start for part in inside])
        full = np.array([full_state(poles, s[0::2] + 1j * s[1::2]) for s in states]).T
        held = np.repeat(f[:, None], nodes.size, axis=1)
        lost = 0.5 * dt * float(weights @ storage.dissipation(full, held))
        before = storage.energy(full_state(poles, x[0::2] + 1j * x[1::2]))
        new = step @ start
        after = storage.energy(full_state(poles, new[0::2] + 1j * new[1::2]))
        residuals.append(float(after - before - f @ (R @ new - R @ x) + lost))
        energies.append(float(after))
        losses.append(lost)
        x = new
    return np.array(residuals), np.array(energies), np.array(losses)
