"""Microphones anywhere in front of a body whose moving surface is known: a one-way bank of modes per microphone.

The pressure is the Rayleigh sum over the whole surface and the soundhole, near field and delays included. For each
driven point of the body the bank has residues on the body's own poles, fitted by least squares to that sum
(`tonewood.physics.plate.microphones`). Nothing acts back on the body; the power radiated is part of the body's own
damping. Time counts from when the microphone that is nearest hears the nearest point of the body; delays between
microphones, up to 5 ms, are kept.

In free air (`baffle: none` of the body) a first-order shelf of 1/2 at low frequencies stands for diffraction about the
box. There is no room, no player, no neck and no sound of the strings themselves.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import tonewood.authoring as ta
from tonewood.authoring import Parameters

#: m, least distance of a microphone from the surface; its squares are 10 mm wide
NEAREST = 0.03
#: m, by which distances of microphones of one output may differ; their delays cost some 15 modes per 0.34 m
FARTHEST = 1.7


class BodyMicrophonesParameters(Parameters):
    """Parameters of the microphones."""

    at: dict[str, ta.Vector] = ta.described(
        "name -> [x, y, z] in m: of the body's drawing, z out of the top", min_length=1, max_length=16
    )


class BodyMicrophones(ta.Microphones[BodyMicrophonesParameters]):
    """The microphones; see the module."""

    api = 1
    Parameters = BodyMicrophonesParameters

    @property
    def channels(self) -> tuple[str, ...]:
        """The microphones."""
        return tuple(self.parameters.at)

    def rows(self, name: str, scene: ta.Scene) -> ta.PickupRows:
        """A component `name` with an input per driven point of the body and an output per channel."""
        sources = None if scene.body is None else scene.body.sources(scene.freq_upper)
        if scene.body is None or sources is None:
            raise self.fault("hears bodies that say how their whole surface moves, such as drawn_body; not this one")
        driven, drives, inputs = self.at_points(name, scene)
        basis = self._basis(scene.body.basis(scene.freq_upper), sources, driven, scene.freq_upper)
        return self.bank_rows(name, basis, drives, inputs)

    def _basis(
        self, body: ta.ModalBasis, sources: ta.plate.Sources, driven: Sequence[str], highest: float
    ) -> ta.ModalBasis:
        """Bank of all microphones; each has modes of its own, so that those that are not recorded are not stepped."""
        shapes = np.array([body.right[body.index(point)].real for point in driven])
        positions = self.parameters.at
        nearest = {name: float(sources.distances(at).min()) for name, at in positions.items()}
        far = max(nearest, key=lambda name: nearest[name])
        if nearest[far] - min(nearest.values()) > FARTHEST:
            raise self.fault(f"is more than {FARTHEST:g} m farther from the body than the nearest one", f"at.{far}")
        delay = min(nearest.values()) / ta.plate.SOUND_SPEED
        digest = hashlib.sha256(f"{highest!r} {sources.baffled} {delay!r}".encode())
        for array in (body.poles, shapes, sources.points, sources.volumes):
            digest.update(np.ascontiguousarray(array).tobytes())
        poles, residues, index = [], [], []
        for k, (name, at) in enumerate(positions.items()):
            if nearest[name] < NEAREST:
                raise self.fault(f"is nearer than {NEAREST:g} m to the body", f"at.{name}")

            def fitted(at: ta.Vector = at) -> dict[str, NDArray[np.complex128]]:
                bank = ta.plate.microphone(sources, at, body.poles, shapes, highest, delay)
                return {"poles": bank.poles, "residues": bank.residues}

            bank = ta.cached_arrays({"sources": digest.hexdigest(), "at": list(at)}, fitted)
            poles.append(bank["poles"])
            residues.append(bank["residues"])
            index.append(np.full(len(bank["poles"]), k))
        owner = np.concatenate(index)
        left = {f"at_{point}": np.concatenate([r[:, i] for r in residues]) for i, point in enumerate(driven)}
        right = {name: (owner == k).astype(np.complex128) for k, name in enumerate(positions)}
        none = np.zeros(len(owner), dtype=np.complex128)
        inputs, outputs = dict.fromkeys(left, none), dict.fromkeys(right, none)
        return ta.ModalBasis.complex(np.concatenate(poles), inputs | right, left | outputs)
