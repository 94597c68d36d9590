"""Simulated listeners with known effects: a check of a test and its analysis before people take it.

They go through the same session as a browser does and write the same files, marked ``simulated``. Their parameters:

- ratings: 100 (5.0 in BS.1116; the middle of a rating scale) plus the effects of the levels heard, less those of the
  reference, plus the listener's own deviation and a random one, within the scale; the hidden reference and anchors have
  values of their own;
- discrimination: they find d' between two sounds, the difference of the levels' positions `d_prime`, and answer as the
  task's model says (`tonewood.workshop.listening.detection`);
- paired comparisons: a Bradley-Terry choice by the levels' `preference`;
- staircases: right answers follow the psychometric function of `tonewood.workshop.listening.thresholds`, whose
  threshold varies between listeners.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, ValidationError

from tonewood.support.validation_messages import first_message
from tonewood.support.yaml_io import load_yaml
from tonewood.workshop.batch.pages import (
    AbPage,
    Bs1116Page,
    MushraPage,
    Name,
    PairedPage,
    QuestionnairePage,
    RatingPage,
    Section,
    StaircasePage,
)
from tonewood.workshop.batch.seeds import generator
from tonewood.workshop.listening.answer_file import begin
from tonewood.workshop.listening.definition import ListeningError, ListeningTest
from tonewood.workshop.listening.detection import CHANCE, share_right, task_of
from tonewood.workshop.listening.session import OPEN, Session, choices
from tonewood.workshop.listening.table import Key, read_key
from tonewood.workshop.listening.psychometric import psychometric

#: points of the scale of 100 in one grade of BS.1116
_POINTS = 25.0
EffectSizes = dict[Name, dict[str, float]]


class PanelThreshold(Section):
    """Threshold of a staircase: its mean level, its standard deviation between listeners, and the slope.

    For steps that are ratios the deviation is a ratio (1.2: 20 %), and the slope is per unit of ln(level).
    """

    mean: float
    sd: float = Field(default=0.0, ge=0)
    slope: float = Field(gt=0)


class SimulatedPanel(Section):
    """Parameters of simulated listeners; a factor that is not named has no effect."""

    schema_: str = Field(alias="schema", pattern=r"^tonewood-panel/1$")
    ratings: EffectSizes = Field(default_factory=dict, description="factor -> level -> points")
    interactions: dict[str, float] = Field(
        default_factory=dict, description="'factor=level, factor=level' -> points more where all hold"
    )
    d_prime: EffectSizes = Field(default_factory=dict, description="factor -> level -> position")
    preference: EffectSizes = Field(default_factory=dict, description="factor -> level -> logits")
    thresholds: dict[str, PanelThreshold] = Field(default_factory=dict, description="number of the page -> threshold")
    anchors: dict[str, float] = Field(default_factory=lambda: {"anchor35": 25.0, "anchor70": 55.0})
    listener_sd: float = Field(default=6.0, ge=0, description="points, of a listener's own deviation")
    residual_sd: float = Field(default=8.0, ge=0, description="points, of a single answer")
    careless: float = Field(default=0.0, ge=0, le=1, description="share of listeners who answer at random")


def read_panel(path: Path) -> SimulatedPanel:
    """Read the parameters of simulated listeners.

    Raises
    ------
    ListeningError : names file, key and the values allowed.
    """
    try:
        return SimulatedPanel.model_validate(load_yaml(path, error=ListeningError))
    except ValidationError as fault:
        key, reason = first_message(fault, SimulatedPanel)
        raise ListeningError(reason, file=path, key=key) from None


def simulate(test: ListeningTest, panel: SimulatedPanel, listeners: int, seed: int) -> list[Path]:
    """Let simulated listeners take the test; returns their files.

    Raises
    ------
    ListeningError : the parameters name a factor or level that the test has not.
    """
    key = read_key(test.folder / test.manifest.output.key)
    _check(panel, test)
    found = []
    for k in range(listeners):
        random = generator(seed, "simulated listener", test.manifest.name, k)
        opened = begin(
            test, language=test.manifest.language, listener=f"simulated {k + 1}", started=_now(),
            seed=int(random.integers(2**48)), simulated=True,
        )  # fmt: skip
        listener = _Listener(panel, key, test, random)
        while opened.session.step is not None:
            opened.answer(listener.answer(opened.session), now=_now())
        found.append(opened.path)
    return found


class _Listener:
    """One simulated listener."""

    def __init__(self, panel: SimulatedPanel, key: Key, test: ListeningTest, random: np.random.Generator):
        self.panel, self.key, self.test, self.random = panel, key, test, random
        self.own = float(random.normal(0.0, panel.listener_sd))
        self.careless = bool(random.random() < panel.careless)
        self.deviation = float(random.standard_normal())  # of thresholds

    def answer(self, session: Session) -> dict[str, Any]:
        """The answer to the step of a session."""
        step, page = session.step, session.page
        assert step is not None
        assert page is not None
        given: dict[str, Any] = {"seconds": 5.0, "plays": dict.fromkeys(step.slots, 1)}
        if isinstance(page, StaircasePage):
            number = session.page_index or 0
            return given | {
                "choice": self._choice(choices(page, step), step.correct, self._detects(page, number, step.level))
            }
        if allowed := choices(page, step):
            return given | {"choice": self._judged(page, step, allowed)}
        if isinstance(page, MushraPage):
            return given | {"ratings": self._mushra(step.slots)}
        if isinstance(page, Bs1116Page):
            return given | {"ratings": self._bs1116(step.slots)}
        if isinstance(page, RatingPage):
            effect = self._effect(self.panel.ratings, step.slots["A"]) + self._interaction(step.slots["A"])
            return given | {
                "values": {s.name: self._within((s.low + s.high) / 2 + effect, s.low, s.high) for s in page.scales}
            }
        if isinstance(page, QuestionnairePage):
            return given | {"values": {q.name: _reply(q) for q in page.questions}}
        return given | {"agreed": True, "spl_db": 70.0}

    def _within(self, centre: float, low: float, high: float) -> float:
        if self.careless:
            return float(self.random.uniform(low, high))
        return float(np.clip(centre + self.own + self.random.normal(0.0, self.panel.residual_sd), low, high))

    def _mushra(self, slots: Mapping[str, str]) -> dict[str, float]:
        ratings = {}
        for slot, code in slots.items():
            if slot == OPEN:
                continue
            role = self.key.stimuli[code].role
            if self.careless:
                ratings[slot] = float(self.random.uniform(0, 100))
            elif code == slots[OPEN]:
                ratings[slot] = 100.0
            elif role in self.panel.anchors:
                ratings[slot] = self._within(self.panel.anchors[role], 0, 100)
            else:
                ratings[slot] = self._within(100 + self._difference(self.panel.ratings, slots[OPEN], code), 0, 100)
        return ratings

    def _bs1116(self, slots: Mapping[str, str]) -> dict[str, float]:
        (other,) = [code for code in slots.values() if code != slots[OPEN]]
        points = self._difference(self.panel.ratings, slots[OPEN], other) + self.random.normal(
            0.0, self.panel.residual_sd
        )
        grade = float(np.clip(5 + points / _POINTS, 1, 5))
        return {slot: grade if code == other else 5.0 for slot, code in slots.items() if slot != OPEN}

    def _judged(self, page: Any, step: Any, allowed: list[str]) -> str:
        trial = next(t for t in self.test.trials if t.id == step.trial)
        codes = (trial.reference or "", trial.stimuli[0])
        if isinstance(page, PairedPage):
            lead = self._difference(self.panel.preference, step.slots["A"], step.slots["B"])
            return "B" if self.random.random() < 1 / (1 + math.exp(-lead)) else "A"
        d = abs(self._difference(self.panel.d_prime, *codes))
        if isinstance(page, AbPage):
            heard = self.random.normal(0.0, math.sqrt(2)) + (d if step.correct == "different" else 0.0)
            return "different" if abs(heard) > max(d / 2, 0.7) else "same"
        task = task_of(page)
        assert task is not None
        return self._choice(allowed, step.correct, share_right(d, task))

    def _detects(self, page: StaircasePage, number: int, level: float | None) -> float:
        """Share of right answers at a level."""
        task, wanted = task_of(page), self.panel.thresholds.get(str(number + 1))
        assert task is not None
        if wanted is None or level is None:
            return CHANCE[task]
        spread = math.log(wanted.sd) if page.ratio and wanted.sd > 0 else wanted.sd
        centre = (math.log(wanted.mean) if page.ratio else wanted.mean) + spread * self.deviation
        u = np.array(math.log(level) if page.ratio else level)
        return float(psychometric(u, centre, wanted.slope, CHANCE[task], 2.0 ** (-1 / page.down)))

    def _choice(self, allowed: list[str], correct: str | None, share: float) -> str:
        others = [c for c in allowed if c not in (correct, "undecided")]
        if self.careless:
            return str(self.random.choice([*others, str(correct)]))
        return str(correct) if self.random.random() < share else str(self.random.choice(others))

    def _effect(self, effects: EffectSizes, code: str) -> float:
        levels = self.key.stimuli[code].levels
        return sum(of.get(levels.get(name, ""), 0.0) for name, of in effects.items())

    def _interaction(self, code: str) -> float:
        levels = self.key.stimuli[code].levels
        return sum(points for rule, points in self.panel.interactions.items() if _rule(rule).items() <= levels.items())

    def _difference(self, effects: EffectSizes, first: str, second: str) -> float:
        more = self._interaction(second) - self._interaction(first) if effects is self.panel.ratings else 0.0
        return self._effect(effects, second) - self._effect(effects, first) + more


def _rule(text: str) -> dict[str, str]:
    """``'a=x, b=y'`` as a mapping."""
    return {name.strip(): level.strip() for name, _, level in (part.partition("=") for part in text.split(","))}


def _reply(question: Any) -> Any:
    if question.kind == "choice":
        return next(iter(question.choices))
    return {"text": "simulated", "number": 0.0, "scale": (question.low + question.high) / 2}[question.kind]


def _check(panel: SimulatedPanel, test: ListeningTest) -> None:
    """Factors, levels and pages exist."""
    known = test.manifest.choices()
    named = [
        (f, level, key)
        for key in ("ratings", "d_prime", "preference")
        for f, of in getattr(panel, key).items()
        for level in of
    ]
    named += [(f, level, "interactions") for rule in panel.interactions for f, level in _rule(rule).items()]
    for factor, level, key in named:
        if factor not in known:
            raise ListeningError(f"{factor} is not one of {', '.join(known)}", key=key)
        if level not in known[factor]:
            raise ListeningError(f"{level} is not one of {', '.join(known[factor])}", key=f"{key}.{factor}")
    stairs = [str(i + 1) for i, page in enumerate(test.pages) if isinstance(page, StaircasePage)]
    for number in panel.thresholds:
        if number not in stairs:
            raise ListeningError(f"page {number} is no staircase; {', '.join(stairs) or 'none'} is", key="thresholds")


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="microseconds")
