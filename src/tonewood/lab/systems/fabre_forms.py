"""The formulations of Fabre, Le Carrou & Chomette (2024, section 2) against each other and against assembled systems.

Complex modes with left and right shapes, the compact form of structures, real modes; vibro-acoustic parts given as
velocity potentials, as pressures, or as measured shapes; redundant constraints, and constraints that are not ideal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import scipy.linalg as sla

from tonewood.lab import assembled
from tonewood.lab.assembled import Matrices
from tonewood.lab.methods import Problem, StepMap, exact, forms, system_map
from tonewood.lab.methods.step_map import held_position
from tonewood.lab.row import Row, halving_order, misfit, pole_error
from tonewood.lab.systems.fabre_academic import FS, JUNCTION, MASSES, bases, problem, subsystems, whole
from tonewood.lab.systems.fabre_guitar import BODY
from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.modal.damping import hermitian_mass_inverse
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.synthesis import basis_from_matrices

SYSTEM = "Fabre forms"
_BY_EIG = "eig of assembled M, C, K"
_BY_EXPM = "expm of the assembled system"


def rows() -> Iterator[Row]:
    """Everything of the module."""
    yield from _structural()
    yield from _vibro_acoustic()
    yield from _redundant()
    yield from _not_ideal()
    yield from _every_kind()


def proportional_problem() -> tuple[Problem, Matrices]:
    """The academic system with damping C = 0.1 M + 0.01 K in its place: real modes exist."""
    parts = {name: Matrices(p.M, 0.1 * p.M + 0.01 * p.K, p.K) for name, p in subsystems().items()}
    components = {name: basis_from_matrices(*part, MASSES[name]) for name, part in parts.items()}
    return Problem(components, (JUNCTION,), (Term("S1", "m2"),), (Term("S2", "m9"),)), whole(parts)


def _structural() -> Iterator[Row]:
    academic, system = problem(), whole(subsystems())
    n, dt = 4000, 1 / 400
    expected = assembled.free_motion(system, np.zeros(8), np.eye(8)[1] / system.M[1, 1], dt, n)[:, 7]
    motions = {}
    cases: tuple[tuple[str, str, Callable[[Problem], forms.Ode], Problem, Matrices], ...] = (
        ("complex modes, general form", "Eqs 24-27", forms.general, academic, system),
        ("complex modes, compact form", "Eqs 28-32, A.4", forms.compact, academic, system),
        ("real modes", "Eqs 11-12", forms.real, *proportional_problem()),
        ("complex form of real modes", "Eqs 24-27", forms.general, *proportional_problem()),
    )
    for name, equations, form, this, reference in cases:
        ode = form(this)
        poles = np.asarray(sla.eigvals(ode.F), dtype=np.complex128)
        error = pole_error(poles, assembled.poles(reference))
        yield Row(SYSTEM, f"{name} ({equations}): largest relative pole error", _BY_EIG, 0, error, 1e-11)
        motions[name] = exact(ode, dt).run(np.zeros((n, 1)), this.impulse_columns[:, 0])[:, 0]
        if reference is system:
            error = misfit(motions[name], expected)
            yield Row(SYSTEM, f"{name}: waveform, largest error / peak", _BY_EXPM, 0, error, 1e-9)
    for one, other in (
        ("complex modes, general form", "complex modes, compact form"),
        ("real modes", "complex form of real modes"),
    ):
        error = float(np.abs(motions[one] - motions[other]).max() / np.abs(motions[one]).max())
        yield Row(SYSTEM, f"{one} against {other}: waveform", "each other", 0, error, 1e-9)

    parts = subsystems()
    apart = Matrices(*(sla.block_diag(a, b) for a, b in zip(parts["S1"], parts["S2"], strict=True)))
    gap = np.eye(9)[[3]] - np.eye(9)[[4]]
    ode = forms.physical(apart, gap, np.eye(9)[[1]], np.eye(9)[[8]])
    error = pole_error(np.asarray(sla.eigvals(ode.F), dtype=np.complex128), assembled.poles(system))
    yield Row(SYSTEM, "physical matrices (Eqs 1-7): largest relative pole error", _BY_EIG, 0, error, 1e-11)
    b = 0.7  # m/s^2, an acceleration of the gap asked for by the constraint
    at_joint = Problem(academic.components, (JUNCTION,), academic.inputs, JUNCTION.terms)
    for name, form in (("general", forms.general), ("compact", forms.compact)):
        ode = form(at_joint)
        rate = ode.F @ np.ones(len(ode.F)) + ode.H[:, 0] * b
        poles = np.concatenate([*(c.poles for c in academic.components.values())] * 2)
        poles[len(poles) // 2 :] = poles[len(poles) // 2 :].conj()
        acceleration = float((ode.C.sum(axis=0) * poles @ rate).real)
        yield Row(
            SYSTEM, f"{name} form: acceleration of a driven gap (m/s^2)", "A y'' = b (Eq. 3)", b, acceleration, 1e-9
        )

    basis, part = academic.components["S2"], subsystems()["S2"]
    inverse = sla.inv(part.M)
    from_modes = 2 * ((basis.right * basis.poles) @ basis.left.T).real
    error = misfit(from_modes, inverse)
    yield Row(SYSTEM, "M^-1 = psi_r Pi^-1 L psi_l^T (Eq. 21)", "physical mass matrix of S2", 0, error, 1e-11)
    norm = basis.right[0] / basis.left[0]
    hermitian = basis.right @ hermitian_mass_inverse(basis.right, basis.poles, norm) @ basis.right.conj().T
    error = misfit(hermitian, inverse)
    yield Row(SYSTEM, "M^-1 = psi M_h^-1 psi^H (Eq. 28)", "physical mass matrix of S2", 0, error, 1e-10)


def _vibro_acoustic() -> Iterator[Row]:
    """The guitar body of Eq. 38 with a chain hung on its plate: air, plate and two masses."""
    chain = assembled.chain([0.02, 0.01], [0.3, 0.1], [6000.0, 3000.0], wall="right")
    # dofs: plate with the first mass of the chain, air, second mass
    eye = np.eye(3)
    system = assembled.joined([BODY, chain], [eye[[0, 1]], eye[[0, 2]]])
    mass = basis_from_matrices(*chain, ["0", "1"])
    L = BODY.C[1, 0]
    pressure_form = Matrices(
        np.array([[BODY.M[0, 0], 0.0], [L, BODY.M[1, 1]]]),
        np.diag(np.diag(BODY.C)),
        np.array([[BODY.K[0, 0], -L], [0.0, BODY.K[1, 1]]]),
    )
    exact_poles = assembled.poles(system)
    bodies = {
        "velocity potentials (Eq. 10)": basis_from_matrices(*BODY, ["plate", "air"], acoustic_dofs=[1]),
        "pressures (Eq. 8)": basis_from_matrices(*pressure_form, ["plate", "air"], acoustic_dofs=[1]),
        "measured shapes (Eq. 17)": measured_body(pressure_form),
    }
    join = Connection("foot", (Term("body", "plate"), Term("chain", "0", -1.0)))
    freq = np.array([60.0, 90.0, 130.0, 160.0, 240.0])
    for name, body in bodies.items():
        this = Problem({"body": body, "chain": mass}, (join,), (Term("chain", "1"),), (Term("body", "plate"),))
        poles = np.asarray(sla.eigvals(forms.general(this).F), dtype=np.complex128)
        yield Row(
            SYSTEM, f"body given by {name}: coupled poles, general form", _BY_EIG, 0, pole_error(poles, exact_poles),
            1e-10,
        )  # fmt: skip
        direct = assembled.receptance(BODY, 2j * np.pi * freq, 1, 0)
        error = float(np.abs(body.frf(freq, "air", "plate", "receptance") / direct - 1).max())
        yield Row(
            SYSTEM, f"body given by {name}: air over force on plate", "direct solution of Eq. 10", 0, error, 1e-10
        )
    psi = bodies["velocity potentials (Eq. 10)"]
    ratio = psi.left[1] / psi.left[0] / (psi.right[1] / psi.right[0])
    error = float(np.abs(ratio + 1).max())
    yield Row(SYSTEM, "left shape of the air over right one, + 1 (Eq. 16)", "Fabre 2024, Eq. 16", 0, error, 1e-11)


def measured_body(pressure_form: Matrices) -> ModalBasis:
    """Modes as a measurement gives them: poles, displacement and *pressure* shapes, the norm Pi of Eq. 20.

    Found from the first-order form of Eq. 8 alone; the rows of the pressure are turned by Eq. 17 in `ModalBasis`.
    """
    values, vectors = sla.eig(assembled.state_matrix(pressure_form))
    up = values.imag > 0
    poles, shapes = values[up], vectors[:2, up]
    # Pi = psi_l^T C psi_r + 2 lambda psi_l^T M psi_r with the matrices of Eq. 10
    right = shapes / np.stack([np.ones(2), poles])
    left = right * np.array([[1.0], [-1.0]])
    L = pressure_form.M[1, 0]
    C = np.array([[pressure_form.C[0, 0], -L], [L, pressure_form.C[1, 1]]])
    M = np.diag(np.diag(pressure_form.M))
    norm = np.sum(left * (C @ right), axis=0) + 2 * poles * np.sum(left * (M @ right), axis=0)
    return ModalBasis.complex(
        poles, {"plate": shapes[0], "air": shapes[1]}, norm=norm, acoustic=("air",), shapes_of="pressure"
    )


def _redundant() -> Iterator[Row]:
    """Constraints stated more than once: the pseudo-inverse, and the same motion."""
    twice = Connection("again, thrice as much", tuple(Term(t.component, t.point, 3 * t.factor) for t in JUNCTION.terms))
    academic, system = problem(), whole(subsystems())
    doubled = Problem(academic.components, (JUNCTION, twice), academic.inputs, academic.outputs)
    poles = np.asarray(sla.eigvals(forms.general(doubled).F), dtype=np.complex128)
    error = pole_error(poles, assembled.poles(system))
    yield Row(SYSTEM, "redundant constraint: poles, general form", _BY_EIG, 0, error, 1e-11)
    poles = held_position(doubled, 1 / FS).poles()
    yield Row(
        SYSTEM, "redundant constraint: poles at 4 kHz", _BY_EIG, 0, pole_error(poles, assembled.poles(system)), 1e-9
    )

    # three chains in one knot, tied in a ring: any one tie follows from the other two
    chains = [
        assembled.chain([1.0, 0.5], [0.1, 0.4], [400.0, 300.0]),
        assembled.chain([0.7, 0.3], [0.2, 0.1], [500.0, 200.0]),
        assembled.chain([0.4, 0.6], [0.3, 0.2], [300.0, 100.0]),
    ]
    eye = np.eye(4)
    system = assembled.joined(chains, [eye[[k, 3]] for k in range(3)])
    components = {f"{k}": basis_from_matrices(*chain, ["root", "tip"]) for k, chain in enumerate(chains)}
    ring = tuple(
        Connection(f"tie {a}{b}", (Term(a, "tip"), Term(b, "tip", -1.0)))
        for a, b in (("0", "1"), ("1", "2"), ("2", "0"))
    )
    this = Problem(components, ring)
    poles = held_position(this, 1 / FS).poles()
    error = pole_error(poles, assembled.poles(system))
    yield Row(SYSTEM, "three chains tied in a ring: poles at 4 kHz", _BY_EIG, 0, error, 1e-9)


def _not_ideal() -> Iterator[Row]:
    """A junction that gives: spring, dashpot, both, and a mass between the parts."""
    parts, components = subsystems(), bases()
    laws = {
        "spring": SpringDashpot(stiffness=150.0),
        "dashpot": SpringDashpot(damping=3.0),
        "spring and dashpot": SpringDashpot(stiffness=150.0, damping=3.0),
    }
    eye = np.eye(9)
    for name, law in laws.items():
        gap = eye[3] - eye[4]
        apart = assembled.joined([parts["S1"], parts["S2"]], [eye[:4], eye[4:]])
        system = Matrices(
            apart.M, apart.C + law.damping * np.outer(gap, gap), apart.K + law.stiffness * np.outer(gap, gap)
        )
        errors = []
        for fs in (FS / 2, FS):
            step = _system_map(components, (Connection("junction", JUNCTION.terms, law),), fs)
            errors.append(pole_error(step.poles(), assembled.poles(system)))
        yield Row(SYSTEM, f"{name} in the junction: poles at 4 kHz", _BY_EIG, 0, errors[1], 1e-5)
        order = halving_order(errors[0], errors[1])
        yield Row(SYSTEM, f"{name} in the junction: order of the error", "2, the law at midpoint", 2, order, 0.1)
    # inertia: a free mass is a component with a rigid-body mode, tied to both sides
    mass = ModalBasis.real([0.0], [0.0], {"mass": [1.0]}, modal_mass=0.8)
    ties = (
        Connection("left", (Term("S1", "m4"), Term("mass", "mass", -1.0))),
        Connection("right", (Term("S2", "m5"), Term("mass", "mass", -1.0))),
    )
    system = whole(parts)
    system.M[3, 3] += 0.8
    step = _system_map({**components, "mass": mass}, ties, FS)
    error = pole_error(step.poles(), assembled.poles(system))
    yield Row(SYSTEM, "inertia in the junction (a free mass): poles at 4 kHz", _BY_EIG, 0, error, 1e-9)


def _every_kind() -> Iterator[Row]:
    """Modes that complex modal analysis leaves out, on the end of S1: all go through the one path."""
    S1 = subsystems()["S1"]
    one, two = np.eye(1), np.eye(2)
    stiffness = 60.0
    added = {
        "critically damped oscillator": Matrices(one, 2 * np.sqrt(stiffness) * one, stiffness * one),
        "over-damped oscillator": Matrices(one, 50.0 * one, stiffness * one),
        "two oscillators of one pole": Matrices(two, 0.4 * two, stiffness * two),
        "free mass": Matrices(one, 0 * one, 0 * one),
        "free mass on a dashpot": Matrices(one, 2.0 * one, 0 * one),
        "two masses adrift on one spring": assembled.joined(
            [Matrices(two, 0 * two, 0 * two), Matrices(0 * one, 0.3 * one, 40.0 * one)], [two, np.array([[1.0, -1.0]])]
        ),
    }
    n, dt = 8000, 1 / FS
    for name, part in added.items():
        size = len(part.M)
        # the part's first dof sits on m4; a second one, where there is one, goes on m4 too if it is its twin
        twin = name.startswith("two oscillators")
        eye = np.eye(4 + (0 if twin else size - 1))
        where = eye[[3] * size] if twin else eye[[3, *range(4, 3 + size)]]
        system = assembled.joined([S1, part], [eye[:4], where])
        basis = basis_from_matrices(*part, [str(i) for i in range(size)])
        ties = tuple(
            Connection(f"tie {i}", (Term("S1", "m4"), Term("part", str(i), -1.0))) for i in range(size if twin else 1)
        )
        joined = Problem(
            {"S1": bases()["S1"], "part": basis}, ties, (Term("S1", "m2"),), (Term("part", str(size - 1)),)
        )
        start = joined.impulse_columns[:, 0]
        y = held_position(joined, dt).run(np.zeros((n, 1)), start)[:, 0]
        v0 = sla.solve(system.M, np.eye(len(system.M))[1])
        expected = assembled.free_motion(system, 0 * v0, v0, dt, n)[:, len(system.M) - 1]
        error = misfit(y, expected)
        yield Row(SYSTEM, f"{name} on m4: waveform, largest error / peak", _BY_EXPM, 0, error, 1e-8)


def _system_map(components: dict[str, ModalBasis], connections: tuple[Connection, ...], fs: float) -> StepMap:
    readout = Readout("m9", "displacement", (Term("S2", "m9"),))
    return system_map(System.build(components, connections, [readout], dt=1 / fs))
