"""Problems A to D of Klosner & Ranlet (1978), solved three ways.

A, B: one mass on a spring carries a second one, on a linear spring or a nonlinear mounting. C, D: a simply supported
beam carries at its middle a chain of two masses, on a linear spring or a nonlinear mounting. The report gives no
values; those below are chosen, and the mountings are F = k (delta + beta delta^3) + c delta' + d delta' |delta'|.

* `assembled`: the physical system put together, by the matrix exponential or, where it is nonlinear, by a Runge-Kutta
  method of order 8 at a relative tolerance of 1e-12. It knows nothing of modes.
* `by_form`: the report's own equations of motion (`klosner_forms`), solved just as accurately.
* `by_engine`: modal components stepped by their exact propagators and joined by the project's connections.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.lab.assembled import (
    Matrices,
    continuous_force,
    driven_states,
    force_at,
    integrated,
    joined,
    state_matrix,
    triangle,
)
from tonewood.lab.beam import Beam
from tonewood.lab.component_modes import fixed_base_modes, free_free_modes
from tonewood.lab.klosner_forms import (
    MainStructure,
    fixed_base_form,
    fixed_base_nonlinear,
    free_free_form,
    free_free_nonlinear,
)
from tonewood.physics.coupling.connections import Connection, Rigid, Term
from tonewood.physics.coupling.laws import HardeningSpring
from tonewood.physics.coupling.system import Injection, Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.synthesis import real_modes
from tonewood.physics.stepping.forcing import Segment, compile_force
from tonewood.physics.stepping.stepper import NumpyStepper
from tonewood.support.arrays import Floats

FORMS = ("fixed-base", "free-free")


@dataclass(frozen=True, eq=False)
class Problem:
    """A main structure, a substructure, their connection and the forces that drive them.

    name : A, B, C or D.
    main : matrices of S, undamped.
    attachment : (n_main,) direction in which S is driven and carries the substructure.
    sub_mass, sub_stiffness : (n_dof, n_dof); dof 0 is the foot.
    mounting : law between S and the foot; None joins them rigidly.
    load : force on S, N.
    sub_direction, sub_load : force on the substructure (Appendix A).
    duration : s.
    """

    name: str
    main: Matrices
    attachment: Floats
    sub_mass: Floats
    sub_stiffness: Floats
    mounting: HardeningSpring | None
    load: tuple[Segment, ...]
    sub_direction: Floats
    sub_load: tuple[Segment, ...] = ()
    duration: float = 1.5

    @property
    def foot(self) -> NDArray[np.intp]:
        """Interface dofs of the substructure."""
        return np.array([0])

    def structure(self) -> MainStructure:
        """S in its modes."""
        shapes, omega, _, _ = real_modes(self.main.M, self.main.K)
        row = self.attachment @ shapes
        return MainStructure(omega, row[None], row)


def spring_mounting(k: float, beta: float = 0.0, c: float = 0.0, d: float = 0.0) -> HardeningSpring:
    """F = k (delta + beta delta^3) + c delta' + d delta' |delta'|."""
    return HardeningSpring(k, k * beta, c, d)


class Motion(NamedTuple):
    """At 0, dt, ...: displacement of S at the attachment (n,) and of the substructure (n, n_dof), m; F_bar (n,), N."""

    main: Floats
    sub: Floats
    force: Floats


def problem_a() -> Problem:
    """A: masses 1 and 0.3 kg on springs of 100 and 40 N/m; the foot of the second spring is massless."""
    return Problem(
        "A", Matrices(np.eye(1), np.zeros((1, 1)), np.array([[100.0]])), np.ones(1),
        np.diag([0.0, 0.3]), 40.0 * np.array([[1.0, -1.0], [-1.0, 1.0]]), None,
        triangle(8.0, 0.05, 0.13), np.zeros(2),
    )  # fmt: skip


def problem_b(law: HardeningSpring | None = None) -> Problem:
    """B: the same masses, joined by the mounting k 40 N/m, beta 300 /m^2, c 0.15 N s/m, d 0.4 N s^2/m^2."""
    return replace(
        problem_a(), name="B", sub_mass=np.array([[0.3]]), sub_stiffness=np.zeros((1, 1)),
        mounting=law or spring_mounting(40.0, 300.0, 0.15, 0.4), sub_direction=np.zeros(1),
    )  # fmt: skip


#: beam of problems C and D: 1 m, 1.2 kg/m, EI 3 N m^2
BEAM = Beam(1.0, 1.2, 3.0)
#: k (N/m) and m (kg) of their chain
K_CHAIN, M_CHAIN = 60.0, 0.05


def problem_c(elements: int = 4) -> Problem:
    """C: beam, foot, 2k, 2m, k, m; all springs linear, the foot massless."""
    beam, middle = BEAM.elements(elements)
    stiffness = K_CHAIN * np.array([[2.0, -2.0, 0.0], [-2.0, 3.0, -1.0], [0.0, -1.0, 1.0]])
    return Problem(
        "C", beam, middle, np.diag([0.0, 2.0, 1.0]) * M_CHAIN, stiffness, None,
        triangle(5.0, 0.04, 0.06), np.zeros(3), duration=0.75,
    )  # fmt: skip


