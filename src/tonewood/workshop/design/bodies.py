"""Bodies as functions of free parameters: their resonances, and these on both sides of each parameter's value.

A drawn body is `tonewood.physics.plate.whole_body` on a grid of cells that does not change, coarser than that of a full
computation; a measured one is its table of modes with the lumps of `body.added`, by
`tonewood.physics.modal.lump_changes.lump_change`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from tonewood.errors import BundleError, TonewoodError
from tonewood.instrument.bundle.added import Poly, body_parts, point_factor, stiffness_rate
from tonewood.instrument.bundle.loading import Instrument
from tonewood.physics.modal.lump_changes import lump_change
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.views import SHOWN_TO
from tonewood.physics.plate.body import BodyDrawing
from tonewood.physics.plate.whole_body import LowModes, Lump, WholeBody, body_change, with_cells
from tonewood.support.arrays import Complexes, Floats
from tonewood.workshop.design.figures import DrawnResonances, Resonances
from tonewood.workshop.design.task import Free

#: point, its factor, rate of the dynamic stiffness there (numerator, denominator), whether residual compliance moves
Rate = tuple[str, float, tuple[Poly, Poly], bool]

#: step of a derivative, re the parameter's range
STEP = 1e-5
#: least z^T M z, squared, of a mode with one of the step before at which it counts as the same
_ALIKE = 0.3
#: modes are known to so many times the highest frequency of the targets, and twice that helps their derivatives
_ABOVE, _HELP = 1.3, 1.45


class DesignBody(Protocol):
    """A body that depends on parameters."""

    def at(self, values: Sequence[float]) -> Resonances:
        """Return the resonances for values of the parameters."""

    def beside(self, i: int) -> tuple[Resonances, Resonances, float]:
        """Return, to first order, those at parameter i less and more a step, and the step; about the last `at`."""


def changed(instrument: Instrument, free: Sequence[Free], values: Sequence[float] | Floats) -> Instrument:
    """Return the instrument with values of the parameters."""
    overrides: dict[str, Any] = {}
    for parameter, value in zip(free, values, strict=True):
        overrides |= parameter.overrides(float(value))
    return instrument.replace(overrides)


def design_body(instrument: Instrument, free: Sequence[Free], highest: float, mobility: bool) -> DesignBody:
    """Make the body for parameters.

    highest : Hz, up to which targets are.
    mobility : whether its mobility is wanted.
    Raises TonewoodError : a parameter is not one that this kind of body can change.
    """
    if isinstance(getattr(instrument.body, "drawing", None), BodyDrawing):
        return DrawnDesign(instrument, free, highest, mobility)
    for parameter in free:
        for path in parameter.paths:
            if not path.startswith("body.added."):
                raise TonewoodError(
                    "cannot change a measured body; masses, springs and dashpots put on it can: "
                    "--set 'body.added=[{at: POINT, mass: 0.005}]' --free 'body.added.0.mass=0.001:0.02'",
                    key=path,
                )
    return MeasuredDesign(instrument, free)


class DrawnDesign:
    """A drawn body; see the module."""

    def __init__(self, instrument: Instrument, free: Sequence[Free], highest: float, mobility: bool):
        self._instrument, self._free, self._mobility = instrument, tuple(free), mobility
        self._below = _ABOVE * max(highest, 400.0)
        self._cells = with_cells(_drawing(instrument), self._below)
        self._values: Floats = np.zeros(0)
        self._named: dict[str, int] = {}
        self._shapes: Floats = np.zeros((0, 0))

    def _body(self, values: Sequence[float] | Floats) -> WholeBody:
        instrument = changed(self._instrument, self._free, values)
        drawing = replace(_drawing(instrument), fmax=self._below)
        drawing = replace(drawing, top=replace(drawing.top, size=self._cells.top.size))
        if drawing.back is not None and self._cells.back is not None:
            drawing = replace(drawing, back=replace(drawing.back, size=self._cells.back.size))
        return WholeBody(drawing, lumps(instrument))

    def at(self, values: Sequence[float]) -> DrawnResonances:
        """Return the resonances for values of the parameters."""
        self._values = np.array(values, dtype=np.float64)
        self._whole = self._body(self._values)
        self._modes = self._whole.modes(below=_HELP * self._below)
        self._count = max(1, int(np.count_nonzero(self._modes[0] < (2 * np.pi * self._below) ** 2)))
        vectors = self._modes[1][:, : self._count]
        description = self._whole.described(self._modes[0][: self._count], vectors, self._mobility)
        self._named = self._followed(description.named, vectors)
        self._shapes = vectors
        return self._damped(replace(description, named=self._named), self._values)

    def _damped(self, modes: LowModes, values: Floats) -> DrawnResonances:
        """Resonances with the tuned dampers of the design at values of the parameters."""
        instrument = changed(self._instrument, self._free, values)
        dampers = [entry for entry in instrument.spec.body.added if entry.frequency is not None]
        if not dampers:
            return DrawnResonances(modes)
        omega, points = 2 * np.pi * modes.freq, instrument.body.points()
        shapes = dict(zip(points, modes.shapes, strict=True))
        basis = ModalBasis.real(omega, 0.5 * omega * modes.loss, shapes, residual=modes.residual)
        mass = modes.mass + sum(entry.mass for entry in dampers)
        return with_parts(body_parts(dampers, basis, points).body, mass, modes)

    def _followed(self, named: dict[str, int], vectors: Floats) -> dict[str, int]:
        """Numbers of the modes with names: those most like the ones that had them before, by z^T M z."""
        if not self._named or len(self._shapes) != len(vectors):
            return named
        out = {}
        for name, k in self._named.items():
            alike = (self._shapes[:, k] @ (self._whole.mass_matrix @ vectors)) ** 2
            if alike.max() > _ALIKE:
                out[name] = int(np.argmax(alike))
        return {**named, **out}

    def freq_rates(self, i: int) -> Floats:
        """(n,) Hz per unit of parameter i, of the modes of the last `at`: lambda' = z^T (K' - lambda M') z."""
        if any(entry.frequency is not None for entry in self._instrument.spec.body.added):
            below, above, step = self.beside(i)
            return np.asarray((above.freq - below.freq) / (2 * step))
        less, more, step = self._sides(i)
        values, vectors = self._modes[0][: self._count], self._shapes
        k, m = (
            np.einsum("ij,ij->j", vectors, a - b) / (2 * step)
            for a, b in (
                (more.stiffness(vectors), less.stiffness(vectors)),
                (more.mass_matrix @ vectors, less.mass_matrix @ vectors),
            )
        )
        return np.asarray((k - values * m) / (2 * np.sqrt(np.maximum(values, 1.0))) / (2 * np.pi))

    def _sides(self, i: int) -> tuple[WholeBody, WholeBody, float]:
        """Bodies at parameter i less and more a step, within its bounds, and the step."""
        low, high = self._free[i].low, self._free[i].high
        step = STEP * (high - low)
        middle = self._values.copy()
        middle[i] = min(max(middle[i], low + step), high - step)
        less, more = (self._body(middle + by * np.eye(len(middle))[i]) for by in (-step, step))
        if not less.size == self._whole.size == more.size:
            raise TonewoodError(
                "changes the drawing's unknowns here; a little other bounds may help", key=self._free[i].name
            )
        return less, more, step

    def beside(self, i: int) -> tuple[DrawnResonances, DrawnResonances, float]:
        """Return the resonances less and more a step of parameter i, to first order."""
        less, more, step = self._sides(i)
        change = body_change(self._whole, *self._modes, less, more, step, self._count, self._mobility)
        values = self._values.copy()
        low, high = self._free[i].low, self._free[i].high
        values[i] = min(max(values[i], low + step), high - step)
        below, above = (
            self._damped(replace(x, named=self._named), values + by * np.eye(len(values))[i])
            for x, by in ((change.less, -step), (change.more, step))
        )
        return below, above, step


