"""How far each mode of a body moves by a tenth of a millimetre of its parts, or by a gram on it: first derivatives.

Of a drawn body the thickness of each plate, the heights of each brace and of the bridge, and a mass at points that
strings end on; of a measured one masses. Derivatives are those of `tonewood.physics.plate.mode_changes` and
`tonewood.physics.modal.lump_changes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tonewood.instrument.bundle.loading import Instrument
from tonewood.physics.plate.body import BodyDrawing
from tonewood.support.arrays import Floats
from tonewood.support.blas import one_blas_thread
from tonewood.workshop.design.bodies import DrawnDesign, MeasuredDesign
from tonewood.workshop.design.task import parse_free

#: modes that are told, at most; Hz, below which those of a drawn body are; points on which a gram is put
_MODES, _BELOW, _POINTS = 8, 650.0, 3
#: changes that are told, at most
_ROWS = 40
#: m, step of a dimension, and kg, of a mass
_DIMENSION, _MASS = 1e-4, 1e-3


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Cents by which modes move.

    freq : (n,) Hz; of a drawn body on coarser cells than those of a render.
    labels : (n,) names of the modes, A0 and T1 among them, or their numbers.
    rows : what is changed, with how much -> (n,) cents.
    remarks : on how they were computed.
    """

    freq: Floats
    labels: tuple[str, ...]
    rows: dict[str, Floats]
    remarks: tuple[str, ...] = ()


@one_blas_thread
def sensitivity(instrument: Instrument) -> Sensitivity:
    """Compute the cents of the lowest modes per 0.1 mm of each part and per gram at strings' ends."""
    drawn = isinstance(getattr(instrument.body, "drawing", None), BodyDrawing)
    added = list(instrument.resolved["body"].get("added") or [])
    points = _points(instrument)
    massive = instrument.replace({"body.added": [*added, *({"at": p, "mass": 1e-6} for p in points)]})
    lines = {f"body.added.{len(added) + k}.mass": f"1e-7 .. {_MASS}" for k in range(len(points))}
    names = {path: f"1 g at {point}" for path, point in zip(lines, points, strict=True)}
    if drawn:
        for path in _dimensions(instrument):
            lines[path], names[path] = f"+ 0 .. {_DIMENSION}", f"0.1 mm of {path.removeprefix('body.')}"
    remarks = ["frequencies on coarser cells than those of a render"] * drawn
    remarks += [f"of {len(lines)} changes the first {_ROWS} are told"] * (len(lines) > _ROWS)
    free = parse_free(dict(list(lines.items())[:_ROWS]), massive)
    start = [p.base[0] if not p.kind else 0.0 for p in free]
    body = DrawnDesign(massive, free, _BELOW / 1.3, mobility=False) if drawn else MeasuredDesign(massive, free)
    resonances = body.at(start)
    chosen = np.flatnonzero(resonances.freq > 1.0)[:_MODES]
    rows = {}
    for i, parameter in enumerate(free):
        rates = body.freq_rates(i) if isinstance(body, DrawnDesign) else _rates(body, i)
        unit = _DIMENSION if parameter.kind == "+" else _MASS
        rows[names[parameter.name]] = 1200 / np.log(2) * rates[chosen] / resonances.freq[chosen] * unit
    called = {k: name for name, k in resonances.named.items()}
    labels = tuple(called.get(int(k), str(n)) for n, k in enumerate(chosen, 1))
    return Sensitivity(resonances.freq[chosen], labels, rows, (*remarks, "the cents are first derivatives"))


def _points(instrument: Instrument) -> list[str]:
    """Points that strings end on, or any that forces act on: the first, the middle and the last of them."""
    points = instrument.body.points()
    ends = [p for part in instrument.spec.strings.values() if part.body_points for p in part.body_points[:1]]
    every = list(dict.fromkeys(ends)) or [name for name, point in points.items() if point.driven]
    return [every[i] for i in dict.fromkeys(np.linspace(0, len(every) - 1, min(_POINTS, len(every))).astype(int))]


def _dimensions(instrument: Instrument) -> Sequence[str]:
    """Keys of thicknesses and heights."""
    body, paths = instrument.resolved["body"], []
    for key, part in (("body", body), ("body.back", body.get("back"))):
        if isinstance(part, dict):
            if isinstance(part.get("thickness"), float):
                paths.append(f"{key}.thickness")
            paths += [f"{key}.braces.{name}.height" for name in part.get("braces") or {}]
    return [*paths, *(["body.bridge.height"] if body.get("bridge") else [])]


def _rates(body: MeasuredDesign, i: int) -> Floats:
    less, more, step = body.beside(i)
    return np.asarray((more.freq - less.freq) / (2 * step))


def words(result: Sensitivity) -> list[str]:
    """A table: a row for each change, a column for each mode."""
    heads = ["cents of each mode", *(f"{n} {f:.0f} Hz" for n, f in zip(result.labels, result.freq, strict=True))]
    rows = [[name, *(f"{x:+.1f}" for x in cents)] for name, cents in result.rows.items()]
    wide = [max(len(row[k]) for row in [heads, *rows]) for k in range(len(heads))]
    table = [[row[0].ljust(wide[0]), *map(str.rjust, row[1:], wide[1:])] for row in [heads, *rows]]
    return [*("  ".join(row) for row in table), "; ".join(result.remarks)]