def problem_d(law: HardeningSpring | None = None, elements: int = 4) -> Problem:
    """D: as C, with the mounting k 120 N/m, beta 500 /m^2, c 0.2 N s/m, d 0.5 N s^2/m^2 in place of the spring 2k."""
    stiffness = K_CHAIN * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return replace(
        problem_c(elements), name="D", sub_mass=np.diag([2.0, 1.0]) * M_CHAIN, sub_stiffness=stiffness,
        mounting=law or spring_mounting(120.0, 500.0, 0.2, 0.5), sub_direction=np.zeros(2),
    )  # fmt: skip


def problems() -> tuple[Problem, ...]:
    """Return problems A to D."""
    return problem_a(), problem_b(), problem_c(), problem_d()


def loaded(problem: Problem) -> Problem:
    """Return the problem with forces on the substructure as well: on its foot and inside it (Appendix A)."""
    n = len(problem.sub_mass)
    return replace(problem, sub_direction=np.linspace(0.6, 1.0, n), sub_load=triangle(1.5, 0.11, 0.06))


def assembled(problem: Problem, dt: float, n: int) -> Motion:
    """Motion of the physical system, put together without modes."""
    n_main, n_sub = len(problem.main.M), len(problem.sub_mass)
    sub = Matrices(problem.sub_mass, np.zeros((n_sub, n_sub)), problem.sub_stiffness)
    if problem.mounting is None:
        embed = np.zeros((n_sub, n_main + n_sub - 1))
        embed[0, :n_main] = problem.attachment
        embed[1:, n_main:] = np.eye(n_sub - 1)
    else:
        embed = np.hstack([np.zeros((n_sub, n_main)), np.eye(n_sub)])
    whole = joined([problem.main, sub], [np.eye(n_main, embed.shape[1]), embed])
    size = len(whole.M)
    to_main = np.concatenate([problem.attachment, np.zeros(size - n_main)])
    to_sub = embed.T @ problem.sub_direction
    acceleration = sla.solve(whole.M, np.stack([to_main, to_sub], axis=1))
    columns = np.vstack([np.zeros((size, 2)), acceleration])
    on_main, on_sub = _sampled(problem, dt, n)
    if problem.mounting is None:
        A = state_matrix(whole)
        x = _superposed(A, columns[:, 0], columns[:, 1:], problem, dt, n)
        rate = x @ A[size:].T + np.outer(on_main, acceleration[:, 0]) + np.outer(on_sub, acceleration[:, 1])
        d = x[:, :size] @ embed.T
        # momentum balance of the foot: M d'' + K d = F at the interface, less the external force there
        force = (rate @ embed.T @ problem.sub_mass + d @ problem.sub_stiffness)[:, 0]
        return Motion(x[:, :size] @ to_main, d, force - on_sub * problem.sub_direction[0])
    law, gap = problem.mounting, to_main - embed[0]
    per_force = sla.solve(whole.M, gap)
    stiff = sla.solve(whole.M, whole.K)

    def rate_of(t: float, x: Floats, v: Floats) -> Floats:
        forces = np.array([force_at(problem.load, t), force_at(problem.sub_load, t)])
        return np.asarray(acceleration @ forces - stiff @ x + per_force * continuous_force(law, gap @ x, gap @ v))

    x = _integrated(rate_of, size, problem, dt, n)
    force = np.array([-continuous_force(law, gap @ q, gap @ v) for q, v in zip(x[:, :size], x[:, size:], strict=True)])
    return Motion(x[:, :size] @ to_main, x[:, :size] @ embed.T, force)


def by_form(problem: Problem, form: str, dt: float, n: int) -> Motion:
    """Motion from the report's equations in the fixed-base or the free-free form."""
    main, foot = problem.structure(), problem.foot
    fixed = fixed_base_modes(problem.sub_mass, problem.sub_stiffness, [0]) if form == "fixed-base" else None
    free = free_free_modes(problem.sub_mass, problem.sub_stiffness)
    n_modes = main.omega.size
    if problem.mounting is None:
        linear = free_free_form(main, free, foot) if fixed is None else fixed_base_form(main, fixed)
        x = _superposed(linear.A, linear.on_main, linear.on_sub @ problem.sub_direction[:, None], problem, dt, n)
        on_main, on_sub = _sampled(problem, dt, n)
        f = np.outer(on_sub, problem.sub_direction)
        force = x @ linear.interaction.T + np.outer(on_main, linear.interaction_main) + f @ linear.interaction_sub.T
        sub = x @ linear.motion.T + f @ linear.motion_sub.T
        return Motion(x[:, :n_modes] @ main.interface[0], sub, force[:, 0])
    spring = problem.mounting

    def law(gap: Floats, rate: Floats) -> Floats:
        return np.array([-continuous_force(spring, float(g), float(v)) for g, v in zip(gap, rate, strict=True)])

    def loads(t: float) -> tuple[float, Floats]:
        return force_at(problem.load, t), problem.sub_direction * force_at(problem.sub_load, t)

    nonlinear = (
        free_free_nonlinear(main, free, foot, law, loads)
        if fixed is None
        else fixed_base_nonlinear(main, fixed, law, loads)
    )
    x = _integrated(nonlinear.rate, nonlinear.size, problem, dt, n)
    q, v = x[:, : nonlinear.size], x[:, nonlinear.size :]
    at_main, speed = q[:, :n_modes] @ main.interface[0], v[:, :n_modes] @ main.interface[0]
    sub = q @ nonlinear.motion.T
    foot_speed = (v @ nonlinear.motion.T)[:, 0]
    return Motion(at_main, sub, law(at_main - sub[:, 0], speed - foot_speed))


