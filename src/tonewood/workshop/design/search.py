"""The smallest change of a design that reaches its targets: bounded least squares with analytic derivatives.

    minimise  sum_t (off_t / weight_t)^2 + sum_i (LEAST (p_i - p_i0) / (high_i - low_i))^2,    low_i <= p_i <= high_i

Each step solves this for figures that change by their derivatives alone, and is halved until the sum falls. Of designs
that reach all targets, the second sum chooses the one that changes least. A full computation at the result gives the
difference between its figures and those of the search's coarser body; the search goes on with it added, and a second
full computation tells how far each target is off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.added import body_parts
from tonewood.instrument.bundle.loading import Instrument
from tonewood.physics.plate.body import BodyDrawing, BodyModes
from tonewood.physics.plate.whole_body import LowModes
from tonewood.support.arrays import Floats
from tonewood.support.blas import one_blas_thread
from tonewood.workshop.design.bodies import MeasuredDesign, changed, design_body, with_parts
from tonewood.workshop.design.figures import DrawnResonances, Resonances, figures, string_ends
from tonewood.workshop.design.task import Free, Target

#: weight of a change by the whole range of a parameter
LEAST = 0.02
#: steps of a search, share of its cost that a step has to gain, and of each range that is no change
_STEPS, _GAIN, _CLOSE = 12, 0.02, 1e-3


@dataclass(frozen=True, eq=False)
class FoundDesign:
    """A design and what it reaches.

    targets, free : of the task.
    before, values : (n,) parameters before and after the search.
    initial, reached : (t,) figures of both, by full computations.
    rates : (t, n) derivatives of the figures at the result, per unit of each parameter.
    instrument : as designed.
    """

    targets: tuple[Target, ...]
    free: tuple[Free, ...]
    before: Floats
    values: Floats
    initial: Floats
    reached: Floats
    rates: Floats
    instrument: Instrument

    @property
    def off(self) -> Floats:
        """(t,) how far each target is off, in its unit."""
        return np.array([t.off(f) for t, f in zip(self.targets, self.reached, strict=True)])

    @property
    def cost(self) -> tuple[float, float]:
        """Sums of squares: errors of missed targets re what is noticed, and changes re their ranges."""
        missed = [o / t.weight for t, o in zip(self.targets, self.off, strict=True) if abs(o) > t.tolerance]
        span = np.array([p.high - p.low for p in self.free])
        return float(np.square(missed).sum()), float(np.square((self.values - self.before) / span).sum())

    @property
    def ok(self) -> bool:
        """Whether every target is reached within its tolerance."""
        return all(abs(o) <= t.tolerance for t, o in zip(self.targets, self.off, strict=True))


@one_blas_thread
def find_design(
    instrument: Instrument,
    targets: Sequence[Target],
    free: Sequence[Free],
    tell: Callable[[str], None] = lambda s: None,
) -> FoundDesign:
    """Search the nearest design that reaches the targets.

    tell : is called with a line about each step.
    Raises TonewoodError : the body has no such mode or parameter.
    """
    search = _Search(instrument, targets, free, tell)
    before = np.array([p.start for p in free])
    tell("the body as it is, in full")
    original = search.full(instrument, None)
    tell("search")
    values = search.run(before)
    for again in (True, False):
        variant = changed(instrument, free, values)
        tell("the design in full")
        reached = search.full(variant, search.figures_at(values))
        if again and not isinstance(search.body, MeasuredDesign):
            search.correct(values, reached)
            tell("search, corrected by it")
            values = search.run(values)
        else:
            break
    return FoundDesign(
        tuple(targets),
        tuple(free),
        before,
        values,
        original,
        reached,
        search.rates(values),
        changed(instrument, free, values),
    )


class _Search:
    """Figures and their derivatives as functions of the parameters."""

    def __init__(
        self, instrument: Instrument, targets: Sequence[Target], free: Sequence[Free], tell: Callable[[str], None]
    ):
        self._tell, self._steps = tell, 0
        self.targets, self.free = tuple(targets), tuple(free)
        self.points, self.ends = list(instrument.body.points()), string_ends(instrument)
        highest = max((max(t.band[1], t.value if t.kind == "freq" else 0.0) for t in targets), default=0.0)
        self.body = design_body(instrument, free, highest, any(t.kind == "mobility" for t in targets))
        self.start = np.array([p.start for p in free])
        self.low, self.high = (np.array([getattr(p, end) for p in free]) for end in ("low", "high"))
        self.shift = np.zeros(len(targets))
        self._at: tuple[bytes, Resonances] | None = None
        self._rates: tuple[bytes, Floats] | None = None

    def _figures(self, resonances: Resonances) -> Floats:
        return figures(self.targets, resonances, self.points, self.ends)

    def _resonances(self, values: Floats) -> Resonances:
        if self._at is None or self._at[0] != values.tobytes():
            self._at = (values.tobytes(), self.body.at(values.tolist()))
        return self._at[1]

    def figures_at(self, values: Floats) -> Floats:
        """(t,) figures with what a full computation added."""
        raw = self._figures(self._resonances(values))
        return np.where(self._relative, raw * np.exp(self.shift), raw + self.shift)

    @property
    def _relative(self) -> NDArray[np.bool_]:
        return np.array([t.kind in ("freq", "mass") for t in self.targets])

    def correct(self, values: Floats, reached: Floats) -> None:
        """Make the figures at `values` those of a full computation."""
        raw = self._figures(self._resonances(values))
        ratio = np.log(np.where(self._relative, reached, 1.0) / np.where(self._relative, raw, 1.0))
        self.shift = np.where(self._relative, ratio, reached - raw)

    def rates(self, values: Floats) -> Floats:
        """(t, n) derivatives of the figures."""
        self._resonances(values)
        if self._rates is None or self._rates[0] != values.tobytes():
            columns = []
            for i in range(len(self.free)):
                less, more, step = self.body.beside(i)
                columns.append((self._figures(more) - self._figures(less)) / (2 * step))
            self._rates = (values.tobytes(), np.array(columns).reshape(len(columns), len(self.targets)).T)
        factor = np.where(self._relative, np.exp(self.shift), 1.0)
        return np.asarray(factor[:, None] * self._rates[1])

    def run(self, start: Floats) -> Floats:
        """(n,) values of the nearest design: steps to the best one by derivatives, halved until the sum falls."""
        if not self.free:
            return start
        span = self.high - self.low
        x = np.clip((start - self.low) / span, 0.0, 1.0)
        for _ in range(_STEPS):
            values = self.low + span * x
            now, self._steps = self.figures_at(values), self._steps + 1
            offs = ((t, t.off(float(f))) for t, f in zip(self.targets, now, strict=True))
            shown = ", ".join(f"{t.text} off by {off:+.3g} {t.unit}" for t, off in offs)
            self._tell(f"step {self._steps}: {shown}")
            aim = self._best(x, now, self.rates(values) * span)
            cost, before = np.inf, float(np.sum(self._errors(x, now) ** 2))
            share, nearest = 2.0, x
            while cost >= before and share * np.abs(aim - x).max() > 2 * _CLOSE:
                share /= 2
                nearest = x + share * (aim - x)
                cost = float(np.sum(self._errors(nearest, self.figures_at(self.low + span * nearest)) ** 2))
            if cost >= before:
                break
            x = nearest
            if before - cost < _GAIN * before:
                break
        return np.asarray(self.low + span * x)

    def _errors(self, x: Floats, reached: Floats) -> Floats:
        """(t + n,) errors and changes of which the sum of squares is least."""
        off = [t.off(float(f)) / t.weight for t, f in zip(self.targets, reached, strict=True)]
        return np.concatenate([off, LEAST * (x - (self.start - self.low) / (self.high - self.low))])

    def _best(self, x: Floats, now: Floats, rates: Floats) -> Floats:
        """(n,) best design, 0 to 1 of each range, if figures change by their derivatives (t, n) alone."""
        from scipy.optimize import least_squares

        def linear(y: Floats) -> Floats:
            reached = now + rates @ (y - x)
            return self._errors(y, np.where(self._relative, np.maximum(reached, 0.1 * now), reached))

        fit = least_squares(linear, np.clip(x, 0.01, 0.99), bounds=(0.0, 1.0), xtol=1e-10, ftol=1e-10, gtol=1e-12)
        y = np.where(fit.active_mask < 0, 0.0, np.where(fit.active_mask > 0, 1.0, fit.x))
        return np.asarray(np.where(y < 1e-4, 0.0, np.where(y > 1 - 1e-4, 1.0, y)))

    def full(self, instrument: Instrument, expected: Floats | None) -> Floats:
        """(t,) figures by the computation that `render` and `compare` use.

        Of a drawn body with lumps, the modes that targets name are those nearest to the frequencies `expected`.
        """
        modes = self._full_modes(instrument)
        named = dict(modes.named)
        if instrument.spec.body.added and expected is not None:
            for target, freq in zip(self.targets, expected, strict=True):
                if target.kind == "freq":
                    named[target.mode] = int(np.argmin(np.abs(modes.freq - freq)))
        return self._figures(_Named(modes, named))

    def _full_modes(self, instrument: Instrument) -> Resonances:
        if isinstance(self.body, MeasuredDesign):
            return self.body.at([_value(p, instrument) for p in self.free])
        drawn = getattr(instrument.body, "modes_below", None)
        if drawn is None or not isinstance(getattr(instrument.body, "drawing", None), BodyDrawing):
            raise TonewoodError("is no drawn and no measured body", key="body")
        modes: BodyModes = drawn(np.inf)
        mass = float(modes.masses.sum()) + sum(e.mass for e in instrument.spec.body.added)
        low = LowModes(modes.freq, modes.loss, modes.shapes, modes.residual, mass, modes.named())
        if not instrument.spec.body.added:
            return DrawnResonances(low)
        basis = body_parts(instrument.spec.body.added, instrument.body.basis(np.inf), instrument.body.points()).body
        return with_parts(basis, mass, low)


def _value(parameter: Free, instrument: Instrument) -> float:
    """Value of a parameter in an instrument."""
    value: object = instrument.resolved
    for key in parameter.paths[0].split("."):
        value = value[int(key)] if isinstance(value, list) else value[key]  # type: ignore[index]  # checked when parsed
    now, base = float(value), parameter.base[0]  # type: ignore[arg-type]
    return {"": now, "x": now / base if base else 1.0, "+": now - base}[parameter.kind]


def slope(target: Target, figure: float) -> float:
    """Derivative of `Target.off` with respect to the figure."""
    if target.kind == "freq":
        return float(1200 / np.log(2) / figure)
    return 100 / target.value if target.kind == "mass" else 1.0


class _Named:
    """Resonances with other names."""

    def __init__(self, resonances: Resonances, named: dict[str, int]):
        self._original, self.named = resonances, named
        self.freq, self.quality, self.squares = resonances.freq, resonances.quality, resonances.squares
        self.mass, self.mobility = resonances.mass, resonances.mobility
