"""The academic system of Fabre, Le Carrou & Chomette (2024, section 3.1): chains of 4 and 5 masses, joined at m4 + m5.

A RECONSTRUCTION: the matrices (Eqs 35-37) are not in the text this was made from. Masses, springs and dashpots here
reproduce every printed digit of their Table 1 and of the third coupled mode, and say no more than that.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import scipy.linalg as sla

from tonewood.lab import assembled
from tonewood.lab.assembled import Matrices
from tonewood.lab.figures import figure
from tonewood.lab.methods import METHODS, Problem, coupled_receptance
from tonewood.lab.methods.scheme import Runner
from tonewood.lab.methods.step_map import held_position
from tonewood.lab.row import Row, misfit, nearest, pole_error
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.modal.damping import damping_groups, phase_collinearity, with_damping_case
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.synthesis import basis_from_matrices
from tonewood.physics.stepping.stepper import NumpyStepper
from tonewood.support.arrays import Floats
from tonewood.support.plotting import save

SYSTEM = "Fabre 4+5 dof (reconstruction)"
#: Hz; the paper's
FS = 4000.0
JUNCTION = Connection("junction", (Term("S1", "m4"), Term("S2", "m5", -1.0)))
MASSES = {"S1": ["m1", "m2", "m3", "m4"], "S2": ["m5", "m6", "m7", "m8", "m9"]}
#: Table 1: undamped frequency (Hz) and phase collinearity of the modes of each subsystem
TABLE_1 = {
    "S1": ((0.71, 1.00), (2.48, 0.97), (3.66, 0.85), (4.21, 0.69)),
    "S2": ((0.42, 0.98), (1.33, 0.66), (1.61, 0.42), (3.13, 1.00), (3.59, 0.99)),
}


def subsystems() -> dict[str, Matrices]:
    """Wall - m1 .. m4 and m5 .. m9 - wall (SI)."""
    return {
        "S1": assembled.chain([0.65, 0.867, 0.9, 0.9], [0.4, 0.5, 0.2, 4.0], [200.0, 102.0, 160.0, 250.0]),
        "S2": assembled.chain(
            [0.2, 1.98, 0.297, 1.28, 2.0], [0.04, 0.0, 0.0, 9.0, 0.09], [70.5, 57.0, 80.0, 42.0, 215.0], wall="right"
        ),
    }


def whole(parts: dict[str, Matrices]) -> Matrices:
    """Assemble both parts: dofs m1, m2, m3, m4 + m5, m6 .. m9."""
    eye = np.eye(8)
    return assembled.joined([parts["S1"], parts["S2"]], [eye[:4], eye[3:]])


def falsely_complex(part: Matrices) -> Matrices:
    """The second-order system of damping case 2, straight from the printed formula and the eigenvectors of `part`.

    phi = Re(psi sqrt(2j Im lambda)) with Pi = 1, then q'' + 2 sigma q' + |lambda|^2 q = phi^T f, x = phi q.
    """
    n = len(part.M)
    values, vectors = sla.eig(assembled.state_matrix(part))
    up = values.imag > 0
    poles, psi = values[up], vectors[:n, up]
    norm = np.sum(psi * (part.C @ psi), axis=0) + 2 * poles * np.sum(psi * (part.M @ psi), axis=0)
    phi = (psi / np.sqrt(norm) * np.sqrt(2j * poles.imag)).real
    back = sla.inv(phi)
    return Matrices(
        back.T @ back, back.T @ np.diag(-2 * poles.real) @ back, back.T @ np.diag(np.abs(poles) ** 2) @ back
    )


def bases(case: str = "complex") -> dict[str, ModalBasis]:
    """Modes of both subsystems at all masses under a damping case."""
    return {
        name: with_damping_case(basis_from_matrices(*part, MASSES[name]), case) for name, part in subsystems().items()
    }


def problem(case: str = "complex") -> Problem:
    """Force on m2, displacement of m9."""
    return Problem(bases(case), (JUNCTION,), (Term("S1", "m2"),), (Term("S2", "m9"),))


def free_motion(problem: Problem, method: str, fs: float, n: int) -> Floats:
    """(n, n_outputs) displacements after a unit impulse on the first input, stepped by a method."""
    runner = Runner(METHODS[method].arrays(problem, 1 / fs))
    runner.start(problem.impulse_columns[:, 0].reshape(-1, 2))
    return runner.run(n)[0][:n]


def exact_impulse_response(system: Matrices, n: int) -> Floats:
    """Return the impulse response from the matrix exponential of the assembled system."""
    v0 = sla.solve(system.M, np.eye(8)[1])
    return assembled.free_motion(system, np.zeros(8), v0, 1 / FS, n)[:, 7]


def rows() -> Iterator[Row]:
    """Table 1, coupled modes, waveform and spectrum in damping cases 1 and 2, block case."""
    parts, components = subsystems(), bases()
    for name, table in TABLE_1.items():
        mpc = phase_collinearity(components[name].right)
        for k, (freq, collinearity) in enumerate(table):
            source = "Fabre 2024, Table 1; the reconstruction was fitted to it"
            freq_computed = components[name].natural_freq[k]
            yield Row(
                SYSTEM, f"{name} mode {k + 1} frequency (Hz)", source, freq, freq_computed, 0.005, kind="regression"
            )
            quantity = f"{name} mode {k + 1} MPC"
            yield Row(SYSTEM, quantity, source, collinearity, float(mpc[k]), 0.0051, kind="regression")

    n = 8000
    systems = {"complex": whole(parts), "proportional": whole({k: falsely_complex(p) for k, p in parts.items()})}
    for number, (case, reference) in enumerate(systems.items(), start=1):
        label = f"case {number}"
        this = problem(case)
        exact = assembled.poles(reference)
        got = held_position(this, 1 / FS).poles()
        error = pole_error(got, exact)
        yield Row(
            SYSTEM, f"{label}: largest relative error of a coupled pole", "eig of assembled M, C, K", 0, error, 1e-9
        )
        third = nearest(got, exact[2])
        printed = {1: 0.0178, 2: 0.0658}[number]
        zeta, source = -third.real / abs(third), "Fabre 2024, section 3.1; the reconstruction was fitted to it"
        quantity = f"{label}: third coupled mode, zeta"
        yield Row(SYSTEM, quantity, source, printed, zeta, 5e-5, kind="regression")
        if number == 1:
            quantity, freq = "case 1: third coupled mode (Hz)", abs(third) / (2 * np.pi)
            yield Row(SYSTEM, quantity, source, 1.452, freq, 5e-4, kind="regression")
        y, expected = free_motion(this, "held_position", FS, n)[:, 0], exact_impulse_response(reference, n)
        by_expm = "expm of the assembled system"
        yield Row(SYSTEM, f"{label}: waveform of m9, largest error / peak", by_expm, 0, misfit(y, expected), 1e-9)
        if number == 1:
            stepped = _by_stepper(this, 2000)
            yield Row(
                SYSTEM, "case 1: the same by the engine's stepper, 0.5 s", by_expm, 0,
                float(np.abs(stepped - expected[:2000]).max() / np.abs(expected).max()), 1e-9,
            )  # fmt: skip
            ab3 = free_motion(this, "ab3", FS, n)[:, 0]
            yield Row(SYSTEM, "case 1: waveform of m9 by AB3 at 4 kHz", by_expm, 0, misfit(ab3, expected), 1e-5)
        grid = np.linspace(0.2, 5.0, 97)
        direct = assembled.receptance(reference, 2j * np.pi * grid, 7, 1)
        got_spectrum = held_position(this, 1 / FS).spectrum(grid, this.impulse_columns[:, 0])
        db = float(np.abs(20 * np.log10(np.abs(got_spectrum[:, 0]) / np.abs(direct))).max())
        yield Row(SYSTEM, f"{label}: spectrum of m9, .2-5 Hz, largest error (dB)", "Fabre 2024, Eq. 34", 0, db, 1e-4)

    at = np.array([1.452])
    exact_levels = [20 * np.log10(np.abs(assembled.receptance(m, 2j * np.pi * at, 7, 1)[0])) for m in systems.values()]
    levels = [20 * np.log10(np.abs(coupled_receptance(problem(c), at)[0, 0, 0])) for c in systems]
    source = "assembled M, C, K of both cases"
    yield Row(
        SYSTEM, "case 2 - case 1 at 1.452 Hz (dB)", source, exact_levels[1] - exact_levels[0], levels[1] - levels[0],
        1e-6,
    )  # fmt: skip
    groups = {name: damping_groups(basis) for name, basis in components.items()}
    # one group, all modes: the block case must give the body back
    joined = all(len(g) == 1 for g in groups.values())
    block = held_position(problem("block"), 1 / FS).poles()
    quantity = "one group per subsystem at threshold 0.2 (1 = yes)"
    yield Row(SYSTEM, quantity, "Fabre 2024, Eq. 39", 1, float(joined), 0, kind="regression")
    third = complex(assembled.poles(whole(parts))[2])
    stepped_third, expected_zeta = nearest(block, third), -third.real / abs(third)
    zeta = -stepped_third.real / abs(stepped_third)
    yield Row(SYSTEM, "block case: third coupled mode, zeta", "case 1", expected_zeta, zeta, 5e-5)


def _by_stepper(problem: Problem, n: int) -> Floats:
    """(n,) the impulse response by the stepper that renders use."""
    system = problem.system(1 / FS)
    state = system.start()
    column = problem.impulse_columns[:, 0].reshape(-1, 2)
    system.modes_of(state, "S1")[:] = column[: problem.components["S1"].n_modes].T
    system.modes_of(state, "S2")[:] = column[problem.components["S1"].n_modes :].T
    return NumpyStepper(system).run(state, n)[0][:, 0]


def plots(directory: Path) -> list[Path]:
    """Redraw Figs 3 and 4: waveform and spectrum of m9, and the complex mode shapes of both subsystems."""
    parts = subsystems()
    exact = exact_impulse_response(whole(parts), int(20 * FS))
    t = np.arange(len(exact)) / FS
    freq = np.linspace(0.2, 5.0, 1500)
    fig, (wave, spectrum_axis) = figure(2, 1)
    wave.plot(t, exact * 1e3, "k", linewidth=2.5, label="assembled system (expm)")
    spectrum_axis.plot(
        freq, 20 * np.log10(np.abs(assembled.receptance(whole(parts), 2j * np.pi * freq, 7, 1))), "k", linewidth=2.5
    )
    for number, case, style in ((1, "complex", "C0--"), (2, "proportional", "C3-")):
        wave.plot(
            t, free_motion(problem(case), "held_position", FS, len(t)) * 1e3, style, label=f"case {number}: {case}"
        )
        spectrum_axis.plot(freq, 20 * np.log10(np.abs(coupled_receptance(problem(case), freq)[:, 0, 0])), style)
    wave.set(xlabel="time (s)", ylabel="m9 (mm per N s)", title="Impulse on m2 (Fabre 2024, Fig. 3; reconstruction)")
    wave.legend()
    spectrum_axis.set(xlabel="frequency (Hz)", ylabel="m9 / force on m2 (dB re 1 m/N)")
    written = [save(fig, directory / "fabre_fig3_academic.png")]

    fig, axes = figure(2, 5, polar=True, size=(13, 5.6))
    for row, (name, basis) in zip(axes, bases().items(), strict=True):
        mpc = phase_collinearity(basis.right)
        for k, axis in enumerate(row):
            if k >= basis.n_modes:
                axis.set_axis_off()
                continue
            shape = basis.right[:, k] / basis.right[np.argmax(np.abs(basis.right[:, k])), k]
            for value in shape:
                axis.annotate(
                    "", (np.angle(value), np.abs(value)), (0, 0), arrowprops={"arrowstyle": "->", "color": "C0"}
                )
            axis.set(ylim=(0, 1), yticks=[], xticklabels=[])
            axis.set_title(f"{name}: {basis.natural_freq[k]:.2f} Hz, MPC {mpc[k]:.2f}", fontsize=9)
    fig.suptitle("Complex mode shapes of the subsystems (Fabre 2024, Fig. 4; reconstruction)")
    return [*written, save(fig, directory / "fabre_fig4_shapes.png")]
