"""Noises of hands between notes: a finger that comes to a stop or leaves it, that ends a note, that slides.

The exciters here are named by ``playing.noises`` of a bundle; no note asks for them. All are known forces of a moving
finger on a string of wave impedance Z = T / (2 L f), and a dashpot that dissipates only. A string resists a finger of
speed v by 2 Z v.

``fretting_noise``. Before a note whose stop is another one than before, a finger presses the string for `time` at the
new stop with the force 2 Z `speed`; the string is then shorter, and sounds as it was pressed. To a lower stop, or to
the open string, the finger leaves the old stop sideways with `lift` times that force. Skin lies on the string
meanwhile.

``touch_noise``. As a note ends, a finger falls on the string, where it was plucked, with 2 Z `speed`, and its push is
over after `time`; that it damps the string, too, is the matter of ``playing.note_end``.

``squeak``. As the hand slides from one stop to another in `time`, the finger rubs over `windings` turns of wire per
metre, each a push; with the hand's way x(t) from stop to stop, level at both ends, the force is

    f = depth x' / max x' sum_{n=1}^{3} sin(2 pi n (windings x + phase)) / n,

where `phase`, a random walk, makes `jitter` turns per square root of a turn: no winding is even. Pakarinen, Puputti,
Valimaki, Virtual slide guitar, Computer Music Journal 32(3), 42 (2008), have the same cause and pitch; there it is a
train of noise pulses. The force is normal to the board, as a finger on ridges lifts; a real one also pulls along the
string.

Speeds, forces and dashpots are by judgement.
"""

from __future__ import annotations

import math
import zlib

import numpy as np
from numpy.typing import NDArray

import tonewood.authoring as ta
from tonewood.authoring import Parameters

Floats = NDArray[np.float64]

#: N and Hz, of a string whose tension or pitch is not known: a nylon string's
_TENSION, _FREQ = 70.0, 200.0
#: Hz, values of a force per second; partials of windings above the second number are left out
_NOISE_FS, _HIGHEST = 48000.0, 20000.0
#: place next to a stop that is left, share of the speaking length
_BESIDE = 0.99


class NoiseParameters(Parameters):
    """Parameters that fingers on a string have in common."""

    roughness: float = ta.quantity("1", low=0.0, high=1.0, default=0.02, doc="rms of the force's random part, re it")
    seed: int = ta.described("of the random part", default=0, ge=0)


class FrettingNoiseParameters(NoiseParameters):
    """Parameters of a finger that comes or goes."""

    speed: float = ta.quantity("m/s", low=0.0, high=10.0, default=0.1, doc="of the finger that presses the string down")
    time: float = ta.quantity("s", low=1e-3, high=1.0, default=0.015, doc="it takes")
    lift: float = ta.quantity(
        "1", low=0.0, high=10.0, default=0.5, doc="force of a finger that leaves, re one that comes"
    )
    hold_dashpot: float = ta.quantity(
        "N s/m", low=0.0, high=100.0, default=1.0, doc="damping of the skin on the string"
    )


class TouchNoiseParameters(NoiseParameters):
    """Parameters of a finger that ends a note."""

    speed: float = ta.quantity("m/s", low=0.0, high=10.0, default=0.05, doc="of the finger that falls on the string")
    time: float = ta.quantity("s", low=2e-3, high=10.0, default=0.02, doc="for which its force lasts")


class SqueakParameters(Parameters):
    """Parameters of a finger that slides."""

    strings: tuple[str, ...] = ta.described("those that are wound; none: all", default=())
    windings: float = ta.quantity("1/m", low=100.0, high=20000.0, default=4000.0, doc="turns of wire per metre")
    depth: float = ta.quantity("N", low=0.0, high=10.0, default=0.01, doc="of the push of a winding, at the top speed")
    time: float = ta.quantity("s", low=0.01, high=5.0, default=0.08, doc="of the slide")
    jitter: float = ta.quantity("1", low=0.0, high=1.0, default=0.05, doc="turns by which turns wander")
    hold_dashpot: float = ta.quantity(
        "N s/m", low=0.0, high=100.0, default=0.3, doc="damping of the skin on the string"
    )
    seed: int = ta.described("of the windings", default=0, ge=0)


def impedance(event: ta.Event, place: ta.Place) -> float:
    """Wave impedance of the string, N s/m."""
    return (place.tension or _TENSION) / (2 * place.length * (event.freq or _FREQ))


