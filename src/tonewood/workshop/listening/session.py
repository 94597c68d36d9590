"""The course of a test for one listener: which step comes next, and whether an answer fits it.

A session is a function of the definition, the listener's seed and place, and the answers so far, and of nothing else. A
server that was killed reads the answers back and goes on at the same step, with the same sounds in the same order.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from tonewood.workshop.batch import pages
from tonewood.workshop.batch.seeds import generator
from tonewood.workshop.listening.definition import ListeningError, ListeningTest, ServedTrial
from tonewood.workshop.listening.thresholds import AdaptiveTrack, track_of

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
#: slot of the open reference
OPEN = "reference"
#: sounds of a staircase, in the place of codes
STANDARD, CHANGED = "standard", "changed"
#: intervals of a check of headphones, in the place of codes: the one to be found is `CHANGED`
INTERVALS = ("1", "2", "3")
#: seconds on one page that a browser may state: ten years, for pages that stay open
_LONGEST = 3.2e8


@dataclass(frozen=True)
class Step:
    """One page as a listener meets it.

    index : counted from 0 over the session.
    page : index of the manifest's page.
    trial : blind id of its trial; empty for a page without sounds.
    slots : slot (A, B, X, 1, 2, 3, reference) -> code, in the order shown.
    correct : the right answer, if there is one.
    training : does not count.
    repetition : of the trial, from 1.
    track, level : of a staircase.
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


