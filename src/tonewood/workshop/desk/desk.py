"""The desk itself: a session's design becomes a model beside the sound, and its take is heard when it is ready."""

from __future__ import annotations

import json
import secrets
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.string_sets import string_sets
from tonewood.instrument.model.assembly import Model
from tonewood.performance.score.note import Score
from tonewood.sound.live.instrument import Live
from tonewood.sound.render.options import RenderOptions
from tonewood.support.units import decibel
from tonewood.workshop.desk import views
from tonewood.workshop.desk.advice import Adviser, offered
from tonewood.workshop.desk.kept_views import KeptViews
from tonewood.workshop.desk.knobs import groups, same_strings_and_body, shown
from tonewood.workshop.desk.making import DesignModels
from tonewood.workshop.desk.models import KeptModels, ModelMaker, Wanted
from tonewood.workshop.desk.phrase import LONGEST, ChosenPhrase
from tonewood.workshop.desk.playback import ComparedTakes, DeskSound
from tonewood.workshop.desk.session import Design, DeskSession
from tonewood.workshop.desk.take import PhraseTake, with_hands

#: s of ringing after the last note; dBFS of the loudest sample of the phrase on the start design
TAIL, _PEAK = 3.0, -4.0
#: frames that are rendered before a take is heard
_READY = 4096


