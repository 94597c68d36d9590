"""Rising tensions that come and go with their strings' amplitude.

A string is stepped with the tension it has at rest, bends included, while two bounds are within their budgets: by how
much its pitch would rise, which its energy tells (`instrument.effects.rise_of_tension`), and the sidebands that the
beating tension would give to its partials (`sidebands`). What is foreseen is the pull of the next pluck: its static
energy adds to that of the string as amplitudes add, sqrt E <= sqrt E0 + sqrt(F^2 C / 2), and so do partials. The
phantom partials (`phantoms`) of a string that moves along itself count with its sidebands.

Leaving a rise out takes its potential EA/(8 L) S^2 away. Coming back it would appear from nowhere: the string pays it
with as much of its kinetic energy, a ten thousandth of it, and waits for a moment at which it can. The potential of a
coupling to the motion along the string may be negative; then it is leaving that is paid.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tonewood.coupling.geometric import GeometricStretch, GeometricString
from tonewood.coupling.system import Compiled, State, System
from tonewood.coupling.tension import TensionModulation, stretch_weights
from tonewood.engine.fretting import Fretting
from tonewood.engine.gestures import places
from tonewood.engine.phantoms import Phantoms
from tonewood.engine.sidebands import Sidebands
from tonewood.engine.timeline import Play
from tonewood.engine.transfer import Transfer
from tonewood.instrument.assembly import Model
from tonewood.instrument.effects import TENSION_MODULATION, Norms
from tonewood.stepping.forcing import Segment
from tonewood.stepping.motion import from_motion, share_velocities, to_motion

Floats = NDArray[np.float64]

#: points of the control grid from one look at the strings' energies to the next while a tension rises; and from one
#: look at all bounds to the next, after which tensions may be left out
LOOK, SELDOM = 16, 64
#: share of the budget below which a rise is left out; above the whole of it, it comes back
_LEAVE = 0.9
#: share of a string's kinetic energy that may be asked for
_AFFORDABLE = 0.5
#: share of the additive budget that is the tensions' where modes may sleep, whose own bound takes the rest
_SHARE = 0.5
#: a string that is drawn aside stretches by 2 E / T, twice as much as one that swings, and 1.5 of that are in the bound
_DRAWN = 4 / 3
#: strings as they are held whose sidebands and phantom partials are kept
_KEPT = 128
#: re full scale, the loudest sample before there is any
SILENT = 1e-150
#: 1/N, of a string without modes
_TINY = 1e-300


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
        self.strings = tuple(t.name for t in system.rising)
        self._laws = {t.name: t for t in system.rising}
        self.stiffness = np.array([t.axial_stiffness for t in system.rising])
        # what a hammer brings may be the string's the next moment
        parts = [(i, c) for i, t in enumerate(system.rising) for c in (*t.components, *_partners(system, t))]
        self._slots = [system.slot(c) for _, c in parts]
        self._owner = np.array([i for i, _ in parts], dtype=np.intp)
        #: those that move along themselves
        self.along = {g.name: g for g in system.stretches if g.longitudinal is not None}
        #: what may be missing at the outputs, ratio to the loudest sample
        self.budget_level = 10 ** (model.choice.budget_db / 20) * (1.0 if system.stretches else _SHARE)
        self._planes = {t.name: [system.slot(c) for c in t.components] for t in system.rising}
        self._told: dict[str, tuple[tuple[Compiled, ...], float, float]] = {}
        self._transfer: Transfer | None = None
        self._phantoms: dict[tuple[str, Fretting], Phantoms] = {}
        self._sidebands: dict[tuple[str, Fretting, int], Sidebands] = {}
        # the tensions' components alone, one after another as in the state
        self._places = np.concatenate(
            [np.zeros(0, dtype=np.intp)]
            + [np.arange(system.capacities[s]) + system.offsets[s] for s in self._slots]
        )  # fmt: skip
        sizes = [system.capacities[s] for s in self._slots]
        self._starts = np.cumsum([0, *sizes[:-1]]).astype(np.intp)
        self._forms = np.zeros((3, len(self._places)))
        self._known: list[Compiled | None] = [None] * len(self._slots)

    @property
    def enabled(self) -> bool:
        """Whether there is anything to switch."""
        return self.model.choice.mode == "auto" and bool(self.strings)

    def energies(self, system: System, state: State) -> Floats:
        """(n_strings,) J, energy of each string's modes, and of what moves at it."""
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

    def bounds(
        self,
        system: System,
        state: State,
        frettings: Mapping[str, Fretting],
        energies: Mapping[str, float],
        peak: Floats,
        names: Collection[str],
    ) -> tuple[dict[str, float], dict[str, float]]:
        """What leaving out each string's rise would cost: cents, and of `names` the largest sample that is missing.

        The latter is a ratio to the loudest sample of each readout so far, `peak` (R,), together with what is missing
        of the strings of which less is heard: the strings with the least share the budget. A string beyond the budget
        of cents is not looked at further, its level is infinite.
        """
        cents = {name: self.rise(name, system, energy) for name, energy in energies.items()}
        alone = {}
        for name in names:
            if cents[name] > self.budget:
                alone[name] = math.inf
                continue
            motion = _motion(system, state, self._laws[name].components)
            alone[name] = self._held_sidebands(name, system, frettings[name]).level(motion, np.maximum(peak, SILENT))
            if name in self.along:
                phantoms = self._held_phantoms(name, system, frettings[name])
                slopes = phantoms.slopes(motion)
                cents[name] += phantoms.cents(slopes)
                alone[name] += phantoms.level(slopes, np.maximum(peak, SILENT))
        quietest = sorted(alone, key=lambda name: alone[name])
        return cents, dict(zip(quietest, itertools.accumulate(alone[name] for name in quietest), strict=True))

    @property
    def transfer(self) -> Transfer:
        """From strings' ends to outputs, found when it is first asked for."""
        if self._transfer is None:
            self._transfer = Transfer(self.model)
        return self._transfer

    def _held_sidebands(self, name: str, system: System, fretting: Fretting) -> Sidebands:
        compiled = {c: system.compiled[system.slot(c)] for c in self._laws[name].components}
        # asleep, a string has fewer modes; where it is touched and plucked changes none of them
        key = name, replace(fretting, place=None, touches=()), sum(c.basis.n_modes for c in compiled.values())
        if key not in self._sidebands:
            if len(self._sidebands) >= _KEPT:
                del self._sidebands[next(iter(self._sidebands))]
            tension, length = self._held(name, system)
            rise = float(self.stiffness[self.strings.index(name)]) / (4 * length * tension**2)
            self._sidebands[key] = Sidebands.of(compiled, rise, system, self.transfer)
        return self._sidebands[key]

    def _held_phantoms(self, name: str, system: System, fretting: Fretting) -> Phantoms:
        key = name, fretting
        if key not in self._phantoms:
            if len(self._phantoms) >= _KEPT:
                del self._phantoms[next(iter(self._phantoms))]
            law = self.along[name]
            compiled = {c: system.compiled[system.slot(c)] for c in law.parts}
            self._phantoms[key] = Phantoms.of(law, compiled, self._held(name, system)[0], self.transfer)
        return self._phantoms[key]

    def rise(self, name: str, system: System, energy: float) -> float:
        """Largest mean rise of a string's tension at an energy (J), in cents of its pitch, as it is stepped now."""
        tension, length = self._held(name, system)
        stiffness = float(self.stiffness[self.strings.index(name)])
        return TENSION_MODULATION.bound(Norms(energy=energy, tension=tension, axial_stiffness=stiffness, length=length))

    def _held(self, name: str, system: System) -> tuple[float, float]:
        """Tension (N), bends included, and speaking length (m) of a string as it is stepped.

        The tension is the least that any mode tells: a tension dT raises the square w^2 of a mode's frequency by
        a dT, of which a stiff string has w^2 = T a + EI b.
        """
        law = self._laws[name]
        compiled = tuple(system.compiled[slot] for slot in self._planes[name])
        known = self._told.get(name)
        if known is None or any(a is not b for a, b in zip(known[0], compiled, strict=True)):
            parts = [part.basis for part in compiled]
            per_newton = [cast(Floats, stretch_weights(basis)) / basis.stiffness for basis in parts]
            length = law.length if isinstance(law, TensionModulation) and law.length else parts[0].metadata["length"]
            tension = 1.0 / float(np.max(np.concatenate(per_newton), initial=_TINY))
            self._told[name] = known = compiled, tension, float(cast(float, length))
        return known[1], known[2]

    def wanted(
        self, rises: Mapping[str, float], levels: Mapping[str, float], on: Collection[str], busy: Collection[str]
    ) -> frozenset[str]:
        """Strings whose tension is to rise.

        Parameters
        ----------
        rises : string -> cents it would rise by.
        levels : string -> what would be missing at the outputs, ratio to the loudest sample.
        on : those that do so now.
        busy : those that a gesture acts on: none of them stops.
        """

        def beyond(name: str, share: float) -> bool:
            return rises[name] > share * self.budget or levels.get(name, 0.0) > share * self.budget_level

        return frozenset(n for n in rises if (n in on and n in busy) or beyond(n, _LEAVE if n in on else 1.0))

    def foreseen(
        self, play: Play, system: System, state: State, fretting: Fretting, energy: float, peak: Floats
    ) -> tuple[float, float]:
        """Cents and level, as of `bounds`, after a gesture on a string of `energy` (J); unknown, they are infinite."""
        gesture = play.gesture
        if gesture.motions or gesture.on is not None or not gesture.segments or play.string in self.along:
            return math.inf, math.inf  # nothing is known beforehand of the phantom partials that a pluck will drive
        name = play.string or ""
        force = max(largest(s) for s in gesture.segments)
        compliance = self.compliance(name, system, fretting)
        foreseen = (math.sqrt(max(energy, 0.0)) + force * math.sqrt(0.5 * compliance)) ** 2
        cents = _DRAWN * self.rise(name, system, foreseen)
        if cents > self.budget:
            return cents, math.inf
        components = self._laws[name].components
        pulled = dict.fromkeys(components, np.zeros(0))
        for component, point, factor in places(play, self.model):
            basis = system.compiled[system.slot(component)].basis
            pulled[component] = force * factor * basis.right[basis.index(point)].real / basis.stiffness
        found = self._held_sidebands(name, system, fretting)
        motion = _motion(system, state, components)
        return cents, found.level(motion, np.maximum(peak, SILENT), pulled)

    def compliance(self, name: str, system: System, fretting: Fretting) -> float:
        """Static compliance of a string between fixed ends where it is plucked, x (L - x) / (T L) in m/N."""
        tension, length = self._held(name, system)
        pluck = self.model.strings[name].pluck_from_bridge
        x = min(pluck, 0.9 * length) if fretting.place is None else fretting.place
        return x * (length - x) / (tension * length)


