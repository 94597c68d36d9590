"""Connections of attachments that are switched string by string: base classes for effects of plugins."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from tonewood.instrument.contract.base import Plugin
from tonewood.instrument.contract.effects import Effect
from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects.base import Moment, SwitchedEffect, Switching, Watched, next_multiple
from tonewood.performance.effects.gesture_connections import with_laws
from tonewood.performance.effects.switching import motion
from tonewood.performance.effects.usage import Bound
from tonewood.performance.player.fretting import Fretting
from tonewood.performance.player.timeline import GRID
from tonewood.physics.coupling.connections import Law, SpringDashpot
from tonewood.physics.coupling.laws import PotentialLaw
from tonewood.physics.coupling.system import State, System
from tonewood.physics.energy.stored import gaps
from tonewood.support.arrays import Floats

#: law of a connection that is switched off: no force
_NONE = SpringDashpot()


class SwitchedConnections(SwitchedEffect, ABC):
    """An effect that is all connections of some attachments, switched on and off string by string.

    A subclass says when, in `next_watch` and `watch`. Off, a connection has no force and its kernel no port to solve
    for. Switching it on costs the potential of its law at the gap as it is, U(offset - g), which the string's kinetic
    energy pays; switching it off loses that potential.

    Parameters
    ----------
    model, effect, plugins : as for `RuntimeEffect`; `plugins` are the attachments.
    """

    def __init__(self, model: Model, effect: Effect, plugins: Mapping[str, Plugin[Any]]):
        super().__init__(model, effect, plugins)
        places: dict[str, list[int]] = defaultdict(list)
        for j, connection in enumerate(model.system.connections):
            if connection.part in plugins:
                places[connection.owner].append(j)
        self._places = dict(places)
        self._laws: dict[tuple[str, float], list[Law]] = {}

    @property
    def components(self) -> tuple[str, ...]:
        """Strings that have such connections; the parts themselves where they are left out by choice."""
        return tuple(self._places) if self.chosen else tuple(self.plugins)

    def names(self, string: str) -> list[str]:
        """Return the names of a string's connections, ``STRING.PART.NAME``."""
        return [self.model.system.connections[j].name for j in self._places[string]]

    def laws(self, string: str, fretting: Fretting) -> list[Law]:
        """Return the laws of a string's connections that are on, in the order of `names`; `fretting` has the stop."""
        key = string, fretting.stop
        if key not in self._laws:
            here = {c.name: c.law for c in self.model.strings[string].connections(fretting.stop)}
            self._laws[key] = [here[name] for name in self.names(string)]
        return self._laws[key]

    def excursion(self, system: System, state: State, string: str) -> Floats:
        """Return a bound on the share of a string's planes in the gaps of its connections, in the order of `names`, m.

        A motion of energy E displaces a point by sqrt(2 E C) at most, C = sum phi^2 / omega^2 the static compliance of
        its modes there (inequality of Cauchy and Schwarz). The bound holds until the string is given energy.

        Parameters
        ----------
        system, state : as they are stepped.
        string : name.

        Returns
        -------
        (n_connections,) m.
        """
        planes, doubled = self.model.strings[string].components, 0.0
        for component in planes:
            q, v = motion(system, state, component)
            doubled += float(v @ v + system.compiled[system.slot(component)].basis.stiffness @ (q * q))
        out = np.zeros(len(self._places[string]))
        for i, j in enumerate(self._places[string]):
            compliance = 0.0
            for term in system.connections[j].terms:
                if term.component in planes:
                    basis = system.compiled[system.slot(term.component)].basis
                    shape = term.factor * basis.right[basis.index(term.point)].real
                    compliance += float(shape @ (shape / basis.stiffness))
            out[i] = np.sqrt(doubled * compliance)
        return out

    def apply(self, system: System, on: Collection[str], frettings: Mapping[str, Fretting]) -> System:
        """Give the connections of these strings their laws, and all others none."""
        changes: list[tuple[int, Law]] = []
        for string, places in self._places.items():
            laws = self.laws(string, frettings[string]) if string in on else [_NONE] * len(places)
            changes += zip(places, laws, strict=True)
        return with_laws(system, changes)

    def cost(self, moment: Moment, component: str, on: bool) -> float:
        """Return the potential of the laws that are switched, J, with the sign of the switch.

        On, they are those of the string's stop; the residual compliance of the components can only lower it.
        """
        gap, total = gaps(moment.system, moment.state), 0.0
        laws = self.laws(component, moment.frettings[component])
        for j, law in zip(self._places[component], laws, strict=True):
            if isinstance(law, SpringDashpot):
                total += 0.5 * law.stiffness * float(gap[j] - law.offset) ** 2
            elif isinstance(law, PotentialLaw):
                total += law.energy(law.offset - float(gap[j]))
        return total if on else -total

    def reset(self, system: System, state: State, changed: Collection[str]) -> None:
        """Forget the slip and the yield in series of connections that have just been switched."""
        for j in (j for string in changed for j in self._places[string]):
            for memory in (state.series, state.slip):
                memory[j : j + 1] = 0.0

    def payers(self, component: str) -> Sequence[str]:
        """Return the string's planes."""
        return self.model.strings[component].components

    def load(self, component: str) -> float:
        """Return the number of connections."""
        return float(len(self._places.get(component, ())))


class ConnectionsInReach(SwitchedConnections):
    """Connections whose laws have no force while the string moves little: switched on before it can reach them.

    A subclass says how far that is, in `reach`. Where a bound on the string's excursion (`excursion`) stays below half
    of the reach, the connection is off and nothing is lost; every gesture on the string switches it on. Parts with
    masses of their own, which could come to the string while it rests, need a `watch` of their own.
    """

    #: shares of the reach: a connection is switched on above the first and off below the second. The energy of a string
    #: that nobody plays would have to grow fourfold from one look to the next to reach it unseen
    ON, OFF = 0.5, 0.4
    #: points of the control grid between two looks; the second where all connections are on, since switching one off
    #: late loses only time
    LOOK, SELDOM = 16, 64

    @abstractmethod
    def reach(self, connection: str) -> float:
        """Return the string's share in the gap of a connection below which its law has no force, m.

        Parameters
        ----------
        connection : its name, ``STRING.PART.NAME``; `parameters` has those of its part.
        """

    def parameters(self, connection: str) -> Any:
        """Return the parameters of the part that a connection belongs to."""
        part = next(c.part for c in self.model.system.connections if c.name == connection)
        return self.plugins[part].parameters

    def next_watch(self, sample: int, switching: Switching) -> int:
        """Look at all strings at fixed samples, whatever is played."""
        return next_multiple(sample, self._looks(switching))

    def watch(self, moment: Moment, switching: Switching) -> Watched | None:
        """Compare bounds on the excursion with the reach; gestures switch a string's connections on at once."""
        if moment.sample % (GRID * self._looks(switching)) and not (moment.moved or moment.fresh):
            return None
        active = set(moment.busy) & set(self.components)
        for string in self.components:
            share = self.ON if string not in switching.on else self.OFF
            reach = np.array([self.reach(name) for name in self.names(string)])
            if np.any(self.excursion(moment.system, moment.state, string) > share * reach):
                active.add(string)
        return Watched(frozenset(active), [(s, Bound(), s not in active) for s in self.components])

    def _looks(self, switching: Switching) -> int:
        return self.LOOK if len(switching.on) < len(self.components) else self.SELDOM
