"""Sounds of staircases, rendered when a listener comes to their level.

Both sounds of a trial, the standard and the changed one, are made as all stimuli are: aligned, trimmed, brought to the
same loudness, and lowered together where a true peak would pass the limit. Renders are kept in the batch's ``work/``;
both levels that may come next are made while the listener listens.
"""

from __future__ import annotations

import io
import threading
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import Protocol

import numpy as np

from tonewood.errors import NumericalError, OutputError, TonewoodError
from tonewood.support.units import decibel
from tonewood.workshop.batch import stimuli as st
from tonewood.workshop.batch.conditions import Condition, expand
from tonewood.workshop.batch.definition import changed_condition, room_sha256, with_value
from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.batch.plan import StimulusRenderer
from tonewood.workshop.batch.production import encoded_wav, levelled
from tonewood.workshop.batch.runner import WORK
from tonewood.workshop.batch.seeds import generator
from tonewood.workshop.batch.store import Rendered, Store, content_key
from tonewood.workshop.listening.definition import ListeningError, ListeningTest
from tonewood.workshop.listening.trials import CHANGED, STANDARD

#: trials of which the sounds stay in memory
_KEPT = 64


#: WAV files of one trial, by name: standard and changed
PairOfSounds = dict[str, bytes]


class PairSource(Protocol):
    """A source of the sounds of staircases."""

    def pair(self, page: int, level: float) -> PairOfSounds:
        """Sounds of page `page` (from 0) at a level."""

    def expect(self, page: int, level: float) -> None:
        """Make the sounds of a level that may come next."""


class RenderedPairs:
    """Renders pairs on one thread, each level once.

    Raises TonewoodError : the manifest's files cannot be used, or the room is not that of the batch.
    """

    def __init__(self, test: ListeningTest, renderer: StimulusRenderer):
        self.test, self.renderer = test, renderer
        self.conditions: dict[int, Condition] = {}
        conditions: tuple[Condition, ...] | None = None
        for index, page in enumerate(test.manifest.pages):
            if isinstance(page, StaircasePage):
                conditions = conditions or expand(test.manifest, test.source)
                self.conditions[index] = changed_condition(test.manifest, conditions, index)
        self._store = Store(test.folder / WORK)
        self._room = None if test.manifest.stimuli.room is None else test.source / test.manifest.stimuli.room
        if self._room is not None and test.room_sha256 and room_sha256(self._room) != test.room_sha256:
            reason = "was changed after `tonewood batch`: staircases would sound in another room; restore it"
            raise ListeningError(reason, file=self._room)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="staircase")
        self._pairs: OrderedDict[tuple[int, float], Future[PairOfSounds]] = OrderedDict()
        self._lock = threading.Lock()

    def changes(self) -> list[str]:
        """A line for each staircase whose sounds cannot be made, or may differ from those of the batch."""
        reason = (
            f"its sound of the batch is not in {self._store.folder}: the folder was cleared, or instrument, plugins, "
            "version or machine are others than at `tonewood batch`, and levels are rendered with these"
        )
        lines = []
        for index, condition in self.conditions.items():
            try:
                if not self._store.has(content_key(self.renderer.identity(condition))):
                    lines.append(f"page {index + 1}: {reason}")
            except TonewoodError as fault:  # the other pages go on; this one says so when it is reached
                lines.append(f"page {index + 1}: its levels cannot be made: {fault}")
        return lines

    def pair(self, page: int, level: float) -> PairOfSounds:
        """Sounds of page `page` (from 0) at a level; waits for them.

        Raises TonewoodError : a value does not fit, or a render fails.
        """
        return self._future(page, level).result()

    def expect(self, page: int, level: float) -> None:
        """Make the sounds of a level that may come next; returns at once."""
        self._future(page, level)

    def close(self) -> None:
        """Stop rendering."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _future(self, page: int, level: float) -> Future[PairOfSounds]:
        key = (page, level)
        with self._lock:
            future = self._pairs.get(key)
            if future is None or (future.done() and future.exception() is not None):
                future = self._pairs[key] = self._thread.submit(self._make, page, level)
            self._pairs.move_to_end(key)
            while len(self._pairs) > _KEPT:
                self._pairs.popitem(last=False)
            return future

    def _make(self, index: int, level: float) -> PairOfSounds:
        page = self.test.manifest.pages[index]
        assert isinstance(page, StaircasePage)
        base, settings = self.conditions[index], self.test.manifest.stimuli
        standard = base if page.reference is None else with_value(self.test.manifest, base, page.path, page.reference)
        value = page.value(level, self.renderer.own_value(base, page.path))
        changed = with_value(self.test.manifest, base, page.path, value)
        pair = {}
        for name, condition in ((STANDARD, standard), (CHANGED, changed)):
            pair[name] = levelled(self._rendered(condition), settings, self._room)
        peaks = [decibel(st.true_peak(sound)) for sound in pair.values()]
        drop = st.page_drop_db(peaks, settings.loudness.true_peak_dbtp)
        length = max(map(len, pair.values()))
        sounds = {}
        for name, sound in pair.items():
            padded = np.pad(sound, ((0, length - len(sound)), (0, 0))) * 10.0 ** (-drop / 20.0)
            random = generator(self.test.manifest.seed, "dither", index, level, name)
            stream = io.BytesIO()
            encoded_wav(stream, st.quantised(padded, settings.subtype, random), settings.fs, settings.subtype)
            sounds[name] = stream.getvalue()
        return sounds

    def _rendered(self, condition: Condition) -> Rendered:
        key = content_key(self.renderer.identity(condition))
        with suppress(OutputError):  # it is not kept, or damaged
            return self._store.load(key)
        rendered = self.renderer.render(condition)
        if not (rendered.samples.size and np.isfinite(rendered.samples).all()):
            raise NumericalError(f"{condition.name}: the sound is empty, or not finite")
        with suppress(OutputError):  # a full disk: the sound is heard all the same, and rendered again next time
            self._store.save(key, rendered)
        return rendered
