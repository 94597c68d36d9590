"""All strings on their body at once: the pitch of a string where another string shares the partial.

The tuner damps the other strings. Once they are free again, a string whose partial lies near the pitch takes part in
its mode through the body: two modes some cents apart take the place of one, and neither need be on the note.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tonewood.instrument.inspection.frequencies import Pitch
from tonewood.instrument.model.assembly import Model
from tonewood.instrument.model.strings import StringModel
from tonewood.instrument.model.tuning import body_ports
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.receptance import Ports, Star
from tonewood.support.units import cents, ratio_of_cents

#: range of the search around the mode of the string alone, cents
REACH_CENTS = 70.0
#: a string with less of the mode's energy than this does not share it; a mode with less of the string is not listed
SHARED, HEARD = 0.05, 0.1


@dataclass(frozen=True, slots=True)
class MountedPitch:
    """A string at a stop, the others open and free beside it.

    freq : Hz, of the mode with the largest share of its energy in the string's first polarization.
    error_cents : of that mode, from the pitch asked for.
    modes : (cents from the pitch asked for, share of its energy in the string's first polarization), ...: this mode and
        all near it with 10 %, by share.
    partner : string with the largest share beside it, or None where no other has 5 %.
    partner_share : of the mode's energy; 0 without a partner.
    """

    freq: float
    error_cents: float
    modes: tuple[tuple[float, float], ...]
    partner: str | None
    partner_share: float


class Mounted:
    """All strings of an instrument on its body.

    strings : name -> string; the first polarization of each, and the second where there is one.
    body : on which they end.
    """

    def __init__(self, strings: Mapping[str, StringModel], body: ModalBasis):
        self.strings = strings
        self._body = body_ports(body, [p.ends for s in strings.values() for p in s.polarizations])
        self._owner = [name for name, s in strings.items() for _ in s.polarizations]
        self._open = {name: _ports(s, 0) for name, s in strings.items()}

    def pitch(self, at: Pitch) -> MountedPitch:
        """The pitch `at` of a string alone, with all others mounted."""
        rays = self._open | {at.string: _ports(self.strings[at.string], at.stop)}
        alone = at.modes[0].pole
        if not any(np.any(ports.right) for ports in rays[at.string]):  # it does not end on the body
            freq = alone.imag / (2 * math.pi)
            error = cents(freq / at.wanted_freq)
            return MountedPitch(freq, error, ((error, 1.0),), None, 0.0)
        star = Star(self._body, [ports for name in self.strings for ports in rays[name]])
        radius = alone.imag * (ratio_of_cents(REACH_CENTS) - 1)
        zeros = star.zeros_within(1j * alone.imag, radius, starts=[alone]) or [alone]
        row = 1 + self._owner.index(at.string)
        modes_by_share = sorted(((star.shares(s), s) for s in zeros), key=lambda pair: -float(pair[0][row]))
        shares, s = modes_by_share[0]

        def off(s: complex) -> float:
            return cents(s.imag / (2 * math.pi) / at.wanted_freq)

        modes = tuple((off(s), float(x[row])) for i, (x, s) in enumerate(modes_by_share) if i == 0 or x[row] >= HEARD)
        by_string = dict.fromkeys(self.strings, 0.0)
        for name, share in zip(self._owner, shares[1:], strict=True):
            by_string[name] += float(share)
        del by_string[at.string]
        partner = max(by_string, key=lambda name: by_string[name], default=None)
        if partner is not None and by_string[partner] < SHARED:
            partner = None
        share = 0.0 if partner is None else by_string[partner]
        return MountedPitch(s.imag / (2 * math.pi), off(s), modes, partner, share)


def mounted_pitches(model: Model, alone: Sequence[Pitch]) -> list[MountedPitch]:
    """Return pitches of strings with others mounted beside them.

    A string that has a damper stands beside those of its key, which are lifted with it, the others with all strings
    that have none: a string under its damper is taken not to move.
    """
    free = {name: string for name, string in model.strings.items() if string.places.damper is None}
    undamped = Mounted(free, model.body)
    out = []
    for p in alone:
        string = model.strings[p.string]
        beside = {name: model.strings[name] for name in string.group}
        out.append((undamped if string.places.damper is None else Mounted(beside, model.body)).pitch(p))
    return out


def _ports(string: StringModel, stop: int) -> list[Ports]:
    """Each polarization of a string at its bridge end."""
    bases = string.tuning.coupled(stop).bases(string.tension(stop))
    return [Ports.of(b, np.eye(len(b.points))[[b.index("bridge")]]) for b in bases]
