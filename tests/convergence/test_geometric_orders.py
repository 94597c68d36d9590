"""Order of a string with longitudinal motion: against an independent integration, and against 32 times the rate."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tonewood.physics.coupling.connections import Term
from tonewood.physics.coupling.potentials.longitudinal import GeometricStretch
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.modal.string_modes import string_basis
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion

Floats = NDArray[np.float64]

LENGTH, TENSION, DENSITY, AXIAL = 0.645, 104.1, 5.735e-4, 14613.0
N_ACROSS, N_LONGITUDINAL, END = 8, 3, 1.5e-3


def string(fs: float) -> System:
    """With its bridge end free: no connection stands between the modes and their forces."""

    def lossy(w: Floats, k: Floats) -> Floats:
        return np.full_like(w, 1e-3)

    across = string_basis(LENGTH, TENSION, DENSITY, 1e-4, lossy, n_modes=N_ACROSS).with_places({"pick": 0.3})
    longitudinal = string_basis(LENGTH, AXIAL, DENSITY, 0.0, lossy, n_modes=N_LONGITUDINAL)
    readouts = [Readout("across", "displacement", (Term("y", "pick"),)),
                Readout("along", "displacement", (Term("x", "bridge"),))]  # fmt: skip
    components = {"y": across, "z": across, "x": longitudinal}
    return System.build(components, [], readouts, dt=1 / fs, potentials=[GeometricStretch("s", ("y", "z"), "x", AXIAL)])


def start(system: System) -> list[Floats]:
    rng = np.random.default_rng(5)
    sizes = [c.basis.n_modes for c in system.compiled]
    return [scale * rng.normal(size=n) / (1 + np.arange(n)) for n, scale in zip(sizes, (3e-5, 2e-5, 0.0), strict=True)]


def stepped(fs: float) -> Floats:
    system = string(fs)
    state = system.start()
    for name, q in zip(system.names, start(system), strict=True):
        basis = system.compiled[system.slot(name)].basis
        system.modes_of(state, name)[:] = from_motion(basis, q, np.zeros(len(q)))
    n = round(END * fs) + 1
    out, _ = KernelStepper(system).run(state, n)
    return out[:: round(fs / 48000)]


def integrated() -> Floats:
    """The assembled system by DOP853; its strain and the forces by quadrature over the string, not by series."""
    system = string(48000.0)
    bases = [c.basis for c in system.compiled]
    x = (np.arange(96) + 0.5) * LENGTH / 96

    def slopes(basis: object, count: int) -> Floats:
        vec = np.asarray(basis.metadata["vec"])  # type: ignore[attr-defined]  # a basis, behind its protocol
        k = np.arange(1, len(vec)) * np.pi / LENGTH
        return np.asarray(-vec[0] / LENGTH + (k * np.cos(np.outer(x, k))) @ vec[1:])

    across, longitudinal = slopes(bases[0], N_ACROSS), slopes(bases[2], N_LONGITUDINAL)
    cosines = np.cos(np.outer(x, np.arange(N_LONGITUDINAL)) * np.pi / LENGTH)
    project = cosines @ np.diag(np.where(np.arange(N_LONGITUDINAL) == 0, 1.0, 2.0)) @ cosines.T / len(x)
    sizes = np.cumsum([0, *(b.n_modes for b in bases)])
    stiffness = np.concatenate([b.stiffness for b in bases])
    damping = 2 * np.concatenate([b.damping_rate for b in bases])
    dx = LENGTH / len(x)

    def rates(t: float, state: Floats) -> Floats:
        q, v = np.split(state, 2)
        y, z, u = (q[a:b] for a, b in pairwise(sizes))
        square = project @ (0.5 * (across @ y) ** 2 + 0.5 * (across @ z) ** 2)
        pull = AXIAL * (square + longitudinal @ u)
        on_y, on_z = (-across.T @ (pull * (across @ q)) * dx for q in (y, z))
        force = np.concatenate([on_y, on_z, -AXIAL * longitudinal.T @ square * dx])
        return np.concatenate([v, force - stiffness * q - damping * v])

    begin = np.concatenate(start(system))
    times = np.arange(round(END * 48000) + 1) / 48000
    found = solve_ivp(
        rates, (0, times[-1]), np.concatenate([begin, 0 * begin]), "DOP853", times, rtol=1e-11, atol=1e-16
    )
    q = found.y[: len(begin)].T
    pick = np.asarray(bases[0].shape(0.3))  # type: ignore[misc]  # made with a shape
    return np.column_stack([q[:, :N_ACROSS] @ pick, q[:, sizes[2] :] @ bases[2].right[0].real])


def test_it_tends_to_the_assembled_system_with_order_two() -> None:
    exact = integrated()
    size = np.abs(exact).max(axis=0)
    errors = np.array([np.abs(stepped(fs) - exact).max(axis=0) / size for fs in (96000, 192000, 384000)])
    orders = np.log2(errors[:-1] / errors[1:])
    assert orders.min() > 1.9
    assert errors[-1].max() < 2e-3


def test_it_tends_to_its_own_limit_with_order_two() -> None:
    reference = stepped(48000.0 * 32)
    errors = np.array([np.abs(stepped(fs) - reference).max(axis=0) for fs in (96000, 192000, 384000)])
    assert np.log2(errors[0] / errors[1]).min() > 1.8
    assert np.log2(errors[1] / errors[2]).min() > 1.8


def test_nothing_but_the_coupling_moves_it_longitudinally() -> None:
    assert np.abs(stepped(96000.0)[:, 1]).max() > 1e-9