def _motion(system: System, state: State, components: Sequence[str]) -> dict[str, tuple[Floats, Floats]]:
    """Component -> q and q'."""
    return {
        c: to_motion(
            system.compiled[system.slot(c)].basis, np.asarray(system.modes_of(state, c), dtype=np.float64)
        )
        for c in components
    }  # fmt: skip


def _partners(system: System, law: TensionModulation | GeometricStretch) -> list[str]:
    """Components of what touches a string: hammers, fingers, rings."""
    own = law.parts if isinstance(law, GeometricStretch) else law.components
    there = [n for n in system.names if n.startswith(f"{law.name}.") and n not in own]
    return [n for n in there if system.compiled[system.slot(n)].basis.is_real]


def string_energy(system: System, state: State, name: str) -> tuple[float, float]:
    """Energy of a string's modes, and what its rising tension stores besides if it is on, J; that may be negative."""
    law = next(t for t in system.rising if t.name == name)
    parts = law.parts if isinstance(law, GeometricStretch) else law.components
    total = stretch = kappa = 0.0
    shares, states = [], []
    for component in parts:
        compiled = system.compiled[system.slot(component)]
        x = np.asarray(system.modes_of(state, component), dtype=np.float64)
        q, v = to_motion(compiled.basis, x)
        total += 0.5 * float(v @ v + compiled.basis.stiffness @ (q * q))
        if compiled.tension is not None:
            stretch += compiled.tension.stretch(x.T)
            kappa = compiled.tension.kappa
        if compiled.geometric is not None:
            shares.append(compiled.geometric)
            states.append(compiled.geometric.coordinates(x.T))
    if shares:
        return total, _coupled(tuple(shares)).energy(np.concatenate(states))
    return total, 0.5 * kappa * stretch**2