class Desk:
    """One instrument on the desk.

    Parameters
    ----------
    session : the designs.
    score : file of a phrase; the chord of open strings where left out.
    fs : sampling rate, Hz.
    folder : for the phrase's file that commands name; a temporary one where left out.

    Raises
    ------
    TonewoodError : the phrase cannot be read.
    """

    def __init__(
        self, session: DeskSession, *, score: Path | None = None, fs: int = 48000, folder: Path | None = None
    ) -> None:
        self.session, self.lock = session, threading.RLock()
        self._temporary = None if folder is not None else tempfile.TemporaryDirectory(prefix="tonewood-desk-")
        self.folder = folder if folder is not None else Path(str(self._temporary and self._temporary.name))
        self.phrase = ChosenPhrase(score, self.folder / "phrase.mid")
        self.score: Score = self.phrase.score(session.instrument)
        self.options = RenderOptions(fs=fs, tail=TAIL, max_duration=LONGEST)
        self.playback = DeskSound(fs)
        self._gain: float | None = None
        self.serial, self.fault = 0, ""
        self._kept = KeptModels()
        self._models = DesignModels(session, self.options, self._kept, self._ready, self._failed)
        self._other = ModelMaker(self.options, self._failed, self._kept)
        self._views = KeptViews(session.start.instrument, self.options, self._kept)
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

    # -- the design -----------------------------------------------------------------------------------------------

    def change(self, act: Callable[[DeskSession], None]) -> int:
        """Change the session, and let the design be heard as soon as it can.

        Parameters
        ----------
        act : on the session.

        Returns
        -------
        The serial of the change, which blocks bear from which on it is heard.

        Raises
        ------
        TonewoodError : the change is not allowed; nothing has changed.
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
        known, take = self._models.exact, self.playback.take
        same = known is not None and same_strings_and_body(known.instrument, self._applied(design))
        if same and known is not None and take is not None:
            self._models.forget()
            if self._models.busy is None:
                self._models.exact = with_hands(known, design.instrument)
                self._by_hands(take, self._models.exact, design)
                return
        self._models.want(design, self.serial)

    def _applied(self, design: Design) -> Any:
        return self.options.applied_to(design.instrument)

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
                fresh = PhraseTake(self.score, model, take.options, dict(design.changes))
                self.playback.swap(fresh, serial=self.serial)

    def _ready(self, model: Model, wanted: Wanted) -> None:
        """Let a model be heard that has been made."""
        with self.lock:
            if wanted.serial != self.serial or (wanted.preview and self._exact_known(wanted)):
                return
            options = self._leveled(model)
            score = self.score
        take = PhraseTake(score, model, options, dict(wanted.changes), wanted.preview)
        playback = self.playback
        goes_on = playback.take is not None and bool(playback.take.preview) and playback.playing
        goes_on = goes_on and playback.serial == wanted.serial
        take.ensure((playback.at if goes_on else 0) + 2 * _READY)
        with self.lock:
            if wanted.serial != self.serial or score is not self.score:
                return
            playback.swap(take, goes_on=goes_on, serial=wanted.serial)
            if not wanted.preview:
                self._models.exact = model

    def _exact_known(self, wanted: Wanted) -> bool:
        take = self.playback.take
        return take is not None and not take.preview and self.playback.serial >= wanted.serial and wanted.serial > 0

    def _leveled(self, model: Model) -> RenderOptions:
        """Options with the gain of the phrase, found once: that of the first model that plays it."""
        if self._gain is None:
            trial = PhraseTake(self.score, model, self.options, {})
            peak = float(abs(trial.sound()).max(initial=0.0))
            self._gain = round(_PEAK - decibel(peak), 1) if peak > 0 else 0.0
        return self.options.at(gain_db=self._gain)

    def _failed(self, wanted: Wanted, reason: str) -> None:
        with self.lock:
            if wanted.serial == self.serial:
                self.fault = f"no model of this design: {reason}. The sound is still that of the design before."

    def advise(self, targets: str, free: str) -> None:
        """Look for the least change that reaches targets, beside the sound; `state` tells how it goes.

        Parameters
        ----------
        targets, free : lines, as in a file of ``tonewood design``.

        Raises
        ------
        TonewoodError : a line is not allowed, or a search goes on.
        """
        session = self.session
        self.adviser.ask(session.instrument, session.options(), session.source, targets, free)

    # -- what plays -----------------------------------------------------------------------------------------------

    def set_phrase(self, kind: str, notes: str = "", velocity: float = 80.0) -> None:
        """Play another phrase.

        Parameters
        ----------
        kind, notes, velocity : as for `phrase`; ``file`` is that of the command line.

        Raises
        ------
        TonewoodError : it cannot be played.
        """
        with self.lock:
            instrument, before = self.session.instrument, self.phrase.asked
            self.phrase.asked = {"kind": kind, "notes": notes, "velocity": velocity}
            try:
                score = self.phrase.score(instrument)
                if self._models.exact is not None:
                    PhraseTake(score, self._models.exact, self.options, {})
            except TonewoodError:
                self.phrase.asked = before
                self.phrase.score(instrument)
                raise
            self.score, self._gain = score, None
            self.serial += 1
            self.playback.compare(None)
            if self._models.exact is not None:
                options = self._leveled(self._models.exact)
                take = PhraseTake(score, self._models.exact, options, dict(self.session.design.changes))
                self.playback.swap(take, serial=self.serial)

    def key(self, note: float | str, velocity: float, *, on: bool) -> None:
        """Press or release a key; `state` tells of notes that cannot be played.

        Parameters
        ----------
        note : MIDI number or name.
        velocity : 1 to 127.
        on : whether it is pressed.

        Raises
        ------
        TonewoodError : there is no model yet, or a value is not allowed.
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

        Parameters
        ----------
        name : of the other one; empty for the start.
        blind : call them X and Y, in an order that `reveal` tells.

        Raises
        ------
        TonewoodError : there is none of that name, or no model of the design yet.
        """
        with self.lock:
            if name is None:
                self._compared = ""
                self.playback.compare(None)
                return
            other = self.session.snapshot(name)
            model, design = self._models.exact, self.session.design
            if model is None or self._models.busy is not None:
                raise TonewoodError("the model of this design is not ready yet: try again when it is")
            self._compared = f"both are brought to one loudness: {name or 'the start'} is made"
            serial, score = self.serial, self.score

        def use(theirs: Model, wanted: Wanted) -> None:
            options = self._leveled(model)
            a = PhraseTake(score, model, options, dict(design.changes))
            b = PhraseTake(score, theirs, options, dict(other.changes))
            louder = a.loudness() - b.loudness()
            gains = (10 ** (-max(louder, 0.0) / 20), 10 ** (min(louder, 0.0) / 20))
            order = (0, 1) if not blind or secrets.randbelow(2) else (1, 0)
            with self.lock:
                if self.serial != serial:
                    return
                self._compared = "" if blind else f"A is {louder:+.1f} LU from {name or 'the start'}, taken out"
                pair = ComparedTakes((a, b), gains, ("this design", name or "the start"), blind=blind, order=order)
                self.playback.compare(pair)

        self._other.want(Wanted(other.instrument, other.changes, serial, use))

    def pick(self, which: int) -> None:
        """Hear the first (0) or second (1) of a comparison."""
        with self.lock:
            if (pair := self.playback.pair) is not None and which in (0, 1):
                self.playback.switch(pair.order[which])

    def reveal(self) -> None:
        """End the blindness of a comparison."""
        with self.lock:
            if self.playback.pair is not None:
                self.playback.pair.blind = False

    # -- what is shown --------------------------------------------------------------------------------------------

    def command(self) -> str:
        """Return the command line that renders what is heard."""
        gain = self._gain or 0.0
        return self.session.command(str(self.phrase.file), f"{self.session.instrument.name}.wav", gain, TAIL)

    def state(self) -> dict[str, Any]:
        """Return all that the page shows besides knobs and pictures."""
        with self.lock:
            session, playback, take = self.session, self.playback, self.playback.take
            busy, pair, seen = self._models.busy, playback.pair, self._seen
            waited = time.monotonic() - busy.since if busy is not None else 0.0
            return {
                "name": session.instrument.name,
                "title": session.instrument.spec.title,
                "serial": self.serial,
                "heard": playback.serial,
                "changes": [{"path": path, "value": value} for path, value in session.design.changes.items()],
                "added": session.instrument.resolved["body"]["added"],
                "undo": session.can_undo,
                "redo": session.can_redo,
                "snapshots": [
                    {"name": name, "changes": [f"{k}={json.dumps(v)}" for k, v in kept.changes.items()]}
                    for name, kept in session.snapshots.items()
                ],
                "sets": list(string_sets()),
                "making": round(waited, 1) if busy is not None else None,
                "preview": "" if take is None else take.preview,
                "fault": self.fault,
                "modes": None if seen is None else seen.n_modes,
                "warnings": [] if seen is None else list(seen.warnings),
                "channels": [] if take is None else list(take.renderer.channels),
                "dropped": self._dropped(),
                "playing": playback.playing,
                "loop": playback.loop,
                "phrase": self.phrase.asked,
                "gain_db": self._gain,
                "fs": playback.fs,
                "has_file": self.phrase.given is not None,
                "compared": self._compared,
                "pair": None if pair is None else pair.state(),
                "command": self.command(),
                "advice": self.adviser.state() | {"offered": offered(session.instrument)},
            }

    def _dropped(self) -> list[str]:
        """Reasons for which notes of the phrase, and the last key, are not played."""
        take, live = self.playback.take, self.playback.live
        keys = [] if live is None else [d.reason for d in live.player.counters.latest][-1:]
        return keys + ([] if take is None else [d.reason for d in take.renderer.dropped[:3]])

    def moments(self, since: int) -> dict[str, Any]:
        """Return what rings: moments of energy after a frame, effects that run, load.

        Parameters
        ----------
        since : frame of the phrase.
        """
        playback = self.playback
        with playback.lock:
            take = playback.take
            at = playback.at
            found = [] if take is None else [asdict(m) for m in take.moments if since < m.frame <= at + 4096]
            effects = [] if take is None else take.effects()
            seconds = 0.0 if take is None else take.frames / take.fs
        meter = playback.meter
        return {
            "frame": at,
            "moments": found,
            "effects": effects,
            "seconds": seconds,
            "load": meter.load,
            "worst": meter.worst,
        }

    def points(self) -> list[str]:
        """Return points of the body on which a mass can be put."""
        points = self.session.instrument.body.points()
        return [name for name, point in points.items() if point.driven]

    def groups(self) -> list[str]:
        """Return names of the groups of knobs."""
        return groups(self.session.instrument)

    def knobs(self, group: str) -> list[dict[str, Any]]:
        """Return the knobs of a group, with the values of the design and of the start.

        Parameters
        ----------
        group : one of `groups`.
        """
        return shown(self.session.design.instrument, self.session.start.instrument, self.session.design.changes, group)

    @property
    def _seen(self) -> Model | None:
        """The model of the pictures: of the preview that is heard, else the exact one."""
        take = self.playback.take
        return take.model if take is not None and take.preview else self._models.exact

    def view(self, kind: str, argument: str = "", *, of_start: bool = False) -> Any:
        """Return a view of the design's exact model, computed where it is not kept.

        Parameters
        ----------
        kind : mobility, shape (at a frequency), strings, wolves, force (of a string), drawing or differences.
        argument : frequency (Hz) or string.
        of_start : of the design that the session began with.

        Raises
        ------
        TonewoodError : there is no such view, or no model yet.
        """
        if kind == "drawing":
            return views.drawing(self.session.instrument)
        design = self._seen
        if design is None:
            raise TonewoodError("there is no model yet: wait for the first sound")
        if kind == "differences" and design is not self._models.exact and self._models.exact is not None:
            return ["a coarse preview is seen: what differs is told of the exact model, which follows"]
        return self._views.view(design, kind, argument, of_start=of_start, exact=self._models.exact is not None)
