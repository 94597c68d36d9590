"""Pages of a listening test: one class per type of page, with the keys that a manifest may give it.

A text is a plain string, or a mapping from languages to strings; it is escaped wherever it is shown, and an empty line
begins a new paragraph.
"""

from __future__ import annotations

import itertools
import math
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from tonewood.workshop.batch.page_parts import (
    Levels,
    Pairs,
    ParameterPath,
    Question,
    RatingScale,
    Return,
    Section,
    Text,
)

#: of a staircase, least distance between its limits: a share of their size, or the logarithm of their ratio
LEAST_SPAN = 1e-9
#: of a staircase, share of the way between its limits that a track of answers of one kind goes at least
LEAST_WAY = 0.01


class Page(Section):
    """A page of any type."""

    name: Text = Field(default="", description="title")
    content: Text = Field(default="", description="plain text shown below the title")


class ConsentPage(Page):
    """Information on the test and a box that must be ticked to go on."""

    type: Literal["consent"] = Field(description="this word")
    agree: Text = Field(default="", description="words beside the box")


class InstructionsPage(Page):
    """A page to read."""

    type: Literal["instructions"] = Field(description="this word")


class LevelPage(Page):
    """Level setting: a tone as loud as the stimuli, by which the playback level is set and not changed again."""

    type: Literal["level"] = Field(description="this word")
    freq: float = Field(default=1000.0, ge=50, le=10000, description="Hz, of the tone")
    spl_db: float | None = Field(default=None, ge=20, le=100, description="dB SPL that the tone is to have at the ear")
    measured: bool = Field(default=False, description="ask for the sound pressure level that was measured")


class TrainingPage(Page):
    """Trials of another page before it begins, with the right answer shown; they do not count."""

    type: Literal["training"] = Field(description="this word")
    page: int = Field(ge=1, description="number of the page that is trained, counted from 1")
    trials: int = Field(default=2, ge=1, le=100, description="of that page")


class QuestionnairePage(Page):
    """Questions on the listener, or on the test."""

    type: Literal["questionnaire"] = Field(description="this word")
    questions: list[Question] = Field(min_length=1, max_length=100, description="in the order shown")


class FinishPage(Page):
    """The last page; one is added where a manifest has none."""

    type: Literal["finish"] = Field(description="this word")
    back: Return | None = Field(default=None, description="code and address shown when the answers are saved")


class HeadphonesPage(Page):
    """A check that headphones are worn: six trials of three intervals that loudspeakers in a room make alike.

    `huggins` (A. E. Milne et al., Behav. Res. Methods 53 (2021) 1551): white noise; in one interval a band at 600 Hz is
    in antiphase between the ears, which is heard as a faint pitch. `antiphase` (K. J. P. Woods et al., Atten. Percept.
    Psychophys. 79 (2017) 2064): tones of 200 Hz; one is 6 dB softer, another in antiphase: over loudspeakers softer.
    """

    type: Literal["headphones"] = Field(description="this word")
    method: Literal["huggins", "antiphase"] = Field(default="huggins", description="sounds of the check")
    trials: int = Field(default=6, ge=1, le=60, description="of one attempt")
    right: int | None = Field(default=None, ge=1, description="right answers to pass; all, of antiphase all but one")
    attempts: int = Field(default=2, ge=1, le=10, description="how often the check may be taken")
    failed: Literal["stop", "go_on"] = Field(default="stop", description="what follows for listeners who do not pass")
    back: Return | None = Field(default=None, description="code and address for listeners who are stopped")

    @property
    def needed(self) -> int:
        """Right answers that pass."""
        return self.right or (self.trials if self.method == "huggins" else max(self.trials - 1, 1))

    @model_validator(mode="after")
    def _can_be_passed(self) -> Self:
        if self.right is not None and self.right > self.trials:
            raise PydanticCustomError("headphones", f"right is {self.right}, there are {self.trials} trials")
        return self


class ListenedPage(Page):
    """A page whose sounds listeners play."""

    listen: float = Field(default=0.5, ge=0, le=1, description="share of each sound that must be heard first")
    plays: int | None = Field(default=None, ge=1, le=1000, description="most times that a sound may be played")


class SoundPage(Page):
    """A page with sounds of the batch."""

    group_by: list[str] = Field(default_factory=list, description="factors that stay the same on one page")


class TrialPage(SoundPage, ListenedPage):
    """Sounds that listeners compare or rate, trial by trial."""

    subset: int | None = Field(
        default=None, ge=1, description="trials that one listener gets, all equally often over the listeners"
    )


