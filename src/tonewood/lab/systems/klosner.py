"""Klosner & Ranlet (1978): component modes, interaction forces, nonlinear mountings; checked quantities and pictures.

The report prints formulas and no results. Its worked component modes are checked as printed; the motion of its problems
A to D, in both forms, against the physical systems put together without modes; the beam of problem C against the closed
form of the continuous beam.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import scipy.linalg as sla

from tonewood.lab.component_modes import FixedBaseModes, FreeFreeModes, fixed_base_modes, free_free_modes
from tonewood.lab.figures import figure
from tonewood.lab.klosner_forms import MainStructure, fixed_base_form, free_free_form
from tonewood.lab.row import Row, halving_order
from tonewood.lab.systems.klosner_modes import MOUNTINGS, WAYS, errors, modes_needed
from tonewood.lab.systems.klosner_problems import (
    BEAM,
    FORMS,
    K_CHAIN,
    M_CHAIN,
    Motion,
    Problem,
    assembled,
    by_engine,
    by_form,
    difference,
    engine_injections,
    engine_system,
    loaded,
    problem_a,
    problem_b,
    problem_c,
    problem_d,
    problems,
    spring_mounting,
)
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.stepping.stepper import NumpyStepper
from tonewood.support.arrays import Floats
from tonewood.support.plotting import save

#: s, step of the coarsest engine run and of the reference grid
DT = 1 / 400
_MODELS = {"A": "2 masses", "B": "2 masses, nonlinear mounting", "C": "beam and chain",
           "D": "beam and chain, nonlinear mounting"}  # fmt: skip


def measured_order(problem: Problem, form: str, reference: Motion, refinements: int = 2) -> tuple[float, float]:
    """Order of the engine's displacement error under halved steps, and the error at the finest of them."""
    n = len(reference.main)
    error = []
    for k in (2**i for i in range(refinements)):
        fine = by_engine(problem, form, DT / k, n * k)
        error.append(difference(reference, Motion(fine.main[::k], fine.sub[::k], fine.force[::k])))
    return halving_order(error[-2], error[-1]), error[-1]


def coupled_frequencies(form: str, n_modes: int, count: int) -> Floats:
    """Lowest natural frequencies of problem C with the continuous beam in `n_modes` sine modes, rad/s."""
    shapes = BEAM.midspan_shapes(n_modes)
    main = MainStructure(BEAM.natural_freq_rad(n_modes), shapes[None], shapes)
    sub = problem_c()
    if form == "fixed-base":
        A = fixed_base_form(main, fixed_base_modes(sub.sub_mass, sub.sub_stiffness, [0])).A
    else:
        A = free_free_form(main, free_free_modes(sub.sub_mass, sub.sub_stiffness), sub.foot).A
    n = len(A) // 2
    squared = np.sort(sla.eigvals(-A[n:, :n]).real)
    # sines of even order are at rest at the middle and stay as they were
    symmetric = BEAM.natural_freq_rad(n_modes)[1::2]
    apart = [w for w in np.sqrt(squared) if np.abs(symmetric - w).min() > 1e-9 * w]
    return np.array(apart[:count])


def exact_frequencies(count: int) -> Floats:
    """Return the frequencies where midspan receptance of the beam times dynamic stiffness of the chain is -1."""
    from scipy.optimize import brentq

    def stiffness(w: float) -> float:
        end = K_CHAIN * -(w**2) * M_CHAIN / (K_CHAIN - w**2 * M_CHAIN)
        upper = end - w**2 * 2 * M_CHAIN
        return float(2 * K_CHAIN * upper / (2 * K_CHAIN + upper))

    def balance(w: float) -> float:
        return 1 / BEAM.midspan_receptance(w) + stiffness(w)

    roots: list[float] = []
    grid = np.linspace(1.0, 2.2 * BEAM.natural_freq_rad(5)[4], 40001)
    values = np.array([balance(w) for w in grid])
    size = float(np.median(np.abs(values)))
    for a, b, left, right in zip(grid[:-1], grid[1:], values[:-1], values[1:], strict=True):
        if left * right < 0:
            root = float(brentq(balance, a, b, xtol=1e-13, rtol=1e-14))
            if abs(balance(root)) < 1e-3 * size:  # a root, not a pole
                roots.append(root)
        if len(roots) == count:
            break
    return np.array(roots)


