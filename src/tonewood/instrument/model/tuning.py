"""Tuning a string on its body: the tension at which the coupled mode sounds the note, and wolf notes.

A string on a compliant body does not sound at the frequency that it has on a rigid bridge. Its pitch is the frequency
Im s / 2 pi of the string-dominated mode: the coupled mode of string and body with the largest share of its energy in
the string's first polarization. The other strings are left out, as if a tuner damped them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.receptance import Joint, Ports
from tonewood.support.units import cents, decibel

#: a second mode this near and this strong makes a wolf note
WOLF_CENTS, WOLF_DB = 60.0, 6.0
#: body poles within this ratio of the pitch take part in the search for modes
_NEAR = 1.15
#: range of the search for a tension, cents of pitch from the uncoupled one
_REACH_CENTS = 120.0
_ACCURACY_CENTS = 1e-3
#: most tensions tried; relative width of the bracket in which a jump over the note lies
_TENSIONS, _NARROW = 60, 1e-5


@dataclass(frozen=True, slots=True)
class CoupledMode:
    """A mode of one string on its body.

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

    def level_db(self, other: CoupledMode) -> float:
        """Level at the bridge over the whole decay, against another mode: energy a^2 / 2 sigma, dB.

        A body mode may be as strong as the string's at first, but it decays at once and disturbs no pitch.
        """
        energy = [m.strength / math.sqrt(max(-m.pole.real, 1e-12)) for m in (self, other)]
        return decibel(energy[0] / energy[1])


@dataclass(frozen=True, slots=True)
class TunedStop:
    """A string at one stop, tuned.

    freq : pitch asked for, Hz.
    tension : of the first polarization, N.
    modes : coupled modes near the pitch, the string-dominated one first, then by strength.
    """

    freq: float
    tension: float
    modes: tuple[CoupledMode, ...]

    @property
    def error_cents(self) -> float:
        """Cents of the string-dominated mode from the pitch."""
        return cents(self.modes[0].freq / self.freq)

    @property
    def wolf(self) -> CoupledMode | None:
        """A second mode within 60 cents and 6 dB of the first, or one that keeps the first from the pitch; or None.

        The other polarization, which is tuned near on purpose, does not count.
        """
        first, *others = self.modes
        for mode in others:
            if of_second_polarization(mode.shares):
                continue
            near = abs(cents(mode.freq / first.freq)) <= WOLF_CENTS
            if (near and mode.level_db(first) >= -WOLF_DB) or abs(self.error_cents) > 1.0:
                return mode
        return None


def of_second_polarization(shares: Sequence[float]) -> bool:
    """Whether half of a mode's energy or more is in the string's second polarization, tuned near on purpose."""
    return sum(shares[1:-1]) >= 0.5


class StringOnBody:
    """One string at one stop, joined to its body, at any tension.

    bases : tension (N) of the first polarization -> bases of all polarizations, with the point ``bridge``.
    body : `Ports` of the body, one row per polarization.
    pluck : m from the bridge, for strengths.
    """

    def __init__(self, bases: Callable[[float], Sequence[ModalBasis]], body: Ports, pluck: float):
        self._bases, self.body, self.pluck = bases, body, pluck
        self._joined: dict[float, tuple[Joint, Sequence[ModalBasis]]] = {}

    def joint(self, tension: float) -> Joint:
        """String and body at a tension."""
        return self._at(tension)[0]

    def bases(self, tension: float) -> Sequence[ModalBasis]:
        """Bases of the string alone at a tension, one per polarization."""
        return self._at(tension)[1]

    def _at(self, tension: float) -> tuple[Joint, Sequence[ModalBasis]]:
        if tension not in self._joined:
            bases = self._bases(tension)
            self._joined[tension] = (self._join(bases), bases)
        return self._joined[tension]

    def _join(self, bases: Sequence[ModalBasis]) -> Joint:
        parts = []
        for i, basis in enumerate(bases):
            rows = np.zeros((len(bases), len(basis.points)))
            rows[i, basis.index("bridge")] = 1.0
            parts.append(Ports.of(basis, rows))
        return Joint([*parts, self.body])

    def poles(self, joint: Joint, freq: float) -> list[tuple[complex, tuple[float, ...]]]:
        """Poles of the coupled modes near `freq` (Hz) with their shares of energy, the string-dominated one first.

        A resonator that does not move at its bridge end keeps its own modes; only the nearest one is returned.
        """
        target = 2 * math.pi * freq
        first = next(bases[0] for joint_of, bases in self._joined.values() if joint_of is joint)
        if ends_at_rest(first):
            alone = first.poles[first.poles.imag > 0]
            alone = alone[(alone.imag < _NEAR * target) & (alone.imag > target / _NEAR)]
            shares = (1.0,) + joint.size * (0.0,)
            return [(complex(alone[np.argmin(np.abs(alone.imag - target))]), shares)] if alone.size else []
        ratio = np.abs(self.body.poles) / target
        seen = np.abs(self.body.right).max(axis=0) * np.abs(self.body.left).max(axis=0) > 0
        near = seen & (self.body.poles.imag > 0) & (ratio < _NEAR) & (ratio > 1 / _NEAR)
        # modes at the same frequency act on one string like a single mode
        poles = list(dict.fromkeys(complex(p) for p in self.body.poles[near]))
        starts = [complex(-1e-3 * target, target * (1 + 1e-3 * i)) for i in range(joint.size)]
        starts += [p * (1 + 1e-3) for p in poles]  # not the pole itself, where M is infinite
        zeros = joint.zeros(starts, multiply=poles)
        modes = [(s, tuple(float(x) for x in joint.shares(s))) for s in zeros if s not in poles]
        if joint.size > 1 and sum(shares[0] for _, shares in modes) < 0.5:
            # the string's mode was not found: one of another plane lies at the same frequency
            of_body = [s for s, shares in modes if shares[-1] > 0.5]
            s = joint.newton(starts[0], multiply=poles, divide=of_body, first=True)
            condensed_modes = [] if s is None else [(s, tuple(float(x) for x in joint.shares(s)))]
            modes += [mode for mode in condensed_modes if mode[1][0] > 0.5]
        return sorted(modes, key=lambda pair: -pair[1][0])

    def modes(self, tension: float, freq: float) -> tuple[CoupledMode, ...]:
        """Coupled modes near `freq` (Hz): first the string-dominated one, then by strength."""
        joint, first = self.joint(tension), self.bases(tension)[0]
        modes = [CoupledMode(s, shares, self._strength(joint, s, first)) for s, shares in self.poles(joint, freq)]
        return (*modes[:1], *sorted(modes[1:], key=lambda m: -m.strength))

    def _strength(self, joint: Joint, s: complex, first: ModalBasis) -> float:
        """Residue of (body displacement at the bridge) / (pluck force) at a mode, over |s|: the pluck is a step.

        The gaps' forces under a pluck F of the first polarization are f = -M^-1 h F, h its receptance from pluck to
        bridge; near a zero of M with right and left null vectors v, w, M^-1 = v w / (w M' v (s - s_j)).
        """
        if ends_at_rest(first):
            return 1.0
        v, w = joint.null(s)
        slope = joint.receptance(s)[1]
        h = np.zeros(joint.size, dtype=np.complex128)
        if first.shape is not None:
            bridge, pluck = first.right[first.index("bridge")].real, first.shape(self.pluck)
            h[0] = np.sum(bridge * pluck / (s**2 + 2 * first.damping_rate * s + first.stiffness))
        body = float(np.abs((self.body.right / (s - self.body.poles)) @ (self.body.left.T @ v)).sum())
        return float(abs(w @ h) / abs(w @ slope @ v) * body / abs(s))