class SwitchedPage(TrialPage):
    """A page on which listeners switch between sounds."""

    switch: Literal["continue", "restart"] = Field(
        default="continue", description="where a sound begins that is switched to"
    )
    loop: Literal["off", "whole", "region"] = Field(
        default="whole", description="sounds may be repeated: not, as a whole, or a region that listeners choose"
    )

    @model_validator(mode="after")
    def _loops_are_not_counted(self) -> Self:
        if self.plays is not None and "loop" in self.model_fields_set and self.loop != "off":
            raise PydanticCustomError("page", "a loop repeats a sound without end: plays allows loop: off only")
        return self

    @property
    def loops(self) -> str:
        """How sounds may be repeated; not at all where plays are limited."""
        return "off" if self.plays is not None else self.loop


class PointsPage(SwitchedPage):
    """Sounds on a scale of points."""

    expect: float | None = Field(default=None, gt=0, description="difference of means to be found, points of the scale")
    expect_sd: float | None = Field(default=None, gt=0, description="standard deviation of listeners' differences")
    expect_sound_sd: float | None = Field(default=None, gt=0, description="standard deviation of sounds' differences")
    waveform: bool = Field(default=False, description="show the waveform of the reference, or of the sound")


class RatedPage(PointsPage):
    """Sounds against a reference."""

    reference: Levels = Field(min_length=1, description="levels of the one sound that is the reference")
    removed: ClassVar[dict[str, str]] = dict.fromkeys(
        ("show_waveform", "looping", "switch_back"),
        "was removed in 0.2: it was an option of webMUSHRA; the keys are waveform, loop and switch",
    )


class MushraPage(RatedPage):
    """Several sounds against a reference on a scale of 0 to 100 (BS.1534)."""

    type: Literal["mushra"] = Field(description="this word")
    anchors: list[Literal[3500, 7000]] = Field(
        default_factory=list, max_length=2, description="Hz, cutoffs of low-pass filtered copies of the reference"
    )
    strict: bool = Field(default=True, description="refuse more signals on a page than BS.1534 allows")


class Bs1116Page(RatedPage):
    """One sound and the hidden reference against the open reference, grades 1 to 5 (BS.1116)."""

    type: Literal["bs1116"] = Field(description="this word")


class PairPage(TrialPage):
    """Pairs of levels of one factor, all else equal; `times` trials each."""

    pairs: Pairs = Field(
        min_length=1, max_length=1, description="one factor: two of its levels, a list of such pairs, or all"
    )
    times: int = Field(default=1, ge=1, le=1000, description="trials of each pair")
    expect: float | None = Field(default=None, gt=0, lt=1, description="share of answers beyond guessing")
    feedback: bool = Field(default=False, description="show whether an answer was right")


class AbxPage(PairPage, SwitchedPage):
    """Which of A and B is X?"""

    type: Literal["abx"] = Field(description="this word")
    unforced: bool = Field(default=False, description="allow the answer that no difference is heard")


class AbPage(PairPage, SwitchedPage):
    """Are A and B the same? Every second trial has one sound twice."""

    type: Literal["ab"] = Field(description="this word")


class PairedPage(PairPage, SwitchedPage):
    """Which of two has more of something, or is preferred?"""

    type: Literal["paired_comparison"] = Field(description="this word")
    question: Text = Field(description="which of the two ...?")
    tie: bool = Field(default=False, description="allow the answer that both are equal")
    feedback: Literal[False] = Field(default=False, description="there is no right answer")
    removed: ClassVar[dict[str, str]] = dict.fromkeys(
        ("unforced", "both_orders", "show_waveform", "looping"),
        "was removed in 0.2: which of two is the reference is asked by type abx; `tonewood migrate` helps",
    )


class AfcPage(PairPage):
    """Forced choice among 2 or 3 intervals, one after the other.

    Without a `question` listeners point at the interval that differs: of three, or of two after the open reference.
    With one ("which decays longer?") they point at the interval that has the pair's second level.
    """

    type: Literal["afc"] = Field(description="this word")
    intervals: Literal[2, 3] = Field(default=3, description="number of sounds, one after the other")
    question: Text = Field(default="", description="which interval has more of it; empty: which differs")


class RatingPage(PointsPage):
    """One sound on one or more scales."""

    type: Literal["rating"] = Field(description="this word")
    scales: list[RatingScale] = Field(min_length=1, max_length=12, description="in the order shown")
    times: int = Field(default=1, ge=1, le=1000, description="trials of each sound")


