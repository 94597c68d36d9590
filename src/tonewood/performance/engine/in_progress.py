"""Gestures in progress: their known forces, the partners that they move, and the fingers that hold strings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.gestures import Active, courses, cut, forces, hold_steps, samples
from tonewood.performance.player.timeline import Play
from tonewood.physics.coupling.system import Injection, PrescribedMotion, System


@dataclass(eq=False)
class GesturesInProgress:
    """Gestures that have begun, and what they do to the system now.

    active : gestures that have begun and are not over.
    injections, controls : their forces and prescribed motions, compiled.
    holds : string -> damping (N s/m) of the finger that holds it now.
    """

    active: list[Active] = field(default_factory=list)
    injections: list[Injection] = field(default_factory=list)
    controls: list[PrescribedMotion] = field(default_factory=list)
    holds: dict[str, float] = field(default_factory=dict)

    def copy(self) -> GesturesInProgress:
        """Return an independent copy."""
        return GesturesInProgress(list(self.active), list(self.injections), list(self.controls), dict(self.holds))

    @property
    def strings(self) -> set[str]:
        """Strings on which a gesture acts; empty text for one that acts on none."""
        return {active.play.string or "" for active in self.active}

    def begin(
        self, fresh: Sequence[Play], moved: Collection[str], model: Model, system: System, now: int, *, dampers: bool
    ) -> None:
        """Begin gestures at a sample.

        A string is held by one finger at a time: a new gesture ends the one before it. The rest of a gesture on a
        string of `moved` is compiled anew.

        fresh : gestures.
        moved : strings whose fretting changes at this sample.
        dampers : whether fingers hold strings.
        """
        struck = {play.string for play in fresh if play.string is not None}
        called = struck | set(moved)
        again = [a.play for a in self.active if a.play.string in called - struck]
        self.active = [a for a in self.active if a.play.string not in struck]
        owners, connections = system.layout.owners, system.connections
        self.injections = [cut(i, now) if owners.get(i.component) in called else i for i in self.injections]
        self.injections = [i for i in self.injections if i.stop > max(now, i.start)]
        places = system.layout.places
        self.controls = [c for c in self.controls if connections[places[c.connection]].owner not in called]
        for play in (*again, *fresh):
            self.injections += forces(play, model, system, now)
            self.controls += courses(play, system.dt, now)
        for play in fresh:
            holds = hold_steps(play, system.dt) if dampers else ()
            self.active.append(Active(play, samples(play.stop, system.dt), holds))

    def end(self, now: int) -> None:
        """Forget forces and motions that are over at a sample."""
        self.injections = [i for i in self.injections if i.stop > now]
        self.controls = [c for c in self.controls if c.stop > now]
