"""Scenes for switching, and how two renders are compared: by samples, and by the pitch and level of partials."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import tonewood as tw
from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects import runtime_effects
from tonewood.performance.effects.base import Moment
from tonewood.performance.effects.tension import TensionEffect
from tonewood.physics.coupling.system import State, System

Floats = NDArray[np.float64]
FS = 24000
TENSION = "tension_modulation"
PITCH = {"B3": 59, "E4": 64}
#: a pluck whose release does not depend on its force, so that the linear instrument is linear in it
RAMP = {"plugin": "pluck_ramp", "from_bridge": 0.12, "angle_deg": 60.0, "release_time": 1e-4}


def duet(**effects: Any) -> tw.Instrument:
    """The two highest steel strings on their body: tensions rise, and it is quickly stepped."""
    guitar = tw.load_instrument("steel_strings")
    values = dict(guitar.resolved)
    values["strings"] = {name: values["strings"][name] for name in PITCH}
    body = dict(values["body"])
    body["points"] = {f"bridge_{name}": body["points"][f"bridge_{name}"] for name in PITCH}
    values["body"] = body
    values["outputs"] = [{**values["outputs"][0], "at": {"mean": [f"body.bridge_{name}" for name in PITCH]}}]
    values["playing"] = {**values["playing"], "note_end": {"kind": "ring"}}
    values["exciters"] = {**values["exciters"], "pluck": RAMP}
    values["effects"] = {**values["effects"], **effects}
    return tw.Instrument.from_values(values, guitar.folder)


def tension_effect(model: Model) -> TensionEffect:
    """The rising tensions of a model."""
    (found,) = (effect for effect in runtime_effects(model) if isinstance(effect, TensionEffect))
    return found


def moment(system: System, state: State, sample: int = 0) -> Moment:
    """Moment of a motion at a sample as effects read it, with nothing heard or played."""
    state.sample = sample
    return Moment(system, state, {}, np.zeros(len(system.readouts)))


def renderer(notes: list[tw.Note], seconds: float, instrument: tw.Instrument, fs: int = FS) -> tw.Renderer:
    return tw.Renderer(tw.Score(notes), instrument, fs, max_duration=seconds)


def sound(stream: tw.Renderer, block: int = 4096) -> Floats:
    return np.concatenate(list(stream.blocks(block)))


def partial(y: Floats, freq: float, fs: float = FS, width: float = 0.04) -> NDArray[np.complex128]:
    """Slowly varying amplitude of the partials within some 1 / (pi `width`) Hz of `freq`."""
    from scipy.signal import oaconvolve

    t = np.arange(-3 * width, 3 * width, 1 / fs)
    window = np.exp(-0.5 * (t / width) ** 2)
    carrier = np.exp(-2j * np.pi * freq * np.arange(len(y)) / fs)
    return np.asarray(oaconvolve(y * carrier, window / window.sum(), mode="same"))


def compared(a: Floats, b: Floats, freq: float, fs: float = FS) -> tuple[Floats, Floats]:
    """Cents by which a partial near `freq` is higher in b than in a, and dB by which it is louder, while it is strong.

    In the nulls of beats both are ill-defined: times at which the level is 20 dB below the loudest are left out.
    """
    x, y = partial(a, freq, fs), partial(b, freq, fs)
    step = round(0.05 * fs)
    x, y = x[step:-step:step], y[step:-step:step]
    turn = np.angle(y[1:] * np.conj(x[1:]) * np.conj(y[:-1] * np.conj(x[:-1])))
    heard = np.minimum(abs(x), abs(y)) > 0.1 * abs(x).max()
    cents = turn * fs / (2 * np.pi * freq * step) * 1200 / np.log(2)
    level = 20 * np.log10(abs(y) / abs(x))
    return cents[heard[1:] & heard[:-1]], level[heard]


def detuned(a: Floats, b: Floats, freq: float, fs: float = FS) -> float:
    """Cents by which a partial is higher in b than in a, in the mean of its power.

    Of two partials in one band, as those of strings in a chord, neither can be followed from moment to moment.
    """
    x, y = partial(a, freq, fs), partial(b, freq, fs)
    step = round(0.05 * fs)
    x, y = x[step:-step:step], y[step:-step:step]
    turn = np.angle(y[1:] * np.conj(x[1:]) * np.conj(y[:-1] * np.conj(x[:-1])))
    power = abs(x[1:] * y[:-1])
    return float(power @ turn / power.sum()) * fs / (2 * np.pi * freq * step) * 1200 / np.log(2)
