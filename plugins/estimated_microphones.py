"""Microphones some way off a measured guitar: an estimate by two oscillators and a statistical extension above them.

Guitars are often measured with microphones 10 cm away, which is not the sound at a listener, and their shapes are known
at the bridge alone. Here A0 and T1 are the two coupled oscillators of top and hole, which radiate as sources in free
air; modes above T1 have a radiation loss factor in common and signs by chance, others for each channel
(`tonewood.physics.plate.two_oscillators`). It estimates levels in bands; nothing of it is measured. Nothing acts back
on the body, and there is no delay.
"""

from __future__ import annotations

import numpy as np

import tonewood.authoring as ta
from tonewood.authoring import Parameters


class EstimatedMicrophonesParameters(Parameters):
    """Parameters of the estimate."""

    A0: float = ta.quantity("Hz", low=20.0, high=1000.0, doc="air mode of the body: the mode nearest to it is taken")
    T1: float = ta.quantity("Hz", low=20.0, high=2000.0, doc="first mode of the top, likewise")
    volume: float = ta.quantity("m^3", low=1e-4, high=1.0, doc="of the body's cavity")
    distance: float = ta.quantity("m", low=0.5, high=100.0, default=1.0, doc="from the body")
    radiation_loss: float = ta.quantity(
        "1", low=0.0, high=0.1, default=0.004, doc="loss factor by radiation of modes above T1"
    )
    channels: list[str] = ta.described("names", default=["left", "right"], min_length=1, max_length=16)
    seed: int = ta.described("of the signs", default=1, ge=0)


class EstimatedMicrophones(ta.Microphones[EstimatedMicrophonesParameters]):
    """The microphones; see the module."""

    api = 1
    Parameters = EstimatedMicrophonesParameters

    @property
    def channels(self) -> tuple[str, ...]:
        """The microphones."""
        return tuple(self.parameters.channels)

    def rows(self, name: str, scene: ta.Scene) -> ta.PickupRows:
        """A component `name` with the body's modes, driven one way; pressure is the acceleration of its channels."""
        driven, drives, inputs = self.at_points(name, scene)
        if scene.body is None:
            raise self.fault("needs a body")
        body = scene.body.basis(scene.freq_upper)
        return self.bank_rows(name, self._basis(body, driven, drives), drives, inputs, "acceleration")

    def _basis(self, body: ta.ModalBasis, driven: list[str], drives: list[ta.Drive]) -> ta.ModalBasis:
        p = self.parameters
        if not body.is_real:
            raise self.fault("needs a body of real modes")
        freq = body.natural_freq
        if freq.max(initial=0.0) < p.T1:
            raise self.fault(f"the body has no mode near {p.T1:g} Hz", "T1")
        pair = int(np.argmin(np.abs(freq - p.A0))), int(np.argmin(np.abs(freq - p.T1)))
        ends = sorted({drive.point.removeprefix("at_") for drive in drives if abs(drive.factor) > 0.5})
        bridge = np.mean([body.right[body.index(point)].real for point in ends or driven], axis=0)
        omega = np.sqrt(body.stiffness)
        loss = np.divide(2 * body.damping_rate, omega, out=np.zeros(len(omega)), where=omega > 0)
        rng = np.random.default_rng(p.seed)
        signs = np.stack([rng.choice([-1.0, 1.0], size=len(freq)) for _ in p.channels])
        try:
            heard = ta.plate.pressure_shapes(freq, loss, bridge, pair, p.volume, p.distance, p.radiation_loss, signs)
        except ValueError as fault:
            raise self.fault(str(fault), "A0") from None
        points = {f"at_{point}": body.right[body.index(point)].real for point in driven}
        return ta.ModalBasis.real(omega, body.damping_rate, points | dict(zip(p.channels, heard, strict=True)))
