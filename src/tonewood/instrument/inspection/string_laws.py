"""A string's partials and their decays as they are stepped, against its own law.

The engine steps bases that `detuned` has taken to the tuned tension, and to others in bends. Held at the bridge, their
partials should have the frequencies of a basis made for that tension, and decay by the string's law.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tonewood.instrument.model.assembly import Model
from tonewood.instrument.model.strings import StringModel
from tonewood.instrument.model.tuning import ends_at_rest
from tonewood.physics.modal.held_modes import HeldModes
from tonewood.support.arrays import Floats
from tonewood.support.units import ratio_of_cents

#: bend at which strings are compared, cents
BEND_CENTS = 200.0
#: relative error of a decay rate, and cents of a partial, that are reported: of a tuned string, of a bent one
DECAY_TOLERANCES, PITCH_TOLERANCES = (1e-3, 2e-2), (1.0, 5.0)


@dataclass(frozen=True, slots=True)
class LawErrors:
    """Partials of a string on a rigid bridge against its own law, at one stop and bend.

    stop : number of the stop.
    bend_cents : by which its tension is raised.
    decay_partial, decay : partial whose decay rate is farthest from the law, and its relative error; None of a string
        whose law is not known.
    pitch_partial, cents : partial whose frequency is farthest from that of a basis made for the tension, and how far.
    own : relative error of that decay rate that such a basis has already: no rates of the modes meet the law.
    """

    stop: int
    bend_cents: float
    decay_partial: int
    decay: float | None
    pitch_partial: int
    cents: float
    own: float

    @property
    def decay_is_off(self) -> bool:
        """Whether the decay rate is worth a warning."""
        return self.decay is not None and not abs(self.decay) <= DECAY_TOLERANCES[self.bend_cents != 0.0]

    @property
    def pitch_is_off(self) -> bool:
        """Whether the frequency is worth a warning."""
        return not abs(self.cents) <= PITCH_TOLERANCES[self.bend_cents != 0.0]


def law_errors(model: Model, name: str) -> list[LawErrors]:
    """Compare the open string, its last stop and, but of strings of keys, a bend; the first polarization.

    Nothing is compared of a resonator that does not end on the body: it has no bridge at which it is held.

    Raises BundleError : the string's modes cannot be held at the bridge.
    """
    string = model.strings[name]
    if ends_at_rest(string.tuning.coupled(0).bases(string.tension(0))[0]):
        return []
    cases = [(0, 0.0), *([(string.n_stops, 0.0)] if string.n_stops and string.stopping.finger is None else [])]
    if name not in model.instrument.key_of:
        cases.append((0, BEND_CENTS))
    return [_compared(string, stop, bend) for stop, bend in cases]


def _compared(string: StringModel, stop: int, bend_cents: float) -> LawErrors:
    tension = string.tension(stop) * ratio_of_cents(bend_cents) ** 2
    freq_upper, position = string.tuning.untuned.freq_upper, string.tuning.stops.position(stop)
    basis = string.resonator.basis(freq_upper, stop=position, tension=tension)
    try:
        tuned_modes, basis_modes = (
            HeldModes.of(b, "bridge") for b in (string.tuning.coupled(stop).bases(tension)[0], basis)
        )
    except ValueError as fault:
        raise string.resonator.fault(f"its partials cannot be found: {fault}") from None
    # of a basis of one's own the highest partials need not have converged
    n = max(1, min(tuned_modes.n_modes, basis_modes.n_modes) // 2)
    off = 1200 * np.log2(tuned_modes.freq_rad[:n] / basis_modes.freq_rad[:n])
    law, stated = string.resonator.decay_rate(basis_modes.freq_rad, tension), basis.metadata.get("loss_error")
    if law is None and isinstance(stated, np.ndarray) and stated.shape == basis_modes.freq_rad.shape:
        law = basis_modes.damping_rate / (1 + stated)
    pitch = int(np.argmax(np.abs(off)))
    if law is None:
        return LawErrors(stop, bend_cents, 0, None, pitch + 1, float(off[pitch]), 0.0)
    law = np.broadcast_to(np.asarray(law, dtype=np.float64), basis_modes.freq_rad.shape)
    error, before = (_relative(rates[:n], law[:n]) for rates in (tuned_modes.damping_rate, basis_modes.damping_rate))
    worst = int(np.argmax(np.abs(error)))
    return LawErrors(
        stop, bend_cents, worst + 1, float(error[worst]), pitch + 1, float(off[pitch]), float(before[worst])
    )


def _relative(rate: Floats, law: Floats) -> Floats:
    """Relative errors of rates; infinite where the law is 0 and the rate is not."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(law > 0.0, rate / law - 1.0, np.where(rate > 0.0, np.inf, 0.0))
