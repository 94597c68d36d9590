"""Which methods are run on the linear systems, at which rates, and which dials of this project are turned."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tonewood.lab.accuracy.cases import FREQ_UPPER, Case, GuitarCase, sliding_string
from tonewood.lab.accuracy.reference import FINE_RATE, FineMotion
from tonewood.lab.accuracy.study import (
    SECOND_ORDER,
    Attempt,
    Point,
    Subject,
    Tell,
    own_point,
    scheme_point,
    silent,
    superposition_point,
    timed,
)
from tonewood.lab.methods.problem import Problem
from tonewood.lab.systems import fabre_guitar
from tonewood.physics.modal.modes import ModalBasis

#: largest stable |s| h of Adams-Bashforth 3 on the imaginary axis, and of velocity Verlet
AB3_LIMIT, VERLET_LIMIT = float((5 + np.sqrt(5)) / 10), 2.0
#: rates that divide that of a reference which has to be computed, Hz
GRID = tuple(1e3 * k for k in (24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768))

Make = Callable[[], Attempt]


def lowest_rate(flat: Problem, limit: float) -> float:
    """Sampling rate, Hz, at which the highest mode stands at a limit of |s| h.

    Rigid connections lower frequencies (interlacing), so the highest mode of the parts is a safe bound, and near it.
    """
    return max(float(np.sqrt(b.stiffness.max())) for b in flat.components.values()) / limit


def study(case: Case, *, quick: bool = False, tell: Tell = silent) -> list[Point]:
    """All points of one linear system."""
    subject = Subject(case)
    real = subject if case.damped_as == "real modes" else Subject(case, real=True)
    makes = [*_own(subject, quick), *_others(subject, real, quick), *_dials(subject, quick)]
    points = timed(makes, 3 if quick else 9, tell)
    motion = subject.motion
    if not isinstance(motion, FineMotion):
        return points
    far = f"reference converged to {motion.convergence:.1e}"
    return [replace(p, note=f"{p.note}; {far}" if p.note else far) for p in points]


def truth_of(case: Case, points: Sequence[Point]) -> str:
    """Return the source of the poles and the waveform that methods are compared with."""
    if isinstance(case, GuitarCase):
        return (
            "poles by Newton's method on the continuous system with string modes to 40 kHz; waveform by this scheme at "
            f"{FINE_RATE / 1e3:g} kHz, {points[0].note.rpartition('; ')[2].removeprefix('reference ')}"
        )
    return "poles of the transcendental string on its body; waveform superposed from the coupled modes up to 20 kHz"


def _own(subject: Subject, quick: bool) -> Iterator[Make]:
    for fs in (24e3, 48e3, 96e3) if quick else (24e3, 32e3, 48e3, 96e3, 192e3):
        yield partial(own_point, subject, fs)
    if not isinstance(subject.case, GuitarCase):
        yield partial(superposition_point, subject)


def _others(subject: Subject, real: Subject, quick: bool) -> Iterator[Make]:
    ab3, verlet = lowest_rate(subject.flat(), AB3_LIMIT), lowest_rate(real.flat(), VERLET_LIMIT)
    if isinstance(subject.case, GuitarCase):
        rates = {
            "ab3": [fs for fs in GRID if fs > ab3][: 2 if quick else 4],
            "verlet": [fs for fs in GRID if fs > verlet][: 2 if quick else 6],
        }
        usual = [48e3, 192e3] if quick else [48e3, 96e3, 192e3, 384e3]
    else:
        rates = {
            "ab3": [1.02 * ab3, 800e3] if quick else [0.9 * ab3, 1.02 * ab3, 400e3, 800e3, 1200e3],
            "verlet": [1.05 * verlet, 400e3] if quick else [0.9 * verlet, 1.05 * verlet, 100e3, 200e3, 400e3, 800e3],
        }
        usual = [48e3, 192e3] if quick else [48e3, 96e3, 192e3, 384e3, 768e3]
    few = ("p1", "newmark") if quick and isinstance(subject.case, GuitarCase) else None
    for method in ("p0", "p1", "p2", "trapezoidal", "simpson", "newmark", "hht", "held_velocity"):
        if few is None or method in few:
            rates[method] = usual
    rates |= {"held_position": usual[:3], "linear_position": [48e3]}
    for method, values in rates.items():
        for fs in values:
            yield partial(scheme_point, real if method in SECOND_ORDER else subject, method, fs)
    if subject.case.name == "fabre_guitar":
        # as in the paper: 150 string modes, at the limit and at the paper's rate
        top = float(fabre_guitar.string(n_modes=150).natural_freq[-1]) * 1.0001
        least = lowest_rate(subject.flat(top), AB3_LIMIT)
        for fs in (1.02 * least, 1200e3) if quick else (0.9 * least, 1.02 * least, 800e3, 1200e3):
            yield partial(scheme_point, subject, "ab3", fs, label="ab3_paper", freq_upper=top)


def _dials(subject: Subject, quick: bool) -> Iterator[Make]:
    """Dials of this project at 48 kHz, one turned at a time."""
    own = partial(own_point, subject, 48e3)
    flat = subject.flat()
    for freq in (5e3, 10e3) if quick else (2.5e3, 5e3, 10e3, 15e3):
        value = f"strings solved to {freq / 1e3:.4g} kHz"
        yield partial(own, flat=subject.flat(freq), dial="modes", value=value)
    for fold, named in ((True, "with"), (False, "without")):
        value = f"string modes above 10 kHz dropped, {named} their compliance"
        yield partial(own, flat=_cut(flat, 10e3, fold), dial="residual", value=value)
    if subject.case.string is not None:
        pluck = {"pluck": flat.components["string"].places["pluck"]}
        for fold, named in ((True, "with"), (False, "without")):
            basis = sliding_string(subject.case.string, FREQ_UPPER, residual=fold).with_places(pluck)
            value = f"sliding cosines, {named} residual compliance"
            yield partial(own, flat=exchanged(flat, "string", basis), dial="basis", value=value)


def exchanged(flat: Problem, name: str, basis: ModalBasis) -> Problem:
    """Return the arrays with another basis for one component."""
    return replace(flat, components={**flat.components, name: basis})


def _cut(flat: Problem, freq: float, fold: bool) -> Problem:
    """String modes above a frequency dropped from the solved basis, their compliance kept or not."""
    parts = {
        name: basis if name == "body" else basis.select(basis.natural_freq < freq, fold=fold)
        for name, basis in flat.components.items()
    }
    return replace(flat, components=parts)
