"""Dampers that fall and rise: keys, sustain pedal (CC64, continuous), sostenuto (CC66), una corda (CC67).

A damper lies on the strings of its key unless the key is down, or the sostenuto pedal was pressed while it was. The
sustain pedal leaves all other dampers a share of their loss; see `schema.Pedals`. The pedals of all channels move one
mechanism: the one pressed farthest counts.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

from tonewood.instrument.model.assembly import Model
from tonewood.performance.player.timeline import GRID, Change
from tonewood.performance.score.note import Control

SUSTAIN, SOSTENUTO, UNA_CORDA = "cc64", "cc66", "cc67"
#: moves of a pedal times strings
_MOST_MOVES = 1_000_000
#: (time in s, value), in order; each value holds until the next
Steps = list[tuple[float, float]]


class PedalCourses:
    """Pedals of a score over time, and the motion of an instrument's dampers.

    Parameters
    ----------
    model : the instrument; without keys that have pedals nothing is done.
    controls : of the score.
    """

    def __init__(self, model: Model, controls: Sequence[Control]):
        self._model = model
        keys = model.instrument.spec.keys
        moved = controls if keys is not None and keys.has_pedals else ()
        self._steps = {kind: pressed_farthest(moved, kind) for kind in (SUSTAIN, SOSTENUTO, UNA_CORDA)}
        self.warnings: list[str] = []
        for kind, steps in self._steps.items():
            spacing = tick = GRID / model.fs
            while len(kept := on_grid(steps, spacing)) * len(model.strings) > _MOST_MOVES:
                spacing *= 2
            if spacing > tick:
                name = f"controller {kind[2:]} moves a pedal {len(steps)} times"
                self.warnings.append(f"{name}: moves within {1e3 * spacing:.0f} ms are taken as one")
            self._steps[kind] = kept
        self._una_corda_times = [time for time, _ in self._steps[UNA_CORDA]]

    def una_corda(self, time: float) -> bool:
        """Whether the una corda pedal is down."""
        i = bisect_right(self._una_corda_times, time)
        return i > 0 and self._steps[UNA_CORDA][i - 1][1] >= 0.5

    def changes(self, pressed: Mapping[str, Sequence[tuple[float, float]]]) -> list[Change]:
        """Return how dampers move.

        Parameters
        ----------
        pressed : first string of a key -> (down, up) of the key, s, in order.
        """
        keys, strings = self._model.instrument.spec.keys, self._model.strings
        if keys is None:
            return []
        shares = [(time, keys.pedals.share(value)) for time, value in self._steps[SUSTAIN]]
        held = latched(self._steps[SOSTENUTO], pressed)
        out: list[Change] = []
        for leader, group in self._model.groups.items():
            if strings[leader].damper is None:
                continue
            lifted = [*pressed.get(leader, ()), *held.get(leader, ())]
            for time, share in damper_course(shares, lifted):
                if time < math.inf:
                    out += [Change(time, string, damper=share) for string in group]
        return out


def damper_course(shares: Steps, lifted: Iterable[tuple[float, float]]) -> Steps:
    """Share of a damper's loss over time where it begins at 1: 0 while it is lifted, else as the pedal leaves it."""
    ends = [(begin, 1) for begin, _ in lifted] + [(end, -1) for _, end in lifted]
    times = sorted({time for time, _ in ends} | {time for time, _ in shares})
    counts: dict[float, int] = defaultdict(int)
    for time, change in ends:
        counts[time] += change
    of_pedal = dict(shares)
    out: Steps = []
    depth, share, last = 0, 1.0, 1.0
    for time in times:
        depth += counts.get(time, 0)
        share = of_pedal.get(time, share)
        if (value := 0.0 if depth > 0 else share) != last:
            out.append((time, value))
            last = value
    return out


def latched(steps: Steps, pressed: Mapping[str, Sequence[tuple[float, float]]]) -> dict[str, list[tuple[float, float]]]:
    """Times during which the sostenuto pedal holds dampers: from its pressing on those of keys that are down then.

    Parameters
    ----------
    steps : of the pedal.
    pressed : first string of a key -> (down, up) of the key, s, in order, one after the other.
    """
    out: dict[str, list[tuple[float, float]]] = defaultdict(list)
    down = [(0.0, 0.0), *[(time, float(value >= 0.5)) for time, value in steps], (math.inf, 0.0)]
    began: float | None = None
    for (_, before), (time, after) in pairwise(down):
        if after > before:
            began = time
        elif after < before and began is not None:
            for leader, times in pressed.items():
                i = bisect_right(times, (began, math.inf)) - 1
                if i >= 0 and began < times[i][1]:
                    out[leader].append((began, time))
            began = None
    return out


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