class Session:
    """The course of a test for one listener.

    test : the definition.
    seed : the listener's; it decides orders and right answers.
    place : number of the listener, from 0; it decides which trials of a `subset` are theirs.
    step : the one to answer; None after the last.
    failed : the page (from 0) of the check of headphones that ended the test, or None.
    answers : records of the answers taken.
    incomplete : staircases (pages from 0) of which a trial was passed over.
    """

    def __init__(self, test: ListeningTest, seed: int, place: int = 0):
        self.test, self.seed, self.place = test, seed, place
        self.failed: int | None = None
        self.answers: list[dict[str, Any]] = []
        self.tracks: dict[int, list[AdaptiveTrack]] = {}
        self.incomplete: set[int] = set()
        self._course = self._steps()
        self.step: Step | None = next(self._course, None)

    @property
    def page_index(self) -> int | None:
        """Index of the step's page in the manifest; of a training step, of the page that is trained."""
        if self.step is None:
            return None
        page = self.test.pages[self.step.page]
        return page.page - 1 if isinstance(page, pages.TrainingPage) else self.step.page

    @property
    def page(self) -> pages.AnyPage | None:
        """The page of `page_index`."""
        return None if self.page_index is None else self.test.pages[self.page_index]

    @property
    def total(self) -> int:
        """Steps of the whole session; a staircase with steps is counted as 40 trials a track, or as many as it had."""
        count = 0
        for index, page in enumerate(self.test.pages):
            if isinstance(page, pages.StaircasePage):
                tracks = self.tracks.get(index, [])
                done = sum(len(track.levels) for track in tracks)
                finished = bool(tracks) and all(track.done for track in tracks)
                count += done if finished else max(done + 5, (40 if page.steps else page.trials) * page.tracks)
            elif isinstance(page, pages.HeadphonesPage):
                count += max(page.trials, sum(record["page"] == index + 1 for record in self.answers))
            elif not isinstance(page, pages.HtmlPage):
                count += len(list(self._static(index, page)))
        return count

    def answer(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Check the answer to the step, take it, and go on; returns the record of it.

        Raises ListeningError : it does not fit the step; one line.
        """
        record = self.record(given)
        self.take(record)
        return record

    def record(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Check the answer to the step; returns the record of it and changes nothing.

        Raises ListeningError : it does not fit the step; one line.
        """
        step, page = self.step, self.page
        if step is None or page is None:
            raise ListeningError("the test is finished")
        answer = checked(page, step, given)
        record: dict[str, Any] = {
            "index": step.index,
            "page": step.page + 1,
            "type": page.type,
            "trial": step.trial,
            "training": step.training,
            "repetition": step.repetition,
            "slots": dict(step.slots),
            "answer": answer,
        }
        if step.correct is not None:
            record |= {"correct": step.correct, "right": answer.get("choice") == step.correct}
        if step.track is not None:
            record |= {"track": step.track, "level": step.level}
        return record

    def take(self, record: dict[str, Any]) -> None:
        """Go on by an answer that was checked before.

        Raises ListeningError : it belongs to another step: the file is damaged, or the test is another one.
        """
        step = self.step
        same = step is not None and all(
            record.get(key) == value
            for key, value in (("index", step.index), ("page", step.page + 1), ("trial", step.trial))
        )
        if not same or step is None or dict(record["slots"]) != dict(step.slots):
            raise ListeningError(f"answer {record.get('index')} does not belong to this test")
        if step.track is not None and not step.training:
            self.tracks[step.page][step.track].answer(bool(record["right"]))
        self.answers.append(record)
        self.step = next(self._course, None)

    def pass_over(self) -> None:
        """Go on without an answer; a staircase ends with that, because its next level is unknown."""
        step = self.step
        if step is not None and step.track is not None and not step.training:
            self.incomplete.add(step.page)
        self.step = next(self._course, None)

    def has_taken(self, given: Mapping[str, Any]) -> bool:
        """Whether the answer to an earlier step, by its `index`, is the one that was taken."""
        index = given.get("index")
        if type(index) is not int or not 0 <= index < len(self.answers):
            return False
        record = self.answers[index]
        course = Session(self.test, self.seed, self.place)
        for earlier in self.answers[:index]:
            course.take(earlier)
        try:
            return bool(course.record(given)["answer"] == record["answer"])
        except ListeningError:
            return False

    def known_steps(self, number: int) -> list[dict[str, Any]]:
        """Fields of the steps of a page (from 0) that do not depend on answers; none of a staircase or a check."""
        page = self.test.pages[number]
        return [] if isinstance(page, (pages.StaircasePage, pages.HeadphonesPage)) else list(self._static(number, page))

    def _steps(self) -> Iterator[Step]:
        index = 0
        for number, page in enumerate(self.test.pages):
            if isinstance(page, pages.StaircasePage):
                steps = self._adaptive(number, page)
            elif isinstance(page, pages.HeadphonesPage):
                steps = self._checked(number, page)
            else:
                steps = self._static(number, page)
            for fields in steps:
                yield Step(index=index, page=number, **fields)
                index += 1
            if self.failed is not None:
                return

    def _static(self, number: int, page: pages.AnyPage) -> Iterator[dict[str, Any]]:
        """Fields of the steps of a page whose number is known before it begins."""
        if isinstance(page, pages.HtmlPage):
            return
        trained = self.test.pages[page.page - 1] if isinstance(page, pages.TrainingPage) else page
        trials = self.test.trials_of(number)
        if isinstance(page, pages.TrainingPage):
            if isinstance(trained, pages.StaircasePage):
                for k in range(page.trials):
                    fields = self._intervals(trained, ("training", number, k), STANDARD, CHANGED)
                    yield {**fields, "training": True, "track": 0, "level": trained.start, "repetition": k + 1}
                return
            if trials:
                order = generator(self.test.manifest.seed, "training", self.seed, number).permutation(len(trials))
                for k in range(page.trials):
                    yield {**self._trial(trained, trials[order[k % len(trials)]], ("training", k)), "training": True}
            return
        if not isinstance(page, (pages.MushraPage, pages.Bs1116Page, pages.PairPage, pages.RatingPage)):
            yield {}
            return
        for trial, repetition in self._ordered(number, self._own(number, trials), getattr(page, "times", 1)):
            yield {**self._trial(page, trial, (repetition,)), "repetition": repetition}

    def _checked(self, number: int, page: pages.HeadphonesPage) -> Iterator[dict[str, Any]]:
        """Trials of a check of headphones, until it is passed or no attempt is left; sets `failed` if the test ends."""
        for attempt in range(1, page.attempts + 1):
            before = len(self.answers)
            for k in range(page.trials):
                random = generator(self.test.manifest.seed, "headphones", self.seed, number, attempt, k)
                odd = int(random.integers(len(INTERVALS)))
                slots = {slot: CHANGED if i == odd else STANDARD for i, slot in enumerate(INTERVALS)}
                yield {"slots": slots, "correct": INTERVALS[odd], "repetition": (attempt - 1) * page.trials + k + 1}
            taken = self.answers[before:]
            # answers that a damaged file lost do not end a test that went on
            if len(taken) < page.trials or sum(bool(record["right"]) for record in taken) >= page.needed:
                return
        if page.failed == "stop":
            self.failed = number

    def _own(self, number: int, trials: list[ServedTrial]) -> list[ServedTrial]:
        """The listener's trials of a page with `subset`, in the manifest's order.

        Listeners take turns on one circle of trials, `subset` each. After n / gcd(n, subset) listeners all n trials
        were given equally often; then the circle is drawn anew, so that other trials meet.
        """
        page, n = self.test.pages[number], len(trials)
        size = page.subset if isinstance(page, pages.TrialPage) else None
        if size is None or size >= n:
            return trials
        turn, place = divmod(self.place, n // math.gcd(n, size))
        circle = generator(self.test.manifest.seed, "subset", number, turn).permutation(n)
        return [trials[i] for i in sorted(circle[(place * size + k) % n] for k in range(size))]

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
            return {
                "trial": trial.id,
                "slots": {"A": a, "B": a if same else b},
                "correct": "same" if same else "different",
            }
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

    def _adaptive(self, number: int, page: pages.StaircasePage) -> Iterator[dict[str, Any]]:
        """Trials of interleaved tracks, until all have ended."""
        tracks = self.tracks[number] = [track_of(page) for _ in range(page.tracks)]
        trial = 0
        while (running := [i for i, t in enumerate(tracks) if not t.done]) and number not in self.incomplete:
            random = generator(self.test.manifest.seed, "track", self.seed, number, trial)
            chosen = running[int(random.integers(len(running)))]
            fields = self._intervals(page, (number, trial), STANDARD, CHANGED)
            trial += 1
            yield {**fields, "track": chosen, "level": tracks[chosen].level, "repetition": trial}


def choices(page: pages.AnyPage, step: Step) -> list[str]:
    """Answers that a choice allows."""
    if isinstance(page, pages.AbPage):
        return ["same", "different"]
    if isinstance(page, pages.AbxPage):
        return ["A", "B", *(["undecided"] if page.unforced else [])]
    if isinstance(page, pages.PairedPage):
        return ["A", "B", *(["tie"] if page.tie else [])]
    if isinstance(page, (pages.AfcPage, pages.StaircasePage, pages.HeadphonesPage)):
        return [slot for slot in step.slots if slot != OPEN]
    return []


def checked(page: pages.AnyPage, step: Step, given: Mapping[str, Any]) -> dict[str, Any]:
    """The answer to a step, with nothing in it beside the fields asked for.

    Raises ListeningError : something is missing or not allowed.
    """
    record: dict[str, Any] = {
        "seconds": _number(given.get("seconds", 0.0), "seconds", 0.0, _LONGEST),
        "plays": {
            slot: int(_number(count, f"plays.{slot}", 0, _most_plays(page)))
            for slot, count in _mapping(given.get("plays", {}), "plays").items()
            if slot in step.slots
        },
    }
    if (shares := given.get("heard")) is not None:
        record["heard"] = _heard(page, step, _mapping(shares, "heard"))
    if comment := given.get("comment"):
        record["comment"] = _text(comment, "comment", 2000)
    if allowed := choices(page, step):
        choice = given.get("choice")
        if choice not in allowed:
            raise ListeningError(f"{choice!r} is not one of {', '.join(allowed)}", key="choice")
        record["choice"] = choice
    elif isinstance(page, (pages.MushraPage, pages.Bs1116Page)):
        low, high = (0.0, 100.0) if isinstance(page, pages.MushraPage) else (1.0, 5.0)
        ratings = _mapping(given.get("ratings"), "ratings")
        record["ratings"] = {
            slot: _number(ratings.get(slot), f"ratings.{slot}", low, high) for slot in step.slots if slot != OPEN
        }
        if isinstance(page, pages.Bs1116Page) and max(record["ratings"].values()) < high:
            raise ListeningError("one of the two is the reference: its grade is 5.0", key="ratings")
    elif isinstance(page, pages.RatingPage):
        values = _mapping(given.get("values"), "values")
        record["values"] = {
            scale.name: _number(values.get(scale.name), f"values.{scale.name}", scale.low, scale.high)
            for scale in page.scales
        }
    elif isinstance(page, pages.QuestionnairePage):
        record["values"] = _questionnaire(page, _mapping(given.get("values"), "values"))
    elif page.type == "consent":
        if given.get("agreed") is not True:
            raise ListeningError("the test goes on only with it", key="agreed")
        record["agreed"] = True
    elif page.type == "level" and page.measured:
        record["spl_db"] = _number(given.get("spl_db"), "spl_db", 0.0, 130.0)
    return record


def _most_plays(page: pages.AnyPage) -> float:
    """Most times that a sound may be played."""
    return page.plays if isinstance(page, pages.ListenedPage) and page.plays is not None else 1e6


def share_wanted(page: pages.AnyPage) -> float:
    """Share of each sound that must be heard before the answer."""
    if isinstance(page, pages.ListenedPage):
        return page.listen
    return 0.5 if isinstance(page, pages.HeadphonesPage) else 0.0


def _heard(page: pages.AnyPage, step: Step, shares: Mapping[str, Any]) -> dict[str, float]:
    """Share of each sound that was heard, as the browser measured it; it must be as large as the page wants it."""
    least, by_name = share_wanted(page), {}
    for slot in step.slots:
        by_name[slot] = share = _number(shares.get(slot), f"heard.{slot}", 0.0, 1.0)
        if share < least:
            raise ListeningError(f"{share:.0%} of the sound was heard, {least:.0%} are wanted", key=f"heard.{slot}")
    return by_name


def _questionnaire(page: pages.QuestionnairePage, values: Mapping[str, Any]) -> dict[str, Any]:
    answers: dict[str, Any] = {}
    for question in page.questions:
        value, key = values.get(question.name), f"values.{question.name}"
        if value in (None, ""):
            if not question.optional:
                raise ListeningError("is missing", key=key)
            continue
        if question.kind == "text":
            answers[question.name] = _text(value, key, 10_000)
        elif question.kind == "choice":
            if not isinstance(value, str) or value not in (question.choices or {}):
                raise ListeningError(f"{value!r} is not one of {', '.join(question.choices or {})}", key=key)
            answers[question.name] = value
        else:
            limits = (question.low, question.high) if question.kind == "scale" else (-math.inf, math.inf)
            answers[question.name] = _number(value, key, *limits)
    return answers


def _mapping(value: Any, key: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ListeningError("is missing" if value is None else "is no mapping", key=key)
    return value


def _text(value: Any, key: str, most: int) -> str:
    if not isinstance(value, str):
        raise ListeningError("is no text", key=key)
    if len(value) > most:  # cut off, a part of a confirmed answer would be lost
        raise ListeningError(f"has {len(value)} characters, {most} are allowed", key=key)
    return value


def _number(value: Any, key: str, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise ListeningError(f"{value!r} is not a number from {low:g} to {high:g}", key=key)
    try:
        number = float(value)
    except OverflowError:  # an integer of hundreds of digits
        number = math.inf
    if not math.isfinite(number):
        raise ListeningError("is not finite", key=key)
    return number
