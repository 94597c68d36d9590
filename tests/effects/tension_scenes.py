"""Random scenes for tensions that come and go: forces, places, planes, stops, bends, soft and loud plucks in turn."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from effect_scenes import FS, partial
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

import tonewood as tw
from tonewood.performance.effects.base import EffectReport
from tonewood.performance.engine.engine import Engine
from tonewood.performance.score.note import Control

Floats = NDArray[np.float64]
#: open notes of the strings taken, of a steel-string guitar and of a classical one with rising tensions
OPEN = {"steel_strings": {"E2": 40, "G3": 55, "E4": 64}, "classical_guitar": {"A2": 45, "G3": 55, "B3": 59}}
#: Pa, of nylon: with a string's bending stiffness E pi r^4 / 4 it gives its axial stiffness E pi r^2
NYLON = 5e9
SECONDS = 2.4
#: s after a pluck or a bend begins, in which the pitch of both renders moves
GLIDE = 0.08
#: plucks whose release does not depend on their force
RAMPS = {
    "steel_strings": {"plugin": "pluck_ramp", "from_bridge": 0.12, "angle_deg": 60.0, "release_time": 1e-4},
    "classical_guitar": {"plugin": "pluck_ramp", "from_bridge": 0.105, "angle_deg": 30.0, "release_time": 2e-4},
}


def guitar(name: str, strings: tuple[str, ...], **effects: Any) -> tw.Instrument:
    """Some strings of a guitar, their tensions rising, on its body."""
    plain = tw.load_instrument(name)
    values = dict(plain.resolved)
    values["strings"] = {string: dict(values["strings"][string]) for string in strings}
    for part in values["strings"].values():
        if part["plugin"] != "tension_modulated_string":
            part["plugin"] = "tension_modulated_string"
            part["axial_stiffness"] = float(np.sqrt(4 * np.pi * NYLON * part["bending_stiffness"]))
    values["playing"] = {**values["playing"], "note_end": {"kind": "ring"}}
    values["exciters"] = {**values["exciters"], "pluck": RAMPS[name]}
    values["connections"] = {}
    values["effects"] = {**values["effects"], **effects}
    return tw.Instrument.from_values(values, plain.folder)


def scene(seed: int) -> tuple[str, str, tw.Score, list[float]]:
    """Instrument, its one string, its score, and when it is bent.

    One string: in a chord, partials of others pass through the body and beat with its own.
    """
    rng = np.random.default_rng(seed)
    name = str(rng.choice(list(OPEN)))
    string = str(rng.choice(list(OPEN[name])))
    notes, bends, time = [], [], 0.0
    for _ in range(rng.integers(1, 5)):
        notes.append(
            tw.Note(time, 4.0, string=string, stop=int(rng.integers(0, 8)), force=float(10 ** rng.uniform(-1.3, 1.3)),
                    from_bridge=float(rng.uniform(0.03, 0.3)), angle_deg=float(rng.uniform(-90, 90)))
        )  # fmt: skip
        time += float(rng.uniform(0.3, 1.0))
    for _ in range(rng.integers(0, 3)):
        bends.append(Control(float(rng.uniform(0.0, 1.2)), "bend", float(rng.uniform(-1200, 700))))
    bends.sort(key=lambda b: b.time)
    return name, string, tw.Score(notes, controls=bends), [b.time for b in bends]


def pieces(renderer: tw.Renderer, score: tw.Score, bends: list[float]) -> list[tuple[slice, float]]:
    """Samples in which one note sounds at one pitch, glides left out, and that pitch, Hz."""
    (string,) = renderer.model.strings.values()
    start, out = renderer.performance.timeline.start, []
    notes = renderer.performance.notes
    for i, played in enumerate(notes):
        end = notes[i + 1].note.time if i + 1 < len(notes) else SECONDS + start
        edges = [played.note.time, *(b for b in bends if played.note.time < b < end), end]
        for first, last in itertools.pairwise(edges):
            bend = [c.value for c in score.controls if c.time <= first]
            here = slice(round((first + GLIDE - start) * FS), round((last - 0.03 - start) * FS))
            if here.stop - here.start > 0.3 * FS:
                out.append((here, string.freq(played.stop) * 2 ** ((bend[-1] if bend else 0.0) / 1200)))
    return out


def deviations(seed: int, **effects: float) -> tuple[float, float, list[EffectReport]]:
    """Largest deviation of `auto` from `all` in cents, and in dB, of the lowest partials; and the report of `auto`."""
    name, string, score, bends = scene(seed)
    every, auto = (
        tw.Renderer(score, guitar(name, (string,), mode=mode, **effects), FS, max_duration=SECONDS + 1)
        for mode in ("all", "auto")
    )
    a, b = (forces(renderer.engine, SECONDS)[1] for renderer in (every, auto))
    cents, levels = [0.0], [0.0]
    for here, pitch in pieces(auto, score, bends):
        # each partial in the plane in which it is stronger: the other one is moved by it, and beats with it
        sizes = {(k, j): abs(partial(a[here, j], k * pitch, width=0.02)).max() for k in (1, 2, 3) for j in range(2)}
        for k in (1, 2, 3):
            j = max(range(2), key=lambda plane, k=k: sizes[k, plane])
            off, louder = followed(a[here, j], b[here, j], k * pitch, 0.03 * max(sizes.values()))
            cents += abs(off).tolist()
            levels += abs(louder).tolist()
    return max(cents), max(levels), [e for e in auto.summary().effects if e.name == "tension_modulation"]


def forces(engine: Engine, seconds: float) -> tuple[Floats, Floats]:
    """(n,) sound of the first channel and (n, components) N, of each component on its bridge."""
    stepper, step = engine.stepper, engine.stepper._step
    bridges = [f"{c}.bridge" for s in engine.model.strings.values() for c in s.components]
    names = [c.name for c in engine.system.connections]
    kept: list[Floats] = []

    def watched(*args: Any) -> Any:
        found = step(*args)
        kept.append(np.array(found[1][:, np.searchsorted(stepper._active, [names.index(b) for b in bridges])]))
        return found

    stepper._step = watched  # type: ignore[method-assign]  # watched, not changed
    sound = engine.advance(int(seconds * FS) // 64)[:, 0]
    return sound, np.concatenate(kept)


def followed(a: Floats, b: Floats, freq: float, floor: float) -> tuple[Floats, Floats]:
    """Cents by which a partial near `freq` is higher in b than in a, and dB by which it is louder, each 0.05 s.

    Left out are sizes below `floor`, and the nulls of beats, more than 6 dB below the neighbourhood of
    0.25 s: a string's two planes beat through the body, and in a null the pitch of both together is ill-defined.
    """
    x, y = partial(a, freq, width=0.02), partial(b, freq, width=0.02)
    step = round(0.05 * FS)
    x, y = x[step:-step:step], y[step:-step:step]
    turn = np.angle(y[1:] * np.conj(x[1:]) * np.conj(y[:-1] * np.conj(x[:-1])))
    size = np.minimum(abs(x), abs(y))
    around = maximum_filter1d(size, 5, mode="nearest")
    heard = (size > 0.5 * around) & (size > floor)
    cents = turn * FS / (2 * np.pi * freq * step) * 1200 / np.log(2)
    level = 20 * np.log10(abs(y) / np.maximum(abs(x), 1e-300))
    return cents[heard[1:] & heard[:-1]], level[heard]
