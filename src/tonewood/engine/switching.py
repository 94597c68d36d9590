"""Rising tensions that come and go with their strings' amplitude.

A string whose tension would not rise by more than the budget of cents is stepped with the tension it has at rest. What
is watched is its energy, which bounds the rise (`instrument.effects.rise_of_tension`); what is foreseen is the pull of
the next pluck, whose static energy adds to it as amplitudes add, sqrt E <= sqrt E0 + sqrt(F^2 C / 2).

Leaving a rise out takes its potential EA/(8 L) S^2 away. Coming back it would appear from nowhere: the string pays it
with as much of its kinetic energy, a ten thousandth of it, and waits for a moment at which it can.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tonewood.engine.fretting import Fretting
from tonewood.engine.timeline import Play
from tonewood.instrument.assembly import Model
from tonewood.instrument.effects import TENSION_MODULATION, Norms, mean_rise
from tonewood.numerics.forcing import Segment
from tonewood.numerics.held_modes import HeldModes
from tonewood.numerics.motion import from_motion, share_velocities, to_motion
from tonewood.numerics.system import Compiled, State, System
from tonewood.units import ratio_of_cents

Floats = NDArray[np.float64]

#: points of the control grid from one look at the strings to the next, while a tension rises and while none does
LOOK, SELDOM = 16, 64
#: share of the budget below which a rise is left out; above the whole of it, it comes back
_LEAVE = 0.8
#: budgets above which no raised tension can stand for one that rises
_HOPELESS = 3.0
#: partials among which the strongest is sought; those above have no more than what these leave of the energy
LOWEST = 8
#: share of a string's kinetic energy that may be asked for; where there is time to wait for a better moment; and where
#: a finger comes down on it at the same moment
_AFFORDABLE, CHEAP, TOUCHED = 0.5, 1e-4, 1e-3
#: budgets above which no raised tension can stand for one that rises
_HOPELESS = 3.0
#: partials among which the strongest is sought; those above have no more than what these leave of the energy
LOWEST = 8
#: share of a string's kinetic energy that may be asked for, and where there is time to wait for a better moment
_AFFORDABLE, CHEAP = 0.5, 1e-4


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


@dataclass(frozen=True, slots=True)
class Lowest:
    """The lowest partials of a component: its modes with the bridge held.

    Attributes
    ----------
    speed : (n_partials, 2 n_modes) velocities from the modes' numbers, x and y.
    bend : (n_partials, n_modes) amplitudes, times their frequencies, from x.
    """

    speed: Floats
    bend: Floats

    @classmethod
    def of(cls, compiled: Compiled) -> Lowest | None:
        """Of a component; None where it has none."""
        basis = compiled.basis
        try:
            held = HeldModes.of(basis, "bridge", LOWEST)
        except ValueError:
            return None
        one, none = np.ones(basis.n_modes), np.zeros(basis.n_modes)
        (q, vx), (_, vy) = (to_motion(basis, np.stack(unit)) for unit in ((one, none), (none, one)))
        picks = held.vectors
        return cls(np.hstack([picks * vx, picks * vy]), held.freq_rad[:, None] * picks * q)

    def energies(self, x: Floats, y: Floats) -> Floats:
        """(LOWEST,) J, from the numbers of the component's modes."""
        speed, bend = self.speed @ np.concatenate([x, y]), self.bend @ x
        out = np.zeros(LOWEST)
        out[: len(bend)] = 0.5 * (speed * speed + bend * bend)
        return out


@dataclass(frozen=True, slots=True)
class Swing:
    """How a string swings: energy of all, and of its strongest partial in both planes at most, J."""

    energy: float = 0.0
    partial: float = 0.0


