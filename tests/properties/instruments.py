"""Random instruments: strings on a body, in physical coordinates and as the system that is stepped."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import strategies as st

from assembled import Part, chain, connect, motion_readouts, uneven
from tonewood.physics.coupling.connections import Rigid, SpringDashpot
from tonewood.physics.coupling.system import Readout, System


@dataclass(frozen=True)
class Instrument:
    """Parts, rows of their joints with laws, the residual compliance of the joints, and a step."""

    parts: dict[str, Part]
    gaps: np.ndarray
    laws: list[Rigid | SpringDashpot]
    residual: np.ndarray
    dt: float
    system: System

    def __repr__(self):
        return f"{len(self.parts) - 1} strings, {len(self.laws)} joints"

    @property
    def n(self) -> int:
        return sum(p.n for p in self.parts.values())

    def dof(self, index):
        """(component, point) of a dof of all."""
        for name, part in self.parts.items():
            if index < part.n:
                return name, f"n{index}"
            index -= part.n
        raise IndexError(index)

    def basis(self, name):
        return self.system.compiled[self.system.slot(name)].basis


def build(seed, n_strings, body_dofs, complex_body, yielding, extra, dt, springs=True):
    """Strings of 1 to 4 masses on a body; besides their ends `extra` joints of any kind between anything."""
    rng = np.random.default_rng(seed)
    make = uneven if complex_body else chain
    options = {"zeta": 0.03} if complex_body else {}
    parts = {"body": make(body_dofs, seed, stiffness=4e5, mass=0.3, **options)}
    for i in range(n_strings):
        size = 10.0 ** rng.uniform(-3, 0)
        parts[f"s{i}"] = chain(
            int(rng.integers(1, 5)), seed + i, stiffness=size * 10.0 ** rng.uniform(4, 6), mass=size,
            mass_damping=10.0 ** rng.uniform(-3, 1), stiffness_damping=0.0, fixed=bool(rng.random() < 0.8),
        )  # fmt: skip
    n = sum(p.n for p in parts.values())
    gaps, laws, start = [], [], body_dofs
    for i in range(n_strings):
        row = np.zeros(n)
        row[start + parts[f"s{i}"].n - 1] = 1.0
        row[rng.integers(body_dofs)] = -rng.uniform(0.3, 1.0)
        gaps.append(row)
        rigid = rng.random() < 0.8 or not springs
        laws.append(Rigid() if rigid else SpringDashpot(10.0 ** rng.uniform(2, 8), rng.uniform(0, 5)))
        start += parts[f"s{i}"].n
    for _ in range(extra):
        row = np.zeros(n)
        row[rng.choice(n, size=min(n, int(rng.integers(1, 4))), replace=False)] = rng.uniform(-1, 1)
        gaps.append(row)
        laws.append(
            [Rigid(), SpringDashpot(10.0 ** rng.uniform(0, 9)), SpringDashpot(0.0, 10.0 ** rng.uniform(-3, 4))][
                rng.integers(3)
            ]
        )
    gaps = np.array(gaps)
    bases, residual = {}, np.zeros((len(gaps),) * 2)
    start = 0
    for name, part in parts.items():
        basis = part.complex_basis() if name == "body" and complex_body else part.real_basis()
        R = np.zeros((part.n, part.n))
        if yielding:
            X = rng.normal(size=(part.n, part.n)) + np.eye(part.n)
            R = 0.02 / max(np.max(np.diag(part.K)), 1e3) * X @ X.T
        a = gaps[:, start : start + part.n]
        residual += a @ R @ a.T
        bases[name] = replace(basis, residual=R)
        start += part.n
    links = [connect(f"c{j}", parts, row, law) for j, (row, law) in enumerate(zip(gaps, laws, strict=True))]
    forces = Readout("force", "force", (), tuple((f"c{j}", 1.0) for j in range(len(links))))
    system = System.build(bases, links, [*motion_readouts(parts), forces], dt=dt)
    rigid = np.array([isinstance(law, Rigid) for law in laws])
    return Instrument(parts, gaps, in_series(laws, residual), residual * np.outer(rigid, rigid), dt, system)


def in_series(laws: list[Rigid | SpringDashpot], residual: np.ndarray) -> list[Rigid | SpringDashpot]:
    """Put springs in series with the residual compliance that they load: k u and r u^2, (1 + R K) u = 1.

    The law is that of `physics.coupling.connections`; `test_springs_in_series.py` compares it with assembled systems.
    """
    k = np.array([0.0 if isinstance(law, Rigid) else law.stiffness for law in laws])
    loaded = np.outer(k > 0, k > 0) * residual * k
    shares = np.linalg.solve(np.eye(k.size) + loaded, np.ones(k.size))
    shares = np.where((shares > 0) & (shares <= 1), shares, 1 / (1 + np.diag(loaded)))
    return [
        law if isinstance(law, Rigid) else SpringDashpot(law.stiffness * u, law.damping * u**2)
        for law, u in zip(laws, shares, strict=True)
    ]


def instruments(max_strings=40):
    """Strategy for random instruments; steps from far below to beyond the Nyquist rate of their modes."""
    return st.builds(
        build,
        seed=st.integers(0, 10**6),
        n_strings=st.integers(1, max_strings),
        body_dofs=st.integers(1, 8),
        complex_body=st.booleans(),
        yielding=st.booleans(),
        extra=st.integers(0, 3),
        dt=st.sampled_from([1e-5, 2e-4, 3e-3, 0.05]),
    )