def _drawing(instrument: Instrument) -> BodyDrawing:
    drawing: BodyDrawing = instrument.body.drawing  # type: ignore[attr-defined]  # of plugins that draw bodies
    return drawing


def lumps(instrument: Instrument) -> list[Lump]:
    """Lumps that `body.added` fixes to a drawn body, without tuned dampers."""
    points, names = instrument.body.points(), list(instrument.body.points())
    return [
        Lump(names.index(e.at), point_factor(i, e, points), e.mass, e.stiffness, e.damping)
        for i, e in enumerate(instrument.spec.body.added)
        if e.frequency is None
    ]


def with_parts(basis: ModalBasis, mass: float, before: LowModes) -> DrawnResonances:
    """Resonances of a body whose modes are complex for the parts put on it; names stay with the nearest frequency.

    mass : kg, of all of it.
    before : modes that have the names.
    """
    freq = basis.natural_freq
    order = np.argsort(freq)
    shapes = np.sqrt(2 * np.abs(basis.poles) * np.abs(basis.right * basis.left))[:, order]
    named = {name: int(np.argmin(np.abs(freq[order] - before.freq[k]))) for name, k in before.named.items()}
    loss = 2 * basis.damping_ratio[order]
    return DrawnResonances(LowModes(freq[order], loss, shapes, basis.residual, mass, named))