@dataclass(frozen=True, slots=True)
class Rise:
    """Cents by which a string's tension rises in the mean, and by which its strongest partial is off besides."""

    mean: float
    own: float

    def off(self, raised: float) -> float:
        """Cents by which partials are off while the tension is raised by so many, and does not rise by itself."""
        return abs(self.mean - raised) + self.own


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
        #: strings whose bases tell what a higher tension stores
        self._raisable = {
            t.name
            for t in system.tensions
            if all(
                {"tension", "tension_part"} <= system.compiled[system.slot(c)].basis.metadata.keys()
                for c in t.components
            )
        }
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
        self._lowest: list[tuple[Compiled, Lowest | None] | None] = [None] * len(self._slots)

    @property
    def enabled(self) -> bool:
        """Whether there is anything to switch."""
        return self.model.choice.mode == "auto" and bool(self.strings)

    def energies(self, system: System, state: State) -> dict[str, float]:
        """J, energy of each string's modes."""
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
        return dict(zip(self.strings, np.bincount(self._owner, each, len(self.strings)).tolist(), strict=True))

    def seen(self, system: System, state: State, name: str, stop: float, energy: float) -> tuple[Swing, Rise]:
        """How a string of `energy` swings, and by how much its tension would rise.

        Which partial is the strongest is asked for only where it may matter.
        """
        swing = Swing(energy, energy)
        rise = self.rise(name, stop, swing)
        if not _LEAVE * self.budget < rise.off(0.0) < _HOPELESS * self.budget:
            return swing, rise
        partials = np.zeros(LOWEST)
        for i in np.flatnonzero(self._owner == self.strings.index(name)):
            compiled = system.compiled[self._slots[i]]
            known = self._lowest[i]
            if known is None or known[0] is not compiled:
                known = self._lowest[i] = compiled, Lowest.of(compiled)
            if known[1] is not None:
                start = system.offsets[self._slots[i]]
                partials += known[1].energies(*state.modes[:, start : start + compiled.basis.n_modes])
        # no partial that is not looked at has more than what they leave
        swing = Swing(energy, min(max(float(partials.max()), energy - float(partials.sum())), energy))
        return swing, self.rise(name, stop, swing)

    def rise(self, name: str, stop: float, swing: Swing) -> Rise:
        """By how much a string's tension would rise for how it swings."""
        tension, length = self._held(name, stop)
        stiffness = float(self.stiffness[self.strings.index(name)])
        norms = Norms(0.0, swing.energy, swing.partial, tension, stiffness, length)
        mean = mean_rise(norms)
        return Rise(mean, TENSION_MODULATION.bound(norms) - mean)

    def _held(self, name: str, stop: float) -> tuple[float, float]:
        """Tension (N) and speaking length (m) of a string at a stop."""
        if (name, stop) not in self._stops:
            string = self.model.strings[name]
            self._stops[name, stop] = string.tension(stop), string.length(stop)
        return self._stops[name, stop]

    def wanted(self, name: str, rise: Rise, before: float | None, busy: bool) -> float | None:
        """Cents by which a string's tension is to be raised and left there; None: it is to rise by itself.

        Parameters
        ----------
        before : what it is now.
        busy : whether a gesture acts on the string: none stops rising then, and what is raised is raised for what the
            gesture will do.
        """
        if before is None:
            return None if busy else self.raised(name, rise)
        off = rise.mean - before + rise.own if busy else rise.off(before)
        return before if off <= self.budget else self.raised(name, rise)

    def raised(self, name: str, rise: Rise) -> float | None:
        """Cents by which a tension may be raised for good instead of rising by itself; None if it has to rise.

        None at all, or as many as are allowed when the string is silent again: its partials are then sharp by as much
        as they were flat when they were strongest.
        """
        limit = _LEAVE * self.budget
        offered = (0.0, limit) if name in self._raisable else (0.0,)
        return next((cents for cents in offered if rise.off(cents) <= limit), None)

    def cheap(self, system: System, state: State, name: str, cents: float, given: float) -> bool:
        """Whether a tension can be raised by so many cents at this moment, nearly for nothing; `given` J are paid."""
        cost = raising(system, state, name, cents) - given
        return cost <= 0.0 or cost <= CHEAP * kinetic_energy(system, state, name)

    def foreseen(self, play: Play, fretting: Fretting, swing: Swing) -> Rise:
        """Rise of tension after a gesture on a string that swings; unknown, it is infinite.

        A finger that holds the string quiets what it did before; where it does not, that shows when it is let go.
        """
        gesture = play.gesture
        if gesture.motions or gesture.on is not None or not gesture.segments:
            return Rise(math.inf, math.inf)
        name = play.string or ""
        force = max(largest(s) for s in gesture.segments)
        if gesture.hold is not None and gesture.hold.damping > 0.0:
            swing = Swing()
        compliance, share = self._plucked(name, fretting)
        bent = 0.5 * force**2 * compliance
        energy = (math.sqrt(max(swing.energy, 0.0)) + math.sqrt(bent)) ** 2
        partial = (math.sqrt(max(swing.partial, 0.0)) + math.sqrt(share * bent)) ** 2
        return self.rise(name, fretting.stop, Swing(energy, partial))

    def _plucked(self, name: str, fretting: Fretting) -> tuple[float, float]:
        """Static compliance of a string between fixed ends where it is plucked, x (L - x) / (T L) in m/N, and the
        largest share of one partial in its energy, 2 sin^2(n pi x / L) / (n pi)^2 over x (L - x) / L^2.
        """
        tension, length = self._held(name, fretting.stop)
        pluck = self.model.strings[name].pluck_from_bridge
        x = min(pluck, 0.9 * length) if fretting.place is None else fretting.place
        at, n = x / length, np.pi * np.arange(1, LOWEST + 1)
        shares = 2.0 * np.sin(n * at) ** 2 / n**2 / max(at * (1.0 - at), 1e-12)
        return x * (length - x) / (tension * length), min(float(max(shares.max(), 1.0 - shares.sum())), 1.0)


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


