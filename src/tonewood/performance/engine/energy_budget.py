"""Energy budget of an engine: stored energy by component, the work of gestures, losses, and the energy of changes."""

from __future__ import annotations

from typing import Any

from tonewood.instrument.model.assembly import Model
from tonewood.performance.engine.in_progress import GesturesInProgress
from tonewood.performance.player.gestures import Active, places
from tonewood.physics.coupling.system import State, System
from tonewood.physics.energy.account import EnergyAccount, EnergyTrace, KnownForce
from tonewood.support.arrays import Floats


class EnergyBudget:
    """Keeps an `EnergyAccount` while an engine steps; it reads the engine's state and never writes it.

    system, state : where it begins.
    model : of the engine.
    """

    def __init__(self, system: System, state: State, model: Model):
        self.model = model
        driven: dict[str, list[str]] = {}
        for entries in model.inputs.values():
            for component, point, _ in entries:
                driven.setdefault(component, []).append(point)
        self.account = EnergyAccount(system, state.copy(), driven_points=driven)

    def changed(self, label: str, system: System, state: State) -> None:
        """Go on with a changed system or state, and enter the energy that the change added under `label`."""
        self.account.exchange(system)
        self.account.book_change(label, state)

    def follow(self, before: State, after: State, forces: Floats, gestures: GesturesInProgress) -> None:
        """Enter the steps between two states, and the work of the gestures in progress."""
        known_forces = [force for active in gestures.active for force in self._known(active)]
        self.account.follow(before, after, forces, gestures.injections, known_forces, gestures.controls)

    def trace(self) -> EnergyTrace:
        """The account so far."""
        return self.account.trace()

    def _known(self, active: Active) -> list[KnownForce]:
        """Forces of a gesture on components that are stepped and move both ways."""
        play, system = active.play, self.account.system
        label = f"{play.string or play.at or 'gesture'} played"
        moving = [
            (component, point, factor)
            for component, point, factor in places(play, self.model)
            if not system.layout.driven[system.slot(component)]
        ]
        pieces: list[Any] = [p for p in (play.gesture.segments, play.gesture.noise) if p]
        return [KnownForce(label, c, point, p, play.time, factor) for c, point, factor in moving for p in pieces]
