"""Dampers of an instrument with keys, moved by keys and pedals as they come (`tonewood.performance.player.pedals`)."""

from __future__ import annotations

from collections.abc import Iterable

from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.pedals import SOSTENUTO, SUSTAIN, UNA_CORDA
from tonewood.performance.player.timeline import Change


class LiveDampers:
    """State of the dampers of every key.

    Parameters
    ----------
    model : without dampers nothing is ever done.

    Attributes
    ----------
    pending : changes that are to be made at the next point of the control grid.
    """

    def __init__(self, model: Model):
        keys = model.instrument.spec.keys
        self._pedals = keys.pedals if keys is not None and keys.has_pedals else None
        self._groups = {
            leader: group for leader, group in model.groups.items() if model.strings[leader].damper is not None
        }
        self._at: dict[str, dict[int, float]] = {SUSTAIN: {}, SOSTENUTO: {}, UNA_CORDA: {}}
        self._down: set[str] = set()
        self._latched: set[str] = set()
        self._now = dict.fromkeys(self._groups, 1.0)
        self.pending: list[Change] = []

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
        self._place_dampers([string])

    def release(self, string: str) -> None:
        """Let the damper of a key fall, as far as the pedals let it."""
        self._down.discard(string)
        self._place_dampers([string])

    def control(self, kind: str, value: float, channel: int) -> None:
        """Move a pedal to a position from 0 to 1."""
        before = self._position(SOSTENUTO)
        self._at[kind][channel] = value
        after = self._position(SOSTENUTO)
        if before < 0.5 <= after:
            self._latched = set(self._down)
        elif after < 0.5 <= before:
            self._latched = set()
        self._place_dampers(self._groups)

    def _position(self, kind: str) -> float:
        return max(self._at[kind].values(), default=0.0)

    def _place_dampers(self, leaders: Iterable[str]) -> None:
        share = 1.0 if self._pedals is None else self._pedals.share(self._position(SUSTAIN))
        for leader in leaders:
            if leader not in self._groups:
                continue
            value = 0.0 if leader in self._down or leader in self._latched else share
            if value != self._now[leader]:
                self._now[leader] = value
                self.pending += [Change(0.0, string, damper=value) for string in self._groups[leader]]
