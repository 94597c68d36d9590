"""Tuning a string on its body: the tension at which the coupled mode sounds the note, and the notes that growl.

A string on a body that gives way does not sound at its own frequency. The mode that is heard as its pitch is the
string-dominated one, the mode of string and body together with the largest share of its energy in the string's first
polarization; its frequency is Im s / 2 pi. The other strings are left out, as a tuner damps them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.numerics.modes import ModalBasis
from tonewood.numerics.receptance import Joint, Ports
from tonewood.units import cents, decibel

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

#: a second mode this near and this strong makes a wolf note
WOLF_CENTS, WOLF_DB = 60.0, 6.0
#: body poles within this ratio of the pitch take part in the search for modes
_NEAR = 1.3
#: a tension this far from the uncoupled one is not looked for, cents of pitch
_REACH_CENTS = 120.0
_ACCURACY_CENTS = 1e-4


@dataclass(frozen=True, slots=True)
class CoupledMode:
    """A mode of one string on its body.

    Attributes
    ----------
    pole : 1/s.
    shares : of the modal energy: one per polarization, then the body's.
    strength : amplitude at the bridge when the string is released from a unit force, relative to the other modes'.
    """

    pole: complex
    shares: tuple[float, ...]
    strength: float

    @property
    def freq(self) -> float:
        """Im s / 2 pi, Hz."""
        return self.pole.imag / (2 * math.pi)


@dataclass(frozen=True, slots=True)
class TunedStop:
    """A string at one stop, tuned.

    Attributes
    ----------
    freq : pitch asked for, Hz.
    tension : of the first polarization, N.
    modes : coupled modes near the pitch, the string-dominated one first, then by strength.
    """

    freq: float
    tension: float
    modes: tuple[CoupledMode, ...]

    @property
    def error_cents(self) -> float:
        """How far the string-dominated mode is from the pitch."""
        return cents(self.modes[0].freq / self.freq)

    @property
    def wolf(self) -> CoupledMode | None:
        """A second mode within 60 cents and 6 dB of the first, not that of another polarization; None if there is none."""
        first, *others = self.modes
        for mode in others:
            near = abs(cents(mode.freq / first.freq)) <= WOLF_CENTS
            strong = decibel(mode.strength / first.strength) >= -WOLF_DB
            if near and strong and max(mode.shares[1:-1], default=0.0) < 0.5:
                return mode
        return None


class StringOnBody:
    """One string at one stop, joined to its body, at any tension.

    Parameters
    ----------
    bases : tension (N) of the first polarization -> bases of all polarizations, with the point ``bridge``.
    body : what the polarizations are joined to, as `Ports` of one row per polarization.
    pluck : m from the bridge, for strengths.
    """

    def __init__(self, bases: Callable[[float], Sequence[ModalBasis]], body: Ports, pluck: float):
        self.bases, self.body, self.pluck = bases, body, pluck

    def joint(self, tension: float) -> Joint:
        """String and body at a tension."""
        bases = self.bases(tension)
        parts = []
        for i, basis in enumerate(bases):
            rows = np.zeros((len(bases), len(basis.points)))
            rows[i, basis.index("bridge")] = 1.0
            parts.append(Ports.of(basis, rows))
        return Joint([*parts, self.body])

    def modes(self, joint: Joint, freq: float, tension: float) -> tuple[CoupledMode, ...]:
        """Coupled modes near `freq` (Hz): first the string-dominated one, then by strength."""
        target = 2 * math.pi * freq
        ratio = np.abs(self.body.poles) / target
        seen = np.abs(self.body.right).max(axis=0) * np.abs(self.body.left).max(axis=0) > 0
        near = seen & (self.body.poles.imag > 0) & (ratio < _NEAR) & (ratio > 1 / _NEAR)
        # modes at the same frequency act on one string as one
        poles = list(dict.fromkeys(complex(p) for p in self.body.poles[near]))
        n = joint.size
        starts = [complex(-1e-3 * target, target * (1 + 1e-3 * i)) for i in range(n)] + poles
        zeros = joint.zeros(starts, multiply=poles)
        bases = self.bases(tension)
        modes = [self._mode(joint, s, bases) for s in zeros if all(abs(s - p) > 1e-9 * abs(s) for p in poles)]
        if not modes:
            return ()
        first = max(modes, key=lambda m: m.shares[0])
        others = sorted((m for m in modes if m is not first), key=lambda m: -m.strength)
        return (first, *others)

    def _mode(self, joint: Joint, s: complex, bases: Sequence[ModalBasis]) -> CoupledMode:
        """Shares, and the residue of (bridge displacement) / (pluck force) at the mode.

        The gaps' forces under a pluck F of the first polarization are f = -M^-1 h F, h its receptance from pluck to
        bridge; near a zero of M with right and left null vectors v, w, M^-1 = v w^T / (w^T M' v (s - s_j)).
        """
        import scipy.linalg as sla

        M, D = joint.receptance(s)
        U, _, Vh = sla.svd(M)
        v, w = Vh[-1].conj(), U[:, -1].conj()
        first = bases[0]
        h = np.zeros(joint.size, dtype=np.complex128)
        if first.shape is not None:
            phi = first.shape(min(self.pluck, 0.9 * float(first.metadata.get("length", math.inf))))  # type: ignore[arg-type]  # a number
            bridge = first.right[first.index("bridge")].real
            h[0] = np.sum(bridge * phi / (s**2 + 2 * first.damping_rate * s + first.stiffness))
        body = sum(abs(x) for x in self.body_motion(s, v))
        strength = abs(w @ h) / abs(w @ D @ v) * body / abs(s)
        return CoupledMode(s, tuple(float(x) for x in joint.shares(s)), float(strength))

    def body_motion(self, s: complex, force: Complexes) -> Complexes:
        """(p,) displacement of the body at its ports under port forces."""
        return np.asarray((self.body.right / (s - self.body.poles)) @ (self.body.left.T @ force))


def tune(string: StringOnBody, freq: float, tension: float) -> TunedStop:
    """Tension at which the string-dominated coupled mode sounds `freq` Hz.

    Parameters
    ----------
    tension : N, first guess; within some semitones.

    Notes
    -----
    The search follows one mode from tension to tension (a secant rule on the logarithms of tension and pitch), then
    asks again which mode dominates. Where string and body modes of one frequency share their energy evenly there may
    be no tension at which the dominating mode sounds the note: the nearest one is taken, and `TunedStop.error_cents`
    says so. Such a stop is a wolf note.
    """
    best: TunedStop | None = None
    guess = tension
    for _ in range(4):
        joint = string.joint(guess)
        modes = string.modes(joint, freq, guess)
        if not modes:
            break
        here = TunedStop(freq, guess, modes)
        if best is None or abs(here.error_cents) < abs(best.error_cents):
            best = here
        if abs(here.error_cents) <= _ACCURACY_CENTS:
            break
        guess = _follow(string, freq, guess, modes[0].pole)
    if best is None:
        raise ValueError(f"no mode of the string was found near {freq:.2f} Hz")
    return best


def _follow(string: StringOnBody, freq: float, tension: float, pole: complex) -> float:
    """Tension at which the mode that has `pole` at `tension` sounds `freq`."""
    start, miss = tension, cents(pole.imag / (2 * math.pi) / freq)
    slope = 600.0 * math.log2(math.e)  # cents per unit of log tension, of a string alone
    s = pole
    for _ in range(12):
        change = -miss / slope
        new = tension * math.exp(change)
        moved = string.joint(new).newton(s * math.exp(-miss / 1200 * math.log(2)))
        if moved is None:
            break
        new_miss = cents(moved.imag / (2 * math.pi) / freq)
        if new_miss != miss:
            secant = (new_miss - miss) / math.log(new / tension)
            slope = secant if 0.1 < secant / (600.0 * math.log2(math.e)) < 3 else slope
        tension, miss, s = new, new_miss, moved
        if abs(miss) <= 0.1 * _ACCURACY_CENTS or abs(600 * math.log2(tension / start)) > _REACH_CENTS * 6:
            break
    return tension


def body_ports(body: ModalBasis, ends: Sequence[Mapping[str, float]]) -> Ports:
    """The body as a string's polarizations meet it: one row per polarization, its shares of the body's points."""
    rows = np.zeros((len(ends), len(body.points)))
    for i, shares in enumerate(ends):
        for point, factor in shares.items():
            rows[i, body.index(point)] = factor
    return Ports.of(body, rows)