def ends_at_rest(basis: ModalBasis) -> bool:
    """Whether no mode moves the bridge end: the resonator does not end on the body."""
    return not np.any(basis.right[basis.index("bridge")])


def tune(string: StringOnBody, freq: float, tension: float) -> TunedStop:
    """Tension at which the string-dominated coupled mode sounds `freq` Hz.

    Parameters
    ----------
    tension : N, first guess; within some semitones.

    Notes
    -----
    One mode is followed from tension to tension (a secant rule on the logarithms of tension and pitch), then the
    dominating mode is determined again. Where a body mode has nearly the pitch and as much of the energy, the
    dominating mode jumps from below the pitch to above it as the tension grows, and no tension makes it sound the note:
    then bisection finds the tension at the jump, on the side that is nearer, and `TunedStop.error_cents` is the error
    that remains. Such a stop is a wolf note whatever the string.
    """
    best, least = tension, math.inf
    flat, sharp = 0.0, math.inf
    guess, bisects = tension, False
    for _ in range(_TENSIONS):
        poles = string.poles(string.joint(guess), freq)
        if not poles:
            break
        pole = poles[0][0]
        error = cents(pole.imag / (2 * math.pi) / freq)
        if abs(error) < least:
            best, least = guess, abs(error)
        width = sharp / flat if flat > 0 else math.inf
        flat, sharp = (max(flat, guess), sharp) if error < 0 else (flat, min(sharp, guess))
        if least <= _ACCURACY_CENTS or sharp < flat * (1 + _NARROW):
            break
        # a mode may leave the note out at every tension near; following it again would lead to the same place
        bisects = not bisects and flat > 0 and sharp / flat > math.sqrt(width)
        guess = math.sqrt(flat * sharp) if bisects else _follow(string, freq, guess, pole)
        if not flat < guess < sharp:
            guess = math.sqrt(flat * sharp) if flat > 0 and sharp < math.inf else best * (1.05 if error < 0 else 0.95)
    modes = string.modes(best, freq)
    if not modes:
        raise ValueError(no_mode(string.bases(best)[0], freq))
    return TunedStop(freq, best, modes)


def no_mode(basis: ModalBasis, freq: float) -> str:
    """Say that no mode lies near a frequency (Hz), and which keys of the string to change; one line.

    basis : of the string with its bridge end free: its lowest mode lies an octave below the pitch on a rigid bridge.
    """
    lowest = int(np.argmin(basis.natural_freq))
    rate, critical = float(basis.damping_rate[lowest]), 2 * math.pi * freq
    mend = (
        f"decays at {rate:.4g} 1/s, and from {critical:.4g} 1/s on nothing vibrates there: lower `loss`"
        if rate > 0.5 * critical
        else "check `tension`, `linear_density` and `length` against its pitch"
    )
    sounds = f"the string alone sounds near {2 * basis.natural_freq[lowest]:.4g} Hz"
    return f"no mode of the string on its body was found near {freq:.2f} Hz; {sounds}; {mend}"


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


def body_ports(body: ModalBasis, ends: Sequence[Mapping[str, float]], copies: int = 1) -> Ports:
    """Ports of the body for a string: one row per polarization, with its shares of the body's points.

    Of `copies` strings that move alike at one place each sees the body's receptance so many times: the rows are
    multiplied by the root of their number.
    """
    rows = np.zeros((len(ends), len(body.points)))
    for i, shares in enumerate(ends):
        for point, factor in shares.items():
            rows[i, body.index(point)] = factor
    return Ports.of(body, math.sqrt(copies) * rows)
