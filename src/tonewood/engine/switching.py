"""Rising tensions that come and go with their strings' amplitude.

A string whose tension would not rise by more than the budget of cents is stepped with the tension it has at rest. What
is watched is its energy, which bounds the rise (`instrument.effects.rise_of_tension`); what is foreseen is the pull of
the next pluck, whose static energy adds to it as amplitudes add, sqrt E <= sqrt E0 + sqrt(F^2 C / 2).

Leaving a rise out takes its potential EA/(8 L) S^2 away. Coming back it would appear from nowhere: the string pays it
with as much of its kinetic energy, a ten thousandth of it, and waits for a moment at which it can.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.engine.fretting import Fretting
from tonewood.engine.timeline import Play
from tonewood.instrument.assembly import Model
from tonewood.instrument.effects import TENSION_MODULATION, Norms
from tonewood.numerics.forcing import Segment
from tonewood.numerics.motion import from_motion, share_velocities, to_motion
from tonewood.numerics.system import Compiled, State, System

Floats = NDArray[np.float64]

#: points of the control grid from one look at the strings to the next, while a tension rises and while none does
LOOK, SELDOM = 16, 64
#: share of the budget below which a rise is left out; above the whole of it, it comes back
_LEAVE = 0.9
#: share of a string's kinetic energy that may be asked for
_AFFORDABLE = 0.5


@dataclass(frozen=True, slots=True)
class Forms:
    """Energy of a component's modes (x, y) as a quadratic form, sum xx x^2 + xy x y + yy y^2 (J)."""

    xx: Floats
    xy: Floats
    yy: Floats

    @classmethod
    def of(cls, compiled: Compiled) -> Forms:
        """Of real modes."""
        basis = compiled.basis
        one, none = np.ones(basis.n_modes), np.zeros(basis.n_modes)
        (qx, vx), (qy, vy) = (to_motion(basis, np.stack(unit)) for unit in ((one, none), (none, one)))
        k = basis.stiffness
        return cls(0.5 * (vx**2 + k * qx**2), vx * vy + k * qx * qy, 0.5 * (vy**2 + k * qy**2))


class TensionSwitch:
    """Says which strings' tensions are to rise.

    Parameters
    ----------
    model : with strings whose tension rises; only these are looked at.
    """

    def __init__(self, model: Model):
        self.model = model
        self.budget = model.choice.budget_cents
        system = model.system
        self.strings = tuple(t.name for t in system.tensions)
        self.stiffness = np.array([t.axial_stiffness for t in system.tensions])
        self._slots = [system.slot(c) for t in system.tensions for c in t.components]
        self._owner = np.array([i for i, t in enumerate(system.tensions) for _ in t.components], dtype=np.intp)
        # the tensions' components alone, one after another as in the state
        self._places = np.concatenate(
            [np.zeros(0, dtype=np.intp)]
            + [np.arange(system.capacities[s]) + system.offsets[s] for s in self._slots]
        )  # fmt: skip
        sizes = [system.capacities[s] for s in self._slots]
        self._starts = np.cumsum([0, *sizes[:-1]]).astype(np.intp)
        self._forms = np.zeros((3, len(self._places)))
        self._stops: dict[tuple[str, float], tuple[float, float]] = {}
        self._known: list[Compiled | None] = [None] * len(self._slots)

    @property
    def enabled(self) -> bool:
        """Whether there is anything to switch."""
        return self.model.choice.mode == "auto" and bool(self.strings)

    def energies(self, system: System, state: State) -> Floats:
        """(n_strings,) J, energy of each string's modes."""
        for i, slot in enumerate(self._slots):
            compiled = system.compiled[slot]
            if self._known[i] is not compiled:
                start, n = self._starts[i], compiled.basis.n_modes
                forms = Forms.of(compiled)
                self._forms[:, start : start + system.capacities[slot]] = 0.0
                self._forms[:, start : start + n] = forms.xx, forms.xy, forms.yy
                self._known[i] = compiled
        x, y = state.modes[:, self._places]
        xx, xy, yy = self._forms
        each = np.add.reduceat((xx * x + xy * y) * x + yy * y * y, self._starts)
        return np.asarray(np.bincount(self._owner, each, len(self.strings)), dtype=np.float64)

    def rise(self, name: str, stop: float, energy: float) -> float:
        """Largest mean rise of a string's tension at an energy (J), in cents of its pitch."""
        tension, length = self._held(name, stop)
        stiffness = float(self.stiffness[self.strings.index(name)])
        return TENSION_MODULATION.bound(Norms(energy=energy, tension=tension, axial_stiffness=stiffness, length=length))

    def _held(self, name: str, stop: float) -> tuple[float, float]:
        """Tension (N) and speaking length (m) of a string at a stop."""
        if (name, stop) not in self._stops:
            string = self.model.strings[name]
            self._stops[name, stop] = string.tension(stop), string.length(stop)
        return self._stops[name, stop]

    def wanted(self, rises: Mapping[str, float], on: Collection[str], busy: Collection[str]) -> frozenset[str]:
        """Strings whose tension is to rise.

        Parameters
        ----------
        rises : string -> cents it would rise by.
        on : those that do so now.
        busy : those that a gesture acts on: none of them stops.
        """
        keeps = {n for n in on if n in busy or rises.get(n, math.inf) > _LEAVE * self.budget}
        return frozenset(keeps | {n for n, cents in rises.items() if cents > self.budget})

    def foreseen(self, play: Play, fretting: Fretting, energy: float) -> float:
        """Rise of tension after a gesture on a string of `energy` (J), in cents; unknown, it is infinite."""
        gesture = play.gesture
        if gesture.motions or gesture.on is not None or not gesture.segments:
            return math.inf
        name = play.string or ""
        force = max(largest(s) for s in gesture.segments)
        compliance = self.compliance(name, fretting)
        foreseen = (math.sqrt(max(energy, 0.0)) + force * math.sqrt(0.5 * compliance)) ** 2
        return self.rise(name, fretting.stop, foreseen)

    def compliance(self, name: str, fretting: Fretting) -> float:
        """Static compliance of a string between fixed ends where it is plucked, x (L - x) / (T L) in m/N."""
        tension, length = self._held(name, fretting.stop)
        pluck = self.model.strings[name].pluck_from_bridge
        x = min(pluck, 0.9 * length) if fretting.place is None else fretting.place
        return x * (length - x) / (tension * length)


