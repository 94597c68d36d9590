"""A design in words: changes, targets reached, and trade-offs between targets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tonewood.support.arrays import Floats
from tonewood.workshop.design.search import FoundDesign, slope
from tonewood.workshop.design.task import Free, Target

#: cosine between the rates of two targets from which on they are said to go together, or against one another
_TOGETHER = 0.9
#: distance from a bound that counts as at it, re the range
_AT_BOUND = 1e-3


def shown(parameter: Free, value: float) -> str:
    """Value of a parameter, with what it does."""
    return {"": f"{value:.5g}", "x": f"x {value:.4g}", "+": f"+ {value:.4g}"}[parameter.kind]


def figure_words(target: Target, figure: float) -> str:
    """A figure with its unit."""
    if target.kind == "freq":
        return f"{figure:.1f} Hz"
    if target.kind == "mass":
        return f"{1e3 * figure:.1f} g"
    if target.kind == "mobility":
        return f"{figure:.1f} dB"
    return "no wolf" if figure <= 0 else f"a wolf, {figure:.0f} cents too strong or too far inside"


def off_words(target: Target, off: float) -> str:
    """How far a target is off."""
    if abs(off) <= target.tolerance:
        return "reached" if off == 0 else f"reached within {abs(off):.2g} {target.unit}"
    return f"MISSED by {off:+.3g} {target.unit}"


def at_bounds(design: FoundDesign) -> list[str]:
    """Parameters that stand at a bound."""
    out = []
    for parameter, value in zip(design.free, design.values, strict=True):
        span = parameter.high - parameter.low
        for bound, word in ((parameter.low, "lower"), (parameter.high, "upper")):
            if abs(value - bound) < _AT_BOUND * span:
                out.append(f"{parameter.name} stands at its {word} bound, {shown(parameter, bound)}")
    return out


def effects(design: FoundDesign) -> Floats:
    """(t, n) change of each figure, in the unit of its target's error, by a tenth of each parameter's range."""
    span = np.array([p.high - p.low for p in design.free])
    unit = [slope(t, float(f)) for t, f in zip(design.targets, design.reached, strict=True)]
    return np.asarray(np.array(unit)[:, None] * design.rates * span / 10)


def trades(design: FoundDesign) -> list[str]:
    """Pairs of targets that the parameters only move together or against one another."""
    scaled = effects(design) / np.array([t.weight for t in design.targets])[:, None]
    size = np.linalg.norm(scaled, axis=1)
    out: list[str] = []
    if not design.free:
        return out
    for i, first in enumerate(design.targets):
        for j in range(i):
            if size[i] < 1e-6 or size[j] < 1e-6:
                continue
            alike = float(scaled[i] @ scaled[j] / (size[i] * size[j]))
            if abs(alike) > _TOGETHER:
                how = "rise and fall together" if alike > 0 else "go against one another"
                out.append(f"{_named(design.targets[j])} and {_named(first)} {how}, whichever of these is changed")
    for t, target in enumerate(design.targets):
        if size[t] < 1e-6:
            out.append(f"none of these parameters moves {_named(target)} here")
    return out


def _named(target: Target) -> str:
    """What a target is about."""
    return {"wolf": "the wolf", "mass": "mass", "mobility": f"mobility at {target.at}"}.get(
        target.kind, target.mode if not target.mode.isdigit() else f"mode {target.mode}"
    )


def lines(design: FoundDesign) -> Sequence[str]:
    """The whole report."""
    out = ["parameters: now, designed (bounds)"] if design.free else []
    for parameter, before, value in zip(design.free, design.before, design.values, strict=True):
        bounds = f"{shown(parameter, parameter.low)} .. {shown(parameter, parameter.high)}"
        out.append(f"  {parameter.name}: {shown(parameter, before)} to {shown(parameter, value)}  ({bounds})")
    out.append("targets: now, designed, by full computations")
    rows = zip(design.targets, design.initial, design.reached, design.off, strict=True)
    for target, present, reached, off in rows:
        words = f"{figure_words(target, present)} to {figure_words(target, reached)}"
        out.append(f"  {target.text}: {words}; {off_words(target, off)}")
    if design.free:
        out.append("what a tenth of each parameter's range does, at the design")
    for parameter, column in zip(design.free, effects(design).T, strict=True):
        moves = ", ".join(f"{_named(t)} {x:+.2g} {t.unit}" for t, x in zip(design.targets, column, strict=True))
        step = (parameter.high - parameter.low) / 10
        out.append(f"  {parameter.name} {parameter.kind}{'' if parameter.kind else '+'}{step:.3g}: {moves}")
    out += [f"trade: {line}" for line in trades(design)]
    out += at_bounds(design)
    if not design.ok:
        missed = [t.text for t, off in zip(design.targets, design.off, strict=True) if abs(off) > t.tolerance]
        out.append(
            f"these targets cannot be reached within these bounds: {'; '.join(missed)}. The design above is the "
            "nearest: widen a bound that is named, free another parameter, or give up what it trades with"
        )
    return out