#: forms of strings as they are held: large, and asked for again
_coupled = lru_cache(maxsize=32)(GeometricString)


def affordable(system: System, state: State, name: str, given: float = 0.0) -> bool:
    """Whether a string can pay for its tension's rise, and if so, let it: velocities fall by as much as is needed.

    Parameters
    ----------
    given : J, that need not be paid.
    """
    return _paid(system, state, name, string_energy(system, state, name)[1] - given)


def may_rest(system: System, state: State, name: str) -> bool:
    """Whether a string's tension may stop rising: if that sets energy free, the string pays for it."""
    return _paid(system, state, name, -string_energy(system, state, name)[1])


def _paid(system: System, state: State, name: str, cost: float) -> bool:
    """Whether a string could give as much of its kinetic energy (J), which it then has done."""
    if cost <= 0.0:
        return True
    law = next(t for t in system.rising if t.name == name)
    motions = []
    kinetic = 0.0
    for component in law.components:
        basis = system.compiled[system.slot(component)].basis
        q, v = to_motion(basis, np.asarray(system.modes_of(state, component), dtype=np.float64))
        motions.append((component, basis, q, v))
        kinetic += 0.5 * float(v @ v)
    if cost > _AFFORDABLE * kinetic:
        return False
    less = math.sqrt(1.0 - cost / kinetic)
    for component, basis, q, v in motions:
        system.modes_of(state, component)[:] = from_motion(basis, q, less * v)
    ends = {f"{component}.bridge" for component in law.components}
    share_velocities(system, state, np.array([c.name in ends for c in system.connections], dtype=bool))
    return True


def largest(piece: Segment) -> float:
    """Largest |F| of a piece of force, N."""
    length = piece.stop - piece.start
    turn = -piece.c1 / (2 * piece.c2) if piece.c2 else 0.0
    times = np.array([0.0, length, turn if 0.0 < turn < length else 0.0])
    return float(np.max(np.abs(piece.c0 + times * (piece.c1 + times * piece.c2))))
