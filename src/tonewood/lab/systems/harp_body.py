"""A stand-in for the Central African harp of Fabre, Le Carrou & Chomette (2024, section 3.2.2).

The paper shows that the harp's 32 modes between 100 and 1700 Hz are complex, several strongly so, and where that is
heard, but does not print them. This body is made up, and like it where the paper gives figures: 32 modes in that
range, in four groups that Hasselman's criterion at 0.2 keeps apart; several with a phase collinearity below 0.95,
the 22nd and the 26th among them, about the third and the fourth partial of the paper's string (247 Hz).

It is given as a second-order system in principal coordinates, and passive because its matrices say so:

    M = 1 kg,   K = diag(omega_n^2),   C = diag(2 zeta_0 omega_n) + sum over patches of c v v^T,

with natural frequencies as written below, light damping zeta_0 of everything, and patches of lossy material (laced
skin, glue, felt), one or two to a group of modes and a weak one for all, which strain each mode by an amount drawn
from a seeded generator. Eight strings are tied to a tailpiece along which mode n has the shape
cos(pi n x / 8 + theta_n) / sqrt(m_n), with theta_n and m_n drawn too.
"""

from __future__ import annotations

import numpy as np

from tonewood.lab.assembled import Matrices
from tonewood.physics.modal.damping import reciprocal_shapes
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.synthesis import basis_from_matrices
from tonewood.support.arrays import Floats

#: of all that is drawn at random
SEED = 1775
#: undamped natural frequencies in their four groups, Hz
FREQS = (
    (103.0, 112.0, 121.0, 133.0, 147.0, 158.0, 170.0, 181.0, 196.0, 214.0),
    (272.0, 288.0, 301.0, 322.0, 341.0, 366.0, 393.0, 419.0, 447.0),
    (585.0, 640.0, 725.0, 758.0, 812.0, 875.0, 965.0, 1008.0),
    (1290.0, 1365.0, 1430.0, 1540.0, 1640.0),
)
#: where strings s1 .. s8 are tied
N_STRINGS = 8
_LIGHT_DAMPING = 0.006
_PATCH_DAMPING = 0.011
_COMMON_DAMPING = 0.002
_MODAL_MASS = 0.08  # kg, geometric mean


def harp_body_matrices(seed: int = SEED) -> tuple[Matrices, dict[str, Floats]]:
    """M, C, K in principal coordinates (kg, N s/m, N/m), and the shapes (32,) at ``s1`` .. ``s8``.

    Displacements count along the normal of the soundboard.
    """
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * np.concatenate(FREQS)
    n = omega.size
    mass = _MODAL_MASS * np.exp(rng.normal(0.0, 0.3, n))
    theta = rng.uniform(0.0, 2 * np.pi, n)
    position = np.linspace(0.0, 1.0, N_STRINGS)
    shapes = np.cos(np.pi * np.outer(position, np.arange(n) / 8) + theta) / np.sqrt(mass)
    C = np.diag(2 * _LIGHT_DAMPING * omega)
    start = 0
    for group in FREQS:
        modes = slice(start, start + len(group))
        patches = len(group) // 5
        for _ in range(patches):
            strain = np.zeros(n)
            sign = rng.choice([-1.0, 1.0], len(group))
            strain[modes] = sign * rng.uniform(0.3, 1.3, len(group)) * np.sqrt(omega[modes])
            C += 2 * _PATCH_DAMPING / patches * np.outer(strain, strain)
        start += len(group)
    strain = rng.choice([-1.0, 1.0], n) * rng.uniform(0.3, 1.3, n) * np.sqrt(omega)
    C += 2 * _COMMON_DAMPING * np.outer(strain, strain)
    return Matrices(np.eye(n), C, np.diag(omega**2)), {f"s{i + 1}": shapes[i] for i in range(N_STRINGS)}


def harp_body(seed: int = SEED) -> ModalBasis:
    """The stand-in as complex modes at the points ``s1`` .. ``s8``."""
    matrices, points = harp_body_matrices(seed)
    return basis_from_matrices(*matrices, points)


def harp_body_table() -> tuple[list[str], Floats]:
    """Columns ``f_Hz, zeta, s1_right_re, s1_right_im, s1_left_re, s1_left_im, ...`` and their (32, n) values.

    Shapes are scaled so that Pi = 1: left and right ones are equal.
    """
    basis = harp_body()
    shapes, _ = reciprocal_shapes(basis)
    names, columns = ["f_Hz", "zeta"], [basis.natural_freq, basis.damping_ratio]
    for point, row in zip(basis.points, shapes, strict=True):
        for side in ("right", "left"):
            names += [f"{point}_{side}_re", f"{point}_{side}_im"]
            columns += [row.real, row.imag]
    return names, np.stack(columns, axis=1)