def components(problem: Problem, form: str) -> dict[str, ModalBasis]:
    """S and the substructure as modal components, with points ``seat`` and ``foot``, and one point per dof."""
    main = problem.structure()
    inside = problem.sub_direction.copy()
    if problem.mounting is None:
        inside[0] = 0.0
    points = {"foot": np.eye(len(problem.sub_mass))[0], "load": inside}
    points |= {f"dof{i}": row for i, row in enumerate(np.eye(len(problem.sub_mass)))}
    if form == "fixed-base":
        sub = fixed_base_modes(problem.sub_mass, problem.sub_stiffness, [0]).basis(points)
    else:
        sub = free_free_modes(problem.sub_mass, problem.sub_stiffness).basis(points)
    undamped = np.zeros_like(main.omega)
    return {"main": ModalBasis.real(main.omega, undamped, {"seat": main.interface[0]}), "sub": sub}


def engine_system(problem: Problem, form: str, dt: float) -> System:
    """Components, their mount and readouts of every displacement, compiled for steps of dt."""
    parts = components(problem, form)
    mount = Connection("mount", (Term("main", "seat", 1.0), Term("sub", "foot", -1.0)), problem.mounting or Rigid())
    readouts = [Readout("seat", "displacement", (Term("main", "seat"),))]
    readouts += [Readout(f"dof{i}", "displacement", (Term("sub", f"dof{i}"),)) for i in range(len(problem.sub_mass))]
    return System.build(parts, [mount], readouts, dt=dt)


def engine_injections(problem: Problem, system: System) -> list[Injection]:
    """The external forces. One on a rigidly joined foot acts on S, as in Eq. A-17."""
    main, sub = (compiled.basis for compiled in system.compiled)
    out = compile_force("main", main, "seat", problem.load, system.dt)
    out += compile_force("sub", sub, "load", problem.sub_load, system.dt)
    if problem.mounting is None:
        share = float(problem.sub_direction[0])
        out += compile_force("main", main, "seat", problem.sub_load, system.dt, factor=share)
    return out


def by_engine(problem: Problem, form: str, dt: float, n: int) -> Motion:
    """Motion of the modal components in steps of dt; the force is the mean over [t, t + dt]."""
    system = engine_system(problem, form, dt)
    out, force = NumpyStepper(system).run(system.start(), n, engine_injections(problem, system))
    if problem.mounting is None:
        # a massless foot moves with S; its own readout leaves out the motion of its residual compliance
        out[:, 1] = out[:, 0]
    return Motion(out[:, 0], out[:, 1:], -force[:, 0])


def difference(one: Motion, other: Motion, dofs: Sequence[int] | None = None) -> float:
    """Largest difference of displacements, relative to the largest displacement."""
    which = list(range(one.sub.shape[1])) if dofs is None else list(dofs)
    scale = max(float(np.abs(one.main).max()), float(np.abs(one.sub).max()))
    error = max(float(np.abs(one.main - other.main).max()), float(np.abs(one.sub - other.sub)[:, which].max(initial=0)))
    return error / scale


def _sampled(problem: Problem, dt: float, n: int) -> tuple[Floats, Floats]:
    t = np.arange(n) * dt
    return (
        np.array([force_at(problem.load, s) for s in t]),
        np.array([force_at(problem.sub_load, s) for s in t]),
    )


def _superposed(A: Floats, on_main: Floats, on_sub: Floats, problem: Problem, dt: float, n: int) -> Floats:
    rest = np.zeros(len(A))
    x = driven_states(A, on_main, problem.load, dt, n, rest)
    if problem.sub_load:
        x = x + driven_states(A, on_sub[:, 0], problem.sub_load, dt, n, rest)
    return x


def _integrated(
    rate: Callable[[float, Floats, Floats], Floats], size: int, problem: Problem, dt: float, n: int
) -> Floats:
    """(n, 2 size) from rest, with a new start at every breakpoint of the forces."""

    def first_order(t: float, y: Floats) -> Floats:
        return np.concatenate([y[size:], rate(t, y[:size], y[size:])])

    edges = [e for piece in (*problem.load, *problem.sub_load) for e in (piece.start, piece.stop)]
    return integrated(first_order, np.zeros(2 * size), np.asarray(np.arange(n) * dt, dtype=np.float64), edges)
