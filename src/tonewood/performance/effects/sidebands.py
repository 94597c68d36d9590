"""Bound on the sidebands that a rising tension gives to a string's partials, which are missing without it.

Partial m, of mean stretch S_m, makes the tension dT_m (1 + cos 2 w_m t) with dT_m = EA S_m / (2 L). The mean raises
the pitch (`instrument.contract.effects.rise_of_tension`). The rest gives partial n, of amplitude A_n and force F_n on
the bridge, sidebands at w = |w_n - 2 w_m| and w_n + 2 w_m. They are those of an oscillator whose stiffness beats; at
the bridge the tension's own beat is subtracted:

    A / A_n = (dT_m / 2T) w_n^2 / |w_n^2 - w^2|,      F / F_n = (dT_m / 2T) w^2 / |w_n^2 - w^2|.

Where n and m are one partial, in the same plane or in both, 2 w_m - w_n is w_n: this sideband is the partial itself,
shifted in pitch and level, and is not counted here. In tune with a partial k other than n, a sideband's force drives
that partial through the bridge, which shifts it by d_k = g_k^2 |Y| / (2 w_k^2) rad/s, Y the bridge's mobility. The
tension drives it, too, since the stretch has terms c sqrt(S_n S_k) besides those of the single partials (c is 2e-4 to
2e-3 in guitars). With a force that decays as s_n + 2 s_m, and a partial as s_k, both add

    (|F / F_n| d_k + (dT_m / 2T) c w_k / 2) / max(s_k + s_n + 2 s_m, |w - w_k| - d_k)    re F_n.

Amplitudes are added up as if all were in phase, with the click of the risen tension's force on the bridge if it stopped
now.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np

from tonewood.performance.effects.bridge_response import BridgeResponse
from tonewood.physics.coupling.potentials.tension import stretch_weights
from tonewood.physics.coupling.system import Compiled, System
from tonewood.physics.modal.held_modes import HeldModes
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.arrays import Floats

#: lowest partials whose beats are counted one by one; those above are taken together
_BEATING = 12
#: lowest partials that are counted one by one
_SINGLE = 32
#: relative; partials drift by so much at most: 2 cents
_DRIFT = 0.0012
_POWER = {"velocity": 1, "acceleration": 2}


@dataclass(frozen=True, eq=False)
class Plane:
    """Partials of one component, the lowest ones counted one by one.

    stiffness, shape : (n_modes,) of its free-interface modes, 1/s^2, and at the bridge, 1/sqrt(kg).
    bent, moving : (n, n_modes) amplitude of each partial's velocity per coordinate q, and per q'.
    bridge_force : (n_modes,) N on the bridge per coordinate q, of all partials.
    heard : (R, n, _BEATING + 1) of each readout, per velocity of a partial and dT_m / 2T; last, of all m above.
    above : (R, _BEATING + 1) the same of all partials above those n together, per root of twice their energy.
    stopped : (R,) click in each readout per N that stops at once.
    """

    stiffness: Floats
    shape: Floats
    bent: Floats
    moving: Floats
    bridge_force: Floats
    heard: Floats
    above: Floats
    stopped: Floats

    @classmethod
    def of(
        cls, component: str, basis: ModalBasis, held_modes: HeldModes, system: System, response: BridgeResponse
    ) -> Plane:
        """Make it of a component and its modes with the bridge held."""
        w, g, s = held_modes.freq_rad, held_modes.force, held_modes.damping_rate
        n, m = w[:, None, None], w[None, :_BEATING, None]
        freq = np.abs(n + 2 * m * np.array([-1.0, 1.0]))
        away = np.maximum(np.abs(n**2 - freq**2), 2 * freq * (_DRIFT * freq + s[:, None, None]))
        answer, bridge = n**2 / away, freq**2 / away
        modes = np.arange(min(len(w), _BEATING))
        answer[modes, modes, 0] = bridge[modes, modes, 0] = 0.0
        decay = s[:, None, None] + 2 * s[None, :_BEATING, None] + np.zeros(2)
        force = (g / w)[:, None, None] * _resonant(component, basis, held_modes, response, freq, decay, bridge)
        heard = response.heard_at(component, freq.ravel()).reshape(-1, *freq.shape) * force
        top = response.heard[:, response.components.index(component)].max(axis=1)
        # sidebands far above a partial act on the bridge alone; those close to it are as strong as its number
        rest = np.outer(top, (g / w) * (2.0 + w / w[0]))
        for r, readout in enumerate(system.readouts):
            for probe in readout.probes:
                if probe.component == component:
                    moved = np.abs(probe.factor * (held_modes.vectors @ basis.right[basis.index(probe.point)].real)) / w
                    power = _POWER.get(readout.quantity, 0)
                    heard[r] += moved[:, None, None] * answer * freq**power
                    rest[r] += moved * (2.0 + w / w[0]) * w[-1] ** power
        each = np.zeros((*rest.shape, _BEATING + 1))
        each[..., : len(modes)], each[..., -1] = heard.sum(axis=-1), rest
        bent = held_modes.vectors * held_modes.stiffness / w[:, None]
        single = min(_SINGLE, len(w))
        return cls(
            held_modes.stiffness,
            held_modes.shape,
            np.ascontiguousarray(bent[:single]),
            np.ascontiguousarray(held_modes.vectors[:single]),
            (g / w) @ bent,
            np.ascontiguousarray(each[:, :single]),
            np.sqrt(np.sum(each[:, single:] ** 2, axis=1)),
            response.stopped_at(component, response.freq_rad[:1])[:, 0],
        )

    def energies(self, q: Floats, v: Floats) -> tuple[float, float]:
        """Potential and kinetic energy of all partials, J: without the shape that the bridge's motion gives."""
        bridge, speed = float(self.shape @ q), float(self.shape @ v)
        compliance = float(np.sum(self.shape**2 / self.stiffness))
        potential = float(self.stiffness @ (q * q)) - bridge**2 / compliance
        kinetic = float(v @ v) - speed**2 / float(self.shape @ self.shape)
        return 0.5 * max(potential, 0.0), 0.5 * max(kinetic, 0.0)


