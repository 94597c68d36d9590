"""How strings are held: their bases, and the projection of their motion when that changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from tonewood.instrument.model.assembly import Model
from tonewood.instrument.model.strings import StringModel
from tonewood.performance.player.timeline import Change
from tonewood.physics.coupling.connections import Connection
from tonewood.physics.coupling.inverse import scaled_pinv
from tonewood.physics.coupling.system import Compiled, State, System
from tonewood.physics.energy.stored import gaps
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.points import damped
from tonewood.physics.stepping.motion import from_motion, to_motion
from tonewood.support.arrays import Floats

#: component -> force of its bridge on a string's end, N
ForceAtBridge = Callable[[str], float]

#: compiled bases that are kept for use again, and of those of each string
_CACHE, _WAYS = 768, 10


@dataclass(frozen=True, slots=True)
class Fretting:
    """How a string is held now.

    stop : number of the stop, 0 open; a fraction where stops are continuous.
    cents : bend from the stop's own pitch.
    added_damping : 1/s, added to every mode's decay rate.
    place : m from the bridge, of the plucking finger; None for the usual one.
    touches : (point, m from the bridge), ...: points of the string that lie elsewhere than their part says.
    width : m, of the plucking finger's contact.
    damper : share of its damper's loss, 0 where that is lifted.
    """

    stop: float = 0.0
    cents: float = 0.0
    added_damping: float = 0.0
    place: float | None = None
    touches: tuple[tuple[str, float], ...] = ()
    width: float = 0.0
    damper: float = 0.0

    @property
    def unplucked(self) -> Fretting:
        """Return the fretting with the usual position of the pluck."""
        return replace(self, place=None, width=0.0)

    def changed(self, change: Change) -> Fretting:
        """Return it after a change of the left hand."""
        return replace(
            self,
            stop=self.stop if change.stop is None else change.stop,
            cents=self.cents if change.cents is None else change.cents,
            added_damping=self.added_damping if change.added_damping is None else change.added_damping,
            touches=self.touches if change.touches is None else change.touches,
            damper=self.damper if change.damper is None else change.damper,
        )


def at_rest(string: StringModel) -> Fretting:
    """Fretting of a string that is not being played: under its damper, if it has one."""
    return Fretting(damper=0.0 if string.places.damper is None else 1.0)


class FrettedBases:
    """A model's strings as they can be held: bases are compiled when first wanted, and the last `room` are kept."""

    def __init__(self, model: Model):
        self.model, system = model, model.system
        self.room = max(_CACHE, _WAYS * len(model.strings))
        # the strings of the model are open and untouched
        self._compiled: dict[tuple[str, Fretting], dict[str, Compiled]] = {
            (name, Fretting()): {c: system.compiled[system.slot(c)] for c in string.components}
            for name, string in model.strings.items()
        }
        #: of each way to hold a string, wherever it is plucked: the last bases made
        self._held: dict[tuple[str, Fretting], dict[str, Compiled]] = {}
        #: those that are kept for good
        self._prepared: dict[tuple[str, Fretting], dict[str, Compiled]] = {}

    def prepare(self, name: str, fretting: Fretting) -> None:
        """Compile the bases of a way to hold a string, and keep them for good."""
        self._prepared[name, fretting] = self.bases(name, fretting)

    def playable(self, name: str, fretting: Fretting) -> Fretting:
        """Return it without the finger's place where that is the usual one, or not on the string's speaking part."""
        if fretting.place is None:
            return fretting
        string = self.model.strings[name]
        length = string.length(fretting.stop)
        usual = fretting.place == min(string.places.pluck, 0.9 * length)
        return replace(fretting, place=None) if usual or fretting.place > length else fretting

    def bases(self, name: str, fretting: Fretting) -> dict[str, Compiled]:
        """Return component -> compiled basis of a string as it is held."""
        key = (name, fretting)
        if (kept := self._prepared.get(key)) is not None:
            return kept
        if key not in self._compiled:
            bases = self._new(name, fretting)
            if len(self._compiled) >= self.room:
                oldest, way = next(iter(self._compiled))
                dropped = self._compiled.pop((oldest, way))
                if self._held.get((oldest, way.unplucked)) is dropped:
                    del self._held[oldest, way.unplucked]
            self._compiled[key] = self._held[name, fretting.unplucked] = bases
        return self._compiled[key]

    def _new(self, name: str, fretting: Fretting) -> dict[str, Compiled]:
        """Compile the bases of a string; where only its pluck is elsewhere, from those that it had before."""
        system, compiled = self.model.system, self._held.get((name, fretting.unplucked))
        if compiled is None:
            return {c: system.compile(c, basis) for c, basis in self._uncompiled(name, fretting).items()}
        before = {c: part.basis for c, part in compiled.items()}
        bases = self.model.strings[name].modes.plucked_at(before, fretting.stop, fretting.place, fretting.width)
        return {
            c: compiled[c] if basis is before[c] else system.compile(c, basis, like=compiled[c])
            for c, basis in bases.items()
        }

    def _uncompiled(self, name: str, fretting: Fretting) -> dict[str, ModalBasis]:
        if fretting.damper:
            free = self.bases(name, replace(fretting, damper=0.0))
            undamped = {c: part.basis for c, part in free.items()}
            return self.model.strings[name].modes.under_damper(undamped, fretting.damper)
        if fretting.added_damping:
            ringing = self.bases(name, replace(fretting, added_damping=0.0))
            return damped({c: compiled.basis for c, compiled in ringing.items()}, fretting.added_damping)
        return self.model.strings[name].bases(
            fretting.stop,
            bend_cents=fretting.cents,
            pluck_from_bridge=fretting.place,
            pluck_width=fretting.width,
            touches=dict(fretting.touches),
        )

    def laws(self, name: str, fretting: Fretting) -> dict[str, Connection]:
        """Return the connections that always touch a string, with their laws at its stop."""
        touching = self.model.strings[name].connections(fretting.stop)
        return {c.name: c for c in touching if c.name not in self.model.resting}

    def fretted(self, system: System, frettings: Mapping[str, Fretting], restopped: Mapping[str, Fretting]) -> System:
        """Return a system with strings held like this; `restopped` ones get the laws of their stop, too."""
        if not frettings:
            return system
        changes: dict[str, Compiled] = {}
        laws: dict[str, Connection] = {}
        for name, fretting in frettings.items():
            changes |= self.bases(name, fretting)
        for name, fretting in restopped.items():
            laws |= self.laws(name, fretting)
        changed = system.with_compiled(changes)
        return changed.with_laws(laws) if laws else changed

    def carried(
        self, name: str, before: Fretting, after: Fretting, modes: Mapping[str, Floats], bridge_force: ForceAtBridge
    ) -> dict[str, Floats]:
        """Project the motion of a string to the bases of another way to hold it.

        modes : component -> (2, n_modes) as it is stepped before.
        bridge_force : component -> N, of the bridge on its end, see `bridge_forces`; called only where modes come back.
        Returns Component -> (2, n_modes) as it is stepped after.
        """
        old, new = self.bases(name, before), self.bases(name, after)
        if before.stop == after.stop:
            return {c: _resized(old[c].basis, new[c].basis, modes[c], c, bridge_force) for c in new}
        string, out = self.model.strings[name], {}
        old_whole, new_whole = self._whole(name, before), self._whole(name, after)
        for component, compiled in new.items():
            basis = old_whole[component]
            q, v = to_motion(basis, _resized(old[component].basis, basis, modes[component], component, bridge_force))
            q, v = string.carried(component, basis, new_whole[component], q, v)
            n = compiled.basis.n_modes
            out[component] = from_motion(compiled.basis, q[:n], v[:n])
        return out

    def _whole(self, name: str, fretting: Fretting) -> dict[str, ModalBasis]:
        """Return the bases with those modes that lie above the limit at this tension."""
        compiled = {c: part.basis for c, part in self.bases(name, fretting).items()}
        string = self.model.strings[name]
        whole = string.n_modes(fretting.stop)
        if all(compiled[p.component].n_modes == whole for p in string.polarizations):
            return compiled
        return string.bases(fretting.stop, bend_cents=fretting.cents, whole=True)