class StaircasePage(ListenedPage):
    """Just noticeable difference of one parameter: the level adapts to the answers.

    The parameter `path` of the test sound is given by the level x:

        value: x        add: r + x        percent: r (1 + x / 100)        db: r 10^(x / 20)

    r is the number `reference`, or the parameter's own value. Smaller levels are harder. Without `steps` the levels are
    those of QUEST+, `trials` of them; with `steps` the level falls after right answers and rises after a wrong one.
    """

    type: Literal["staircase"] = Field(description="this word")
    path: ParameterPath = Field(
        description="parameter of the bundle, or of the render (render.), that the level changes"
    )
    of: Levels = Field(default_factory=dict, description="levels of the one condition that is changed")
    scale: Literal["value", "add", "percent", "db"] = Field(
        default="add", description="how a level gives the value, see above"
    )
    reference: Any = Field(default=None, description="value of the path in the reference sound; its own if left out")
    unit: Text = Field(default="", description="of the level, for tables")
    start: float = Field(description="first level")
    ratio: bool = Field(default=False, description="levels are compared by their ratios, not their differences")
    lowest: float = Field(description="least level")
    highest: float = Field(description="greatest level")
    trials: int = Field(default=60, ge=10, le=1000, description="of a track (QUEST+)")
    steps: list[Annotated[float, Field(gt=0)]] = Field(
        default_factory=list, max_length=10, description="of the level (Levitt); ratios with ratio: true"
    )
    down: Literal[1, 2, 3] = Field(default=2, description="right answers in a row before the level falls (Levitt)")
    reversals: int = Field(default=8, ge=2, le=50, description="of a track (Levitt)")
    discard: int = Field(default=2, ge=0, le=20, description="first reversals that do not count (Levitt)")
    longest: int = Field(default=80, ge=5, le=1000, description="trials of a track (Levitt)")
    tracks: int = Field(default=1, ge=1, le=8, description="interleaved")
    intervals: Literal[2, 3] = Field(default=3, description="number of sounds, one after the other")
    question: Text = Field(default="", description="which interval has more of it; empty: which differs")
    feedback: bool = Field(default=True, description="show whether an answer was right")
    expect: float | None = Field(default=None, gt=0, description="mean threshold that is expected, a level")
    expect_sd: float | None = Field(
        default=None, gt=0, description="standard deviation of the listeners' thresholds: levels, or a ratio above 1"
    )
    expect_slope: float | None = Field(
        default=None, gt=0, description="slope of the psychometric function, per unit of the level or of its logarithm"
    )
    margin: float | None = Field(
        default=None, gt=0, description="difference of thresholds to be found: levels, or a ratio above 1"
    )

    @model_validator(mode="after")
    def _levels_fit(self) -> Self:
        if not self.lowest <= self.start <= self.highest or self.lowest == self.highest:
            raise PydanticCustomError("staircase", "lowest <= start <= highest is wanted, and lowest < highest")
        if self.ratio and (self.lowest <= 0 or min(self.steps, default=2.0) <= 1):
            raise PydanticCustomError("staircase", "ratio: true needs levels above 0 and steps above 1")
        if self.reversals - self.discard < 2:
            raise PydanticCustomError("staircase", "reversals must be at least discard + 2")
        levitt = {"down", "reversals", "discard", "longest"} & self.model_fields_set
        if not self.steps and levitt:
            raise PydanticCustomError("staircase", f"{min(levitt)} belongs to a staircase with steps")
        if self.steps and "trials" in self.model_fields_set:
            raise PydanticCustomError(
                "staircase", "trials belongs to QUEST+, which has no steps; longest limits a track"
            )
        for key in ("expect_sd", "margin"):
            if self.ratio and (value := getattr(self, key)) is not None and value <= 1:
                raise PydanticCustomError("staircase", f"{key} is a ratio above 1 where ratio: true (1.2: 20 %)")
        return self

    @model_validator(mode="after")
    def _levels_move(self) -> Self:
        """Refuse tracks whose levels stay where they are, or that end before their reversals."""
        span = self.transformed(self.highest) - self.transformed(self.lowest)
        size = 1.0 if self.ratio else max(abs(self.lowest), abs(self.highest))
        if span < LEAST_SPAN * size:
            raise PydanticCustomError("staircase", "lowest and highest are too near to each other")
        if not self.steps or math.isinf(span):  # a value that is not finite is refused where its path is known
            return self
        steps = [math.log(step) if self.ratio else step for step in self.steps]
        if (most := max(steps) * self.longest) < LEAST_WAY * span:
            way = f"{100 * most / span:.2g} % of the way from lowest to highest, {100 * LEAST_WAY:.0f} % at least"
            raise PydanticCustomError("staircase", f"steps: {self.longest} (longest) of the largest go {way} is wanted")
        for index, step in enumerate(self.steps):
            if any(self.moved(end, by, 2 * index) == end for end, by in ((self.lowest, 1), (self.highest, -1))):
                raise PydanticCustomError("staircase", f"steps.{index}: {step:g} is lost by rounding of the level")
        least = 1 + self.reversals // 2 + (self.reversals + 1) // 2 * self.down
        if self.longest < least:
            raise PydanticCustomError(
                "staircase", f"longest: {self.reversals} reversals take {least} trials or more (down: {self.down})"
            )
        return self

    def __hash__(self) -> int:
        return hash(self.model_dump_json())

    @property
    def adaptive(self) -> Literal["levitt", "quest_plus"]:
        """The method that chooses levels."""
        return "levitt" if self.steps else "quest_plus"

    @property
    def share(self) -> float:
        """Share of right answers at the threshold: that which `down` right answers in a row converge to."""
        return float(2.0 ** (-1 / self.down))

    def transformed(self, level: float) -> float:
        """u: the level, or its logarithm where ratios count."""
        return math.log(level) if self.ratio else float(level)

    def level_of(self, u: float) -> float:
        """The level of a transformed one."""
        return math.exp(u) if self.ratio else float(u)

    def value(self, level: float, current: Any) -> Any:
        """The parameter at a level.

        level : x.
        current : the parameter's value in the bundle, used where `reference` is not given.
        Raises ValueError : the scale needs a number to change and there is none.
        """
        if self.scale == "value":
            return level
        base = current if self.reference is None else self.reference
        if isinstance(base, bool) or not isinstance(base, (int, float)):
            raise ValueError(f"is {base!r}; scale: {self.scale} needs a number")
        if self.scale == "add":
            return base + level
        return base * (1 + level / 100) if self.scale == "percent" else base * 10.0 ** (level / 20)

    def moved(self, level: float, by: int, reversals: int) -> float:
        """The level one step down (`by` -1) or up (+1), after so many reversals, within its limits."""
        step = self.steps[min(reversals // 2, len(self.steps) - 1)]
        moved = level * step**by if self.ratio else level + by * step
        return min(max(moved, self.lowest), self.highest)

    def mean(self, levels: list[float]) -> float:
        """Mean of levels, geometric where steps are ratios."""
        if self.ratio:
            return math.exp(math.fsum(map(math.log, levels)) / len(levels))
        return math.fsum(levels) / len(levels)


class HtmlPage(SoundPage):
    """A page only of the audition file; anchors are written as files."""

    type: Literal["html"] = Field(description="this word")
    reference: Levels | None = Field(
        default=None, description="levels of the sound that the anchors are made of, and the others compared with"
    )
    anchors: list[Literal[3500, 7000]] = Field(
        default_factory=list, max_length=2, description="Hz, cutoffs of low-pass filtered copies of the reference"
    )

    @model_validator(mode="after")
    def _anchored(self) -> Self:
        if self.anchors and self.reference is None:
            raise PydanticCustomError("html", "anchors are made from a reference: give one")
        return self


AnyPage = Annotated[
    ConsentPage | InstructionsPage | LevelPage | HeadphonesPage | TrainingPage | QuestionnairePage | MushraPage
    | Bs1116Page | AbxPage | AbPage | PairedPage | AfcPage | RatingPage | StaircasePage | HtmlPage | FinishPage,
    Field(discriminator="type"),
]  # fmt: skip
#: pages with trials that listeners answer
TRIALS = (MushraPage, Bs1116Page, PairPage, RatingPage, StaircasePage)


def as_pairs(pairs: Literal["all"] | list[str] | list[list[str]], levels: list[str]) -> list[list[str]]:
    """One pair ``[a, b]``, a list of pairs, or `all` pairs of the levels, as a list of pairs."""
    if pairs == "all":
        return [list(pair) for pair in itertools.combinations(levels, 2)]
    rows = [p for p in pairs if isinstance(p, list)]
    return rows if len(rows) == len(pairs) else [[str(p) for p in pairs]]


def localised(text: Text, language: str) -> str:
    """A text in a language, or in its base language, or in the first language it has."""
    if isinstance(text, str):
        return text
    base = language.partition("-")[0]
    return text.get(language) or text.get(base) or next(iter(text.values()), "")
