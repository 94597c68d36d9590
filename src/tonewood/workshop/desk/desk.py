"""The desk itself: a session's design becomes a model beside the sound, and its take is heard when it is ready."""

from __future__ import annotations

import json
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.string_sets import string_sets
from tonewood.instrument.inspection.potentials_at_rest import left_out_lines
from tonewood.instrument.model.assembly import Model
from tonewood.sound.live.instrument import Live
from tonewood.sound.render.options import RenderOptions
from tonewood.workshop.desk import views
from tonewood.workshop.desk.advice import Adviser, offered
from tonewood.workshop.desk.kept_views import KeptViews
from tonewood.workshop.desk.knobs import same_strings_and_body
from tonewood.workshop.desk.making import DesignModels
from tonewood.workshop.desk.models import KeptModels, ModelMaker, Wanted
from tonewood.workshop.desk.phrase import LONGEST, ChosenPhrase
from tonewood.workshop.desk.playback import ComparedTakes, DeskSound
from tonewood.workshop.desk.session import Design, DeskSession
from tonewood.workshop.desk.take import LeveledTakes, PhraseTake, with_hands

#: s of ringing after the last note
TAIL = 3.0
#: frames that are rendered before a take is heard
_READY = 4096


class Desk:
    """One instrument on the desk.

    score : file of a phrase; the chord of open strings where left out.
    folder : for the phrase's file that commands name; a temporary one where left out.
    Raises TonewoodError : the phrase cannot be read.
    """

    def __init__(
        self, session: DeskSession, *, score: Path | None = None, fs: int = 48000, folder: Path | None = None
    ) -> None:
        self.session, self.lock = session, threading.RLock()
        self._temporary = None if folder is not None else tempfile.TemporaryDirectory(prefix="tonewood-desk-")
        self.folder = folder if folder is not None else Path(str(self._temporary and self._temporary.name))
        self.phrase = ChosenPhrase(score, self.folder / "desk_phrase.mid")
        options = RenderOptions(fs=fs, tail=TAIL, max_duration=LONGEST)
        self.takes = LeveledTakes(self.phrase, session.instrument, options)
        self.playback = DeskSound(fs)
        self.serial, self.fault = 0, ""
        models = KeptModels()
        self._models = DesignModels(session, options, models, self._ready, self._failed)
        self._other = ModelMaker(options, self._failed, models)
        self._views = KeptViews(session.start.instrument, options, models)
        self._compared = ""
        self.adviser = Adviser()
        self._make(session.design)

    def close(self) -> None:
        """End the threads, and remove the temporary folder."""
        self.adviser.stop()
        self._models.close()
        self._other.close()
        if self._temporary is not None:
            self._temporary.cleanup()

    def change(self, act: Callable[[DeskSession], None]) -> int:
        """Change the session by `act`, and let the design be heard as soon as it can.

        Returns the serial of the change: blocks of sound bear it from the first in which the change is heard.
        Raises TonewoodError : the change is not allowed; nothing has changed.
        """
        with self.lock:
            before, model = self.session.course(), self._models.exact
            act(self.session)
            if self.session.design is not before[0]:
                self.serial += 1
                try:
                    self._make(self.session.design)
                except TonewoodError:
                    self._models.exact, self.serial = model, self.serial - 1
                    self.session.go_back(before)
                    raise
                self.fault, self._compared = "", ""
                self.playback.compare(None)
            return self.serial

    def _make(self, design: Design) -> None:
        """Let a design be heard: at once where strings and body stay, else as a preview and then exactly."""
        exact, take = self._models.exact, self.playback.take
        applied = self.takes.options.applied_to(design.instrument)
        if exact is not None and take is not None and same_strings_and_body(exact.instrument, applied):
            self._models.forget()
            if self._models.busy is None:
                self._models.exact = with_hands(exact, design.instrument)
                self._by_hands(take, self._models.exact, design)
                return
        self._models.want(design, self.serial)

    def _by_hands(self, take: PhraseTake, model: Model, design: Design) -> None:
        """Play on with other hands, on the model of a design; a take of a preview may be of another body."""
        with self.playback.lock:
            forked = None
            if self.playback.playing and not take.ended and not take.preview:
                first = self.playback.at - self.playback.unheard
                forked = take.forked(first, design.instrument, dict(design.changes))
            if forked is not None:
                self.playback.fork(*forked, self.serial)
            else:
                self.playback.swap(self.takes.take(model, design.changes), serial=self.serial)

    def _ready(self, model: Model, request: Wanted) -> None:
        """Let a model be heard that has been made."""
        with self.lock:
            if request.serial != self.serial or (request.preview and self._exact_known(request)):
                return
            take = self.takes.take(model, request.changes, request.preview)
        playback = self.playback
        goes_on = playback.take is not None and bool(playback.take.preview) and playback.playing
        goes_on = goes_on and playback.serial == request.serial
        take.ensure((playback.at if goes_on else 0) + 2 * _READY)
        with self.lock:
            if request.serial != self.serial or take.score is not self.takes.score:
                return
            playback.swap(take, goes_on=goes_on, serial=request.serial)
            if not request.preview:
                self._models.exact = model

    def _exact_known(self, request: Wanted) -> bool:
        take = self.playback.take
        return take is not None and not take.preview and self.playback.serial >= request.serial and request.serial > 0

    def _failed(self, request: Wanted, reason: str) -> None:
        with self.lock:
            if request.serial == self.serial:
                self.fault = f"no model of this design: {reason}. The sound is still that of the design before."

    def set_phrase(self, kind: str, notes: str = "", velocity: float = 80.0) -> None:
        """Play another phrase; values are those of `phrase`, or the kind ``file``: that of the command line.

        Raises TonewoodError : it cannot be played.
        """
        with self.lock:
            exact = self._models.exact
            self.takes.choose(kind, notes, velocity, self.session.instrument, exact)
            self.serial += 1
            self.playback.compare(None)
            if exact is not None:
                self.playback.swap(self.takes.take(exact, self.session.design.changes), serial=self.serial)

    def key(self, note: float | str, velocity: float, *, on: bool) -> None:
        """Press or release a key; `state` names notes that cannot be played.

        note : MIDI number or name.
        velocity : 1 to 127.
        Raises TonewoodError : there is no model yet, or a value is not allowed.
        """
        take = self.playback.take
        if take is None:
            raise TonewoodError("there is no model yet: wait for the first sound")
        live = self.playback.live
        if on and (live is None or live.model is not take.model):
            options = RenderOptions(fs=take.fs, gain_db=take.options.gain_db)
            live = Live(take.model.instrument, options=options, model=take.model, prepare=False)
            self.playback.exchange_live(live)
        if live is None:
            return
        with self.playback.lock:
            if on:
                live.note_on(note, velocity)
            else:
                live.note_off(note)

    def compare(self, name: str | None, *, blind: bool = False) -> None:
        """Put the design beside another one, at one loudness; None ends that.

        name : of the other one; empty for the start.
        blind : call them X and Y, in a random order.
        Raises TonewoodError : there is none of that name, or no model of the design yet.
        """
        with self.lock:
            if name is None:
                self._compared = ""
                self.playback.compare(None)
                return
            other = self.session.snapshot(name)
            model, design, serial = self._models.exact, self.session.design, self.serial
            if model is None or self._models.busy is not None:
                raise TonewoodError("the model of this design is not ready yet: try again when it is")
            title = name or "the start"
            self._compared = f"both are brought to one loudness: {title} is made"

        def use(other_model: Model, request: Wanted) -> None:
            takes = self.takes.take(model, design.changes), self.takes.take(other_model, other.changes)
            pair, louder = ComparedTakes.of_one_loudness(takes, ("this design", title), blind=blind)
            with self.lock:
                if self.serial == serial:
                    self._compared = "" if blind else f"A is {louder:+.1f} LU from {title}, taken out"
                    self.playback.compare(pair)

        self._other.want(Wanted(other.instrument, other.changes, serial, use))

    def state(self) -> dict[str, Any]:
        """Return all that the page shows besides knobs and pictures."""
        with self.lock:
            playback, take, live, seen = self.playback, self.playback.take, self.playback.live, self._seen
            busy, pair = self._models.busy, playback.pair
            notes = [] if live is None else [d.reason for d in live.player.counters.latest][-1:]
            phrase = {
                "phrase": self.phrase.asked,
                "gain_db": self.takes.gain_db,
                "has_file": bool(self.phrase.score_file),
            }
            return self._shown_session() | phrase | {
                "serial": self.serial,
                "heard": playback.serial,
                "making": None if busy is None else round(time.monotonic() - busy.since, 1),
                "preview": "" if take is None else take.preview,
                "fault": self.fault,
                "modes": None if seen is None else seen.n_modes,
                "warnings": [] if seen is None else [*seen.warnings, *left_out_lines(seen)],
                "channels": [] if take is None else list(take.renderer.channels),
                "dropped": notes + ([] if take is None else [d.reason for d in take.renderer.dropped[:3]]),
                "playing": playback.playing,
                "loop": playback.loop,
                "fs": playback.fs,
                "compared": self._compared,
                "pair": None if pair is None else pair.state(),
            }  # fmt: skip

    def _shown_session(self) -> dict[str, Any]:
        session, instrument = self.session, self.session.instrument
        gain = self.takes.gain_db or 0.0
        return {
            "name": instrument.name,
            "title": instrument.spec.title,
            "changes": [{"path": path, "value": value} for path, value in session.design.changes.items()],
            "added": instrument.resolved["body"]["added"],
            "undo": session.can_undo,
            "redo": session.can_redo,
            "snapshots": [
                {"name": name, "changes": [f"{k}={json.dumps(v)}" for k, v in design.changes.items()]}
                for name, design in session.snapshots.items()
            ],
            "sets": list(string_sets()),
            "command": session.command(str(self.phrase.file), f"{instrument.name}.wav", gain, TAIL),
            "advice": self.adviser.state() | {"offered": offered(instrument)},
        }

    @property
    def _seen(self) -> Model | None:
        """The model of the pictures: of the preview that is heard, else the exact one."""
        take = self.playback.take
        return take.model if take is not None and take.preview else self._models.exact

    def view(self, kind: str, argument: str = "", *, of_start: bool = False) -> Any:
        """Return a view of the design's exact model, computed where it is not kept.

        kind : mobility, shape (at a frequency), strings, wolves, force (of a string), drawing or differences.
        argument : frequency (Hz) or string.
        of_start : of the design that the session began with.
        Raises TonewoodError : there is no such view, or no model yet.
        """
        if kind == "drawing":
            return views.drawing(self.session.instrument)
        model, exact = self._seen, self._models.exact
        if model is None:
            raise TonewoodError("there is no model yet: wait for the first sound")
        if kind == "differences" and exact is not None and model is not exact:
            return ["a coarse preview is seen: what differs is told of the exact model, which follows"]
        return self._views.view(model, kind, argument, of_start=of_start, exact=exact is not None)
