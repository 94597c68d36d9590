"""Gestures compiled for the steppers: forces to injections, courses of partners to controls, fingers to dashpots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tonewood.errors import BundleError
from tonewood.instrument.contract.attached import Motion
from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.timeline import GRID, Play
from tonewood.physics.coupling.system import Injection, PrescribedMotion, System
from tonewood.physics.stepping.forcing import Course, course, windowed
from tonewood.support.arrays import Floats

#: steps in which a finger's dashpot grows
_HOLD_LEVELS = 3
#: times at which the smooth step 3 s^2 - 2 s^3 passes half way between two of them
_RISE = tuple(0.5 - math.sin(math.asin(1 - 2 * (i + 0.5) / _HOLD_LEVELS) / 3) for i in range(_HOLD_LEVELS))


@dataclass(frozen=True, slots=True)
class Active:
    """A gesture in progress.

    play : the gesture.
    stop : sample at which it is over.
    holds : (sample, N s/m), ...: the damping of its finger from that sample on.
    """

    play: Play
    stop: float
    holds: tuple[tuple[int, float], ...] = ()


def samples(time: float, dt: float) -> float:
    """Convert s to samples, rounded to 1e-6 so that a time on a grid point stays there."""
    return round(time / dt, 6)


def places(play: Play, model: Model) -> tuple[tuple[str, str, float], ...]:
    """Return component, point and factor of each point at which a gesture's forces enter."""
    if play.string is None or play.gesture.on is not None:
        return model.inputs[play.gesture.on or play.at or ""]
    weights = model.strings[play.string].weights(play.gesture.angle_deg)
    return tuple((component, "pluck", weight) for component, weight in weights.items())


def forces(play: Play, model: Model, system: System, first: int, *, window: int | None = None) -> list[Injection]:
    """Compile a gesture's known forces from sample `first` on, in windows; see `windowed`.

    Raises BundleError : the gesture names an input, a connection or a point that nothing has attached.
    """
    _check_names(play, model)
    segments, noise = play.gesture.segments, play.gesture.noise
    course = Course.of(segments, system.dt, time=play.time, first=first)
    if noise is not None:
        course = course.with_noise(noise.course(system.dt, time=play.time, first=first))
    out: list[Injection] = []
    for component, point, factor in places(play, model):
        compiled = system.compiled[system.slot(component)]
        if segments or noise is None:
            out += course.injections(component, compiled.impulses(point), factor, window=window)
        else:  # constant in each step: one vector
            out += course.held(component, factor * compiled.held_force(point)[None], [0], window=window)
    return out


def _check_names(play: Play, model: Model) -> None:
    gesture = play.gesture
    if gesture.on is None and not gesture.motions and not gesture.touches:
        return
    parts = model.strings[play.string].attached() if play.string is not None else ()
    named = (
        ("on", [gesture.on] if gesture.on is not None else [], model.inputs),
        ("motions", [motion.connection for motion in gesture.motions], model.system.layout.places),
        ("touches", list(gesture.touches), [point for part in parts for point in part.places]),
    )
    for field, names, allowed in named:
        for name in names:
            if name not in allowed:
                reason = f"gesture: {field} names {name!r}; there are {', '.join(list(allowed)[:10]) or 'none'}"
                exciter = model.exciters.get(play.exciter or "")
                named_class = f"{type(exciter).__name__}." if exciter else ""
                raise BundleError(
                    named_class + reason,
                    file=exciter.files.manifest if exciter else None,
                    key=exciter.key if exciter else f"exciters.{play.exciter}",
                )


def quasi_static(active: Sequence[Active], model: Model, system: System, start: int, n: int) -> Floats | None:
    """Add the contribution of modes above the limit to readouts of a component on which known forces act.

    Those modes are not stepped. They follow a force F(t) by their compliance: y = R F with R = `ModalBasis.residual`
    between the point that is read and the point on which the force acts. Velocities take R F'; accelerations, means
    over a step, R (F'(t + h) - F'(t)) / h.

    Returns (n, n_readouts) of the samples from `start` on; None if nothing is added.
    """
    out: Floats | None = None
    for play in (a.play for a in active if a.play.gesture.segments):
        for component, point, factor in places(play, model):
            basis = system.compiled[system.slot(component)].basis
            for channel, readout in enumerate(system.readouts):
                compliance = factor * sum(
                    p.factor * float(basis.residual[basis.index(p.point), basis.index(point)])
                    for p in readout.probes
                    if p.component == component
                )
                if compliance:
                    out = np.zeros((n, len(system.readouts))) if out is None else out
                    times = np.arange(start, start + n + 1) * system.dt - play.time
                    derivative = readout.quantity != "displacement"
                    force = course(play.gesture.segments, times, derivative=derivative)
                    if (noise := play.gesture.noise) is not None:
                        force += noise.rate(times) if derivative else noise.at(times)
                    mean = readout.quantity == "acceleration"
                    out[:, channel] += compliance * (np.diff(force) / system.dt if mean else force[:-1])
    return out


def courses(play: Play, dt: float, first: int, *, window: int | None = None) -> list[PrescribedMotion]:
    """Compile the course of a gesture's partners from sample `first` until the gesture ends on the grid, in windows."""
    stop = max(math.ceil(samples(play.stop, dt) / GRID) * GRID, first)

    def moving(motion: Motion, start: int, stop: int) -> PrescribedMotion:
        # offsets are given at both ends of every step, other quantities at its middle, as means
        if motion.quantity == "offset":
            times = (start + np.arange(stop - start + 1)) * dt - play.time
        else:
            times = (start + np.arange(stop - start) + 0.5) * dt - play.time
        values: dict[str, Any] = {motion.quantity: motion.course(times)}
        return PrescribedMotion(motion.connection, start, **values)

    return [windowed(first, stop, partial(moving, m), window) for m in play.gesture.motions if m.segments]


def hold_steps(play: Play, dt: float) -> tuple[tuple[int, float], ...]:
    """Replace the finger's smoothly growing dashpot by a few steps, each at a whole sample.

    A finger on a moving string exerts a force; steps on the control grid would make the sound depend on the phase of
    the grid by -31 dB.
    """
    hold = play.gesture.hold
    if hold is None or play.string is None:
        return ()
    times = [*(hold.start + rise * (hold.grown - hold.start) for rise in _RISE), hold.stop]
    sizes = [*((i + 1) / _HOLD_LEVELS * hold.damping for i in range(_HOLD_LEVELS)), 0.0]
    return tuple((math.floor(samples(play.time + t, dt)), size) for t, size in zip(times, sizes, strict=True))
