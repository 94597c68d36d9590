"""The work of a batch, before anything is rendered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from tonewood.workshop.batch import definition
from tonewood.workshop.batch.conditions import Condition
from tonewood.workshop.batch.layout import Group
from tonewood.workshop.batch.manifest import Manifest
from tonewood.workshop.batch.pages import PairPage, as_pairs
from tonewood.workshop.batch.production import Fault
from tonewood.workshop.batch.store import Rendered


class StimulusRenderer(Protocol):
    """Renders conditions. It is pickled into workers; every call depends on its condition alone."""

    def identity(self, condition: Condition) -> dict[str, Any]:
        """Everything that decides the samples, JSON-ready: parameters, hashes, version, instruction set."""

    def render(self, condition: Condition) -> Rendered:
        """The sound itself."""

    def own_value(self, condition: Condition, path: str) -> Any:
        """Value of a parameter of the instrument or the render (``render.``); raises a TonewoodError without one."""

    def predict(self, condition: Condition) -> float:
        """About how long `render` will take, s."""


@dataclass(frozen=True)
class BatchPlan:
    """The work of a batch, before anything is rendered.

    conditions, groups : of the manifest, those that could be resolved.
    levels : of staircases, rendered beforehand.
    keys : content key by condition name.
    todo : one condition for each key that is not rendered yet.
    seconds : predicted time of rendering those and of writing the files with the workers given, s; None if not asked.
    faults : conditions that could not be resolved.
    """

    manifest: Manifest
    source: Path
    conditions: tuple[Condition, ...]
    levels: tuple[definition.StaircaseLevel, ...]
    groups: tuple[Group, ...]
    keys: dict[str, str]
    identities: dict[str, dict[str, Any]]
    todo: tuple[Condition, ...]
    seconds: float | None
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]

    @property
    def room(self) -> Path | None:
        """File of the impulse response that all sounds are convolved with."""
        return None if self.manifest.stimuli.room is None else self.source / self.manifest.stimuli.room

    @property
    def n_files(self) -> int:
        """Sound files that will be written."""
        return sum(len(g.stimuli) for g in self.groups)

    def trials_of_a_pair(self) -> dict[int, int]:
        """Trials that a listener gets on each page (from 0) of pairs, of one pair of levels."""
        counts: dict[int, int] = {}
        for index, page in enumerate(self.manifest.pages):
            if isinstance(page, PairPage):
                (factor, pairs), *_ = page.pairs.items()
                count = len(as_pairs(pairs, self.manifest.choices()[factor]))
                trials = sum(len(g.trials) for g in self.groups if g.page == index)
                trials = min(trials, page.subset or trials)
                counts[index] = page.times * max(1, trials // count)
        return counts

    def summary(self) -> dict[str, Any]:
        """The plan as JSON-ready data."""
        return {
            "name": self.manifest.name,
            "conditions": [c.name for c in self.conditions],
            "to_render": len(self.todo),
            "rendered": len(set(self.keys.values())) - len(self.todo),
            "files": self.n_files,
            "trials": sum(len(g.trials) for g in self.groups),
            "predicted_seconds": None if self.seconds is None else round(self.seconds, 3),
            "failed": [{"name": f.name, "reason": f.reason} for f in self.faults],
            "notes": list(self.notes),
        }
