"""Strings with longitudinal motion: a plain steel string with held ends, plucked or in two modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.coupling.connections import Connection, Rigid, Term
from tonewood.physics.coupling.potentials.longitudinal import GeometricStretch
from tonewood.physics.coupling.system import Readout, State, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import string_basis
from tonewood.physics.stepping.motion import from_motion

Floats = NDArray[np.float64]

LENGTH, TENSION, DENSITY, AXIAL = 0.645, 104.1, 5.735e-4, 14613.0
BENDING = 8.5e-5


def transverse(
    n_modes: int | None = None, *, fs: float = 48000.0, bending: float = 0.0, eta: float = 0.0
) -> ModalBasis:
    upper = None if n_modes else 0.45 * fs
    basis = string_basis(
        LENGTH, TENSION, DENSITY, bending, lambda w, k: np.full_like(w, eta), n_modes=n_modes, freq_upper=upper
    )
    return basis.with_places({"pick": 0.13, "fret": 0.3})


def longitudinal(n_modes: int | None = None, *, fs: float = 48000.0, eta: float = 0.0) -> ModalBasis:
    upper = None if n_modes else 0.45 * fs
    return string_basis(
        LENGTH, AXIAL, DENSITY, 0.0, lambda w, k: np.full_like(w, eta), n_modes=n_modes, freq_upper=upper
    )


def held_string(
    fs: float,
    planes: Sequence[str] = ("y",),
    *,
    basis: ModalBasis | None = None,
    motion: ModalBasis | None = None,
    freq_coupled: float = 5000.0,
    coupled: bool = True,
    more: Sequence[Connection] = (),
    others: Mapping[str, ModalBasis] | None = None,
    ends: Mapping[str, tuple[Term, ...]] | None = None,
) -> System:
    """A string whose ends are rigid, or moved by `others` as `ends` (component -> terms) tell."""
    transverse_basis, motion = basis or transverse(fs=fs), motion or longitudinal(fs=fs)
    components = dict.fromkeys(planes, transverse_basis) | {"x": motion} | dict(others or {})
    connections = [
        Connection(f"{n}.bridge", (Term(n, "bridge"), *(ends or {}).get(n, ())), Rigid()) for n in (*planes, "x")
    ]
    readouts = [
        Readout("pick", "displacement", (Term(planes[0], "pick"),)),
        Readout("across", "force", forces=((f"{planes[0]}.bridge", 1.0),)),
        Readout("along", "force", forces=(("x.bridge", 1.0),)),
    ]
    stretch = [GeometricStretch("string", tuple(planes), "x", AXIAL, freq_coupled)] if coupled else []
    return System.build(components, [*connections, *more], readouts, dt=1 / fs, potentials=stretch)


def sines(basis: ModalBasis, amplitudes: Floats) -> Floats:
    """Modal coordinates of sum amplitudes_n sin(n pi x / L), by the mass matrix of ramp and sines."""
    vec = np.asarray(basis.metadata["vec"])
    n = np.arange(1, len(vec))
    mass = np.diag(np.concatenate([[LENGTH / 3], np.full(len(n), LENGTH / 2)])) * DENSITY
    mass[0, 1:] = mass[1:, 0] = DENSITY * LENGTH / (np.pi * n)
    return np.asarray(vec.T @ mass @ np.concatenate([[0.0], amplitudes]))


def plucked(system: System, height: float, planes: Sequence[str] = ("y",), at: float = 0.2) -> State:
    """At rest in the shape of a triangle with its corner at a fifth; the second plane half as high."""
    state = system.start()
    for i, name in enumerate(planes):
        basis = system.compiled[system.slot(name)].basis
        n = np.arange(1, len(np.asarray(basis.metadata["vec"])))
        a = 2 * height / (np.pi**2 * n**2 * at * (1 - at)) * np.sin(n * np.pi * at) / (i + 1)
        q = sines(basis, a)
        system.modes_of(state, name)[:] = from_motion(basis, q, np.zeros(len(q)))
    return state


def in_modes(system: System, amplitudes: Mapping[int, float], name: str = "y") -> State:
    """At rest in a few sines, number -> amplitude in m."""
    state = system.start()
    basis = system.compiled[system.slot(name)].basis
    a = np.zeros(len(np.asarray(basis.metadata["vec"])) - 1)
    for number, amplitude in amplitudes.items():
        a[number - 1] = amplitude
    q = sines(basis, a)
    system.modes_of(state, name)[:] = from_motion(basis, q, np.zeros(len(q)))
    return state
