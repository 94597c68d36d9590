"""Methods of the literature beside the project's own: the order each states, and where it stops being stable.

Fabre, Le Carrou & Chomette (2024) step their equation with Adams-Bashforth 3, Antunes & Debut (2017) theirs with
velocity Verlet. Both constrain accelerations; constraints on positions and velocities, and a constraint force that is
linear in time, are stepped on the exact flow of the modes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.linalg as sla

from tonewood.lab import assembled
from tonewood.lab.figures import figure
from tonewood.lab.methods import METHODS, Method, Problem, forms, stability_limit
from tonewood.lab.methods.scheme import multipliers
from tonewood.lab.row import Row, cents, halving_order, nearest, pole_error
from tonewood.lab.string_end import coupled_pole
from tonewood.lab.systems import fabre_guitar
from tonewood.lab.systems.fabre_academic import free_motion, problem, subsystems, whole
from tonewood.lab.systems.fabre_forms import proportional_problem
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.arrays import Complexes, Floats
from tonewood.support.plotting import save

SYSTEM = "Fabre methods"
#: largest |omega h| on the imaginary axis at which Adams-Bashforth 3 does not grow
AB3_LIMIT = (5 + np.sqrt(5)) / 10
#: methods of other names are the same ones, or take no steps
STEPPED = [m for name, m in METHODS.items() if name not in ("tonewood", "ab3_paper", "superposition")]


def subject(method: Method) -> tuple[Problem, Complexes]:
    """The academic system for a method, with its true poles; proportional damping where real modes are asked for."""
    if method.real:
        system, matrices = proportional_problem()
        return system, assembled.poles(matrices)
    return problem(), assembled.poles(whole(subsystems()))


def pole_errors(method: Method, rates: Floats) -> Floats:
    """Largest relative pole error of a method at each sampling rate, Hz."""
    system, expected = subject(method)
    return np.array([pole_error(method.arrays(system, 1 / fs).poles(expected), expected) for fs in rates])


def free_oscillator(freq_rad: float) -> Problem:
    """One undamped mode, and a constraint that holds nothing."""
    basis = ModalBasis.real([freq_rad], [0.0], {"p": [1.0]})
    return Problem({"a": basis}, (Connection("none", (Term("a", "p", 0.0),)),), (), (Term("a", "p"),))


def lowest_ab3_rate(poles: Complexes) -> float:
    """Sampling rate, Hz, above which AB3 is stable for these poles: the boundary locus, pole by pole."""
    low, high = 1.0, 1e8
    while high > low * (1 + 1e-6):
        rate = np.sqrt(low * high)
        radius = 0.0
        for z in poles / rate:
            radius = max(radius, float(np.abs(np.roots([1.0, -1 - 23 * z / 12, 16 * z / 12, -5 * z / 12])).max()))
        low, high = (low, rate) if radius <= 1 + 1e-9 else (rate, high)
    return high


def rows() -> Iterator[Row]:
    """Orders, limits of stability, the constraint's gap."""
    for method in STEPPED:
        errors = pole_errors(method, np.array([400.0, 800.0]))
        order = halving_order(errors[0], errors[1])
        yield Row(SYSTEM, f"{method.name}: measured order", "the order it states", method.order, order, 0.15)
    for name, label, source, limit, rate in (
        ("ab3", "AB3", "boundary locus, (5 + sqrt 5)/10", float(AB3_LIMIT), 500.0),
        ("verlet", "velocity Verlet", "closed form", 2.0, 300.0),
    ):
        value = 1000.0 / stability_limit(METHODS[name], free_oscillator(1000.0), rate, 5000.0)
        yield Row(SYSTEM, f"{label}: largest stable omega h", source, limit, value, 2e-3)
    academic = problem()
    force = multipliers(METHODS["linear_position"].arrays(academic, 1e-4))
    grows = float(force[np.argmax(np.abs(force))].real)
    source = "f2 + 4 f1 + f0 = 0, step to 0"
    yield Row(SYSTEM, "linear constraint force: multiplier of the force", source, -2 - np.sqrt(3), grows, 1e-2)
    above = max(float(np.abs(multipliers(METHODS["held_position"].arrays(academic, 1 / 400))).max()) - 1, 0.0)
    yield Row(SYSTEM, "held_position: spectral radius - 1, if above", "energy never rises", 0, above, 1e-12)
    joint = replace(academic, outputs=(Term("S1", "m4"), Term("S2", "m5")))
    for name, tolerance in (("held_position", 1e-12), ("ab3", 1e-9)):
        y = free_motion(joint, name, 400.0, 2001)
        gap = float(np.abs(y[:, 0] - y[:, 1]).max() / np.abs(y).max())
        yield Row(SYSTEM, f"{name}: gap of the junction over 5 s / peak", "constraint", 0, gap, tolerance)
    # the paper's string of 150 modes on its guitar, and the rate it was stepped at
    guitar = fabre_guitar.problem(fabre_guitar.string(n_modes=150))
    poles = np.asarray(sla.eigvals(forms.general(guitar).F), dtype=np.complex128)
    poles = poles[np.abs(poles) > 1.0]  # two zeros of the constraint
    lowest = lowest_ab3_rate(poles)
    top = float(np.abs(poles).max()) / AB3_LIMIT
    yield Row(
        SYSTEM, "guitar, 150 string modes: lowest stable rate of AB3 (kHz)", "top pole / .7236", top / 1e3,
        lowest / 1e3, 1.0,
    )  # fmt: skip
    exact = {n: coupled_pole(fabre_guitar.exact_string(), fabre_guitar.body_receptance, n) for n in (1, 20, 60)}
    few = fabre_guitar.problem(fabre_guitar.string(n_modes=91))
    values = np.asarray(sla.eigvals(forms.general(few).F), dtype=np.complex128)
    for n, pole in exact.items():
        z = nearest(values, pole) / 1.2e6
        roots = np.roots([1.0, -1 - 23 * z / 12, 16 * z / 12, -5 * z / 12])
        got = nearest(np.log(roots[np.abs(roots) > 0.5]) * 1.2e6, pole)
        error = cents(got, pole)
        yield Row(SYSTEM, f"guitar by AB3 at 1200 kHz: partial {n} (cents)", "exact dynamic stiffness", 0, error, 0.02)


def plots(directory: Path) -> list[Path]:
    """Pole error against sampling rate, every method."""
    fig, axis = figure(1, 1, size=(8, 6))
    rates = np.array([50.0 * 2**i for i in range(8)])
    for i, method in enumerate(STEPPED):
        dashed = "--" if method.name == "linear_position" else "-"
        label = f"{method.name}, order {method.order}" + (" (unstable)" if dashed == "--" else "")
        axis.loglog(rates, pole_errors(method, rates), dashed + "osv^"[i % 4], color=f"C{i}", label=label, markersize=4)
    axis.set(xlabel="sampling rate (Hz)", ylabel="largest relative pole error", ylim=(1e-15, 1))
    axis.set_title("Academic system (highest pole 4.2 Hz): error of the coupled poles")
    axis.legend(fontsize=8)
    axis.grid(alpha=0.3)
    return [save(fig, directory / "fabre_methods_order.png")]