def raising(system: System, state: State, name: str, cents: float) -> float:
    """What it takes (J) to raise a string's tension by so many cents, as it is bent now; negative for lowering it."""
    tension = next(t for t in system.tensions if t.name == name)
    total, share = 0.0, ratio_of_cents(cents) ** 2 - 1.0
    for component in tension.components:
        basis = system.compiled[system.slot(component)].basis
        q, _ = to_motion(basis, np.asarray(system.modes_of(state, component), dtype=np.float64))
        pull, part = (cast(Floats, basis.metadata[key]) for key in ("tension", "tension_part"))
        total += 0.5 * share * float(pull * (part @ (q * q)))
    return total


def affordable(system: System, state: State, name: str, given: float = 0.0) -> bool:
    """Whether a string can pay for its tension's rise, and if so, let it.

    Parameters
    ----------
    given : J, that need not be paid.
    """
    return paid(system, state, name, string_energy(system, state, name)[1] - given)


def paid(system: System, state: State, name: str, cost: float, share: float = _AFFORDABLE) -> bool:
    """Whether a string has so much (J) to give, and if so, take it: velocities fall by what is needed.

    Parameters
    ----------
    share : of its kinetic energy that may be taken.
    """
    tension = next(t for t in system.tensions if t.name == name)
    if cost <= 0.0:
        return True
    kinetic = kinetic_energy(system, state, name)
    if cost > share * kinetic:
        return False
    less = math.sqrt(1.0 - cost / kinetic)
    for component in tension.components:
        basis = system.compiled[system.slot(component)].basis
        modes = system.modes_of(state, component)
        q, v = to_motion(basis, np.asarray(modes, dtype=np.float64))
        modes[:] = from_motion(basis, q, less * v)
    ends = {f"{component}.bridge" for component in tension.components}
    share_velocities(system, state, np.array([c.name in ends for c in system.connections], dtype=bool))
    return True


def kinetic_energy(system: System, state: State, name: str) -> float:
    """Of a string whose tension may rise, J."""
    total = 0.0
    for component in next(t for t in system.tensions if t.name == name).components:
        basis = system.compiled[system.slot(component)].basis
        _, v = to_motion(basis, np.asarray(system.modes_of(state, component), dtype=np.float64))
        total += 0.5 * float(v @ v)
    return total


def largest(piece: Segment) -> float:
    """Largest |F| of a piece of force, N."""
    length = piece.stop - piece.start
    turn = -piece.c1 / (2 * piece.c2) if piece.c2 else 0.0
    times = np.array([0.0, length, turn if 0.0 < turn < length else 0.0])
    return float(np.max(np.abs(piece.c0 + times * (piece.c1 + times * piece.c2))))
