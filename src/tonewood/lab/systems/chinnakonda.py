"""Chinnakonda (2007): interpolatory updates of complex modes; checked quantities.

The thesis prints curves and few numbers. Checked here: those numbers, tables computed once from its stated system, the
order every update states, closed forms, and matrix exponentials of the assembled systems. Where the thesis says
something else, the row's source says so.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import scipy.linalg as sla

from tonewood.lab.assembled import Matrices, free_motion
from tonewood.lab.estimates import sine_error
from tonewood.lab.interpolatory import P0, P1, P2, SIMPSON, TRAPEZOIDAL, UPDATES, Update, respond
from tonewood.lab.newmark import AVERAGE_ACCELERATION, HHT, Newmark
from tonewood.lab.nonproportionality import commutator, coupling, imaginary_part, modal_damping, reduced
from tonewood.lab.pseudo_load import PseudoLoad
from tonewood.lab.row import Row, halving_order
from tonewood.lab.systems.chinnakonda_plots import plots as draw
from tonewood.lab.systems.chinnakonda_problems import (
    AMPLITUDES,
    DRIVE_FREQ,
    DURATION,
    FORCES,
    HEAVY,
    LIGHT,
    OMEGA,
    STIFF_DAMPING,
    STIFF_START,
    basis_of,
    damped_chain,
    driven_error,
    every_kind_of_mode,
    exact_driven,
    ramp_difference,
    relative_errors,
    sampled_forces,
    stiff_system,
    two_masses,
    two_step,
)
from tonewood.lab.transition import Transition
from tonewood.physics.modal.synthesis import basis_from_matrices, initial_state

#: largest relative error of mass 1 over 10 s with 20, 40, 80, 160 steps per period, light damping: the thesis' system
#: (its Fig. 3.8a shows them as points), computed independently, to the digits given
ERROR_TABLE = {
    "P0": (P0, ("0.1641", "0.0823", "0.0412", "0.0206")),
    "P1": (P1, ("8.196e-3", "2.054e-3", "5.139e-4", "1.285e-4")),
    "P2": (P2, ("1.837e-4", "1.160e-5", "7.268e-7", "4.546e-8")),
}
RESOLUTIONS = (20, 40, 80, 160)


def measured_order(update: Update, c: float) -> float:
    """Slope of the error of mass 1 between two resolutions at which it is small, but clear of rounding."""
    steps = (80, 160) if update.order < 4 else (60, 120)
    if update.within:
        # nodes inside the steps: as many nodes, fewer steps
        steps = (steps[0] // update.degree, steps[1] // update.degree)
    coarse, fine = relative_errors(update, c, steps)
    return halving_order(coarse, fine)


def reduction_table() -> dict[int, dict[str, float]]:
    """Non-proportionality of a chain with one dashpot, reduced to 1, 2, ... real modes.

    Returns n_modes -> index name -> value; of `nonproportionality.imaginary_part` the largest over the modes.
    """
    whole = damped_chain()
    out = {}
    for n in range(1, len(whole.M) + 1):
        small = reduced(whole, n)
        basis = basis_from_matrices(*small, [str(k) for k in range(n)])
        out[n] = {
            "coupling": coupling(small),
            "commutator": commutator(small),
            "imaginary part": float(imaginary_part(basis).max()),
        }
    return out


def rows() -> Iterator[Row]:
    """Checked quantities."""
    yield from _two_masses()
    yield from _orders()
    yield from _initial_conditions()
    yield from _every_kind()
    yield from _stiff()
    yield from _alternatives()
    yield from _estimates()
    yield from _indices()


def plots(directory: Path) -> list[Path]:
    """Figs. 3.2 to 3.10 redrawn, and the indices under reduction."""
    return draw(directory, reduction_table())


def _two_masses() -> Iterator[Row]:
    system = two_masses(LIGHT)
    freq = np.sqrt(sla.eigh(system.K, system.M, eigvals_only=True)) / (2 * np.pi)
    yield Row(
        "chinnakonda two masses", "undamped frequency 1, Hz", "Chinnakonda 2007, p. 20", 1.0, float(freq[0]), 1e-12
    )
    yield Row(
        "chinnakonda two masses", "undamped frequency 2, Hz", "Chinnakonda 2007, p. 20",
        float(np.sqrt(3)), float(freq[1]), 1e-12,
    )  # fmt: skip
    for name, c, printed in (("light", LIGHT, (0.01, 0.0289)), ("very heavy", HEAVY, (0.5, 1.4434))):
        ratio = np.diag(modal_damping(two_masses(c))) / (4 * np.pi * freq)
        for k in range(2):
            yield Row(
                "chinnakonda two masses", f"{name} damping, modal damping ratio {k + 1}", "Chinnakonda 2007, p. 20",
                printed[k], float(ratio[k]), 5e-5,
            )  # fmt: skip
    for name, (update, table) in ERROR_TABLE.items():
        for steps, printed_error, value in zip(RESOLUTIONS, table, relative_errors(update, LIGHT), strict=True):
            mantissa, _, exponent = printed_error.partition("e")
            half = 0.5 * 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
            yield Row(
                "chinnakonda two masses", f"{name}, light damping, {steps} steps per period: largest relative error",
                "exact solution, Fig. 3.8a", float(printed_error), float(value), 1.01 * half,
            )  # fmt: skip


def _orders() -> Iterator[Row]:
    thesis = {("P2", HEAVY): "; the thesis reads 3 for P2 and very heavy damping (p. 27)"}
    for name, c in (("light", LIGHT), ("very heavy", HEAVY)):
        for update in UPDATES:
            source = "stated order" + thesis.get((update.name, c), "")
            value, order = measured_order(update, c), float(update.order)
            allowed = 0.05 if order <= 4 else 0.25
            yield Row("chinnakonda order", f"{update.name}, {name} damping", source, order, value, allowed)


def _initial_conditions() -> Iterator[Row]:
    """Fig. 3.9: u = (1, -1) without load is exact with every update."""
    dt, n = 1 / 30, 301
    start = np.array([1.0, -1.0])
    for name, c in (("light", LIGHT), ("very heavy", HEAVY)):
        system = two_masses(c)
        basis = basis_of(system)
        exact = free_motion(system, start, [0.0, 0.0], dt, n)[:, :2]
        state = initial_state(basis, system.M, system.C, start, [0.0, 0.0])
        worst = 0.0
        for update in UPDATES:
            displacement = respond(update, basis, {}, np.arange(n) * dt, state).displacement
            worst = max(worst, float(np.abs(displacement - exact[:: update.span][: len(displacement)]).max()))
        yield Row(
            "chinnakonda two masses", f"free motion from u = (1, -1), {name} damping: largest error of any update, m",
            "matrix exponential, Fig. 3.9", 0.0, worst, 1e-11,
        )  # fmt: skip


def _every_kind() -> Iterator[Row]:
    for name, system in every_kind_of_mode().items():
        for update in (P1, P2):
            yield Row(
                "chinnakonda modes", f"{update.name} under a broken line of force, {name}: largest relative error",
                "matrix exponential", 0.0, ramp_difference(system, update), 1e-11,
            )  # fmt: skip


def _stiff() -> Iterator[Row]:
    for proportional, c in STIFF_DAMPING.items():
        kind = "proportional" if proportional else "non-proportional"
        system = stiff_system(c, proportional=proportional)
        omega = np.sqrt(sla.eigh(system.K, system.M, eigvals_only=True))
        ratio = np.diag(modal_damping(system)) / (2 * omega)
        where = "Chinnakonda 2007, p. 30"
        yield Row(
            "chinnakonda stiff", f"{kind}: damping ratio 1", where, 0.1 if proportional else 0.2, float(ratio[0]), 5e-4
        )
        yield Row(
            "chinnakonda stiff", f"{kind}: damping ratio 2 beyond 0.4 %", where, 0.0, max(0.0, ratio[1] - 0.004), 1e-6
        )
        period = 2 * np.pi / omega[0]
        t = np.arange(101) * period / 20
        displacement = two_step(system, 1, t, STIFF_START).displacement
        shape = sla.eigh(system.K, system.M)[1][:, 0]
        zeta, wd = ratio[0], omega[0] * np.sqrt(1 - ratio[0] ** 2)
        decay = np.exp(-zeta * omega[0] * t) * (np.cos(wd * t) + zeta * omega[0] / wd * np.sin(wd * t))
        closed = np.outer(decay, shape) * (shape @ system.M @ STIFF_START)
        yield Row(
            "chinnakonda stiff", f"{kind}: P1 reduced to one mode, largest error, m", "closed form of one damped mode",
            0.0, float(np.abs(displacement - closed).max()), 1e-11,
        )  # fmt: skip
        exact = free_motion(system, STIFF_START, [0.0, 0.0], period / 20, 101)[:, :2]
        direct, _ = HHT.run(system, period / 20, 101, (STIFF_START, np.zeros(2)))
        error = np.abs(displacement - exact).max(axis=0)[1], np.abs(direct - exact).max(axis=0)[1]
        yield Row(
            "chinnakonda stiff", f"{kind}: largest error of mass 2, P1 reduced over HHT-alpha", "matrix exponential, "
            "Fig. 3.10: the reduction is the more accurate", 0.0, float(error[0] / error[1]), 0.1,
        )  # fmt: skip
    one = Matrices(np.eye(1), np.zeros((1, 1)), np.array([[1.0]]))
    radius = float(np.abs(sla.eigvals(HHT.step_matrix(one, 1e8)[0])).max())
    yield Row("chinnakonda stiff", "HHT-alpha (-0.3): spectral radius at infinite frequency",
              "(1 + alpha)/(1 - alpha)", 0.7 / 1.3, radius, 1e-7)  # fmt: skip
    # the eigenvalues are exp(+-i angle) and a zero, whose angle is not defined
    turning = sla.eigvals(AVERAGE_ACCELERATION.step_matrix(one, 0.7)[0])
    turn = float(np.abs(np.angle(turning[np.abs(turning) > 0.5])).max())
    yield Row("chinnakonda stiff", "average acceleration: angle per step at omega h = 0.7", "2 atan(omega h / 2)",
              float(2 * np.arctan(0.35)), turn, 1e-12)  # fmt: skip
    for method in (HHT, AVERAGE_ACCELERATION):
        yield Row(
            "chinnakonda order", f"{method.name}, light damping", "stated order", 2.0, _newmark_order(method), 0.05
        )


def _newmark_order(method: Newmark) -> float:
    error = []
    for steps in (100, 200):
        dt = 1 / DRIVE_FREQ / steps
        n = round(DURATION / dt) + 1
        system = two_masses(LIGHT)
        rest = (np.zeros(2), np.zeros(2))
        motion, _ = method.run(system, dt, n, rest, lambda t: sampled_forces(t)[0])
        error.append(np.abs(motion - exact_driven(system, dt, n)).max())
    return halving_order(error[0], error[1])


def _alternatives() -> Iterator[Row]:
    """One shot and Picard's iteration on the pseudo-load; the matrix-exponential transition."""
    for name, c in (("light", LIGHT), ("very heavy", HEAVY)):
        system = two_masses(c)
        split = PseudoLoad.of(system)
        errors = []
        for steps in (40, 80):
            dt = 1 / DRIVE_FREQ / steps
            n = round(DURATION / dt) + 1
            forces = sampled_forces(np.arange(n) * dt)
            once = split.one_shot(forces, dt)
            # P1 is exact for the same broken line, so the rest is the pseudo-load's own error
            displacement = respond(P1, basis_of(system), FORCES, np.arange(n) * dt).displacement
            errors.append(float(np.abs(once - displacement).max()))
            if steps == 40:
                again, _ = split.picard(forces, dt, window=10)
                yield Row(
                    "chinnakonda pseudo-load", f"{name} damping: Picard's iteration against one shot, largest "
                    "difference, m", "fixed point of the iteration", 0.0, float(np.abs(again - once).max()), 1e-12,
                )  # fmt: skip
        yield Row(
            "chinnakonda pseudo-load", f"one shot, {name} damping: order of its own error", "stated order", 2.0,
            halving_order(errors[0], errors[1]), 0.05,
        )  # fmt: skip
        for update in (P0, P1, P2):
            dt, n = 1 / 30, 301
            dense = Transition.of(system, update, dt).run(sampled_forces, n)[:, :2]
            modal = respond(update, basis_of(system), FORCES, np.arange(n) * dt).displacement
            yield Row(
                "chinnakonda transition", f"{update.name}, {name} damping: modal update against matrix exponential, "
                "largest difference, m", "scipy.linalg.expm", 0.0, float(np.abs(dense - modal).max()), 1e-12,
            )  # fmt: skip


