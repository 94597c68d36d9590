"""Bound on the phantom partials of a string, which are missing while its longitudinal motion is not coupled.

Partials i and j of a string, of slopes C_i cos(i pi x / L) cos(w_i t + ...), put C_i C_j H_n,ij / 4 into s_n, the n-th
cosine of the squared slope, at the frequencies w_i + w_j and |w_i - w_j| (H_n: `potentials.longitudinal`). At such a
frequency W the n-th longitudinal mode, of W_n and decay s, answers with the strain

    e_n = s_n (2 i s W - W^2) / (W_n^2 - W^2 + 2 i s W)

and EA e_n acts on the bridge: phantom partials. Their amplitudes are added up as if all were in step, each as loud as
the body makes its frequency. So are the free decay of the longitudinal modes when they are driven no more, and the
click of the mean tension. All that is at most C^T M C. The same stresses move partials, as a
tension would: by no more than C^T N C. Partials drift with the tension; a resonance is taken to reach as far as they
may.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tonewood.performance.effects.bridge_response import BridgeResponse
from tonewood.physics.coupling.potentials.longitudinal import GeometricShare, GeometricStretch, cosine_products
from tonewood.physics.coupling.system import Compiled
from tonewood.physics.modal.held_modes import HeldModes
from tonewood.support.arrays import Floats

#: relative; partials are off by so much at most: 1 cent
_DRIFT = 0.0006
#: cents per relative change of tension
_CENTS = 600.0 / np.log(2.0)


@dataclass(frozen=True, eq=False)
class PartialSlopes:
    """Slopes of a component's partials.

    displaced : (n, n_modes) amplitude of each partial's slope per coordinate q.
    moving : (n, n_modes) the same per q'.
    """

    displaced: Floats
    moving: Floats

    @property
    def n_modes(self) -> int:
        """Modes of the component."""
        return int(self.displaced.shape[1])

    @classmethod
    def of(cls, part: GeometricShare, modes: HeldModes) -> PartialSlopes:
        """Make them of a transverse component's share and its modes with the bridge held."""
        n = modes.n_modes
        shapes = part.slopes @ modes.vectors[:, : part.n].T
        # a held mode is one sine but for the change by bending and the bridge's ramp
        slope = np.sqrt(np.sum(shapes**2, axis=0))[:n]
        rows = modes.vectors * modes.stiffness / modes.freq_rad[:, None] ** 2
        return cls(slope[:, None] * rows, (slope / modes.freq_rad)[:, None] * rows)

    def first(self, n: int) -> PartialSlopes:
        """The lowest n partials."""
        return PartialSlopes(self.displaced[:n], self.moving[:n])

    def amplitudes(self, q: Floats, velocity: Floats) -> Floats:
        """(..., n) slopes of partials in motions (..., n_modes)."""
        return np.hypot(q @ self.displaced.T, velocity @ self.moving.T)


@dataclass(frozen=True, eq=False)
class Phantoms:
    """Phantom partials of one string as it is held now.

    parts : transverse component -> slopes of its n lowest partials.
    heard : (R, n, n) M of each readout.
    detuning : (n, n) N, cents.
    """

    parts: Mapping[str, PartialSlopes]
    heard: Floats
    detuning: Floats

    @classmethod
    def of(
        cls, law: GeometricStretch, compiled: Mapping[str, Compiled], tension: float, response: BridgeResponse
    ) -> Phantoms:
        """Make them of a string under a tension (N).

        compiled : component -> its modes as they are stepped.
        """
        longitudinal = compiled[law.longitudinal]
        end_modes = {name: HeldModes.of(compiled[name].basis, "bridge") for name in law.transverse}
        n = min(int(np.count_nonzero(h.freq_rad < 2 * np.pi * law.freq_coupled)) for h in end_modes.values())
        freq = np.min([h.freq_rad[:n] for h in end_modes.values()], axis=0)
        axial = HeldModes.of(longitudinal.basis, "bridge")
        combined = np.stack([np.abs(np.subtract.outer(freq, freq)), np.add.outer(freq, freq)])
        audible = np.stack([~np.eye(n, dtype=bool), np.ones((n, n), dtype=bool)])
        end = law.longitudinal
        per_newton = response.heard_at(end, combined.ravel()).reshape(len(response.heard), *combined.shape)
        own_per_newton = response.heard_at(end, axial.freq_rad)
        heard, moved = np.zeros((len(per_newton), n, n)), np.zeros((n, n))
        for order in range(axial.n_modes + 1):
            # the partial of index i is the cosine i + 1
            driven = 0.25 * law.axial_stiffness * np.abs(cosine_products(order, n + 1)[1:, 1:])
            answer, after = np.ones(combined.shape), response.stopped_at(end, response.freq_rad[:1])[:, 0]
            if order:
                W, s = axial.freq_rad[order - 1], axial.damping_rate[order - 1]
                away = np.maximum(np.abs(W**2 - combined**2) - 2 * _DRIFT * combined**2, 0.0)
                answer = np.hypot(combined**2, 2 * s * combined) / np.hypot(away, 2 * s * combined + 1e-9 * W**2)
                moved += driven * answer.sum(axis=0)
                after = own_per_newton[:, order - 1]
            # the driven motion, and the motion that is left when that stops: a mode bent as the slopes had it
            bent = 2.0 + (answer.sum(axis=0) if order else 0.0)
            heard += driven * (np.sum(per_newton * answer * audible, axis=1) + after[:, None, None] * bent)
        return cls(
            {name: PartialSlopes.of(compiled[name].potentials[law.name], h).first(n) for name, h in end_modes.items()},
            heard,
            _CENTS / tension * moved,
        )

    def slopes(self, motion: Mapping[str, tuple[Floats, Floats]]) -> Floats:
        """(..., n) slopes of partials, all polarizations, in motions q and q', (..., n_modes), of the components."""
        squares = [self.parts[name].amplitudes(q, v) ** 2 for name, (q, v) in motion.items()]
        return np.asarray(np.sqrt(np.sum(squares, axis=0)))

    def cents(self, slopes: Floats) -> float:
        """Detuning of a partial without them at most, cents, besides that of the mean tension."""
        return float(slopes @ self.detuning @ slopes)

    def level(self, slopes: Floats, peak: Floats) -> Floats:
        """(...,) largest sample that would be missing, ratio to the loudest one of each readout (R,)."""
        missing = np.sum((slopes @ self.heard) * slopes, axis=-1)
        return np.asarray(np.max(missing.T / peak, axis=-1, initial=0.0))