def energy_drift(form: str, steps: int = 4000) -> float:
    """Relative change of the energy of problem B without dashpots after its load has gone, largest over the run."""
    problem = problem_b(spring_mounting(40.0, 300.0))
    system = engine_system(problem, form, 1 / 200)
    stepper, state = NumpyStepper(system), system.start()
    stepper.run(state, 60, engine_injections(problem, system))
    start, worst = stored_energy(system, state).total, 0.0
    for _ in range(steps // 200):
        stepper.run(state, 200)
        worst = max(worst, abs(stored_energy(system, state).total / start - 1))
    return worst


def rows() -> Iterator[Row]:
    """Checked quantities."""
    yield from _printed_modes()
    yield from _motions()
    yield from _beam()
    yield from _modes_needed()
    for form in FORMS:
        yield Row(
            "klosner B", f"energy drift without dashpots in 20 s, {form}", "conservation of energy",
            0.0, energy_drift(form), 1e-10,
        )  # fmt: skip


def _printed_modes() -> Iterator[Row]:
    """Component modes worked out in the report, in units of k and m and with first components 1."""
    where = "Klosner & Ranlet 1978, problem"
    c, d, a = problem_c(), problem_d(), problem_a()
    fixed = fixed_base_modes(c.sub_mass, c.sub_stiffness, [0])
    free = free_free_modes(c.sub_mass, c.sub_stiffness)
    unit = K_CHAIN / M_CHAIN

    def printed(
        kind: str, i: int, modes: FixedBaseModes | FreeFreeModes, dof: int, figures: Sequence[float]
    ) -> Iterator[Row]:
        first, other = modes.shapes[0, i], "second" if dof == 1 else "last"
        values = (modes.omega[i] ** 2 / unit, 1 / first**2 / M_CHAIN, modes.shapes[dof, i] / first)
        names = ("frequency squared / (k/m)", "modal mass / m", f"{other} over first component")
        source = f"{where} C ({'i' if dof == 1 else 'ii'})"
        for name, reference, value in zip(names, figures, values, strict=True):
            yield Row("klosner C", f"{kind} mode {i + 1}: {name}", source, reference, float(value), 1e-12)

    for i, figures in enumerate(((0.5, 6.0, 2.0), (2.0, 3.0, -1.0))):
        yield from printed("fixed-base", i, fixed, 1, figures)
    yield Row("klosner C", "constraint mode, last dof", f"{where} C (i)", 1.0, float(fixed.constraint[1, 0]), 1e-12)
    for i, figures in enumerate(((0.0, 3.0, 1.0), (1.5, 6.0, -2.0))):
        yield from printed("free-free", i, free, 2, figures)
    soft = free.shapes[0, 2]
    yield Row("klosner C", "massless mode: 1 / frequency", f"{where} C (ii)", 0.0, float(1 / free.omega[2]), 0.0)
    yield Row("klosner C", "massless mode: stiffness / k", f"{where} C (ii)", 2.0, float(soft**-2 / K_CHAIN), 1e-12)
    soft = free_free_modes(a.sub_mass, a.sub_stiffness).shapes[0, 1]
    yield Row("klosner A", "massless mode: stiffness, N/m", f"{where} A (ii)", 40.0, float(soft**-2), 1e-12)
    free = free_free_modes(d.sub_mass, d.sub_stiffness)
    square = float(free.omega[1] ** 2 / unit)
    yield Row("klosner D", "free-free mode 2: frequency squared / (k/m)", f"{where} D (ii)", 1.5, square, 1e-12)


def _motions() -> Iterator[Row]:
    """Yield rows for both forms of every problem, with forces on both structures (Appendix A)."""
    for problem in problems():
        linear = problem.mounting is None
        system = f"klosner {problem.name}"
        source = f"assembled system, {'matrix exponential' if linear else 'DOP853, rtol 1e-12'}"
        tolerance = 1e-11 if linear else 1e-9
        cases = {", loads on both": loaded(problem)}
        if linear:
            cases = {", load on S": problem} | cases
        for case, with_load in cases.items():
            n = round(with_load.duration / DT)
            reference = assembled(with_load, DT, n)
            size = float(np.abs(reference.force).max())
            for form in FORMS:
                motion = by_form(with_load, form, DT, n)
                name = f"{form} equations{case}: largest relative difference of"
                yield Row(system, f"{name} displacements", source, 0.0, difference(reference, motion), tolerance)
                force = float(np.abs(motion.force - reference.force).max()) / size
                yield Row(system, f"{name} interaction force", source, 0.0, force, tolerance)
        for form in FORMS:
            order, error = measured_order(with_load, form, reference)
            yield Row(system, f"{form} components{case}: order of the error in the step", source, 2.0, order, 0.03)
            name = f"{form} components{case}, 800 Hz: largest relative difference of displacements"
            yield Row(system, name, source, 0.0, error, 5e-4)


def _beam() -> Iterator[Row]:
    exact = exact_frequencies(4)
    for form in FORMS:
        for i, (reference, value) in enumerate(zip(exact, coupled_frequencies(form, 80, 4), strict=True)):
            yield Row(
                "klosner C", f"coupled frequency {i + 1}, 80 beam modes, {form}, rad/s",
                "closed form of beam and chain", float(reference), float(value), 2e-5, relative=True,
            )  # fmt: skip


def _modes_needed() -> Iterator[Row]:
    """The report's remark on stiff mountings, and its counterpart, at 1 % of the mounting's force."""
    need = {(n.mounting, n.way): n.modes for n in modes_needed((1e-2,))}
    for mounting, fewer, more in (
        ("stiff", "fixed-base", "free-free"),
        ("as a link", "fixed-base", "free-free"),
        ("soft", "free-free", "fixed-base"),
    ):
        a, b = need[mounting, fewer], need[mounting, more]
        yield Row(
            "klosner modes", f"{mounting} mounting, 1 %: modes that {fewer} ({a}) needs beyond {more} ({b})",
            "Klosner & Ranlet 1978, p. 10", 0.0, float(max(0, a - b)), 0.0,
        )  # fmt: skip


def plots(directory: Path) -> list[Path]:
    """Motion of the four problems in both forms, and the error against the number of modes."""
    fig, axes = figure(4, 2, size=(11, 11), sharex="row")
    for (left, right), problem in zip(axes, problems(), strict=True):
        n = round(problem.duration / DT)
        t = np.arange(n) * DT
        reference = assembled(problem, DT, n)
        left.plot(t, 1e3 * reference.main, "k", lw=2.5, alpha=0.3, label="S, assembled")
        left.plot(t, 1e3 * reference.sub[:, -1], "b", lw=2.5, alpha=0.3, label="last mass, assembled")
        right.plot(t, reference.force, "k", lw=2.5, alpha=0.3, label="assembled")
        for form, style, every in zip(FORMS, ("-", "o"), (1, 12), strict=True):
            motion = by_engine(problem, form, DT, n)
            look = {"lw": 1, "ms": 3, "mfc": "none", "markevery": every}
            left.plot(t, 1e3 * motion.main, "k" + style, label=f"S, {form}", **look)
            left.plot(t, 1e3 * motion.sub[:, -1], "b" + style, label=f"last mass, {form}", **look)
            right.plot(t + DT / 2, motion.force, "r" + style, label=form, **look)
        left.set(ylabel="displacement, mm", title=f"Problem {problem.name}: {_MODELS[problem.name]}")
        right.set(ylabel="interaction force, N")
    axes[0, 0].legend(fontsize=7, loc="upper left", bbox_to_anchor=(0.0, -0.12), ncols=3)
    axes[0, 1].legend(fontsize=7, loc="upper left", bbox_to_anchor=(0.0, -0.12), ncols=3)
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    return [save(fig, directory / "klosner_problems.png"), _plot_modes(directory)]


def _plot_modes(directory: Path) -> Path:
    fig, axes = figure(1, 3, size=(12, 3.8), sharey=True)
    for axis, mounting in zip(axes, MOUNTINGS, strict=True):
        for way, marker in zip(WAYS, "os^", strict=True):
            error = errors(mounting, way)[:, 1]
            axis.semilogy(np.arange(1, error.size + 1), error, marker, ls="-", ms=3, label=way)
        axis.set(
            title=f"mounting {mounting}" if mounting == "as a link" else f"{mounting} mounting",
            xlabel="modes of the chain",
            ylim=(1e-8, 10),
        )
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("error of the mounting's force")
    axes[0].legend(fontsize=8)
    return save(fig, directory / "klosner_modes.png")
