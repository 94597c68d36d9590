"""Noises of a piano's key: the key that meets its felts, and the hammer's shank that rings after the blow.

``playing.noises`` of a bundle names this exciter; a note does not. Its forces act on one point of the body. A
force F on the keybed moves the case, here a rigid mass M, and the soundboard in it: mode k, of mass-normalised shape
phi_k on a board of mass m per area, takes -F Gamma_k / M with Gamma_k = int m phi_k dA. So the shape at that point is
-Gamma_k / M, and it is a point of the body like any other.

``part: bottom``. With each note the front of the key, of effective `mass` m, meets the felt below with the speed
V / `ratio`, V that of the hammer, and stops: a force of the impulse m V / ratio, smooth and `contact` long. It does so

    t = `travel` / V - `lead`

after the hammer met the string: 12 ms at 1 m/s, and 3 ms before it at 4 m/s. Askenfelt and Jansson (Five lectures on
the acoustics of the piano, KTH 1990) measured these times at piano and forte; the speeds for both are by judgement.
Goebl, Bresin and Galembo, J. Acoust. Soc. Am. 118, 1154 (2005), have 35 ms to -4 ms from the softest to the loudest.
The shank's mode of 250 Hz (Askenfelt, STL-QPSR 32/4, 19, 1991) rings from the blow on; its hinge pushes the rail with

    F = `shank_share` m_h V omega e^(-zeta omega t) sin(omega t),

m_h the mass of the `head`. ``part: rest``. As a key comes up, it meets the felt of its back end with `speed`, after the
time `fall`.

Mass, contact, share and loss of the shank, and the speed of a key that comes up are by judgement.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

import tonewood.authoring as ta
from tonewood.authoring import Parameters

#: Hz, values of the shank's force per second
_FS = 48000.0
#: of its amplitude, where it is over
_LEAST = 1e-4


class KeyNoiseParameters(Parameters):
    """Parameters of a key's noise."""

    at: str = ta.described("point it acts on, e.g. body.keybed")
    part: Literal["bottom", "rest"] = ta.described("the key goes down, or comes up", default="bottom")
    velocity: float = ta.quantity("m/s", low=0.0, high=20.0, default=2.0, doc="of the hammer")
    mass: float = ta.quantity("kg", low=0.0, high=10.0, default=0.1, doc="of the key, at its front")
    ratio: float = ta.quantity("1", low=1.0, high=20.0, default=5.0, doc="speed of the hammer re that of the key")
    speed: float = ta.quantity("m/s", low=0.0, high=10.0, default=0.2, doc="part rest: of the key")
    contact: float = ta.quantity("s", low=2e-4, high=0.1, default=4e-3, doc="of the felt, from first to last")
    travel: float = ta.quantity("m", low=0.0, high=0.1, default=0.02, doc="part bottom: see the module")
    lead: float = ta.quantity("s", low=0.0, high=0.1, default=8e-3, doc="part bottom: see the module")
    fall: float = ta.quantity("s", low=0.0, high=1.0, default=0.03, doc="part rest: from the key's release to its felt")
    head: float = ta.quantity("kg", low=0.0, high=0.1, default=8.7e-3, doc="part bottom: of the hammer")
    shank_freq: float = ta.quantity("Hz", low=10.0, high=5000.0, default=250.0, doc="of the shank's mode")
    shank_loss: float = ta.quantity("1", low=1e-3, high=1.0, default=0.05, doc="its damping ratio")
    shank_share: float = ta.quantity("1", low=0.0, high=2.0, default=0.3, doc="of the head's momentum in it; 0: none")


class KeyNoise(ta.Exciter[KeyNoiseParameters]):
    """The noises; see the module."""

    api = 1
    effects = (ta.KEY_NOISE,)
    Parameters = KeyNoiseParameters

    @property
    def at(self) -> str:
        """``component.point`` it acts on."""
        return self.parameters.at

    def gesture(self, event: ta.Event, place: ta.Place) -> ta.Gesture:
        """Forces about the time 0 of the blow, or after that of the key's release."""
        p = self.adjusted(event.values)
        if p.velocity == 0.0 and p.part == "bottom":
            return ta.Gesture(())
        bottom = p.part == "bottom"
        speed, start = (p.velocity / p.ratio, p.travel / p.velocity - p.lead) if bottom else (p.speed, p.fall)
        middle, peak = start + p.contact / 2, 2 * p.mass * speed / p.contact
        force = ta.smooth_step(start, middle, 0.0, -peak) + ta.smooth_step(middle, start + p.contact, -peak, 0.0)
        omega = 2 * math.pi * p.shank_freq
        strength = p.shank_share * p.head * p.velocity * omega
        if not bottom or strength == 0.0:
            return ta.Gesture(force)
        n = math.ceil(-math.log(_LEAST) / (p.shank_loss * omega) * _FS)
        time = np.arange(n + 1) / _FS
        values = strength * np.exp(-p.shank_loss * omega * time) * np.sin(omega * time)
        values[-1] = 0.0
        return ta.Gesture(force, noise=ta.SampledForce(0.0, 1 / _FS, values))
