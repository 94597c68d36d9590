"""A stiff string with phantom partials: `stiff_string`, whose transverse motion drives a longitudinal one.

    mu u_tt + loss = EA (u_x + (v_x^2 + w_x^2) / 2)_x,      force on the bridge EA (u_x + (v_x^2 + w_x^2) / 2)

The square of the slope has partials at sums and differences of the transverse frequencies; it drives the longitudinal
modes, n / (2 L) sqrt(EA / mu), and the bridge hears them (Conklin 1999; Bank & Sujbert 2005). One way: the transverse
motion does not feel it, nor does the tension rise (`geometric_string` steps both ways at tens of times the cost). The
force acts on the body's point by the projection on the inclined string, and by `bridge_leverage` times more.

Equations, terms left out, energy: `tonewood.physics.coupling.potentials.phantom`. Good where the rise of the tension is
not heard: a piano's strings, below a cent.
"""

from __future__ import annotations

from collections.abc import Sequence

from tonewood.plugins.stiff_string import StiffString, StiffStringParameters

import tonewood.authoring as ta


class PhantomStringParameters(StiffStringParameters):
    """Parameters of the open string."""

    axial_stiffness: float = ta.quantity("N", low=1.0, high=1e7, doc="E A of the core")
    freq_coupled: float = ta.quantity(
        "Hz", low=20.0, high=1e5, default=3000.0, doc="transverse modes below it drive the longitudinal ones"
    )
    longitudinal_loss: float = ta.quantity(
        "1", low=0.0, high=1.0, default=0.01, doc="loss factor of longitudinal modes, 2 sigma / omega"
    )
    bridge_leverage: float = ta.quantity(
        "1", low=-2.0, high=2.0, default=0.1, doc="force on the body's point per tension at the bridge"
    )


class PhantomString(StiffString):
    """The string; see the module."""

    api = 1
    effects = (*StiffString.effects, ta.PHANTOM_PARTIALS)
    Parameters = PhantomStringParameters
    parameters: PhantomStringParameters

    def potentials(self, string: ta.StringMotion) -> Sequence[ta.Potential]:
        """The motion along the string, where it moves the body."""
        p, onto = self.parameters, string.onto_body(self.parameters.bridge_leverage)
        driven = string.name, string.planes, onto, p.axial_stiffness, p.freq_coupled, p.longitudinal_loss
        return [ta.DrivenLongitudinal(*driven)] if onto else []
