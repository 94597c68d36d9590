"""Trials of one listener: their order, slots and right answers, drawn from the seeds of the test and the listener."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from tonewood.workshop.batch import pages
from tonewood.workshop.batch.seeds import generator
from tonewood.workshop.listening.definition import ListeningTest, ServedTrial

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
#: slot of the open reference
OPEN = "reference"
#: sounds of a staircase, in the place of codes
STANDARD, CHANGED = "standard", "changed"
#: intervals of a check of headphones, in the place of codes: the one to be found is `CHANGED`
INTERVALS = ("1", "2", "3")


@dataclass(frozen=True)
class Step:
    """One page as a listener meets it.

    index : counted from 0 over the session.
    page : index of the manifest's page.
    trial : blind id of its trial; empty for a page without sounds.
    slots : slot (A, B, X, 1, 2, 3, reference) -> code, in the order shown.
    correct : the right answer, if there is one.
    repetition : of the trial, from 1.
    """

    index: int
    page: int
    trial: str = ""
    slots: Mapping[str, str] = field(default_factory=dict)
    correct: str | None = None
    training: bool = False
    repetition: int = 1
    track: int | None = None
    level: float | None = None


class ListenerTrials:
    """Fields of a listener's steps; nothing here depends on answers.

    seed : the listener's; it decides orders and right answers.
    place : number of the listener, from 0; it decides which trials of a `subset` are theirs.
    """

    def __init__(self, test: ListeningTest, seed: int, place: int):
        self.test, self.seed, self.place = test, seed, place

    def steps(self, number: int) -> Iterator[dict[str, Any]]:
        """Fields of the steps of a page (from 0) that do not depend on answers; none of a staircase or a check."""
        page = self.test.pages[number]
        if isinstance(page, (pages.HtmlPage, pages.StaircasePage, pages.HeadphonesPage)):
            return
        trained = self.test.pages[page.page - 1] if isinstance(page, pages.TrainingPage) else page
        trials = self.test.trials_of(number)
        if isinstance(page, pages.TrainingPage):
            if isinstance(trained, pages.StaircasePage):
                for k in range(page.trials):
                    fields = self.of_staircase(trained, "training", number, k)
                    yield {**fields, "training": True, "track": 0, "level": trained.start, "repetition": k + 1}
            elif trials:
                order = generator(self.test.manifest.seed, "training", self.seed, number).permutation(len(trials))
                for k in range(page.trials):
                    yield {**self._trial(trained, trials[order[k % len(trials)]], ("training", k)), "training": True}
            return
        if not isinstance(page, (pages.MushraPage, pages.Bs1116Page, pages.PairPage, pages.RatingPage)):
            yield {}
            return
        for trial, repetition in self._ordered(number, self._subset(number, trials), getattr(page, "times", 1)):
            yield {**self._trial(page, trial, (repetition,)), "repetition": repetition}

    def of_staircase(self, page: pages.StaircasePage, *labels: object) -> dict[str, Any]:
        """Slots and right answer of one trial of a staircase."""
        return self._intervals(page, labels, STANDARD, CHANGED)

    def of_check(self, number: int, attempt: int, trial: int) -> dict[str, Any]:
        """Slots and right answer of one trial of a check of headphones; `attempt` counts from 1, `trial` from 0."""
        random = generator(self.test.manifest.seed, "headphones", self.seed, number, attempt, trial)
        odd = int(random.integers(len(INTERVALS)))
        slots = {slot: CHANGED if i == odd else STANDARD for i, slot in enumerate(INTERVALS)}
        return {"slots": slots, "correct": INTERVALS[odd]}

    def track(self, number: int, trial: int, running: list[int]) -> int:
        """The track of a staircase that a trial belongs to, one of those that run."""
        random = generator(self.test.manifest.seed, "track", self.seed, number, trial)
        return running[int(random.integers(len(running)))]

    def _subset(self, number: int, trials: list[ServedTrial]) -> list[ServedTrial]:
        """The listener's trials of a page with `subset`, in the manifest's order.

        Listeners take turns on one circle of trials, `subset` each. After n / gcd(n, subset) listeners all n trials
        were given equally often; then the circle is drawn anew, so that other trials meet.
        """
        page, n = self.test.pages[number], len(trials)
        size = page.subset if isinstance(page, pages.TrialPage) else None
        if size is None or size >= n:
            return trials
        turn, offset = divmod(self.place, n // math.gcd(n, size))
        circle = generator(self.test.manifest.seed, "subset", number, turn).permutation(n)
        return [trials[i] for i in sorted(circle[(offset * size + k) % n] for k in range(size))]

    def _ordered(self, number: int, trials: list[ServedTrial], times: int) -> list[tuple[ServedTrial, int]]:
        """Trials with their repetitions: all of them once, in random order, then again in another."""
        order = self.test.manifest.output.page_order
        whose = self.seed if order == "per_listener" else ""
        sequence = []
        for repetition in range(1, times + 1):
            random = generator(self.test.manifest.seed, "page order", number, repetition, whose)
            indices = range(len(trials)) if order == "listed" else random.permutation(len(trials))
            sequence += [(trials[i], repetition) for i in indices]
        return sequence

    def _trial(self, page: pages.AnyPage, trial: ServedTrial, labels: tuple[object, ...]) -> dict[str, Any]:
        """Slots and right answer of one trial."""
        names = ("slots", self.seed, trial.id, *labels)
        random = generator(self.test.manifest.seed, *names)
        reference = trial.reference or ""
        if isinstance(page, (pages.MushraPage, pages.Bs1116Page)):
            codes = [reference, *trial.stimuli]
            order = random.permutation(len(codes))
            hidden = {LETTERS[i]: codes[k] for i, k in enumerate(order)}
            return {"trial": trial.id, "slots": {OPEN: reference, **hidden}}
        if isinstance(page, pages.RatingPage):
            return {"trial": trial.id, "slots": {"A": trial.stimuli[0]}}
        if isinstance(page, pages.AfcPage):
            return {"trial": trial.id, **self._intervals(page, names, reference, trial.stimuli[0])}
        pair = [reference, trial.stimuli[0]]
        a, b = (pair[i] for i in random.permutation(2))
        if isinstance(page, pages.AbxPage):
            x = int(random.integers(2))
            return {"trial": trial.id, "slots": {"A": a, "B": b, "X": (a, b)[x]}, "correct": "AB"[x]}
        if isinstance(page, pages.AbPage):
            same = bool(random.integers(2))
            slots = {"A": a, "B": a if same else b}
            return {"trial": trial.id, "slots": slots, "correct": "same" if same else "different"}
        return {"trial": trial.id, "slots": {"A": a, "B": b}}

    def _intervals(
        self, page: pages.AfcPage | pages.StaircasePage, labels: tuple[object, ...], standard: str, other: str
    ) -> dict[str, Any]:
        """Slots of a forced choice: the other sound in one of the intervals."""
        interval = int(generator(self.test.manifest.seed, "interval", self.seed, *labels).integers(page.intervals))
        slots = {str(i + 1): other if i == interval else standard for i in range(page.intervals)}
        if page.intervals == 2 and not page.question:
            slots = {OPEN: standard, **slots}
        return {"slots": slots, "correct": str(interval + 1)}