def _resonant(
    component: str,
    basis: ModalBasis,
    modes: HeldModes,
    response: BridgeResponse,
    freq: Floats,
    decay: Floats,
    bridge: Floats,
) -> Floats:
    """Magnitudes of sidebands on the bridge, with the string's partials that they drive.

    freq, decay, bridge : (n, m, 2) rad/s, 1/s, and magnitudes without these partials.
    """
    i, end = response.components.index(component), basis.index("bridge")
    w = modes.freq_rad
    mobility = np.interp(w, response.freq_rad, response.mobility[i]) + w * abs(basis.residual[end, end])
    shift = modes.force**2 * mobility / (2 * w**2)
    low = modes.vectors[:_BEATING]
    form = (low * cast(Floats, stretch_weights(basis))) @ low.T
    coupled = np.abs(form) / np.sqrt(np.outer(np.diag(form), np.diag(form))) - np.eye(len(low))
    near = np.searchsorted(0.5 * (w[1:] + w[:-1]), freq)
    apart = np.abs(freq - w[near]) - _DRIFT * w[near] - shift[near]
    driven = bridge * shift[near] + 0.5 * coupled.max(initial=0.0) * w[near] * (bridge > 0.0)
    return np.asarray(bridge + driven / np.maximum(modes.damping_rate[near] + decay, apart))


def _same_modes(one: ModalBasis, other: ModalBasis) -> bool:
    """Whether two planes of a string have the same modes, as they have where nothing tells the planes apart."""
    shapes = (basis.right[basis.index("bridge")] for basis in (one, other))
    return (
        np.array_equal(one.stiffness, other.stiffness)
        and np.array_equal(one.damping_rate, other.damping_rate)
        and np.array_equal(*shapes)
    )


@dataclass(frozen=True, eq=False)
class Sidebands:
    """Sidebands of one string as it is held now.

    planes : component -> its partials.
    rise : dT / 2T in the mean per J.
    """

    planes: Mapping[str, Plane]
    rise: float

    @classmethod
    def of(cls, compiled: Mapping[str, Compiled], rise: float, system: System, response: BridgeResponse) -> Sidebands:
        """Make them of a string's transverse components."""
        planes = {}
        before: tuple[ModalBasis, HeldModes] | None = None
        for name, part in compiled.items():
            if part.basis.n_modes > 1:
                same = before is not None and _same_modes(before[0], part.basis)
                end_modes = before[1] if same and before else HeldModes.of(part.basis, "bridge")
                before = part.basis, end_modes
                planes[name] = Plane.of(name, part.basis, end_modes, system, response)
        return cls(planes, rise)

    def level(
        self, motion: Mapping[str, tuple[Floats, Floats]], peak: Floats, plucked: Mapping[str, Floats] | None = None
    ) -> float:
        """Largest sample that would be missing, ratio to the loudest one of each readout (R,).

        motion : component -> q and q'.
        plucked : component -> q that the next pluck will add.
        """
        beats, sizes, bending, all_ = np.zeros(_BEATING), [], 0.0, 0.0
        for name, plane in self.planes.items():
            q, v = motion[name]
            potential, kinetic = plane.energies(q, v)
            size, energy = np.hypot(plane.bent @ q, plane.moving @ v), potential + kinetic
            if plucked is not None:
                size += np.abs(plane.bent @ plucked[name])
                energy = (math.sqrt(energy) + math.sqrt(plane.energies(plucked[name], 0.0 * v)[0])) ** 2
            squares = 0.5 * size * size
            higher = max(energy - float(squares.sum()), 0.0)
            bending += potential
            all_ += float(squares.sum()) + higher
            lowest = squares[:_BEATING]
            beats[: len(lowest)] += lowest
            sizes.append((plane, size, math.sqrt(2 * higher), abs(float(plane.bridge_force @ q))))
        shares = self.rise * np.append(beats, max(all_ - float(beats.sum()), 0.0))
        heard = np.zeros(len(peak))
        for plane, size, higher, force in sizes:
            # 4 rise bending is dT / T at this moment: a switch changes the force on the bridge by that share
            heard += (plane.heard @ shares) @ size + higher * (plane.above @ shares)
            heard += plane.stopped * (4 * self.rise * bending * force)
        return float(np.max(heard / peak, initial=0.0))
