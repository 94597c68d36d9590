"""Wolf notes of an instrument, ranked by how bad they are: how deep, and over which range of pitch.

Near a body mode a string's fundamental is not one mode but two, a splitting apart: it beats, and falls as fast as the
body does. At every pitch x (cents) that the string can be brought to, at its stops and between them,

    d(x) = sum' p_k / (p_1 + sum' p_k)

is the share of the string's energy in its fundamental that modes other than the string-dominated one (k = 1) hold. p_k
is the string's share of the energy of coupled mode k; sum' runs over the coupled modes within 15 % of the pitch,
without those of the string's second polarization. d is 0 beside a rigid body and 0.5 where string and body share two
modes alike. A wolf is an interval of pitch in which d stays at or above 0.2, with

    depth = max d,    breadth = length of the interval, cents,    severity = integral of d over it, cents.

For a string and one body mode, the splitting 2 c wide against their losses,

    d(x) = (1 - |x| / sqrt(x^2 + 4 c^2)) / 2:    depth 1/2, breadth 3 c, severity c:

the severity is half the splitting at coincidence, c = (1200 / ln 2) sqrt(m / 2 M) / pi cents for a string of mass m
on a mode of mass M. Losses that differ by more than the splitting end it: d falls to 0, and the note is merely short.

Source: C. E. Gough, The theory of string resonances on musical instruments, Acustica 49 (1981) 124, for the coupled
modes and the splitting; depth, breadth and severity are this module's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from tonewood.instrument.model.assembly import Model
from tonewood.instrument.model.tuning import StringOnBody, of_second_polarization
from tonewood.support.arrays import Floats
from tonewood.support.units import cents, ratio_of_cents

#: least share of the string's energy in other modes that counts
LEAST_SHARE = 0.2
#: widest step of pitch, cents, and where the share at an end of the step exceeds `_HINT`
_COARSE_CENTS, STEP_CENTS, _HINT = 25.0, 6.5, 0.05
#: how far from a stop's pitch a body mode may lie to matter, cents
_NEAR_CENTS = 250.0
#: cents below the open string and above the last stop that are looked at
_MARGIN_CENTS = 50.0
#: cents between points to which the share is interpolated
_FINE_CENTS = 0.25


@dataclass(frozen=True, slots=True)
class WolfNote:
    """An interval of pitch on one string in which a body mode disturbs the fundamental.

    string : its name.
    low_freq, high_freq : Hz, ends of the interval.
    worst_freq : Hz, pitch at which the share is largest.
    depth : largest share of the string's energy in other modes, 0 to 1.
    breadth_cents : length of the interval.
    severity_cents : integral of the share over the interval.
    body_freq : Hz, natural frequency of the body mode nearest to `worst_freq`.
    stops : whole stops whose pitch lies in the interval.
    """

    string: str
    low_freq: float
    high_freq: float
    worst_freq: float
    depth: float
    breadth_cents: float
    severity_cents: float
    body_freq: float
    stops: tuple[int, ...]


def disturbed_share(shares: Sequence[Sequence[float]]) -> float:
    """Share d of the string's energy in modes other than the first, 0 to 1.

    shares : of each mode's energy: one per polarization, then the body's.
    """
    first, *others = shares
    rest = sum(mode[0] for mode in others if not of_second_polarization(mode))
    return float(rest / (first[0] + rest))


def share_curve(string: StringOnBody, tension: float, freq: float, offsets: Floats) -> Floats:
    """d(x) of a string that is brought to other pitches by its tension.

    tension, freq : N and Hz at x = 0.
    offsets : (n,) x, cents: tension 2^(x / 600) times as large.
    Returns (n,) shares; 0 where no mode is found.
    """
    out = np.zeros(offsets.size)
    for i, x in enumerate(offsets):
        coupled_poles = string.poles(
            string.joint(tension * ratio_of_cents(2 * float(x))), freq * ratio_of_cents(float(x))
        )
        out[i] = disturbed_share([shares for _, shares in coupled_poles]) if coupled_poles else 0.0
    return out


def wolf_notes(model: Model, strings: Sequence[str] | None = None) -> list[WolfNote]:
    """Wolf notes of all strings, or of those named, the most severe first."""
    body = model.body.natural_freq
    wolves = [wolf for name in (strings or model.groups) for wolf in _of_string(model, name, body)]
    return sorted(wolves, key=lambda wolf: -wolf.severity_cents)


def _of_string(model: Model, name: str, body_freq: Floats) -> list[WolfNote]:
    """Wolf notes of one string: its range of pitch is cut half-way between stops, each part swept at its stop."""
    string = model.strings[name]
    freqs = np.array(string.tuning.freqs)
    above = 1200 * np.log2(freqs / freqs[0])
    edges = np.concatenate([[-_MARGIN_CENTS], (above[:-1] + above[1:]) / 2, [above[-1] + _MARGIN_CENTS]])
    places: list[Floats] = []
    shares: list[Floats] = []
    for stop, (low, high) in enumerate(pairwise(edges)):
        if high <= low:
            continue
        body_cents = 1200 * np.log2(np.maximum(body_freq, 1e-9) / freqs[0])
        if not np.any(np.abs(body_cents - above[stop]) < _NEAR_CENTS + (high - low) / 2):
            x = np.array([low, high])
            d = np.zeros(2)
        else:
            at = partial(share_curve, string.tuning.coupled(stop), string.tension(stop), float(freqs[stop]))
            even = np.linspace(low, high, max(2, round((high - low) / _COARSE_CENTS) + 1))
            x, d = _refined(
                at, np.unique(np.concatenate([even, body_cents[(body_cents > low) & (body_cents < high)]])), above[stop]
            )
        places.append(x)
        shares.append(d)
    where, share = np.concatenate(places), np.concatenate(shares)
    return [
        WolfNote(
            string=name,
            low_freq=float(freqs[0] * ratio_of_cents(low)),
            high_freq=float(freqs[0] * ratio_of_cents(high)),
            worst_freq=(worst := float(freqs[0] * ratio_of_cents(peak))),
            depth=depth,
            breadth_cents=high - low,
            severity_cents=severity,
            body_freq=float(min(body_freq, key=lambda f: abs(cents(max(f, 1e-9) / worst)))),
            stops=tuple(int(i) for i in np.flatnonzero((above >= low) & (above <= high))),
        )
        for low, high, peak, depth, severity in intervals(where, share)
    ]


def _refined(curve: Callable[[Floats], Floats], x: Floats, origin: float) -> tuple[Floats, Floats]:
    """Places and values of a curve of x - origin, steps halved to `STEP_CENTS` where it exceeds `_HINT`."""
    d = curve(x - origin)
    while True:
        halve = (np.diff(x) > STEP_CENTS) & (np.maximum(d[:-1], d[1:]) > _HINT)
        if not halve.any():
            return x, d
        new = ((x[:-1] + x[1:]) / 2)[halve]
        order = np.argsort(np.concatenate([x, new]))
        d = np.concatenate([d, curve(new - origin)])[order]
        x = np.concatenate([x, new])[order]


def intervals(x: Floats, share: Floats) -> list[tuple[float, float, float, float, float]]:
    """Intervals in which a share, taken as straight between its points, is at least `LEAST_SHARE`.

    x : (n,) cents, ascending; share : (n,).
    Returns low, high, place of the largest share, largest share, integral of the share over the interval; in cents.
    """
    fine = np.linspace(x[0], x[-1], int((x[-1] - x[0]) / _FINE_CENTS) + 1)
    d = np.interp(fine, x, share)
    inside = np.concatenate([[0], (d >= LEAST_SHARE).astype(int), [0]])
    starts, stops = np.flatnonzero(np.diff(inside) == 1), np.flatnonzero(np.diff(inside) == -1)
    out = []
    for start, stop in zip(starts, stops, strict=True):
        part, places = d[start:stop], fine[start:stop]
        integral = float(np.trapezoid(part, places)) if part.size > 1 else 0.0
        if integral > 0:
            peak = int(np.argmax(part))
            out.append((float(places[0]), float(places[-1]), float(places[peak]), float(part[peak]), integral))
    return out
