"""The potentials of a system, and which of them act."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from tonewood.physics.coupling.potentials.base import Potential
from tonewood.physics.coupling.potentials.user import ModalPotential
from tonewood.support.arrays import Floats


@dataclass(frozen=True, eq=False)
class Potentials:
    """Potentials of any kinds, in a fixed order.

    each : the potentials.
    on : which of them act.
    """

    each: tuple[Potential, ...] = ()
    on: tuple[bool, ...] = ()

    def __iter__(self) -> Iterator[Potential]:
        return iter(self.each)

    def __len__(self) -> int:
        return len(self.each)

    def __getitem__(self, index: int) -> Potential:
        return self.each[index]

    @classmethod
    def of(cls, potentials: Iterable[Potential], components: Collection[str], driven: Collection[str]) -> Potentials:
        """Check potentials against the components of a system, and switch all of them on.

        driven : components that are driven one way.
        Raises ValueError : two have one name, or a component is missing, driven one way, or of another potential.
        """
        each = tuple(potentials)
        if len({p.name for p in each}) != len(each):
            raise ValueError("two potentials have the same name")
        owned = [name for p in each for name in p.components]
        for p in each:
            for name in (*p.components, *p.targets):
                if name not in components or name in driven or owned.count(name) > (name in p.components):
                    raise ValueError(f"{p.name}: a potential needs two-way components of its own, not {name!r}")
        return cls(each, (True,) * len(each))

    def switched(self, names: Collection[str], among: Collection[str] | None = None) -> Potentials:
        """Return the potentials with `names` on and all others off; with `among`, only those names are changed.

        Raises ValueError : there is no potential of a name.
        """
        there = [p.name for p in self.each]
        if unknown := set(names) - set(there):
            raise ValueError(f"no potential {sorted(unknown)}; there are {there}")
        changed = there if among is None else among
        pairs = zip(there, self.on, strict=True)
        on = tuple(name in names if name in changed else was for name, was in pairs)
        return self if on == self.on else Potentials(self.each, on)

    def index(self, name: str) -> int:
        """Index of a potential."""
        return next(i for i, p in enumerate(self.each) if p.name == name)

    @cached_property
    def two_way(self) -> tuple[int, ...]:
        """Indices of those that act on their own components now: their psi is put back every 64 steps."""
        return tuple(i for i, (p, on) in enumerate(zip(self.each, self.on, strict=True)) if on and not p.one_way)

    @cached_property
    def one_way(self) -> tuple[int, ...]:
        """Indices of those that are driven and act on other components now."""
        return tuple(i for i, (p, on) in enumerate(zip(self.each, self.on, strict=True)) if on and p.one_way)

    @cached_property
    def user(self) -> tuple[int, ...]:
        """Indices of the potentials written by users that act now."""
        return tuple(i for i in self.two_way if isinstance(self.each[i], ModalPotential))

    @cached_property
    def memory(self) -> tuple[slice, ...]:
        """Place of each potential's numbers in `State.potentials`."""
        ends = np.cumsum([0, *(p.memory for p in self.each)]).tolist()
        return tuple(slice(*pair) for pair in pairwise(ends))

    def checked(self, memory: Floats) -> Floats:
        """Return a state's numbers if they are as many as these potentials have, else zeros; 0 where one is off.

        The argument is not changed.
        """
        size = self.memory[-1].stop if self.memory else 0
        memory = memory if memory.size == size else np.zeros(size)
        off = [block for block, on in zip(self.memory, self.on, strict=True) if not on and memory[block].any()]
        if off:
            memory = memory.copy()
            for block in off:
                memory[block] = 0.0
        return memory
