"""Descriptions of systems for the kernel, in which parts that have not changed are not described again."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.coupling.connections import NonlinearGaps
from tonewood.physics.coupling.inverse import Hub, InverseInParts
from tonewood.physics.coupling.laws import NonlinearLaw
from tonewood.physics.coupling.potentials.base import Kind
from tonewood.physics.coupling.system import Compiled, System
from tonewood.physics.stepping.description import (
    Description,
    OwnTerms,
    PortSets,
    describe_component,
    describe_linear,
    describe_potentials,
    law_arrays,
    sort_ports,
)
from tonewood.support.arrays import Floats

_NONE = np.zeros(0, dtype=np.intp)
_NO_MATRIX = np.zeros((0, 0))
#: linear and nonlinear connections in use, which of these are contacts, slots stepped sample by sample; hub, its ports
_Use = tuple[bytes, bytes, bytes, frozenset[int], tuple[int, bytes] | None]
#: ways in which all connections are used that are remembered
_KEPT_PORT_SETS = 64
#: (n, 4): nonlinear connection, component, port among its fixed or contact ports, whether it is a contact port; factors
Terms = tuple[NDArray[np.int64], Floats]
#: slot of a component, whether laws act on its fixed ports, and how connections use it
_Key = tuple[int, bool, bytes]


class KeptDescriptions:
    """Describes one system after another, each made of the one before.

    shortcuts : name -> whether it is on.
    """

    def __init__(self, shortcuts: dict[str, bool]):
        self._shortcuts = shortcuts
        self._descriptions: WeakKeyDictionary[Compiled, dict[_Key, Description]] = WeakKeyDictionary()
        self._keys = count()
        self._port_sets: dict[tuple[int, bytes, bytes], tuple[PortSets, OwnTerms]] = {}
        self._sorted_for: dict[_Use, tuple[list[PortSets], Terms]] = {}
        self._nonlinear = self._active = _NONE
        self._laws: tuple[NonlinearLaw, ...] = ()
        self._law_arrays: Description = law_arrays(())
        self._gaps: tuple[NonlinearGaps, bytes, Description] | None = None

    def of(self, system: System, cached: frozenset[int] = frozenset()) -> Description:
        """Describe a system; components with a key among `cached` come without arrays."""
        self._nonlinear = _NONE if system.nonlinear is None else system.nonlinear.index
        self._active = system.solve.on
        by, potentials = system.solve.by, describe_potentials(system)
        hub = by.hub if isinstance(by, InverseInParts) else None
        in_parts = hub is None or not any(hub.slot in p["slots"] for p in potentials if p["kind"] != Kind.PHANTOM)
        hub = hub if in_parts else None
        # these are stepped sample by sample: contacts on them are never left out, and have fixed ports
        by_sample = (p["slots"] for p in potentials if p["kind"] in (Kind.LONGITUDINAL, Kind.USER))
        coupled = frozenset(slot for slots in by_sample for slot in slots)
        port_sets, terms = self._sorted_ports(system, hub, coupled)
        weights = system.layout.force_weights
        components = self._components(system, port_sets, terms)
        return {
            "components": [{"key": c["key"]} if c["key"] in cached else c for c in components],
            "linear": describe_linear(system.solve, weights, port_sets, in_parts),
            "nonlinear": self._laws_and_gaps(system, terms, np.ascontiguousarray(weights[:, self._nonlinear])),
            "potentials": potentials,
            "shortcuts": self._shortcuts,
        }

    def _laws_and_gaps(self, system: System, terms: Terms, weights: Floats) -> Description:
        """Describe the nonlinear connections; unchanged arrays are those of the last description."""
        nonlinear, on = system.nonlinear, self._active
        laws: tuple[NonlinearLaw, ...] = () if nonlinear is None else nonlinear.laws
        if laws is not self._laws:
            self._law_arrays = law_arrays(laws, self._laws, self._law_arrays)
            self._laws = laws
        key = on.tobytes()
        if nonlinear is None:
            no = np.zeros((0, len(on)))
            gaps: Description = {"theta": 0.5, "compliance": _NO_MATRIX, "from_linear": no}
            gaps |= {"to_linear": no.T.copy(), "residual": _NO_MATRIX}
        elif self._gaps is not None and self._gaps[0] is nonlinear.gaps and self._gaps[1] == key:
            gaps = self._gaps[2]
        else:
            g = nonlinear.gaps
            parts = ("compliance", g.compliance), ("from_linear", g.from_linear[:, on]), ("to_linear", g.to_linear[on])
            gaps = {"theta": g.laws.theta, "residual": np.ascontiguousarray(g.residual)}
            gaps |= {name: np.ascontiguousarray(a) for name, a in parts}
            self._gaps = g, key, gaps
        index, factors = terms
        return {"dt": system.dt, "terms": index, "factors": factors, "weights": weights, **self._law_arrays, **gaps}

    def _components(self, system: System, port_sets: Sequence[PortSets], terms: Terms) -> list[Description]:
        """Describe every component; a component that comes back with the same sets of ports keeps its description."""
        loaded = {slot for _, slot, _, on_contact in terms[0].tolist() if not on_contact}
        out: list[Description] = []
        parts = zip(system.compiled, system.layout.driven, port_sets, strict=True)
        for slot, (compiled, one_way, sets) in enumerate(parts):
            descriptions = self._descriptions.setdefault(compiled, {})
            if (key := (slot, slot in loaded, sets.key)) not in descriptions:
                descriptions[key] = {"key": next(self._keys), "offset": system.layout.offsets[slot], "driven": one_way}
                descriptions[key] |= describe_component(compiled, sets, one_way, slot in loaded)
            out.append(descriptions[key])
        return out

    def _sorted_ports(self, system: System, hub: Hub | None, coupled: frozenset[int]) -> tuple[list[PortSets], Terms]:
        """Sort the ports of every component by the connections now in use.

        A component whose connections are used as before keeps its sets of ports: a note changes a few of hundreds.
        Where all are used as some time before (a finger comes and goes), all of it is kept.
        """
        is_contact = system.elimination.others.is_contact
        met = None if hub is None else (hub.slot, hub.ports.tobytes())
        use = self._active.tobytes(), self._nonlinear.tobytes(), is_contact.tobytes(), coupled, met
        if use not in self._sorted_for:
            while len(self._sorted_for) >= _KEPT_PORT_SETS:
                del self._sorted_for[next(iter(self._sorted_for))]
            self._sorted_for[use] = self._sort_ports(system, hub, is_contact, coupled)
        return self._sorted_for[use]

    def _sort_ports(
        self, system: System, hub: Hub | None, is_contact: NDArray[np.bool_], coupled: frozenset[int]
    ) -> tuple[list[PortSets], Terms]:
        m = len(system.connections)
        index, law, culled = np.full(m, -1), np.full(m, -1), np.zeros(m, dtype=bool)
        index[self._active], law[self._nonlinear] = np.arange(len(self._active)), np.arange(len(self._nonlinear))
        culled[self._nonlinear] = is_contact
        use = np.stack([index, np.where(law < 0, 0, 1 + culled)], axis=1)
        port_sets: list[PortSets] = []
        terms: list[tuple[int, int, int, bool]] = []
        factors: list[float] = []
        for slot, one_way in enumerate(system.layout.driven):
            at, shares = system.layout.touching[slot]
            ports = hub.ports if hub is not None and hub.slot == slot else None
            used = use[at]
            way = f"{len(self._active)} {one_way or slot in coupled} {slot in coupled}".encode()
            key = slot, used.tobytes(), way + (b"" if ports is None else ports.tobytes())
            if key not in self._port_sets:
                self._port_sets[key] = sort_ports(shares, used, len(self._active), slot in coupled, one_way, ports)
            sets, numbers = self._port_sets[key]
            port_sets.append(sets)
            for i, port, on_contact, factor in numbers:
                terms.append((int(law[at[i]]), slot, port, on_contact))
                factors.append(factor)
        return port_sets, (np.array(terms, dtype=np.int64).reshape(-1, 4), np.array(factors))