class FrettingNoise(ta.Exciter[FrettingNoiseParameters]):
    """Noise of a hand: a finger that comes to a stop, or leaves one."""

    api = 1
    effects = (ta.FRETTING_NOISE,)
    Parameters = FrettingNoiseParameters

    def gesture(self, event: ta.Event, place: ta.Place) -> ta.Gesture:
        """Return a gesture that ends at time 0, when the string has its new stop; `place` is that of the new one."""
        p = self.adjusted(event.values)
        before = event.length_before or place.length
        comes = place.length < before
        force = 2 * impedance(event, place) * p.speed * (1.0 if comes else p.lift)
        label = f"fret {place.name} {event.stop_before:g} {event.stop:g}"
        noise = pressed(-p.time, p.time, (0.25, 0.02), force, p, label)
        hold = ta.Hold(-p.time, -p.time, 0.0, p.hold_dashpot) if p.hold_dashpot > 0 else None
        at = place.length if comes else _BESIDE * before
        return ta.Gesture((), at, 180.0 if comes else 90.0, hold, noise=noise)


class TouchNoise(ta.Exciter[TouchNoiseParameters]):
    """Noise of a hand: a finger that falls on a sounding string."""

    api = 1
    effects = (ta.TOUCH_NOISE,)
    Parameters = TouchNoiseParameters

    def gesture(self, event: ta.Event, place: ta.Place) -> ta.Gesture:
        """Return a gesture that begins at time 0."""
        p = self.adjusted(event.values)
        force = 2 * impedance(event, place) * p.speed
        noise = pressed(0.0, p.time, (0.025, 0.975), force, p, f"touch {place.name} {event.stop:g}")
        return ta.Gesture((), None, 180.0, noise=noise)


class Squeak(ta.Exciter[SqueakParameters]):
    """Noise of a hand: a finger that slides along windings."""

    api = 1
    effects = (ta.SQUEAK,)
    Parameters = SqueakParameters

    def gesture(self, event: ta.Event, place: ta.Place) -> ta.Gesture:
        """Return a gesture that ends at time 0, at the new stop; none on strings that are not wound."""
        p = self.adjusted(event.values)
        before = event.length_before or place.length
        way = abs(before - place.length)
        if way == 0.0 or (p.strings and place.name not in p.strings):
            return ta.Gesture(())
        n = math.ceil(p.time * _NOISE_FS)
        share = np.linspace(0.0, 1.0, n + 1)
        travelled = way * _smooth(share)
        relative_speed = 4.0 * share * (1.0 - share)
        random = np.random.Generator(np.random.PCG64(zlib.crc32(f"{p.seed} squeak {place.name}".encode())))
        per_value = np.sqrt(np.diff(p.windings * travelled, prepend=0.0))
        passed = p.windings * travelled + np.cumsum(p.jitter * per_value * random.standard_normal(n + 1))
        rate = 1.5 * p.windings * way / p.time * relative_speed
        values = sum(np.sin(2 * np.pi * k * passed) / k * (k * rate < _HIGHEST) for k in (1, 2, 3))
        noise = ta.SampledForce(-p.time, p.time / n, np.asarray(p.depth * relative_speed * values))
        hold = ta.Hold(-p.time, -p.time, 0.0, p.hold_dashpot) if p.hold_dashpot > 0 else None
        at = min((before + place.length) / 2, _BESIDE * before)
        return ta.Gesture((), at, 180.0, hold, noise=noise)


def pressed(
    start: float, time: float, shares: tuple[float, float], force: float, p: NoiseParameters, label: str
) -> ta.SampledForce:
    """Force that rises smoothly to `force`, stays and falls smoothly, with its random part.

    Parameters
    ----------
    start, time : s, its beginning and how long it lasts.
    shares : of the time, in which it rises and falls.
    label : beside the seed, of the random part.
    """
    n = math.ceil(time * _NOISE_FS)
    share = np.linspace(0.0, 1.0, n + 1)
    level = force * _smooth(share / shares[0]) * _smooth((1.0 - share) / shares[1])
    white = np.random.Generator(np.random.PCG64(zlib.crc32(f"{p.seed} {label}".encode()))).standard_normal(n + 1)
    return ta.SampledForce(start, time / n, level * (1.0 + p.roughness * white))


def _smooth(x: Floats) -> Floats:
    """From 0 at 0 to 1 at 1, level at both ends and beyond."""
    x = np.minimum(x, 1.0)
    return x * x * (3.0 - 2.0 * x)