@dataclass(frozen=True, eq=False)
class TabledResonances:
    """Of a body that is known by its table of modes.

    basis : of which the mobility is.
    poles : (n,) 1/s of positive frequency, ascending.
    residues : (p, n) r l of displacement at each point, m/N/s.
    less : point -> what a change of a parameter adds to its mobility at omega (rad/s).
    mass : not known.
    """

    basis: ModalBasis
    poles: Complexes
    residues: Complexes
    less: Mapping[int, Any]
    mass: float | None = None

    @property
    def freq(self) -> Floats:
        """(n,) Hz."""
        return np.asarray(np.abs(self.poles) / (2 * np.pi))

    @property
    def quality(self) -> Floats:
        """(n,) Q."""
        return np.asarray(np.abs(self.poles) / np.maximum(-2 * self.poles.real, 1e-12))

    @property
    def squares(self) -> Floats:
        """(p, n) 1/kg, 2 omega |r l|."""
        return np.asarray(2 * np.abs(self.poles) * np.abs(self.residues))

    @property
    def named(self) -> Mapping[str, int]:
        """No mode of a table has a name."""
        return {}

    def mobility(self, point: int, freq: Floats) -> Complexes:
        """(f,) m/s/N, to first order in the parameter beside which it stands."""
        omega = 2 * np.pi * freq
        rows = np.array([self.basis.points[point]])
        value = _mobility(self.basis, omega, [rows[0]], [rows[0]])[:, 0, 0]
        change = self.less.get(point)
        return value if change is None else np.asarray(value + change(omega))


def _mobility(
    basis: ModalBasis, omega: Floats, read: Sequence[str], driven: Sequence[str], whole: bool = True
) -> Complexes:
    """(f, r, d) mobility between points; without the residual compliance where not `whole`."""
    from tonewood.physics.modal.mobility import mobility

    rows, columns = [basis.index(p) for p in read], [basis.index(p) for p in driven]
    modes = mobility(basis.poles, basis.right, basis.left, omega)[:, rows][:, :, columns]
    return np.asarray(modes + whole * 1j * omega[:, None, None] * basis.residual[np.ix_(rows, columns)])


class MeasuredDesign:
    """A table of modes with lumps; see the module."""

    def __init__(self, instrument: Instrument, free: Sequence[Free]):
        self._instrument, self._free = instrument, tuple(free)
        self._basis, self._points = instrument.body.basis(SHOWN_TO), instrument.body.points()

    def at(self, values: Sequence[float]) -> TabledResonances:
        """Return the resonances for values of the parameters."""
        self._values = np.array(values, dtype=np.float64)
        self._made = changed(self._instrument, self._free, values)
        self._whole = body_parts(self._made.spec.body.added, self._basis, self._points).body
        up = np.flatnonzero(self._whole.poles.imag > 0)
        self._kept = up[np.argsort(np.abs(self._whole.poles[up]))]
        residues = (self._whole.right * self._whole.left)[:, self._kept]
        return TabledResonances(self._whole, self._whole.poles[self._kept], residues, {})

    def beside(self, i: int) -> tuple[TabledResonances, TabledResonances, float]:
        """Return the resonances less and more a step of parameter i, to first order."""
        step = STEP * (self._free[i].high - self._free[i].low)
        rates = self._rates(i)
        poles = np.zeros(len(self._kept), dtype=np.complex128)
        residues = np.zeros((len(self._whole.points), len(self._kept)), dtype=np.complex128)
        for name, factor, (rate, below), massive in rates:
            scaled = [factor**2 * x for x in rate]
            moved, turned = lump_change(self._whole, self._whole.index(name), scaled, massive, below)
            poles, residues = poles + moved[self._kept], residues + turned[:, self._kept]
        now_poles, now = self._whole.poles[self._kept], (self._whole.right * self._whole.left)[:, self._kept]

        def beside(by: float) -> TabledResonances:
            change = {p: self._change(p, rates, by) for p in range(len(self._whole.points))}
            return TabledResonances(self._whole, now_poles + by * poles, now + by * residues, change)

        return beside(-step), beside(step), step

    def _rates(self, i: int) -> list[Rate]:
        """Where and by which rate parameter i changes the dynamic stiffness of each part put on the body."""
        free, rates = self._free[i], []
        for path, base in zip(free.paths, free.base, strict=True):
            _, _, number, key, *_ = [*path.split("."), ""]
            entry = self._made.spec.body.added[int(number)]
            try:
                top, below = stiffness_rate(entry, key)
            except BundleError as fault:
                raise BundleError(fault.reason, key=path) from None
            rate = (tuple((base if free.kind == "x" else 1.0) * x for x in top), below)
            massive = entry.mass > 0 and entry.frequency is None
            rates.append((entry.at, point_factor(int(number), entry, self._points), rate, massive))
        return rates

    def _change(self, point: int, rates: Sequence[Rate], by: float) -> Any:
        """Change of a point's mobility, -Y_pa Y_ap z'(i omega) / i omega for each part."""

        def change(omega: Floats) -> Complexes:
            total = np.zeros(len(omega), dtype=np.complex128)
            for name, factor, (rate, below), massive in rates:
                points, s = [self._whole.points[point]], 1j * omega
                z = factor**2 * np.polyval(rate, s) / np.polyval(below, s) / s
                to = _mobility(self._whole, omega, points, [name], massive)[:, 0, 0]
                back = _mobility(self._whole, omega, [name], points, massive)[:, 0, 0]
                total -= to * z * back
            return by * total

        return change
