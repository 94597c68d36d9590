"""Strings, and the high modes of every string, that sleep while they are not heard.

A band of modes falls asleep when what it does at the outputs has decayed below the additive budget, re the loudest
sample so far, shared among the strings. While it sleeps nobody steps it, so it cannot be looked at: what the body would
have put into it meanwhile is bounded from what the other strings do in its band,

    |F|' <= -sigma |F| + g^2 / (2 W^2) |v|,      |v| <= sum 2 |Y| |F_others|,

as if every partial met a mode exactly in tune; W, g are a held mode's frequency and force, v the velocity of the
bridge, Y the body's largest mobility in the band. Strings are looked at now and then; between two looks the forces of
those that are awake are bounded by what they were at the first, and by the energy that strings and body had in the band
then: by themselves they only lose it, whatever they pass to each other. Where what has come in would pass the budget
before the next look, the band is woken.

What stays in use moves differently without what sleeps, too: culled modes push at partials in tune with them, they no
longer oppose the bridge's motion in lower bands with their inertia (`Part.inertia`), and steps turn partials of the
condensed string (`Part.turned`). A partial of amplitude a that is turned by d rad/s is off by |a| d / (e sigma) at
most, and by 2 |a|. All this is an estimate on the safe side, no bound: `tests/effects/random_scenes.py` measures it.
A band wakes at rest: the displacement and the velocity of the string are what they were, and so is its energy.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tonewood.coupling.connections import Rigid, SpringDashpot
from tonewood.coupling.system import Compiled, State, System
from tonewood.engine.fretting import Fingerboard, Fretting
from tonewood.engine.listening import _AT_ONCE, Listening
from tonewood.engine.rungs import BANDS, Part, Rungs, cuts, quiet_energy
from tonewood.engine.switching import SILENT, largest
from tonewood.engine.timeline import Play, Timeline
from tonewood.engine.transfer import Transfer, frequency_bins
from tonewood.instrument.assembly import Model
from tonewood.stepping.motion import to_motion

Floats = NDArray[np.float64]

#: strings as they are held that are kept for use again
_CACHE = 64
#: share of the budget below which modes fall asleep; at the whole of it they wake
_LEAVE = 0.5
#: steps of one mode that culling in a string has to save: making its fewer modes, putting them in and back and judging
#: what that changes take some 12 ms
WORTH = 4e7
#: what a mode of a string whose tension rises costs in such steps
_TENSE = 8.0
#: s until the next look: where a sleeper might have to wake or a string touch something, and where not
_SOON, _LATE = 0.08, 0.75
#: and when nothing has happened for a long time
_LONG = 3.0
#: share of all steps that a rest saves; 0.05 to 0.2 were seen in rests of 8 s of guitars
_SHARE = 0.1
#: ratio of frequencies by which a body's mode may lie outside a band and yet move with it
_AROUND = 1.5
#: a force that sets in shakes the body up to twice as much as it does when it lasts
_ONSET = 2.0
#: share of its first size to which the body's slowest mode must decay after a stroke
_DECAYED = 1e-4
#: N, more than any bound allows
_ENDLESS = 1e30
_LEVELS = np.arange(BANDS + 1)


@dataclass(eq=False)
class Asleep:
    """What is known of strings that sleep; part of an engine's snapshot.

    Attributes
    ----------
    level : string -> how many bands sleep, from the highest.
    own, own_heard : (C, BANDS) N and (R, C, BANDS): what slept off, decaying.
    driven : (C, BANDS) N, bound on what came in since.
    force : (C, BANDS) N, of all that is awake, at the last look.
    root : (BANDS,) roots of twice the energy (J) of strings and body in each band, at the last look.
    ringing : (C, F) m/s, bound on what earlier forces left of motion at the ends, in bins of the body's resonances.
    shifted, earlier : (R, C) bound on what was heard of what is in use being off since modes of each component are
        culled, and of all earlier times together.
    peak : (R,) largest sample of each readout so far.
    last, following : samples of the last look, and of the next at the latest.
    changed : sample of the last gesture or exchange.
    shaken_until : sample until which all are awake.
    touched : whether a contact has acted since.
    """

    level: dict[str, int]
    own: Floats
    own_heard: Floats
    driven: Floats
    force: Floats
    root: Floats
    ringing: Floats
    shifted: Floats
    earlier: Floats
    peak: Floats
    last: int = 0
    following: int = 0
    changed: int = 0
    shaken_until: int = -(2**62)
    touched: bool = False

    def copy(self) -> Asleep:
        """Return an independent copy."""
        return Asleep(
            dict(self.level), self.own.copy(), self.own_heard.copy(), self.driven.copy(), self.force.copy(),
            self.root.copy(), self.ringing.copy(), self.shifted.copy(), self.earlier.copy(), self.peak.copy(),
            self.last, self.following, self.changed, self.shaken_until, self.touched,
        )  # fmt: skip


@dataclass(eq=False)
class Sleeper:
    """Says which bands of which strings sleep.

    Parameters
    ----------
    model : of the engine.
    board : its strings as they can be held.
    timeline : what is going to happen: nothing falls asleep that is played at once.
    worth : steps of one mode that the exchange of one string has to save.
    tail : s after the last event in which the sound may fall below what the budget allows to leave out.
    """

    model: Model
    board: Fingerboard
    timeline: Timeline
    worth: float = WORTH
    tail: float = 0.0
    state: Asleep = field(init=False)
    #: string -> largest bound on what it would have added, ratio to the loudest sample
    largest: dict[str, float] = field(init=False)
    _known: dict[tuple[str, Fretting], Rungs | None] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        model = self.model
        self.enabled = model.choice.mode == "auto" and model.choice.budget_db > -math.inf
        # what sleeps is taken to be linear; strings that move along themselves are not, and all stay awake with them
        self.enabled = self.enabled and not model.system.geometric
        self.names, self._n_modes = tuple(model.strings), model.n_modes
        self._parts = tuple((name, c) for name, s in model.strings.items() for c in s.components)
        self.components = tuple(c for _, c in self._parts)
        self._owner = np.array([i for i, s in enumerate(model.strings.values()) for _ in s.components], dtype=np.intp)
        n, r = len(self.components), len(model.system.readouts)
        none, n_bins = np.zeros((n, BANDS)), len(frequency_bins(model.system.dt)) - 1
        self.state = Asleep(
            dict.fromkeys(self.names, 0), none.copy(), np.zeros((r, n, BANDS)), none.copy(), none.copy(),
            np.zeros(BANDS), np.zeros((n, n_bins)), np.zeros((r, n)), np.zeros((r, n)), np.zeros(r),
        )  # fmt: skip
        self.largest = dict.fromkeys(self.names, 0.0)
        self._met: System | None = None
        #: re the loudest sample, of each string
        self.budget = 10 ** (model.choice.budget_db / 20) / max(len(self.names), 1)
        events: dict[str, list[float]] = {name: [] for name in self.names}
        for play in self.timeline.plays:
            if play.string is not None:
                events[play.string].append(play.start)
        for change in self.timeline.changes:
            events[change.string].append(change.time)
        self._events = {name: np.sort(times) for name, times in events.items()}
        self._all_events = np.sort(
            [*(play.start for play in self.timeline.plays), *(change.time for change in self.timeline.changes)]
        )
        between = np.diff(np.concatenate([[min(self.timeline.start, 0.0)], self._all_events]))
        self._longest = float(between.max(initial=0.0))

    @cached_property
    def _listening(self) -> Listening:
        """What tells levels of strings; it and the bounds are made when they are first wanted."""
        model, n = self.model, len(self.components)
        self.transfer = Transfer(model)
        n_bins = len(self.transfer.bins) - 1
        self.edges = edges = cuts(model)
        self._of = (self._owner == np.arange(len(self.names))[:, None]).astype(float)
        octaves = list(itertools.pairwise(edges))
        between = [self.transfer.between(self.transfer.mobility, low, high) for high, low in octaves]
        self._mobility = _ONSET * np.stack(between)
        #: (F, C, C), (R, C, F) and the bands of bins
        self._mobility_bins = np.ascontiguousarray(self.transfer.binned(self.transfer.mobility).transpose(2, 0, 1))
        self._response = self.transfer.binned(self.transfer.heard)
        upper = self.transfer.bins[1:]
        self._band_of = np.clip(np.searchsorted(-edges[1:], -upper), 0, BANDS - 1)
        self._in_band = (self._band_of[:, None] == np.arange(BANDS)).astype(float)
        self._mobility[:, np.arange(n), np.arange(n)] = 0.0
        body = model.system.compiled[model.system.slot("body")].basis
        freq = np.abs(body.poles)
        self._near_body = np.array(
            [(freq >= low / _AROUND) & (freq < high * _AROUND) for high, low in octaves], dtype=float
        )
        #: (F,) 1/s, slowest decay of the body's modes in each bin
        self._ringing_decay = np.full(n_bins, _AT_ONCE)
        np.minimum.at(self._ringing_decay, self.transfer.bin_of(freq), np.maximum(body.damping_rate, 0.0))
        self._resonant = self._ringing_decay < _AT_ONCE
        slowest = float(body.damping_rate[body.damping_rate > 0].min(initial=np.inf))
        self._shaken = math.ceil(-math.log(_DECAYED) / slowest * model.fs)
        # connections of each string besides its ends; dashpots and springs among them hold it awake while they act
        self._touching: dict[str, list[int]] = {name: [] for name in self.names}
        for j, connection in enumerate(model.system.connections):
            owners = {t.component.partition(".")[0] for t in connection.terms} & set(self.names)
            if not isinstance(connection.law, Rigid) or not connection.name.endswith(".bridge"):
                for name in owners:
                    self._touching[name].append(j)
        self._springs = {
            name: [j for j in found if isinstance(model.system.connections[j].law, SpringDashpot)]
            for name, found in self._touching.items()
        }
        return Listening(model, self.components, n_bins)

    @property
    def sleeping(self) -> dict[str, int]:
        """Strings with bands that sleep, and how many."""
        return {name: level for name, level in self.state.level.items() if level}

    @property
    def worthwhile(self) -> bool:
        """Whether any rest of the score is long enough to watch in."""
        last = float(self._all_events[-1]) if len(self._all_events) else 0.0
        return self.enabled and self._promises(max(self._longest, self._end - last))

    def promising(self, now: int, pending: float) -> bool:
        """Whether it pays to look: somebody sleeps, or nothing is going to be played until `pending`, s, for a while.

        While gestures follow each other closely every string is moved by the others, and nothing may sleep for long.
        """
        if not self.worthwhile:
            return False
        return bool(self.sleeping) or self._promises(min(pending, self._end) - now * self.model.system.dt)

    def _promises(self, seconds: float) -> bool:
        """Whether a rest of so many seconds saves more steps than it takes to look and to exchange strings."""
        return _SHARE * self._n_modes * max(seconds, 0.0) * self.model.fs >= self.worth * len(self.names)

    @property
    def _end(self) -> float:
        """Time until which strings ring, s."""
        return self.timeline.stop + self.tail

    def _until(self, times: Floats, now: float) -> float:
        """Seconds from now to the next of these times, or to the end."""
        following = np.searchsorted(times, now)
        return max((float(times[following]) if following < len(times) else self._end) - now, 0.0)

    def rungs(self, name: str, fretting: Fretting) -> Rungs | None:
        """A string as it is held; None if it cannot be held at its bridge, and no other may sleep beside it."""
        key = (name, fretting)
        if key not in self._known:
            if len(self._known) >= _CACHE:
                self._known.pop(next(iter(self._known)))
            self._known[key] = self._made(name, fretting)
        return self._known[key]

    def _made(self, name: str, fretting: Fretting) -> Rungs | None:
        _ = self._listening  # made now
        whole = self.board.bases(name, fretting)
        laws = self.board.laws(name, fretting)
        system = self.model.system
        touching = [laws.get(c.name, c) for j in self._touching[name] for c in [system.connections[j]]]
        touching = [c for c in touching if c.name not in self.model.resting]
        quiet = quiet_energy(name, {c: compiled.basis for c, compiled in whole.items()}, touching)
        try:
            parts = {c: Part.of(c, compiled, self.model, self.transfer, self.edges) for c, compiled in whole.items()}
        except ValueError:
            return None
        return Rungs(parts, quiet)

    def missing(self, name: str, fretting: Fretting, level: int) -> int:
        """How many modes of a string sleep at a level."""
        rungs = self.rungs(name, fretting)
        return 0 if rungs is None else sum(int(p.counts[0] - p.counts[level]) for p in rungs.parts.values())

    def compiled(self, name: str, fretting: Fretting, level: int) -> dict[str, Compiled]:
        """Component -> what is stepped of a string at a level."""
        rungs = self.rungs(name, fretting)
        if rungs is None or level == 0:
            return self.board.bases(name, fretting)
        return {c: part.at(c, self.model, level)[1] for c, part in rungs.parts.items()}

    def carried(self, name: str, fretting: Fretting, level: int, modes: Mapping[str, Floats]) -> dict[str, Floats]:
        """The motion of a string taken from its level to another: component -> (2, n_modes)."""
        rungs = self.rungs(name, fretting)
        assert rungs is not None
        return {c: rungs.carried(c, self.model, self.state.level[name], level, modes[c]) for c in modes}

    def moved(self, name: str, level: int) -> None:
        """Enter that a string is at another level now."""
        mine = np.isin(np.arange(len(self.components)), np.flatnonzero(self._owner == self.names.index(name)))
        awake = mine[:, None] & (np.arange(BANDS) >= level)
        if level < self.state.level[name]:
            # what is in use moves as it would from now on, from where it is
            self.state.earlier[:, mine] += self.state.shifted[:, mine]
            self.state.shifted[:, mine] = 0.0
        self.state.level[name] = level
        self.state.own[awake] = self.state.driven[awake] = 0.0
        self.state.own_heard[:, awake] = 0.0

    def heard(self, out: Floats) -> None:
        """Take note of what the readouts said, (n, R)."""
        if len(out):
            # the rows of channels in one piece: several times quicker
            np.maximum(self.state.peak, np.abs(np.ascontiguousarray(out.T)).max(axis=1), out=self.state.peak)

    def shaken(self, now: int, plays: Collection[Play]) -> bool:
        """Whether something moves that no bound is known of: strokes on the body, bows and fingers, contacts."""
        _ = self._listening  # made now
        if any(p.string is None for p in plays):
            self.state.shaken_until = max(self.state.shaken_until, now + self._shaken)
        unknown = any(p.gesture.on is not None or p.gesture.motions or not p.gesture.segments for p in plays)
        return self.state.touched or unknown or now < self.state.shaken_until

    def look(
        self,
        now: int,
        system: System,
        state: State,
        frettings: Mapping[str, Fretting],
        busy: Collection[str],
        tense: Collection[str],
        fresh: Sequence[Play] = (),
    ) -> dict[str, int]:
        """Strings that are to sleep or wake, and at which level; and when to look again.

        Parameters
        ----------
        now : sample of this look.
        busy : strings that are played, or damped by a finger.
        tense : strings whose tension rises.
        fresh : gestures that begin, of known forces on strings.
        """
        s, dt, strings = self.state, self.model.system.dt, self._listening
        if system is not self._met:
            self._meet(system, frettings)
        rungs = self._rungs
        if any(known is None for known in rungs):
            return self.all_awake(now)
        force, spectrum, heard, doubled, energies = strings.look(state)
        decay, lasting, loudest = strings.decay, strings.lasting, strings.loudest
        gathers, apart = strings.gathers[:, None], strings.spread[:, None]
        free = self._loose & [name not in busy for name in self.names]
        level = np.array([s.level[name] for name in self.names])
        asleep = np.arange(BANDS) < level[self._owner, None]
        elapsed = (now - s.last) * dt
        lost = -np.expm1(-elapsed * decay)
        quiet = np.where(asleep, s.own + s.driven, 0.0)
        s.own, s.own_heard = s.own * (1.0 - lost), s.own_heard * (1.0 - lost)
        ringing = s.ringing @ self._in_band
        came = (self._velocity(s.force, s.root, ~asleep, elapsed) + self._driving(quiet) + ringing) * gathers
        s.driven = np.where(asleep, s.driven * (1.0 - lost) + came * lost * lasting, 0.0)
        quiet = np.where(asleep, s.own, 0.0) + s.driven
        s.earlier *= math.exp(-elapsed * self._slowest)
        root = np.sqrt(doubled.sum(axis=0) + self._doubled_body(system, state, doubled))
        for play in fresh:
            begun, at_bins, gained = self._foreseen(play, frettings[play.string or ""])
            force, spectrum, root = force + begun, spectrum + at_bins, root + gained
        s.force, s.root, s.last = force, root, now
        s.changed = now if fresh else s.changed
        s.ringing *= np.exp(-elapsed * self._ringing_decay)
        moving = self._moved(spectrum)
        forced = np.where(self._resonant, moving.sum(axis=1, keepdims=True) if fresh else moving, 0.0)
        s.ringing = np.maximum(s.ringing, forced)
        ringing = s.ringing @ self._in_band

        def moved(ahead: float) -> Floats:
            """(C, BANDS) m/s, bound on the velocities of the ends for so many seconds."""
            return np.asarray(self._velocity(force, root, ~asleep, ahead) + self._driving(quiet) + ringing)

        def still(velocity: Floats, ahead: float) -> NDArray[np.bool_]:
            """(n_strings,) whether they reach nothing meanwhile."""
            speed = np.sqrt(2.0 * energies) + ahead * np.sum(strings.kick * velocity, axis=1)
            return np.asarray(self._quiet >= self._of @ (0.5 * speed * speed))

        late = self._shifting(spectrum, root, ~asleep, _LATE)
        for i in np.flatnonzero(level[self._owner]):
            late[:, i, level[self._owner[i]]] += self._turning(i, spectrum, int(level[self._owner[i]]))

        def totals(culled: Floats, missing: Floats) -> Floats:
            """(n_strings, BANDS + 1) at every level, from what is heard of culled bands and their forces."""
            below = np.maximum(late + self._back(missing, force), s.shifted[:, :, None])
            heard = below + s.earlier[:, :, None]
            heard[:, :, 1:] += np.cumsum(culled, axis=-1)
            heard[:, :, 0] = 0.0
            return self._levels(heard)

        def kept(ahead: float) -> NDArray[np.intp]:
            """(n_strings,) bands that may go on sleeping for so many seconds."""
            left, velocity = np.exp(-ahead * decay), moved(ahead)
            soon = s.driven * left + velocity * (gathers * lasting * (1.0 - left) + apart)
            each = totals(s.own_heard + soon * loudest, np.where(asleep, s.own, 0.0) + soon)
            allowed = (each <= self.budget) & (level[:, None] >= _LEVELS)
            going_on = np.where(free & still(velocity, ahead), BANDS - np.argmax(allowed[:, ::-1], axis=1), 0)
            done[:] = np.maximum(done, each[np.arange(len(going_on)), going_on])
            return going_on

        done = np.zeros(len(level))
        unchanged = bool(np.all(kept(_LATE) == level))
        after = level if unchanged else kept(_SOON)
        velocity = moved(_LATE)
        at_last = np.maximum(velocity * gathers * lasting, s.driven) + velocity * apart
        resting = totals(
            np.where(asleep, s.own_heard, heard) + at_last * loudest, np.where(asleep, s.own, force) + at_last
        )
        allowed = (resting <= _LEAVE * self.budget) & still(velocity, _LATE)[:, None]
        deeper = np.where(allowed.any(axis=1), BANDS - np.argmax(allowed[:, ::-1], axis=1), 0)
        wanted: dict[str, int] = {}
        begun = np.zeros_like(s.shifted)
        for k, name in enumerate(self.names):
            before, then = int(level[k]), int(after[k])
            may = then == before and free[k] and deeper[k] > before
            if may and self._pays(name, rungs[k], before, int(deeper[k]), now * dt, name in tense):
                then = int(deeper[k])
                for i in np.flatnonzero(self._owner == k):
                    turning = self._turning(i, spectrum, then)
                    late[:, i, then] += turning
                    resting[k, then] += self._ratio(turning)
                if resting[k, then] > self.budget * _LEAVE:
                    then = before
            if before:
                self.largest[name] = max(self.largest[name], float(done[k]))
            if then > before:
                mine = np.flatnonzero(self._owner == k)
                s.own[mine, before:then] = force[mine, before:then]
                s.own_heard[:, mine, before:then] = heard[:, mine, before:then]
                self.largest[name] = max(self.largest[name], float(resting[k, then]))
            if then != before:
                wanted[name] = then
            # what is in use is off from now on by what is allowed, at most
            mine = np.flatnonzero(self._owner == k)
            if then > 0:
                begun[:, mine] = late[:, mine, then]
        s.shifted = np.maximum(s.shifted, begun)
        # where none are culled looks may become rare: what they cost grows with the logarithm of a rest
        nobody = not any(wanted.get(name, s.level[name]) for name in self.names)
        s.changed = now if wanted else s.changed
        wait = min(max(0.5 * (now - s.changed) * dt, _LATE), _LONG) if nobody else _LATE if unchanged else _SOON
        s.following = now + math.floor(wait / dt)
        return wanted

    def _meet(self, system: System, frettings: Mapping[str, Fretting]) -> None:
        """Take note of how strings are held and stepped now."""
        self._met, self._rungs = system, [self.rungs(name, frettings[name]) for name in self.names]
        for i, (name, c) in enumerate(self._parts):
            rungs = self._rungs[self._owner[i]]
            part = None if rungs is None else rungs.parts[c]
            self._listening.set(i, system.compiled[system.slot(c)], part, self.state.level[name])
        self._quiet = np.array([-1.0 if rungs is None else rungs.quiet for rungs in self._rungs])
        strings, transfer = self._listening, self.transfer
        self._slowest = float(strings.decay.min(initial=_AT_ONCE))
        parts = [rungs.parts[c] if rungs else None for rungs, (_, c) in zip(self._by_part(), self._parts, strict=True)]
        if None in parts:
            return
        self._inertia = np.stack([part.inertia for part in parts if part])
        self._gain = np.stack([part.gain for part in parts if part])
        limits = np.stack([part.edge for part in parts if part])
        # the first modes culled may be in tune with the last ones kept of other strings
        last = np.where(np.eye(len(parts), dtype=bool)[:, :, None], 0.0, limits[None, :, :BANDS, 0]).max(axis=1)
        gap = np.maximum(0.5 * (limits[:, :BANDS, 1] - last), np.minimum.accumulate(strings.decay, axis=1))
        near = np.where(last > 0.0, strings.gathers[:, None] / gap, 0.0)
        np.add.at(
            self._inertia,
            (np.arange(len(parts))[:, None], np.arange(1, BANDS), transfer.bin_of(last[:, 1:])),
            near[:, 1:],
        )
        # what a force at an end does at the readouts, by itself and by way of the partials in tune with it
        tuned = (self._response * self._gain).transpose(2, 0, 1) @ self._mobility_bins
        self._turned = self._response + tuned.transpose(1, 2, 0)
        #: strings that no spring or dashpot holds
        self._loose = np.array(
            [not any(_acts(system.connections[j].law) for j in self._springs[name]) for name in self.names], dtype=bool
        )

    def _by_part(self) -> list[Rungs | None]:
        return [self._rungs[owner] for owner in self._owner]

    def all_awake(self, now: int) -> dict[str, int]:
        """Nobody may sleep: strings that are to wake."""
        self.state.last, self.state.following = now, now + math.floor(_SOON / self.model.system.dt)
        return dict.fromkeys(self.sleeping, 0)

    def _foreseen(self, play: Play, fretting: Fretting) -> tuple[Floats, Floats, Floats]:
        """What a gesture's force leaves in its string when it is let go: (C, BANDS) and (C, F) N, and (BANDS,) roots of
        twice the energies, J.
        """
        out, gained, name = np.zeros((len(self.components), BANDS)), np.zeros(BANDS), play.string or ""
        at_bins = np.zeros_like(self.state.ringing)
        rungs = self.rungs(name, fretting)
        segments = play.gesture.segments
        if rungs is None:
            return np.full_like(out, _ENDLESS), np.full_like(at_bins, _ENDLESS), np.full_like(gained, _ENDLESS)
        size, shortest = max(largest(s) for s in segments), min(s.stop - s.start for s in segments)
        for c, weight in self.model.strings[name].weights(play.gesture.angle_deg).items():
            force, spectrum, root = rungs.parts[c].plucked(shortest)
            out[self.components.index(c)] = abs(weight) * size * force
            at_bins[self.components.index(c)] = abs(weight) * size * spectrum
            gained += abs(weight) * size * root
        return out, at_bins, gained

    def _doubled_body(self, system: System, state: State, doubled: Floats) -> Floats:
        """(BANDS,) twice the energy of the body in each band, J.

        Complex modes' energies are not theirs alone to tell: such a body is taken to have as much as the strings.
        """
        basis = system.compiled[system.slot("body")].basis
        if not basis.is_real:
            return np.asarray(doubled.sum(axis=0))
        q, v = to_motion(basis, np.asarray(system.modes_of(state, "body"), dtype=np.float64))
        return np.asarray(self._near_body @ (v * v + basis.stiffness * (q * q)))

    def _velocity(self, force: Floats, root: Floats, awake: NDArray[np.bool_], ahead: float) -> Floats:
        """(C, BANDS) m/s, bound on each end's velocity for `ahead` s.

        No string's force passes what all the energy there is would make of it; nor what it is now and what its modes
        gather, in tune, from the ends' velocities meanwhile.

        Parameters
        ----------
        force : (C, BANDS) N, of strings now.
        root : (BANDS,) roots of twice the energy of all.
        awake : (C, BANDS) which bands of them are.
        """
        listening = self._listening
        utmost = np.where(awake, listening.reach * root, 0.0)
        # whichever strings have the energy, the squares of their shares add up to one
        velocity = np.sqrt((self._mobility**2 @ (utmost**2).T[:, :, None])[:, :, 0].T)
        gathered = (listening.gathers * ahead + listening.spread)[:, None] * velocity
        return np.asarray(np.minimum(velocity, self._driving(np.minimum(utmost, force + gathered))))

    def _driving(self, force: Floats) -> Floats:
        """(C, BANDS) m/s, bound on each end's velocity under forces of strings (C, BANDS)."""
        return np.asarray((self._mobility @ force.T[:, :, None])[:, :, 0].T)

    def _levels(self, heard: Floats) -> Floats:
        """(n_strings, ...) what each string does at the outputs, (R, C, ...), re the loudest samples."""
        return np.asarray(np.tensordot(self._of, self._ratio(heard), axes=1))

    def _ratio(self, heard: Floats) -> Floats:
        """(...) largest of what is heard at the readouts, (R, ...), re the loudest samples."""
        peak = np.maximum(self.state.peak, SILENT)
        return np.asarray((heard / peak.reshape(-1, *(1,) * (heard.ndim - 1))).max(axis=0, initial=0.0))

    def _turning(self, i: int | np.intp, spectrum: Floats, level: int) -> Floats:
        """(R,) what is heard of the partials of component i being off at a level; see `Part.turned`."""
        rungs, c = self._rungs[self._owner[i]], self.components[i]
        assert rungs is not None
        return np.asarray(self._response[:, i] @ (spectrum[i] * rungs.parts[c].turned(c, self.model, level)))

    def _moved(self, spectrum: Floats) -> Floats:
        """(C, F) m/s, bound on each end's velocity in every bin under the forces of all strings (C, F)."""
        return np.asarray((self._mobility_bins @ spectrum.T[:, :, None])[:, :, 0].T)

    def _shifting(self, spectrum: Floats, root: Floats, awake: NDArray[np.bool_], ahead: float) -> Floats:
        """(R, C, BANDS + 1) bound on what is heard of the difference that culling makes to partials in lower bands.

        At every level of each component: its culled modes no longer oppose the bridge's motion with their inertia. That
        is heard at once, and turns the partials of strings that are in tune with the motion for as long as they last;
        no partial is off by more than twice its amplitude.

        Parameters
        ----------
        spectrum : (C, F) N, forces of all strings.
        root, awake, ahead : as of `_velocity`.
        """
        utmost = np.where(awake, self._listening.reach * root, 0.0)[:, self._band_of]
        moving = self._moved(spectrum) + self.state.ringing
        gathered = np.minimum(self._listening.gathers[:, None] * ahead, self._gain) * moving
        spectrum = np.minimum(spectrum + gathered, np.maximum(utmost, spectrum))
        moving = self._moved(spectrum) + self.state.ringing
        # a resonance of the body rings as if a force kept it up
        own = np.einsum("fcc->cf", self._mobility_bins)
        ringing = np.divide(self.state.ringing, own, out=np.zeros_like(own), where=own > 0.0).max(axis=0)
        most = 2.0 * self._response.max(axis=1) * (spectrum.sum(axis=0) + ringing)
        out = np.empty((len(self._response), len(self.components), BANDS + 1))
        for level in range(BANDS + 1):
            each = self._turned * (self._inertia[:, level] * moving)
            out[:, :, level] = np.minimum(each, most[:, None]).sum(axis=-1)
        return out

    def _back(self, missing: Floats, force: Floats) -> Floats:
        """(R, C, BANDS + 1) what is heard of partials of other strings in tune with the culled bands of each component.

        Parameters
        ----------
        missing : (C, BANDS) N, bound on the forces of culled bands.
        force : (C, BANDS) N, of what is in use.
        """
        strings = self._listening
        lasting = (strings.gathers[:, None] * strings.lasting).T
        # (BANDS, C, C): of the first, by the second
        off = np.minimum(self._mobility * lasting[:, :, None] * missing.T[:, None], 2.0 * force.T[:, :, None])
        each = np.einsum("rib,bic->rcb", strings.loudest, off)
        out = np.zeros((*each.shape[:2], BANDS + 1))
        out[:, :, 1:] = np.cumsum(each, axis=-1)
        return out

    def _pays(self, name: str, rungs: Rungs | None, before: int, after: int, now: float, tense: bool) -> bool:
        """Whether falling asleep saves more than it takes."""
        assert rungs is not None
        seconds = self._until(self._events[name] if self.state.peak.any() else self._all_events, now)
        modes = sum(int(part.counts[before] - part.counts[after]) for part in rungs.parts.values())
        return modes * (_TENSE if tense else 1.0) * seconds * self.model.fs >= self.worth


def _acts(law: object) -> bool:
    return isinstance(law, SpringDashpot) and (law.stiffness > 0.0 or law.damping > 0.0)
