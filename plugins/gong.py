"""A gong: a rectangular plate of large deflection. After a hard blow its pitch falls and its spectrum fills.

It is played as a string is, struck by the plugin `hammer`: its places lie on a straight line across the plate, from an
edge (`bridge`, which does not move) to another, in metres along the line. All motion is across the plate. The modes are
those of a simply supported plate,

    omega = sqrt(D / rho h) pi^2 (m^2 / a^2 + n^2 / b^2),    damping rate sigma0 + sigma2 omega^2.

Those below `freq_coupled` share the energy V of the stretched middle surface (`_gong_energy`: von Karman's equations),
a potential that the engine steps with them; higher ones are stepped without it. `edges` is the support of the plate in
its plane. With Numba (``pip install "tonewood[plates]"``) V is compiled; without it, NumPy computes V at every step,
three to five times slower.

V <= K E^2, E the energy of the modes. K is the largest V / E^2 that an ascent from several motions reaches
(`stiffening`): an estimate, not a proven bound; random motions stay below it. At an energy E the pitch of a strong mode
rises by 3/4 K E, that of a weak one beside it by up to twice as much: 1.5 K E decides when `large_deflection` may be
left out.

Left out: shear, rotation and curvature of the plate; radiation is a loss alone. Valid up to deflections of some
thicknesses.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Collection, Mapping, Sequence
from functools import cached_property
from importlib.util import find_spec
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator
from tonewood.plugins._gong_energy import GongPlate, PlateGrid

import tonewood.authoring as ta

Floats = NDArray[np.float64]

#: modes that share the potential, at most: V of 600 modes costs some 30 s per second
MOST_COUPLED = 600
#: modes of the plate, at most
MOST_MODES = 5000
#: steps of the ascent to the largest V / E^2
_ASCENT = 60
#: part of the budget below which the potential is left out; above the whole of it, it comes back
_LEAVE = 0.8
#: points of the control grid between two looks
_LOOK = 16


class GongParameters(ta.Parameters):
    """Parameters of the plate."""

    sides: tuple[ta.Number, ta.Number] = ta.described("[a, b], m, between the supported edges")
    thickness: float = ta.quantity("m", low=1e-5, high=0.02, doc="of the plate")
    young: float = ta.quantity("Pa", low=1e8, high=1e12, doc="Young's modulus")
    poisson: float = ta.quantity("1", low=0.0, high=0.49, doc="Poisson's ratio")
    density: float = ta.quantity("kg/m^3", low=100.0, high=3e4, doc="of the material")
    sigma0: float = ta.quantity("1/s", low=0.0, high=1e3, doc="damping rate of low modes")
    sigma2: float = ta.quantity("s", low=0.0, high=1e-3, default=0.0, doc="damping rate per square of omega")
    edges: Literal["sliding", "movable"] = ta.described(
        "in the plane of the plate: sliding along the edge, not across it; or movable", default="sliding"
    )
    freq_coupled: float = ta.quantity(
        "Hz", low=20.0, high=2e4, default=3000.0, doc="modes below it share the potential"
    )
    line: tuple[tuple[ta.Number, ta.Number], tuple[ta.Number, ta.Number]] = ta.described(
        "[[x, y], [x, y]] of the ends of the line of places, parts of the sides", default=((0.0, 0.1), (1.0, 0.8))
    )

    @model_validator(mode="after")
    def _on_the_plate(self) -> GongParameters:
        if not all(0.02 <= side <= 5.0 for side in self.sides):
            raise ValueError("sides from 0.02 to 5 m are allowed")
        if not all(0.0 <= v <= 1.0 for end in self.line for v in end):
            raise ValueError("the ends of `line` lie on the plate: parts of the sides from 0 to 1")
        if not any(v in (0.0, 1.0) for v in self.line[0]):
            raise ValueError("`line` begins on an edge: an x or y of 0 or 1")
        if self.line[0] == self.line[1]:
            raise ValueError("`line` needs two different ends")
        return self


class PlateEnergy(ta.PotentialEnergy):
    """V of the modes of a gong that share it.

    Parameters
    ----------
    grid : V and its gradient, of the lowest modes.
    """

    def __init__(self, grid: PlateGrid):
        self.grid = grid
        self.sizes = (len(grid.numbers),)

    def gradient(self, y: Floats) -> tuple[float, Floats]:
        """V, J, and dV/dy, N / sqrt(kg), at coordinates y, m sqrt(kg)."""
        value, slope = self.grid.gradient(y)
        return value, slope

    def energy(self, y: Floats) -> float:
        """V, J, at coordinates y, m sqrt(kg)."""
        return float(self.grid.energy(y))

    def function(self) -> ta.PotentialFunction | None:
        """Return V compiled by Numba; None, with a warning, where it is not installed."""
        if find_spec("numba") is None:
            text = 'Numba is not installed: a gong takes three to five times as long; pip install "tonewood[plates]"'
            warnings.warn(text, stacklevel=2)
            return None
        from tonewood.plugins._gong_energy_numba import compiled

        return ta.PotentialFunction(compiled.ctypes, data=self.grid.packed, scratch=self.grid.scratch)


def stiffening(grid: PlateGrid, omega: Floats) -> float:
    """Return K, 1/J, the largest V / E^2 at energy E = sum (omega y)^2 / 2 of the modes that an ascent reaches.

    V is of degree 4, so that y <- Omega^-2 dV/dy, scaled to the same E, does not lower it; from the lowest modes one by
    one and from even mixtures of all.

    Parameters
    ----------
    grid : V of n modes.
    omega : (n,) rad/s.
    """
    n, largest = len(omega), 0.0
    signs = np.where(np.add.outer(np.arange(3), np.arange(n)) % 3 == 0, -1.0, 1.0)
    for start in (*np.eye(n)[:3], *signs):
        y = start / omega
        for _ in range(_ASCENT):
            y = grid.gradient(y)[1] / omega**2
            y /= math.sqrt(0.5 * float(np.sum((omega * y) ** 2)))
        largest = max(largest, grid.energy(y))
    return largest


class LargeDeflection(ta.SwitchedEffect):
    """Switches the potential of each gong with its energy.

    A gong is on from any gesture on. At looks every 1,024 samples it is left out if its energy, and that of the mallets
    at it, raises no mode by more than the budget of cents, and if the force of the potential, as a part of that of the
    modes at the same energy (4 K E at most), is within the budget of level.
    """

    def __init__(self, model: ta.Model, effect: ta.Effect, plugins: Mapping[str, ta.Plugin[Any]]):
        super().__init__(model, effect, plugins)
        self._planes = {name: model.strings[name].components for name in plugins}
        self._budget_level = self.share * 10 ** (model.choice.budget_db / 20)

    def next_watch(self, sample: int, switching: ta.Switching) -> int:
        """Return the next look: at once while a switch waits."""
        return ta.next_multiple(sample, 1 if switching.pending else _LOOK)

    def watch(self, moment: ta.Moment, switching: ta.Switching) -> ta.Watched | None:
        """Compare the rise of pitch at the energy of each gong with the budget."""
        fresh = {play.string for play in moment.fresh}
        names, bounds = set(), []
        for name in self.components:
            bound = self._bound(moment, name)
            on = name in switching.on or name in switching.pending
            part = _LEAVE if on else 1.0
            within = bound.cents <= part * self.model.choice.budget_cents and bound.level <= part * self._budget_level
            if name in fresh or (on and name in moment.busy) or not within:
                names.add(name)
            bounds.append((name, bound, name not in names))
        return ta.Watched(frozenset(names), bounds)

    def _bound(self, moment: ta.Moment, name: str) -> ta.Bound:
        system, energy, factor = moment.system, 0.0, 0.0
        # a mallet on its way may give its energy to the gong at the next moment
        for component in (c for c in system.names if system.layout.owners.get(c) == name):
            basis = system.compiled[system.slot(component)].basis
            if basis.is_real:
                q, v = _motion(system, moment.state, component)
                energy += 0.5 * float(v @ v + basis.stiffness @ (q * q))
                factor = max(factor, cast(float, basis.metadata.get("stiffening", 0.0)))
        rise = factor * energy
        return ta.Bound(1200 / math.log(2) * 1.5 * rise, 4 * rise)

    def apply(self, system: Any, on: Collection[str], frettings: Mapping[str, Any]) -> Any:
        """Switch the potentials of these gongs on, and all others off."""
        return system.with_potentials([name for name in self.components if name in on], self.components)

    def cost(self, moment: ta.Moment, component: str, on: bool) -> float:
        """Return the energy that psi holds, or V where it is off, J, with the sign of the switch."""
        system, index = moment.system, moment.system.potentials.index(component)
        energy, memory = system.joined(index), moment.state.potentials
        q, _ = _motion(system, moment.state, self._planes[component][0])
        row = memory[system.potentials.memory[index]] if memory.size else np.zeros(2)
        return (1.0 if on else -1.0) * float(energy.stored(q[: energy.n], row))

    def payers(self, component: str) -> Sequence[str]:
        """Return the gong's modes."""
        return self._planes[component]

    def reset(self, system: Any, state: Any, changed: Collection[str]) -> None:
        """Forget psi of gongs that are switched."""
        for name in changed:
            if state.potentials.size:
                state.potentials[system.potentials.memory[system.potentials.index(name)]] = 0.0

    def load(self, component: str) -> float:
        """Return the number of modes that share the potential."""
        system = self.model.system
        metadata = system.compiled[system.slot(self._planes[component][0])].basis.metadata
        return float(cast(int, metadata["coupled"]))


