"""Figs. 3.2 to 3.10 of Chinnakonda (2007) redrawn."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tonewood.lab.assembled import free_motion
from tonewood.lab.figures import figure
from tonewood.lab.interpolatory import P0, P1, P2, SIMPSON, TRAPEZOIDAL, respond
from tonewood.lab.newmark import HHT
from tonewood.lab.systems.chinnakonda_problems import (
    DRIVE_FREQ,
    FORCES,
    HEAVY,
    LIGHT,
    STIFF_DAMPING,
    STIFF_START,
    basis_of,
    driven_error,
    exact_driven,
    relative_errors,
    stiff_system,
    two_masses,
    two_step,
)
from tonewood.physics.modal.synthesis import initial_state
from tonewood.support.plotting import save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CASES = (("light", LIGHT), ("very heavy", HEAVY))
_STEPS = 20


def plots(directory: Path, reduction: Mapping[int, Mapping[str, float]]) -> list[Path]:
    """Draw everything; `reduction` is the table of non-proportionality indices over the number of real modes."""
    drawn = {
        "chinnakonda_displacements": _displacements(),
        "chinnakonda_errors": _errors(),
        "chinnakonda_convergence": _convergence(),
        "chinnakonda_initial_conditions": _initial_conditions(),
        "chinnakonda_stiff": _stiff(),
        "chinnakonda_indices": _indices(reduction),
    }
    return [save(fig, directory / f"{name}.png") for name, fig in drawn.items()]


def _displacements() -> Figure:
    """Figs. 3.2 and 3.5: P0 and P1 against the exact motion."""
    fig, axes = figure(2, 2, size=(11, 6), sharex=True)
    dt = 1 / DRIVE_FREQ / _STEPS
    fine = np.arange(1201) / 240
    for row, (name, c) in zip(axes, _CASES, strict=True):
        system = two_masses(c)
        exact = exact_driven(system, 1 / 240, 1201)
        for k, axis in enumerate(row):
            axis.plot(fine, exact[:, k], "k", lw=1, label="exact")
            for update, mark in ((P0, "bx"), (P1, "ro")):
                response = respond(update, basis_of(system), FORCES, np.arange(0, 5 + dt / 2, dt))
                axis.plot(response.times, response.displacement[:, k], mark, ms=3, mfc="none", label=update.name)
            axis.set(title=f"mass {k + 1}, {name} damping", ylabel="displacement, m")
    axes[0, 0].legend()
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    return fig


def _errors() -> Figure:
    """Figs. 3.3, 3.4 and 3.6: error of mass 1."""
    fig, axes = figure(2, 2, size=(11, 6), sharex=True)
    for row, (name, c) in zip(axes, _CASES, strict=True):
        for axis, updates in zip(row, ((TRAPEZOIDAL, P1, SIMPSON, P2), (SIMPSON, P2)), strict=True):
            for update in updates:
                times, error, _ = driven_error(update, c, _STEPS)
                axis.plot(times, error[:, 0], ".-", ms=3, lw=0.8, label=update.name)
            axis.set(title=f"{name} damping", ylabel="error of mass 1, m")
            axis.legend(fontsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    return fig


def _convergence() -> Figure:
    """Fig. 3.7, error over damping, and Fig. 3.8, error over step."""
    from matplotlib.ticker import NullFormatter

    updates = (P0, TRAPEZOIDAL, P1, SIMPSON, P2)
    fig, axes = figure(1, 3, size=(13, 4.2))
    damping = np.linspace(0.005, 1, 25) * HEAVY
    steps = (10, 20, 40, 80, 160, 320)
    for update in updates:
        axes[0].semilogy(
            damping / np.pi, [relative_errors(update, c, (_STEPS,))[0] for c in damping], ".-", ms=3, label=update.name
        )
        for axis, (_, c) in zip(axes[1:], _CASES, strict=True):
            axis.loglog(1 / DRIVE_FREQ / np.array(steps), relative_errors(update, c, steps), "o-", ms=3,
                        label=f"{update.name}, order {update.order}")  # fmt: skip
    axes[0].set(xlabel="c / pi, N s/m", ylabel="largest relative error of mass 1", title="20 steps per period")
    for axis, (name, _) in zip(axes[1:], _CASES, strict=True):
        axis.set(xlabel="step, s", title=f"{name} damping")
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=8, loc="center right")
    axes[1].legend(fontsize=8)
    return fig


def _initial_conditions() -> Figure:
    """Fig. 3.9: free motion from u = (1, -1), light damping."""
    fig, axes = figure(1, 2, size=(11, 3.2), sharey=True)
    system, start = two_masses(LIGHT), np.array([1.0, -1.0])
    basis = basis_of(system)
    exact = free_motion(system, start, [0.0, 0.0], 1 / 240, 2401)
    state = initial_state(basis, system.M, system.C, start, [0.0, 0.0])
    response = respond(P1, basis, {}, np.arange(301) / 30, state)
    for k, axis in enumerate(axes):
        axis.plot(np.arange(2401) / 240, exact[:, k], "k", lw=1, label="exact")
        axis.plot(response.times, response.displacement[:, k], "ro", ms=2.5, mfc="none", label="P1")
        axis.set(title=f"mass {k + 1}", xlabel="time, s")
    axes[0].set_ylabel("displacement, m")
    axes[0].legend()
    return fig


def _stiff() -> Figure:
    """Fig. 3.10: the stiff system, reduced to one real mode, and by HHT-alpha."""
    fig, axes = figure(3, 1, size=(10, 8.5))
    dt, n = 1 / 20, 101
    t, fine = np.arange(n) * dt, np.arange(20001) / 4000
    for (proportional, c), axis, colour in zip(STIFF_DAMPING.items(), axes[1:], "rb", strict=True):
        kind = "proportional" if proportional else "non-proportional"
        system = stiff_system(c, proportional=proportional)
        exact = free_motion(system, STIFF_START, [0.0, 0.0], 1 / 4000, 20001)
        small = two_step(system, 1, t, STIFF_START).displacement
        direct, _ = HHT.run(system, dt, n, (STIFF_START, np.zeros(2)))
        axes[0].plot(fine, exact[:, 0], colour, lw=0.3, alpha=0.3, label=f"exact, {kind}")
        axes[0].plot(t, small[:, 0], colour + "-", lw=1.5, label=f"P1 (reduced), {kind}")
        axes[0].plot(t, direct[:, 0], colour + "x--", ms=4, lw=0.8, label=f"HHT-alpha, {kind}")
        axis.plot(fine, exact[:, 1], "k", lw=1, label="exact")
        axis.plot(t, small[:, 1], colour + "o", ms=3, mfc="none", label="P1 (reduced)")
        axis.plot(t, direct[:, 1], "gx--", ms=4, lw=0.8, label="HHT-alpha (-0.3)")
        axis.set(title=f"mass 2, {kind} damping", ylabel="displacement, m")
        axis.legend(fontsize=8)
    axes[0].set(title="mass 1", ylabel="displacement, m", ylim=(-1.1, 1.1), xlim=(0, 2))
    axes[0].legend(fontsize=8, ncols=2)
    axes[-1].set_xlabel("time, s")
    return fig


def _indices(reduction: Mapping[int, Mapping[str, float]]) -> Figure:
    fig, axis = figure(size=(6, 3.8))
    for name in next(iter(reduction.values())):
        axis.plot(list(reduction), [values[name] for values in reduction.values()], "o-", ms=3, label=name)
    axis.set(xlabel="real modes kept", ylabel="index of non-proportionality", title="chain of 12 with one dashpot")
    axis.grid(alpha=0.3)
    axis.legend()
    return fig
