"""How many modes the fixed-base and the free-free form need for one and the same error (Klosner & Ranlet 1978, p. 10).

The report remarks that the advantages of free-free modes "can readily be offset by the need to use a far greater
number" of them, and that "for rather stiff mountings, fewer fixed-base modes would be required". Measured here: a mass
on a spring carries a chain of 24 masses on a mounting that is a plain spring, stiff or soft, so that every truncation
can be solved by a matrix exponential.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tonewood.lab.assembled import Matrices, driven_motion, triangle
from tonewood.lab.component_modes import fixed_base_modes, free_free_modes
from tonewood.support.arrays import Floats

#: mass (kg) and spring (N/m) of S; of the chain: number of masses, mass of each, spring between them
MAIN_MASS, MAIN_SPRING = 1.0, 400.0
LINKS, LINK_MASS, LINK_SPRING = 24, 1 / 24, 4000.0
#: N/m
MOUNTINGS = {"stiff": 400 * LINK_SPRING, "as a link": LINK_SPRING, "soft": LINK_SPRING / 400}
LOAD = triangle(10.0, 0.02, 0.03)
DT, STEPS = 2e-3, 750

#: ways to describe the chain; "with residual" adds the static compliance of the modes left out (not in the report)
WAYS = ("fixed-base", "free-free", "free-free with residual")


@dataclass(frozen=True, slots=True)
class Need:
    """Modes of the chain (rigid-body or constraint mode counted) that bring the error below a limit."""

    mounting: str
    way: str
    limit: float
    modes: int


def chain_matrices() -> tuple[Floats, Floats]:
    """M and K of the free chain; dof 0 is its foot."""
    n = LINKS
    K = LINK_SPRING * (np.diag([1.0] + [2.0] * (n - 2) + [1.0]) - np.eye(n, k=1) - np.eye(n, k=-1))
    return LINK_MASS * np.eye(n), K


def responses(mounting: float, way: str, n_modes: int | None) -> Floats:
    """(STEPS, 2) displacement of S (m) and force in the mounting (N); the whole chain if `n_modes` is None."""
    M, K = chain_matrices()
    compliance = 1 / mounting
    if n_modes is None:
        mass, stiff, foot = M, K, np.eye(LINKS)[0]
    elif way == "fixed-base":
        T = fixed_base_modes(M, K, [0], n_modes - 1).transformation
        mass, stiff, foot = T.T @ M @ T, T.T @ K @ T, T[0]
    else:
        whole = free_free_modes(M, K)
        kept = whole.truncated(n_modes)
        mass, stiff, foot = np.eye(n_modes), np.diag(kept.omega**2), kept.shapes[0]
        if way == "free-free with residual":
            compliance += float(np.sum(whole.shapes[0, n_modes:] ** 2 / whole.omega[n_modes:] ** 2))
    n = len(mass) + 1
    whole_mass, whole_stiff = np.zeros((n, n)), np.zeros((n, n))
    whole_mass[0, 0], whole_mass[1:, 1:] = MAIN_MASS, mass
    whole_stiff[0, 0], whole_stiff[1:, 1:] = MAIN_SPRING, stiff
    gap = np.concatenate([[1.0], -foot])
    whole_stiff += np.outer(gap, gap) / compliance
    system = Matrices(whole_mass, np.zeros((n, n)), whole_stiff)
    x = driven_motion(system, np.eye(n)[0], LOAD, DT, STEPS)[:, :n]
    return np.stack([x[:, 0], x @ gap / compliance], axis=1)


def errors(mounting: str, way: str) -> Floats:
    """(LINKS, 2) relative maximum error of displacement and force with 1, 2, ... modes of the chain."""
    stiffness = MOUNTINGS[mounting]
    exact = responses(stiffness, way, None)
    size = np.abs(exact).max(axis=0)
    return np.array([
        np.abs(responses(stiffness, way, k) - exact).max(axis=0) / size for k in range(1, LINKS + 1)
    ])  # fmt: skip


def modes_needed(limits: tuple[float, ...] = (1e-1, 1e-2, 1e-3)) -> list[Need]:
    """The table: fewest modes from which on the force in the mounting stays within each limit."""
    out = []
    for mounting in MOUNTINGS:
        for way in WAYS:
            force = errors(mounting, way)[:, 1]
            for limit in limits:
                over = np.flatnonzero(force > limit)
                out.append(Need(mounting, way, limit, int(over[-1]) + 2 if over.size else 1))
    return out