def _estimates() -> Iterator[Row]:
    for name, c in (("light", LIGHT), ("medium", np.pi), ("very heavy", HEAVY)):
        for update in (P1, P2):
            times, error, _ = driven_error(update, c, 40)
            estimate = sine_error(
                update, basis_of(two_masses(c)), AMPLITUDES, OMEGA, 1 / DRIVE_FREQ / 40, len(times), "mass 1"
            )
            yield Row(
                "chinnakonda estimates", f"{update.name}, {name} damping, 40 steps per period: largest error, m",
                "measured against the matrix exponential", float(np.abs(error[:, 0]).max()),
                float(np.abs(estimate).max()), 3e-3, relative=True,
            )  # fmt: skip
            off = float(np.abs(estimate - error[:, 0]).max() / np.abs(error[:, 0]).max())
            yield Row(
                "chinnakonda estimates", f"{update.name}, {name} damping, 40 steps per period: misfit of the estimated "
                "error's whole course", "measured against the matrix exponential", 0.0, off, 3e-3,
            )  # fmt: skip


def _indices() -> Iterator[Row]:
    system = two_masses(HEAVY)
    yield Row("chinnakonda indices", "two masses: coupling", "C* = c/2 [[1, 1], [1, 5]]: 1/sqrt(14)",
              float(1 / np.sqrt(14)), coupling(system), 1e-12)  # fmt: skip
    yield Row("chinnakonda indices", "two masses: commutator", "closed form: 1/sqrt(140)",
              float(1 / np.sqrt(140)), commutator(system), 1e-12)  # fmt: skip
    table = reduction_table()
    whole = damped_chain()
    for n in (1, len(whole.M)):
        expected = coupling(whole) if n > 1 else 0.0
        yield Row(
            "chinnakonda indices", f"chain reduced to {n} real modes: coupling",
            "one mode is proportional, all are the system itself", expected, table[n]["coupling"], 1e-12,
        )  # fmt: skip
    yield Row(
        "chinnakonda indices", "chain: coupling of the dashpot's rank-one C*", "closed form from the mode shapes",
        _rank_one_coupling(whole), coupling(whole), 1e-12,
    )  # fmt: skip


def _rank_one_coupling(system: Matrices) -> float:
    """C* = c g g^T with g_k = sqrt(2/(n+1)) sin(3 k pi/(n+1)): sqrt(1 - sum g^4 / (sum g^2)^2)."""
    n = len(system.M)
    g = np.sqrt(2 / (n + 1)) * np.sin(3 * np.arange(1, n + 1) * np.pi / (n + 1))
    return float(np.sqrt(1 - np.sum(g**4) / np.sum(g**2) ** 2))


__all__ = ["ERROR_TABLE", "SIMPSON", "TRAPEZOIDAL", "measured_order", "plots", "reduction_table", "rows"]
