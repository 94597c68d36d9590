"""Dampers that fall and rise: keys, sustain pedal (CC64, continuous), sostenuto (CC66), una corda (CC67).

A damper lies on the strings of its key unless the key is down, or the sostenuto pedal was pressed while it was. The
sustain pedal leaves all other dampers a share of their loss; see `schema.Pedals`. The pedals of all channels move one
mechanism: the one pressed farthest counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby

from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.timeline import GRID, Change
from tonewood.performance.score.note import Control

SUSTAIN, SOSTENUTO, UNA_CORDA = "cc64", "cc66", "cc67"
#: moves of a pedal times strings
_MOST_MOVES = 1_000_000
#: (time in s, value), in order; each value holds until the next
Steps = list[tuple[float, float]]


class Dampers:
    """Dampers of every key, moved by keys and pedals in the order of time.

    model : without dampers nothing is ever done.
    stirred : whether keys or pedals were moved since `moved` was asked last.
    """

    def __init__(self, model: Model):
        keys = model.instrument.spec.keys
        self._pedals = keys.pedals if keys is not None and keys.has_pedals else None
        self._groups = {
            leader: group for leader, group in model.groups.items() if model.strings[leader].places.damper is not None
        }
        self._at: dict[str, dict[int | None, float]] = {SUSTAIN: {}, SOSTENUTO: {}, UNA_CORDA: {}}
        self._down: set[str] = set()
        self._latched: set[str] = set()
        self._now = dict.fromkeys(self._groups, 1.0)
        self.stirred = False

    @property
    def kinds(self) -> frozenset[str]:
        """Controllers that are read."""
        return frozenset(self._at) if self._pedals is not None else frozenset()

    def has(self, string: str) -> bool:
        """Whether the first string of a key has a damper."""
        return string in self._groups

    @property
    def una_corda(self) -> bool:
        """Whether that pedal is down."""
        return self._position(UNA_CORDA) >= 0.5

    def press(self, string: str) -> None:
        """Lift the damper of a key."""
        self._down.add(string)
        self.stirred = True

    def release(self, string: str) -> None:
        """Let the damper of a key fall, as far as the pedals let it."""
        self._down.discard(string)
        self.stirred = True

    def control(self, kind: str, value: float, channel: int | None) -> None:
        """Move a pedal to a position from 0 to 1; a controller that is none of `kinds` moves nothing."""
        if kind not in self.kinds:
            return
        self.stirred = True
        before = self._position(SOSTENUTO)
        self._at[kind][channel] = value
        after = self._position(SOSTENUTO)
        if before < 0.5 <= after:
            self._latched = set(self._down)
        elif after < 0.5 <= before:
            self._latched = set()

    def moved(self, time: float) -> list[Change]:
        """Return the changes at a time (s) of the dampers that lie otherwise than when this was asked last."""
        self.stirred = False
        share = 1.0 if self._pedals is None else self._pedals.share(self._position(SUSTAIN))
        out: list[Change] = []
        for leader, group in self._groups.items():
            value = 0.0 if leader in self._down or leader in self._latched else share
            if value != self._now[leader]:
                self._now[leader] = value
                out += [Change(time, string, damper=value) for string in group]
        return out

    def _position(self, kind: str) -> float:
        return max(self._at[kind].values(), default=0.0)


def damper_changes(model: Model, pedals: Sequence[Control], pressed: Sequence[tuple[float, bool, str]]) -> list[Change]:
    """Return how keys and pedals move dampers; at one time keys come up, then go down, then pedals move.

    pedals : their moves.
    pressed : (time, whether it goes down, first string) of keys.
    """
    dampers = Dampers(model)
    events: list[tuple[float, int, Control | str]] = [(time, int(down), name) for time, down, name in pressed]
    events += [(move.time, 2, move) for move in pedals]
    out: list[Change] = []
    for time, together in groupby(sorted(events, key=lambda e: e[:2]), key=lambda e: e[0]):
        for _, kind, event in together:
            if isinstance(event, Control):
                dampers.control(event.kind, event.value, event.channel)
            elif kind:
                dampers.press(event)
            else:
                dampers.release(event)
        out += dampers.moved(time)
    return out


def pedal_moves(model: Model, controls: Sequence[Control]) -> tuple[list[Control], list[str]]:
    """Return the moves of pedals in a score, at most one of each per point of the control grid, and warnings.

    There are fewer where all strings would be moved too often.
    """
    out: list[Control] = []
    warnings: list[str] = []
    for kind in sorted(Dampers(model).kinds):
        steps = pressed_farthest(controls, kind)
        spacing = tick = GRID / model.fs
        while len(kept := on_grid(steps, spacing)) * len(model.strings) > _MOST_MOVES:
            spacing *= 2
        if spacing > tick:
            name = f"controller {kind[2:]} moves a pedal {len(steps)} times"
            warnings.append(f"{name}: moves within {1e3 * spacing:.0f} ms are taken as one")
        out += [Control(time, kind, value) for time, value in kept]
    return out, warnings


def pressed_farthest(controls: Sequence[Control], kind: str) -> Steps:
    """The largest of a controller's positions over all channels, whenever it changes."""
    positions: dict[int | None, float] = {}
    out: Steps = []
    for control in sorted((c for c in controls if c.kind == kind), key=lambda c: c.time):
        positions[control.channel] = control.value
        value = max(positions.values())
        if out and out[-1][0] == control.time:
            out[-1] = control.time, value
        elif not out or out[-1][1] != value:
            out.append((control.time, value))
    return out


def on_grid(steps: Steps, spacing: float) -> Steps:
    """The last of the steps in each interval of a grid (s)."""
    return list({math.floor(time / spacing): (time, value) for time, value in steps}.values())