def bridge_forces(system: System, state: State) -> ForceAtBridge:
    """Return the forces of bridges on strings' ends, N, from the residual compliance; all are solved for at once."""

    @cache
    def forces() -> dict[str, float]:
        rigid = system.elimination.linear.rigid
        R = system.elimination.gap.residual[np.ix_(rigid, rigid)]
        force = -scaled_pinv(R) @ gaps(system, state)[rigid]
        components = [c.terms[0].component for c, on in zip(system.connections, rigid, strict=True) if on]
        return dict(zip(components, force.tolist(), strict=True))

    return lambda component: forces()[component]


def _resized(old: ModalBasis, new: ModalBasis, modes: Floats, component: str, bridge_force: ForceAtBridge) -> Floats:
    """Return the modes' numbers for the same shapes at other frequencies or decay rates.

    Modes that leave the basis lose their energy, and their compliance goes into the residual. Modes that come back are
    displaced as the residual was under the `bridge_force` on the string's end (N), so that they bring no energy.
    """
    n = min(old.n_modes, new.n_modes)
    if old.poles is new.poles or np.array_equal(old.poles, new.poles):
        return modes
    q, v = to_motion(old, modes)
    if old.n_modes == new.n_modes:
        return from_motion(new, q, v)
    full_q, full_v = np.zeros(new.n_modes), np.zeros(new.n_modes)
    full_q[:n], full_v[:n] = q[:n], v[:n]
    if new.n_modes > n:
        end, old_end = new.index("bridge"), old.index("bridge")
        shape = new.right[end, n:].real
        static = shape / new.stiffness[n:]
        softer = old.residual[old_end, old_end] - new.residual[end, end]
        full_q[n:] = static * (bridge_force(component) * softer / (shape @ static))
    return from_motion(new, full_q, full_v)
