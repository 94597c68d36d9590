"""Simulated listeners with known effects: a check of a test and its analysis before people take it.

They go through the same session as a browser does and write the same files, marked ``simulated``. Their parameters:

- ratings: every sound, the hidden reference among them, is heard as the effects of its levels less those of the
  reference (anchors: their own value less 100), plus the listener's own response to a level (`slope_sd`) and a random
  deviation. In MUSHRA and BS.1116 the sound that is heard as best is taken for the reference and gets 100 or 5.0, the
  others 100 plus their value and the listener's own deviation, within the scale: the hidden reference is found with the
  probability that effects and deviations give, and at chance where there is no effect. On a rating scale values stand
  around its middle;
- discrimination: they find d' between two sounds, the difference of the levels' positions `d_prime`, and answer as the
  task's model says (`tonewood.workshop.listening.detection`);
- paired comparisons: a Bradley-Terry choice by the levels' `preference`;
- staircases: right answers follow the psychometric function of `tonewood.workshop.listening.thresholds`, whose
  threshold varies between listeners.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, ValidationError

from tonewood.support.validation_messages import first_message
from tonewood.support.yaml_io import load_yaml
from tonewood.workshop.batch import pages
from tonewood.workshop.batch.page_parts import Name, Section
from tonewood.workshop.batch.seeds import generator
from tonewood.workshop.listening.answer_file import FOLDER, answers_of, begin, now
from tonewood.workshop.listening.checked_answer import choices
from tonewood.workshop.listening.definition import ListeningError, ListeningTest
from tonewood.workshop.listening.detection import chance_of, share_right, task_of
from tonewood.workshop.listening.psychometric import psychometric
from tonewood.workshop.listening.session import Session
from tonewood.workshop.listening.table import Key, read_key
from tonewood.workshop.listening.trials import OPEN

#: points of the scale of 100 in one grade of BS.1116
_POINTS = 25.0
EffectSizes = dict[Name, dict[str, float]]


class PanelThreshold(Section):
    """Threshold of a staircase: its mean level, its spread between listeners, slope and lapse rate.

    `sd` is the standard deviation in levels; with ``ratio: true`` it is a ratio of 1 or more, the exponential of the
    standard deviation of ln(level) (1.2: 20 %), the slope is per unit of ln(level), and the mean is geometric.
    """

    mean: float
    sd: float | None = Field(default=None, ge=0, description="None: all listeners have one threshold")
    slope: float = Field(gt=0)
    lapses: float = Field(default=0.02, ge=0, le=0.2, description="share of answers that are guesses at any level")


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
    slope_sd: float = Field(default=0.0, ge=0, description="points, of a listener's own response to each level")
    residual_sd: float = Field(default=8.0, ge=0, description="points, of a single answer")
    careless: float = Field(default=0.0, ge=0, le=1, description="share of listeners who answer at random")


def read_panel(path: Path) -> SimulatedPanel:
    """Read the parameters of simulated listeners. Raises ListeningError : names file, key and the values allowed."""
    try:
        return SimulatedPanel.model_validate(load_yaml(path, error=ListeningError))
    except ValidationError as fault:
        key, reason = first_message(fault, SimulatedPanel)
        raise ListeningError(reason, file=path, key=key) from None


def simulate(test: ListeningTest, panel: SimulatedPanel, listeners: int, seed: int) -> list[Path]:
    """Let simulated listeners take the test; returns their files.

    Raises ListeningError
        The parameters name a factor or level that the test has not, or listeners of this seed took the test before.
    """
    key = read_key(test.folder / test.manifest.output.key)
    _check(panel, test)
    randoms = [generator(seed, "simulated listener", test.manifest.name, k) for k in range(listeners)]
    seeds = [int(random.integers(2**48)) for random in randoms]
    if seeds[0] in {one.header["seed"] for one in answers_of(test).listeners}:
        reason = f"is {seed}: its listeners took this test before, and their answers would count twice"
        raise ListeningError(f"{reason}; take another seed, or remove {test.folder / FOLDER}", key="--seed")
    answers = []
    for k, random in enumerate(randoms):
        opened = begin(
            test, language=test.manifest.language, listener=f"simulated {k + 1}", started=now("microseconds"),
            seed=seeds[k], simulated=True,
        )  # fmt: skip
        listener = _Listener(panel, key, test, random)
        while opened.session.step is not None:
            opened.answer(listener.answer(opened.session), now=now("microseconds"))
        answers.append(opened.path)
    return answers


class _Listener:
    """One simulated listener."""

    def __init__(self, panel: SimulatedPanel, key: Key, test: ListeningTest, random: np.random.Generator):
        self.panel, self.key, self.test, self.random = panel, key, test, random
        self.seed = int(random.integers(2**48))
        self.offset = float(random.normal(0.0, panel.listener_sd))
        self.careless = bool(random.random() < panel.careless)
        self.deviation = float(random.standard_normal())  # of thresholds

    def answer(self, session: Session) -> dict[str, Any]:
        """The answer to the step of a session."""
        step, page = session.step, session.page
        assert step is not None
        assert page is not None
        answer: dict[str, Any] = {"seconds": 5.0, "plays": dict.fromkeys(step.slots, 1)}
        if isinstance(page, pages.StaircasePage):
            share = self._detects(page, session.page_index or 0, step.level)
            return answer | {"choice": self._choice(choices(page, step.slots), step.correct, share)}
        if isinstance(page, pages.HeadphonesPage):
            return answer | {"choice": step.correct}
        if allowed := choices(page, step.slots):
            return answer | {"choice": self._judged(page, step, allowed)}
        if isinstance(page, pages.MushraPage):
            return answer | {"ratings": self._mushra(step.slots)}
        if isinstance(page, pages.Bs1116Page):
            return answer | {"ratings": self._bs1116(step.slots)}
        if isinstance(page, pages.RatingPage):
            code = step.slots["A"]
            effect = self._effect(self.panel.ratings, code) + self._interaction(code) + self._response(code)
            return answer | {
                "values": {s.name: self._within((s.low + s.high) / 2 + effect, s.low, s.high) for s in page.scales}
            }
        if isinstance(page, pages.QuestionnairePage):
            return answer | {"values": {q.name: _reply(q) for q in page.questions}}
        return answer | {"agreed": True, "spl_db": 70.0}

    def _within(self, centre: float, low: float, high: float) -> float:
        if self.careless:
            return float(self.random.uniform(low, high))
        return float(np.clip(centre + self.offset + self.random.normal(0.0, self.panel.residual_sd), low, high))

    def _heard(self, reference: str, codes: Mapping[str, str]) -> dict[str, float]:
        """Differences from the reference as they are heard, points by slot."""
        heard = {}
        for slot, code in codes.items():
            role = self.key.stimuli[code].role
            points = self.panel.anchors[role] - 100 if role in self.panel.anchors else self._points(reference, code)
            heard[slot] = points + self.random.normal(0.0, self.panel.residual_sd)
        return heard

    def _points(self, reference: str, code: str) -> float:
        """Effects of a sound less those of the reference, with this listener's own responses."""
        return self._difference(self.panel.ratings, reference, code) + self._response(code) - self._response(reference)

    def _response(self, code: str) -> float:
        """Points of this listener's own response to the levels of a sound."""
        if self.panel.slope_sd == 0:
            return 0.0
        levels = self.key.stimuli[code].levels.items()
        return sum(
            self.panel.slope_sd * float(generator(self.seed, "response", *at).standard_normal()) for at in levels
        )

    def _mushra(self, slots: Mapping[str, str]) -> dict[str, float]:
        codes = {slot: code for slot, code in slots.items() if slot != OPEN}
        if self.careless:
            return {slot: float(self.random.uniform(0, 100)) for slot in codes}
        heard = self._heard(slots[OPEN], codes)
        best = max(heard, key=heard.__getitem__)
        return {
            slot: 100.0 if slot == best else float(np.clip(100 + self.offset + value, 0, 100))
            for slot, value in heard.items()
        }

    def _bs1116(self, slots: Mapping[str, str]) -> dict[str, float]:
        codes = {slot: code for slot, code in slots.items() if slot != OPEN}
        heard = self._heard(slots[OPEN], codes)
        if self.careless:
            heard = {slot: float(self.random.uniform(-100, 0)) for slot in codes}
        best = max(heard, key=heard.__getitem__)
        lead = heard[best] - min(heard.values())
        return {slot: 5.0 if slot == best else float(np.clip(5 - lead / _POINTS, 1, 5)) for slot in codes}

    def _judged(self, page: Any, step: Any, allowed: list[str]) -> str:
        trial = next(t for t in self.test.trials if t.id == step.trial)
        codes = (trial.reference or "", trial.stimuli[0])
        if isinstance(page, pages.PairedPage):
            lead = self._difference(self.panel.preference, step.slots["A"], step.slots["B"])
            return "B" if self.random.random() < 1 / (1 + math.exp(-lead)) else "A"
        d = abs(self._difference(self.panel.d_prime, *codes))
        if isinstance(page, pages.AbPage):
            heard = self.random.normal(0.0, math.sqrt(2)) + (d if step.correct == "different" else 0.0)
            return "different" if abs(heard) > max(d / 2, 0.7) else "same"
        task = task_of(page)
        assert task is not None
        return self._choice(allowed, step.correct, share_right(d, task))

    def _detects(self, page: pages.StaircasePage, number: int, level: float | None) -> float:
        """Share of right answers at a level."""
        chance, law = chance_of(page), self.panel.thresholds.get(str(number + 1))
        if law is None or level is None:
            return chance
        spread = 0.0 if law.sd is None else page.transformed(law.sd)
        centre = page.transformed(law.mean) + spread * self.deviation
        return float(psychometric(page.transformed(level), centre, law.slope, chance, page.share, law.lapses))

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
    levels_of = test.manifest.choices()
    keys = ("ratings", "d_prime", "preference")
    named = [(f, level, key) for key in keys for f, of in getattr(panel, key).items() for level in of]
    named += [(f, level, "interactions") for rule in panel.interactions for f, level in _rule(rule).items()]
    for factor, level, key in named:
        if factor not in levels_of:
            raise ListeningError(f"{factor} is not one of {', '.join(levels_of)}", key=key)
        if level not in levels_of[factor]:
            raise ListeningError(f"{level} is not one of {', '.join(levels_of[factor])}", key=f"{key}.{factor}")
    stairs = [str(i + 1) for i, page in enumerate(test.pages) if isinstance(page, pages.StaircasePage)]
    for number, threshold in panel.thresholds.items():
        if number not in stairs:
            raise ListeningError(f"page {number} is no staircase; {', '.join(stairs) or 'none'} is", key="thresholds")
        page = test.pages[int(number) - 1]
        assert isinstance(page, pages.StaircasePage)
        if page.ratio and (threshold.mean <= 0 or (threshold.sd is not None and threshold.sd < 1)):
            key, value = ("mean", threshold.mean) if threshold.mean <= 0 else ("sd", threshold.sd)
            allowed = "a level above 0" if key == "mean" else "a ratio of 1 or more (1.2: 20 %)"
            raise ListeningError(f"is {value:g}; {allowed} is allowed, the page has ratio: true",
                                 key=f"thresholds.{number}.{key}")  # fmt: skip
