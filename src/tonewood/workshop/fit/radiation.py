"""Microphones as a one-way bank of modes: pressure per force at the points where the body was driven.

    p(s) = s^2 / ((s + a) (s + b)) sum_k (A_k s + B_k w_k) / (s^2 + 2 zeta_k w_k s + w_k^2) F

with any A and B: air between body and microphone turns phases, and nothing acts back, so no sign is asked for. The
factor is the high-pass of the plugin `modal_radiation`, at a fifth of the band's lower end, below which a fit means
nothing. The search is that of the body's modes and begins with them; cavities and the room may add others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.errors import TonewoodError
from tonewood.support.arrays import Complexes, Floats
from tonewood.support.blas import one_blas_thread
from tonewood.workshop.fit import noise
from tonewood.workshop.fit.body import FittedBody
from tonewood.workshop.fit.projection import FitData, Poles, Shape
from tonewood.workshop.fit.responses import Responses
from tonewood.workshop.fit.search import Iteration, NothingFoundError, sought

#: Hz, of the high-pass of a bank
_LOWEST_CUT, _HIGHEST_CUT = 1.0, 200.0


@dataclass(frozen=True, eq=False)
class FittedRadiation:
    """A one-way bank, as the plugin `modal_radiation` has it.

    Attributes
    ----------
    channels : names of the microphones.
    poles : (K,) 1/s, of each conjugate pair the one with a positive imaginary part.
    low_cut : Hz, of the high-pass s^2 / ((s + a) (s + b)), a and b 0.8 and 1.25 times 2 pi low_cut.
    heave, moment : (n_channels, K) Pa/(N s), residues of the pressure of a force at u = 0, and its change to u = 1.
    error_db : (P, N) |fitted| re |measured|, dB, of each microphone and reference.
    """

    channels: tuple[str, ...]
    poles: Complexes
    low_cut: float
    heave: Complexes
    moment: Complexes
    error_db: Floats

    def __repr__(self) -> str:
        return f"<FittedRadiation of {self.poles.size} modes to {', '.join(self.channels)}>"

    def pressure(self, freq: Floats, u: float, alpha: float = 0.0) -> Complexes:
        """Return the pressure (n_channels, N), Pa/N, of a force at u, on s = alpha + j 2 pi freq."""
        s = (alpha + 2j * np.pi * freq)[:, None]
        residues = self.heave + u * self.moment
        bank = residues @ (1 / (s - self.poles)).T + residues.conj() @ (1 / (s - self.poles.conj())).T
        return np.asarray(bank * _high_pass(s[:, 0], self.low_cut))

    def table(self) -> str:
        """Return the bank as a CSV table; numbers read back are the same numbers."""
        parts = ("re", "im", "moment_re", "moment_im")
        names = [f"{channel}_{part}" for channel in self.channels for part in parts]
        rows = [
            "# Sound pressure per force on the bridge: residues of poles -pi f/Q + 2 pi i f, Pa/(N s).",
            ",".join(["f_Hz", "Q", *names]),
        ]
        freq = self.poles.imag / (2 * np.pi)
        quality = -np.pi * freq / self.poles.real
        for k in range(self.poles.size):
            numbers = [freq[k], quality[k]]
            for heave, moment in zip(self.heave[:, k], self.moment[:, k], strict=True):
                numbers += [heave.real, heave.imag, moment.real, moment.imag]
            rows.append(",".join(repr(float(x)) for x in numbers))
        return "\n".join(rows) + "\n"


@one_blas_thread
def fit_radiation(
    responses: Responses,
    body: FittedBody,
    places: Mapping[str, float],
    *,
    tell: Callable[[Iteration], None] = lambda iteration: None,
) -> FittedRadiation | None:
    """Fit the bank of all microphones; return None where there are none.

    Parameters
    ----------
    responses : of the band, with the pressures.
    body : whose modes the search begins with.
    places : reference -> u, place along the bridge from -1 to 1; with one reference it tells nothing of `moment`,
        which is 0 then.
    tell : called after each iteration of the search.

    Raises
    ------
    TonewoodError : a microphone was not measured from every reference, several references have no different places,
        or no mode stands out of the noise.
    """
    if not responses.pressure:
        return None
    channels = responses.microphones
    references = responses.references
    for name in channels:
        for reference in references:
            if (name, reference) not in responses.pressure:
                raise TonewoodError(f"microphone {name!r} was not measured from {reference!r}", key="responses")
    u = np.array([places.get(reference, 0.0) for reference in references])
    if len(references) > 1 and np.ptp(u) == 0:
        raise TonewoodError(
            "microphones heard the body driven at several points: say where these lie along the bridge, from -1 (bass) "
            "to 1 (treble), as --point NODE=NAME:z:U",
            key="--point",
        )
    measured = np.array([responses.pressure[name, reference] for name in channels for reference in references])
    low_cut = min(max(float(responses.freq[0]) / 5, _LOWEST_CUT), _HIGHEST_CUT)
    cut = np.abs(high_pass := _high_pass(responses.alpha + 2j * np.pi * responses.freq, low_cut))
    sigma = noise.of_neighbours(measured) / cut
    data = FitData(responses.freq, measured / high_pass, sigma, responses.alpha)
    shape = Shape((), len(channels) * min(len(references), 2), True, lower=False, upper=False)
    try:
        problem, poles = sought(data, shape, Poles.at(body.freq[body.measured], body.quality[body.measured]), tell)
    except NothingFoundError:
        raise TonewoodError("no mode of the sound stands out of the noise", key="responses") from None
    poles, k = poles.damped_beyond(float(data.freq[0]), float(data.freq[-1])), len(poles)
    shares = problem.solve(poles).residues
    w, zeta = np.exp(poles.log_freq), np.exp(poles.log_zeta)
    pole = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
    residues = (shares[:, :k] * pole + shares[:, k:] * w) / (2j * pole.imag)
    by_place = np.column_stack([np.ones(u.size), u]) if u.size > 1 else np.ones((1, 1))
    split = sla.pinv(by_place) @ residues.reshape(len(channels), u.size, k)
    moment = split[:, 1] if u.size > 1 else np.zeros_like(split[:, 0])
    bank = FittedRadiation(channels, pole, low_cut, split[:, 0], moment, np.zeros((0, 0)))
    each = [bank.pressure(responses.freq, position, responses.alpha) for position in u]
    fitted = np.array([each[r][c] for c in range(len(channels)) for r in range(u.size)])
    error = np.asarray(20 * np.log10(np.abs(fitted) / np.maximum(np.abs(measured), 1e-300)))
    return replace(bank, error_db=error)


def _high_pass(s: NDArray[np.complexfloating], low_cut: float) -> Complexes:
    """(N,) the high-pass of `modal_radiation`."""
    a, b = 2 * np.pi * low_cut * np.array([0.8, 1.25])
    return np.asarray(s * s / ((s + a) * (s + b)), dtype=np.complex128)
