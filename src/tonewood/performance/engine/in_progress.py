"""Gestures in progress: their known forces, the partners that they move, and the fingers that hold strings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.gestures import Active, courses, forces, hold_steps, samples
from tonewood.performance.player.timeline import GRID, Play
from tonewood.physics.coupling.system import Injection, PrescribedMotion, System

#: samples for which forces and motions are computed at once
WINDOW = 128 * GRID
_Acting = TypeVar("_Acting", Injection, PrescribedMotion)


@dataclass(eq=False)
class GesturesInProgress:
    """Gestures that have begun, and what they do to the system now.

    active : gestures that have begun and are not over.
    injections, controls : their forces and prescribed motions, compiled as far as they were reached.
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
        self.injections = [i for i in self.injections if owners.get(i.component) not in called and i.stop > now]
        places = system.layout.places
        self.controls = [c for c in self.controls if connections[places[c.connection]].owner not in called]
        for play in (*again, *fresh):
            self.injections += forces(play, model, system, now, window=WINDOW)
            self.controls += courses(play, system.dt, now, window=WINDOW)
        for play in fresh:
            holds = hold_steps(play, system.dt) if dampers else ()
            self.active.append(Active(play, samples(play.stop, system.dt), holds))

    def reach(self, until: int) -> None:
        """Compile forces and motions as far as a sample, before it is reached."""
        self.injections = _reaching(self.injections, until)
        self.controls = _reaching(self.controls, until)

    def end(self, now: int) -> None:
        """Forget forces and motions that are over at a sample."""
        self.injections = [i for i in self.injections if i.stop > now]
        self.controls = [c for c in self.controls if c.stop > now]


def _reaching(acting: Sequence[_Acting], until: int) -> list[_Acting]:
    out = list[_Acting]()
    for window in acting:
        while window.further and window.stop <= until:
            out.append(replace(window, further=None))
            window = window.further()
        out.append(window)
    return out