def string_energy(system: System, state: State, name: str) -> tuple[float, float]:
    """Energy of a string's modes, and of its tension if that rises, J."""
    tension = next(t for t in system.tensions if t.name == name)
    total = stretch = kappa = 0.0
    for component in tension.components:
        compiled = system.compiled[system.slot(component)]
        x = np.asarray(system.modes_of(state, component), dtype=np.float64)
        q, v = to_motion(compiled.basis, x)
        total += 0.5 * float(v @ v + compiled.basis.stiffness @ (q * q))
        if compiled.tension is not None:
            stretch += compiled.tension.stretch(x.T)
            kappa = compiled.tension.kappa
    return total, 0.5 * kappa * stretch**2


def affordable(system: System, state: State, name: str, given: float = 0.0) -> bool:
    """Whether a string can pay for its tension's rise, and if so, let it: velocities fall by as much as is needed.

    Parameters
    ----------
    given : J, that need not be paid.
    """
    tension = next(t for t in system.tensions if t.name == name)
    cost = string_energy(system, state, name)[1] - given
    if cost <= 0.0:
        return True
    motions = []
    kinetic = 0.0
    for component in tension.components:
        basis = system.compiled[system.slot(component)].basis
        q, v = to_motion(basis, np.asarray(system.modes_of(state, component), dtype=np.float64))
        motions.append((component, basis, q, v))
        kinetic += 0.5 * float(v @ v)
    if cost > _AFFORDABLE * kinetic:
        return False
    less = math.sqrt(1.0 - cost / kinetic)
    for component, basis, q, v in motions:
        system.modes_of(state, component)[:] = from_motion(basis, q, less * v)
    ends = {f"{component}.bridge" for component in tension.components}
    share_velocities(system, state, np.array([c.name in ends for c in system.connections], dtype=bool))
    return True


def largest(piece: Segment) -> float:
    """Largest |F| of a piece of force, N."""
    length = piece.stop - piece.start
    turn = -piece.c1 / (2 * piece.c2) if piece.c2 else 0.0
    times = np.array([0.0, length, turn if 0.0 < turn < length else 0.0])
    return float(np.max(np.abs(piece.c0 + times * (piece.c1 + times * piece.c2))))
