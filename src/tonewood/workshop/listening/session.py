"""The course of a test for one listener: which step comes next, and whether an answer fits it.

A session is a function of the definition, the listener's seed and place, and the answers so far, and of nothing else. A
server that was killed reads the answers back and goes on at the same step, with the same sounds in the same order.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from tonewood.workshop.batch import pages
from tonewood.workshop.listening.checked_answer import checked
from tonewood.workshop.listening.definition import ListeningError, ListeningTest
from tonewood.workshop.listening.thresholds import AdaptiveTrack, track_of
from tonewood.workshop.listening.trials import ListenerTrials, Step


class Session:
    """The course of a test for one listener.

    seed : the listener's; it decides orders and right answers.
    place : number of the listener, from 0; it decides which trials of a `subset` are theirs.
    step : the one to answer; None after the last.
    failed : the page (from 0) of the check of headphones that ended the test, or None.
    incomplete : staircases and checks of headphones (pages from 0) of which a trial was passed over; the number of
        their trials is unknown.
    """

    def __init__(self, test: ListeningTest, seed: int, place: int = 0):
        self.test, self.seed, self.place = test, seed, place
        self.trials = ListenerTrials(test, seed, place)
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
            else:
                count += len(list(self.trials.steps(index)))
        return count

    def answer(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Check the answer to the step as `record` does, take it, and go on; returns the record of it."""
        record = self.record(message)
        self.take(record)
        return record

    def record(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Check the answer to the step; returns the record of it and changes nothing.

        Raises ListeningError : it does not fit the step; one line.
        """
        step, page = self.step, self.page
        if step is None or page is None:
            raise ListeningError("the test is finished")
        answer = checked(page, step, message)
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
        here = None if step is None else (step.index, step.page + 1, step.trial, dict(step.slots))
        if step is None or here != (*map(record.get, ("index", "page", "trial")), dict(record["slots"])):
            raise ListeningError(f"answer {record.get('index')} does not belong to this test")
        if step.track is not None and not step.training:
            self.tracks[step.page][step.track].answer(bool(record["right"]))
        self.answers.append(record)
        self.step = next(self._course, None)

    def pass_over(self) -> None:
        """Go on without an answer.

        A staircase ends with that, because its next level is unknown, and a check of headphones with that attempt.
        """
        step = self.step
        checks = step is not None and isinstance(self.test.pages[step.page], pages.HeadphonesPage)
        if step is not None and (checks or (step.track is not None and not step.training)):
            self.incomplete.add(step.page)
        self.step = next(self._course, None)

    def has_taken(self, message: Mapping[str, Any]) -> bool:
        """Whether the answer to an earlier step, by its `index`, is the one that was taken."""
        index = message.get("index")
        if type(index) is not int or not 0 <= index < len(self.answers):
            return False
        record = self.answers[index]
        course = Session(self.test, self.seed, self.place)
        for earlier in self.answers[:index]:
            course.take(earlier)
        try:
            return bool(course.record(message)["answer"] == record["answer"])
        except ListeningError:
            return False

    def _steps(self) -> Iterator[Step]:
        index = 0
        for number, page in enumerate(self.test.pages):
            if isinstance(page, pages.StaircasePage):
                steps = self._adaptive(number, page)
            elif isinstance(page, pages.HeadphonesPage):
                steps = self._checked(number, page)
            else:
                steps = self.trials.steps(number)
            for fields in steps:
                yield Step(index=index, page=number, **fields)
                index += 1
            if self.failed is not None:
                return

    def _checked(self, number: int, page: pages.HeadphonesPage) -> Iterator[dict[str, Any]]:
        """Trials of a check of headphones, until it is passed or no attempt is left; sets `failed` if the test ends."""
        for attempt in range(1, page.attempts + 1):
            before = len(self.answers)
            for k in range(page.trials):
                fields = self.trials.of_check(number, attempt, k)
                yield {**fields, "repetition": (attempt - 1) * page.trials + k + 1}
            taken = self.answers[before:]
            # answers that a damaged file lost do not end a test that went on
            if len(taken) < page.trials or sum(bool(record["right"]) for record in taken) >= page.needed:
                return
        if page.failed == "stop":
            self.failed = number

    def _adaptive(self, number: int, page: pages.StaircasePage) -> Iterator[dict[str, Any]]:
        """Trials of interleaved tracks, until all have ended."""
        tracks = self.tracks[number] = [track_of(page) for _ in range(page.tracks)]
        trial = 0
        while (running := [i for i, t in enumerate(tracks) if not t.done]) and number not in self.incomplete:
            track = self.trials.track(number, trial, running)
            fields = self.trials.of_staircase(page, number, trial)
            trial += 1
            yield {**fields, "track": track, "level": tracks[track].level, "repetition": trial}