def _motion(system: Any, state: Any, component: str) -> tuple[Floats, Floats]:
    """(n_modes,) coordinates and their rates of a component of real modes, m sqrt(kg) and m sqrt(kg)/s."""
    per_q, first, second, *_ = system.compiled[system.slot(component)].basis.motion
    x = np.asarray(system.modes_of(state, component), dtype=np.float64)
    return per_q * x[0], first * x[0] + second * x[1]


LARGE_DEFLECTION = ta.Effect(
    "large_deflection", "stretch of a plate's middle surface: falling pitch, energy that spreads to high modes",
    "detuning", "every gesture", "the plate's energy, by which its modes' pitch rises",
    cost=lambda n: 10.0 * n, runtime=LargeDeflection,
)  # fmt: skip


class Gong(ta.Resonator[GongParameters]):
    """The gong; see the module."""

    api = 1
    effects = (LARGE_DEFLECTION,)
    Parameters = GongParameters

    @cached_property
    def plate(self) -> GongPlate:
        """The plate."""
        p = self.parameters
        return GongPlate(p.sides[0], p.sides[1], p.thickness, p.young, p.poisson, p.density)

    @property
    def length(self) -> float:
        """Length of the line of places, m."""
        return math.hypot(*(self.end - self.start))

    @cached_property
    def start(self) -> Floats:
        """(2,) m, first end of the line of places."""
        return np.multiply(self.parameters.line[0], self.parameters.sides)

    @cached_property
    def end(self) -> Floats:
        """(2,) m, last end of the line of places."""
        return np.multiply(self.parameters.line[1], self.parameters.sides)

    @property
    def tension(self) -> float:
        """Tension of a string as long as the line, with the plate's lowest frequency and impedance at a point, N.

        A plate has none; this is the number by which a hammer foresees how the plate gives way: Z = T / (2 L f) = 8
        sqrt(D rho h).
        """
        lowest = math.sqrt(self.plate.rigidity / self.plate.surface_density) * math.pi / 2
        lowest *= sum(1 / side**2 for side in self.parameters.sides)
        return 16 * self.length * lowest * math.sqrt(self.plate.rigidity * self.plate.surface_density)

    def basis(self, freq_upper: float, *, stop: float = 0.0, tension: float | None = None) -> ta.ModalBasis:
        """Modes below `freq_upper` (Hz); a plate has no stops, and `tension` changes nothing."""
        if stop != 0.0:
            raise self.fault("a gong has no stops: `stops: {kind: none}` is wanted")
        speed = math.sqrt(self.plate.rigidity / self.plate.surface_density)
        expected = self.plate.a * self.plate.b * freq_upper / (2 * speed)
        if expected > MOST_MODES:
            raise self.fault(f"has some {expected:.0f} modes below {freq_upper:g} Hz; at most {MOST_MODES} are allowed")
        numbers, omega = self.plate.modes(freq_upper)
        p, coupled = self.parameters, self._coupled(freq_upper)
        if not len(omega):
            return ta.ModalBasis.real(omega, omega, {"bridge": omega})
        if not coupled:
            raise self.fault(f"is below the lowest mode, {omega[0] / (2 * math.pi):.4g} Hz", "freq_coupled")
        return ta.ModalBasis.real(
            omega,
            p.sigma0 + p.sigma2 * omega**2,
            {"bridge": 0.0},
            shape=lambda position: self._shape(numbers, position),
            metadata={
                "length": self.length, "tension": self.tension, "numbers": numbers, "coupled": coupled,
                "stiffening": self._stiffening(coupled),
            },
        )  # fmt: skip

    def _coupled(self, freq_upper: float) -> int:
        """Number of modes below a frequency (Hz) that share the potential."""
        count = len(self.plate.modes(min(freq_upper, self.parameters.freq_coupled))[1])
        if count > MOST_COUPLED:
            raise self.fault(
                f"lets {count} modes share the potential; at most {MOST_COUPLED} are allowed", "freq_coupled"
            )
        return count

    def _shape(self, numbers: NDArray[np.intp], position: float) -> Floats:
        """(n_modes,) shape at a place of the line, m from its start, 1/sqrt(kg)."""
        x, y = self.start + position / self.length * (self.end - self.start)
        shape = self.plate.shapes(numbers, float(x), float(y))
        return np.where(np.abs(shape) > 1e-12 * np.abs(shape).max(initial=0.0), shape, 0.0) if position else 0.0 * shape

    def grid(self, count: int) -> PlateGrid:
        """Return V of the lowest modes, `count` of them."""
        numbers, _ = self.plate.modes(self.parameters.freq_coupled)
        return PlateGrid(self.plate, numbers[:count], self.parameters.edges)

    def _stiffening(self, count: int) -> float:
        if count == 0:
            return 0.0
        _, omega = self.plate.modes(self.parameters.freq_coupled)
        inputs = {**self.parameters.model_dump(mode="json", include=set(_OF_ENERGY)), "count": count}
        arrays = ta.cached_arrays(inputs, lambda: {"K": np.array([stiffening(self.grid(count), omega[:count])])})
        return float(arrays["K"][0])

    def potentials(self, string: ta.StringMotion) -> Sequence[ta.Potential]:
        """Return the energy of the stretched middle surface."""
        if len(string.planes) != 1:
            raise self.fault("moves across itself alone: `polarizations: [z]` is wanted", "polarizations")

        def energy(bases: Sequence[ta.ModalBasis]) -> PlateEnergy:
            return PlateEnergy(self.grid(min(cast(int, bases[0].metadata["coupled"]), bases[0].n_modes)))

        return [ta.ModalPotential(string.name, string.planes, energy, effect=LARGE_DEFLECTION.name)]

    def detuned(self, basis: ta.ModalBasis, tension: float) -> ta.ModalBasis:
        """`basis` itself: a plate has no tension at rest."""
        return basis

    def transfer(self, old: ta.ModalBasis, new: ta.ModalBasis) -> tuple[Floats, Floats]:
        """Nothing changes."""
        same = np.eye(new.n_modes, old.n_modes)
        return same, same


#: parameters on which V depends
_OF_ENERGY = ("sides", "thickness", "young", "poisson", "density", "edges", "freq_coupled")
