"""Components of a string beside its planes: longitudinal motion, and all that its potentials act on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from tonewood.physics.modal.modes import ModalBasis


@dataclass(frozen=True, slots=True)
class Longitudinal:
    """Motion along a string, stepped with the transverse one; see `tonewood.physics.coupling.potentials.longitudinal`.

    Attributes
    ----------
    basis : highest frequency (Hz) and stop (m from the nut) -> modes along the string with its bridge end free, made by
        `ta.string_basis` with EA as tension.
    bridge_leverage : displacement of the string's end towards the nut per displacement of the body's point, in
        addition to the projection on the inclined string.
    """

    basis: Callable[[float, float], ModalBasis]
    bridge_leverage: float


@dataclass(frozen=True, slots=True)
class StringMotion:
    """Components of a string in the system, for its potentials.

    Attributes
    ----------
    name : of the string: that of its potential, or the beginning of it.
    planes : components of its polarizations.
    longitudinal : component of its longitudinal motion; None where that is not stepped.
    end_shares : body point -> share of its displacement in that of the string's end along the string.
    """

    name: str
    planes: tuple[str, ...]
    longitudinal: str | None
    end_shares: Mapping[str, float]

    def onto_body(self, leverage: float = 0.0) -> tuple[tuple[str, str, float], ...]:
        """Return (component, point, share), ...: on which a tension at the bridge acts, times the share.

        Parameters
        ----------
        leverage : share added at the point that moves most along the string, which turns about the bridge.
        """
        return tuple(("body", point, share) for point, share in levered(self.end_shares, leverage).items())


def levered(end_shares: Mapping[str, float], leverage: float) -> dict[str, float]:
    """Return shares of body points in the motion along a string, `leverage` added to the largest one."""
    shares = dict(end_shares)
    shares[max(shares, key=lambda point: abs(shares[point]))] += leverage
    return {point: share for point, share in shares.items() if abs(share) > 1e-12}
