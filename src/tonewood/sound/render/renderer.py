"""Renders scores: `Renderer.blocks` yields the sound block by block; `render` and `play` use it."""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import DroppedNotesWarning, TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.assembly import FREQ_LIMIT, Model, assemble
from tonewood.instrument.model.string_setup import GivenTension
from tonewood.performance.effects.base import EffectReport
from tonewood.performance.engine.engine import GRID, Engine, Snapshot
from tonewood.performance.player.playing import Performance, perform
from tonewood.performance.score.note import Dropped
from tonewood.physics.energy.trace import EnergyTrace
from tonewood.sound.files.audio import Audio, decibels
from tonewood.sound.files.inputs import InstrumentLike, ScoreLike, as_instrument, as_score
from tonewood.sound.files.tags import Tags
from tonewood.sound.render.accuracy import LEVELS
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.presets import with_preset
from tonewood.sound.render.resampling import Resampler
from tonewood.sound.render.routing import Routing, columns_of
from tonewood.sound.room import Room, reverberation_db, room_response
from tonewood.support.arrays import Floats
from tonewood.support.blas import one_blas_thread
from tonewood.support.garbage import without_collecting
from tonewood.support.one_user import OneReader

#: ticks of the control grid in a span; a sound that has decayed ends after a whole span, whatever the block size
_TICKS = 8
#: spans that are stepped at once after the last event; those beyond the end of the sound are cut
_TAIL_SPANS = 8
#: frames of a block in `render`
_BLOCK = 4096
#: s for which the sound must have stayed below the level of the tail
_WINDOW = 0.2
#: re full scale, the loudest sample of silence: 1 bit of 32
SILENT = 2.0**-31
#: s over which a step at the first frame is smoothed
_SMOOTHING = 5e-3
#: attributes of a renderer that change while it renders, besides its engine, filters and room
_MOVING = ("_pending", "_made", "_frames", "_loudest", "_peak", "_recent", "_end", "_step")


@dataclass(frozen=True, slots=True)
class Summary:
    """Summary of a render.

    Attributes
    ----------
    frames, fs, duration_s : length of the sound, lead-in included.
    render_s : seconds of computing, without import and load.
    realtime_factor : seconds of sound per second of computing.
    n_modes : modes that were stepped, at most at a time.
    notes : notes played, of those that begin in it.
    notes_dropped : notes that could not be played and would begin in it, and why.
    peak_dbfs : largest sample re full scale.
    end : why it ended: decayed, tail cap or maximum duration.
    warnings : one line each.
    effects : when they ran and were left out, one per effect and component.
    ignored : kind of MIDI message or controller without effect -> number of them.
    zero_frame : frame of score time 0: the lead-in's length.
    tensions : strings whose given and used tension differ noticeably.
    onset_step_dbfs : largest sample at the first frame before it was smoothed; None if nothing sounded before it.
    room : the room and the level of its own sound; None without one.
    """

    frames: int
    fs: int
    duration_s: float
    render_s: float
    realtime_factor: float
    n_modes: int
    notes: int
    notes_dropped: Sequence[Dropped]
    peak_dbfs: float
    end: str
    warnings: Sequence[str]
    effects: Sequence[EffectReport] = ()
    ignored: Mapping[str, int] = field(default_factory=dict)
    zero_frame: int = 0
    tensions: Sequence[GivenTension] = ()
    onset_step_dbfs: float | None = None
    room: str | None = None


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Snapshot of a renderer between two blocks.

    origin : that renderer's arguments by name.
    """

    origin: Mapping[str, Any]
    engine: Snapshot
    memory: tuple[Floats, ...]
    room: tuple[NDArray[np.complex128], Floats, Floats] | None
    values: Mapping[str, Any]


def assembled(instrument: Instrument, options: RenderOptions, *, by_string: bool = False) -> Model:
    """The model that a `Renderer` steps: of an instrument, at the engine's rate of these options.

    With `by_string` its outputs are split into the shares of all strings; see `assemble`.
    """
    options = with_preset(options, instrument.spec)
    engine_fs = float(_steps(instrument, options) * options.fs)
    limit = None if options.freq_limit is None else min(options.freq_limit, FREQ_LIMIT * engine_fs)
    return assemble(
        options.applied_to(instrument), engine_fs, freq_limit=limit, outputs=options.outputs, by_string=by_string
    )


def _steps(instrument: Instrument, options: RenderOptions) -> Fraction:
    if options.oversampling is not None:
        return Fraction(options.oversampling)
    return LEVELS[options.accuracy].oversampling(instrument.spec)


class Renderer:
    """Streams a score on an instrument.

    Frame 0 is score time 0. Sound before it (the ramp of a pluck at time 0) is computed and discarded, unless a lead-in
    is asked for. This would leave a step at the first frame; the value of the first frame is therefore subtracted with
    a fade of 5 ms, (1 + cos(pi t / 5 ms)) / 2. The note's own attack is not scaled. Samples do not depend on the block
    size, to the last bit.

    `dropped` lists the notes that cannot be played, and one `DroppedNotesWarning` is issued.

    Parameters
    ----------
    score : notes and controllers, or the path of a MIDI file.
    instrument : a loaded instrument, or its name or folder.
    fs : sampling rate, Hz.
    options, settings : of the render; single ones may be given as keywords instead.
    model : that `assembled` made of this instrument and these options, for several renders; else it is made.

    Raises
    ------
    NothingPlayedError : no note can be played.
    TonewoodError : something is out of range; one line.
    """

    @without_collecting
    @one_blas_thread
    def __init__(
        self,
        score: ScoreLike,
        instrument: InstrumentLike,
        fs: float | None = None,
        *,
        options: RenderOptions | None = None,
        model: Model | None = None,
        **settings: Any,
    ):
        score, instrument = as_score(score), as_instrument(instrument)
        self.options = options = with_preset(RenderOptions.of(options, fs, settings), instrument.spec)
        self.fs = options.fs
        steps = _steps(instrument, options)
        self.model = assembled(instrument, options) if model is None else model
        self.performance: Performance = perform(
            score, self.model, channel_per_string=options.channel_per_string, capo=options.capo
        )
        self.engine = Engine(self.model, self.performance.timeline, energy=options.energy)
        self.engine.tail_level = options.tail_level_db
        self._routing = Routing(self.model, self.fs, options.gain_db)
        n_channels = len(self._routing.channels)
        self._resampler = Resampler(steps, n_channels)
        earliest = self.performance.timeline.start
        auto = options.lead_in == "auto"
        self.zero_frame = math.ceil(-earliest * self.fs) if auto else round(float(options.lead_in) * self.fs)
        # the first frame out of the resampler, which looks ahead; silence before it where the lead-in is longer
        first = self._resampler.frame(self.engine.state.sample)
        self._pending = np.zeros((max(0, first + self.zero_frame), len(self.channels)))
        #: value of the first frame where earlier sound was discarded; None until that frame is computed
        self._step: Floats | None = None if earliest * self.fs < -self.zero_frame else np.zeros(n_channels)
        n = round(_SMOOTHING * self.fs)
        self._fade = 0.5 + 0.5 * np.cos(np.pi * np.arange(n) / n)
        self._room: Room | None = None
        self._about_room: str | None = None
        if options.room is not None:
            self._room, self._about_room = self._set_in_room()
        self._made, self._frames, self._seconds, self._loudest, self._peak = len(self._pending), 0, 0.0, 0.0, 0.0
        self._recent: list[tuple[int, float]] = []
        self._end = ""
        self._reading = OneReader("renderer")
        #: checkpoints of a renderer with the same fit this one
        self._origin = {
            "notes": score, "options": options, "values of the instrument": (instrument.folder, instrument.resolved),
        }  # fmt: skip
        warn_of_dropped_notes(self.dropped)

    def _set_in_room(self) -> tuple[Room, str]:
        """The room, each output group with microphones of its own place, and a line about it."""
        options, groups = self.options, self.columns
        name, distance, mix = str(options.room), options.room_distance, options.room_mix_db
        by_width = {
            n: room_response(name, self.fs, n, distance=distance, mix_db=mix) for n in {len(group) for group in groups}
        }
        responses = np.concatenate([by_width[len(group)] for group in groups], axis=1)
        level = reverberation_db(by_width[len(groups[0])], self.fs)
        room = Room(responses, [c for group in groups for c in group])
        return room, f"{name}, not measured: its own sound is {level:+.1f} dB re the direct sound"

    @property
    def dropped(self) -> tuple[Dropped, ...]:
        """Notes that cannot be played, and why."""
        return tuple(self.performance.dropped)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the output channels."""
        names, out = self._routing.channels, []
        for group in self.columns:
            doubled = len(set(group)) < len(group)
            out += (
                [f"{names[c]}_{side}" for c, side in zip(group, ("left", "right"), strict=True)]
                if doubled
                else [names[c] for c in group]
            )
        return tuple(out)

    @property
    def columns(self) -> list[list[int]]:
        """Dry channel of each channel, an entry per output group."""
        return columns_of(self.model.outputs, in_room=self.options.room is not None)

    @property
    def energy(self) -> EnergyTrace | None:
        """Account of energy so far, an entry per 64 samples of the engine's rate; None if it was not asked for."""
        return None if self.engine.energy_budget is None else self.engine.energy_budget.trace()

    @property
    def expected_duration(self) -> float:
        """Upper bound of the length in s: lead-in, last event and the tail's cap."""
        longest = self.performance.timeline.stop + self.options.tail
        longest = longest if self.options.max_duration is None else min(longest, self.options.max_duration)
        return longest + self.zero_frame / self.fs

    @property
    def time(self) -> float:
        """Score time reached, s."""
        return self.engine.state.sample / self.model.fs

    def blocks(self, block_size: int = 1024) -> Iterator[Floats]:
        """Yield (n, n_channels) arrays of `block_size` frames, the last one shorter, until the sound has ended.

        A later call goes on where the one before was left, which can then be continued no more.

        Raises
        ------
        NumericalError : the state is no longer finite; nothing of that block is yielded.
        TonewoodError : `block_size` is no whole number, or below 1; or blocks are taken in several places at once,
            which would each get pieces of the sound.
        """
        if not (isinstance(block_size, int | np.integer) and block_size >= 1):
            raise TonewoodError(f"is {block_size}; a whole number, 1 or more, is allowed", key="block_size")
        with self._reading.begun() as reading:
            while True:
                with reading:
                    while len(self._pending) < block_size and not self._end:
                        self._fill(block_size - len(self._pending))
                    if not len(self._pending):
                        return
                    block, self._pending = self._pending[:block_size], self._pending[block_size:]
                    self._frames += len(block)
                yield block

    def summary(self) -> Summary:
        """Return the summary of the frames so far."""
        duration = self._frames / self.fs
        until = (self._frames - self.zero_frame) / self.fs
        return Summary(
            frames=self._frames,
            fs=self.fs,
            duration_s=duration,
            render_s=self._seconds,
            realtime_factor=duration / self._seconds if self._seconds > 0 else 0.0,
            n_modes=self.model.n_modes,
            notes=sum(play.time < until for play in self.performance.timeline.plays),
            notes_dropped=[drop for drop in self.performance.dropped if drop.time < until],
            peak_dbfs=decibels(self._peak),
            end=self._end or "not ended",
            warnings=[*self.model.warnings, *self.performance.warnings, *silence(self._peak, ended=bool(self._end))],
            effects=[report for effect in self.engine.effects for report in effect.report(self.engine.usage)],
            ignored=self.performance.ignored,
            zero_frame=self.zero_frame,
            tensions=[t for s in self.model.strings.values() if (t := s.tuning.given).noticeable],
            room=self._about_room,
            onset_step_dbfs=None if self._step is None or not self._step.any() else decibels(np.abs(self._step).max()),
        )

    def snapshot(self) -> Checkpoint:
        """Return a copy of the whole state, to `restore` in this renderer or in one made from the same arguments."""
        with self._reading.use:
            return Checkpoint(
                self._origin,
                self.engine.snapshot(),
                (self._resampler.memory.copy(), *self._routing.memory),
                None if self._room is None else self._room.memory,
                {name: copy(getattr(self, name)) for name in _MOVING},
            )

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore a `checkpoint` of this renderer; the samples that follow are the same to the last bit.

        Raises TonewoodError : it was made with another score, another instrument or other options.
        """
        for name, value in self._origin.items():
            if checkpoint.origin[name] != value:
                raise TonewoodError(f"is of a renderer with other {name}", key="checkpoint")
        self._continue_from(checkpoint)

    def _continue_from(self, checkpoint: Checkpoint) -> None:
        with self._reading.use:
            self.engine.restore(checkpoint.engine)
            self._resampler.memory, self._routing.memory = checkpoint.memory[0].copy(), checkpoint.memory[1:]
            if self._room is not None and checkpoint.room is not None:
                self._room.memory = checkpoint.room
            vars(self).update({name: copy(value) for name, value in checkpoint.values.items()})

    def take_over(self, checkpoint: Checkpoint) -> None:
        """Go on from a `checkpoint` of a renderer of the same strings and body, with this one's own gestures.

        Motion and gestures that had begun go on; gestures of this renderer's score that begin later follow.
        """
        self._continue_from(checkpoint)
        self.engine.follow_timeline()

    def _fill(self, frames: int) -> None:
        """Step at least `frames` frames, in whole spans; after the last event always the same number of spans."""
        sample, span = self.engine.state.sample, _TICKS * GRID
        # first frame out of the resampler, which looks ahead
        first = self._resampler.frame(sample)
        longest = self.options.max_duration
        room = math.inf if longest is None else round(longest * self.fs) - max(first, 0)
        lively = (int(self.performance.timeline.stop * self.model.fs) - sample) // span - 1
        if lively > 0:
            spans, pieces = min(math.ceil(self._resampler.samples(min(frames, room)) / span), lively), 1
        else:  # an account of energy has no entries beyond the end of the sound
            left = math.inf if room == math.inf else math.ceil(self._resampler.samples(room) / span)
            spans = pieces = 1 if self.options.energy else max(1, int(min(_TAIL_SPANS, left)))
        began = time.perf_counter()
        sound = self._resampler(self._routing.scaled(self.engine.advance(max(spans, 1) * _TICKS)), sample)
        sound = self._routing.finished(sound)
        self._seconds += time.perf_counter() - began
        unheard = max(0, -first - self.zero_frame)
        sound = self._begun(sound, first + self.zero_frame)
        room += min(max(0, -first), self.zero_frame)  # counted from score time 0
        start = 0
        for piece in range(pieces):
            now = sample + (piece + 1) * max(spans, 1) * span // pieces
            stop = max(0, self._resampler.frame(now) - first - unheard)
            if stop >= room:
                stop, self._end = int(room), "maximum duration"
            self._watch(now, float(np.max(np.abs(sound[start:stop]), initial=0.0)))
            start = stop
            if self._end:
                break
        sound = sound[:start]
        if self._room is not None:
            sound = self._room.add(sound, last=bool(self._end))
            if longest is not None:  # the reverberation ends with the render, too
                sound = sound[: max(0, self.zero_frame + round(longest * self.fs) - self._made)]
        self._made += len(sound)
        self._peak = max(self._peak, float(np.max(np.abs(sound), initial=0.0)))
        self._pending = np.concatenate([self._pending, sound]) if len(self._pending) else sound

    def _begun(self, sound: Floats, first: int) -> Floats:
        """Discard the sound before the first frame, and smooth the step that this leaves; `first` is sound's frame."""
        sound, first = sound[max(0, -first) :], max(0, first)
        if self._step is None and len(sound):
            self._step = sound[0].copy()
        if self._step is not None and self._step.any() and first < len(self._fade):
            fade = self._fade[first : first + len(sound)]
            sound = sound.copy()
            sound[: len(fade)] -= fade[:, None] * self._step
        return sound

    def _watch(self, sample: int, peak: float) -> None:
        """End the render before a sample if the sound has decayed; `peak` is that of the frames since the last call."""
        now = sample // self._resampler.ratio
        self._loudest = max(self._loudest, peak)
        self._recent.append((now, peak))
        since_end = sample / self.model.fs - self.performance.timeline.stop
        while len(self._recent) > 1 and self._recent[0][0] <= now - _WINDOW * self.fs - _TICKS * GRID:
            self._recent.pop(0)
        late = self._routing.longest_delay / self.fs  # sound still due of a delayed channel
        if self._end or not self.engine.done or since_end < _WINDOW + late:
            return
        if max(p for _, p in self._recent) <= self._loudest * 10 ** (self.options.tail_level_db / 20):
            self._end = "decayed"
        elif since_end >= self.options.tail:
            self._end = "tail cap"


def silence(peak: float, *, ended: bool) -> list[str]:
    """Return a warning where nothing is heard of a render that has ended, else none."""
    return [f"the sound is silent: its peak is {decibels(peak):.0f} dBFS"] if ended and peak <= SILENT else []


def warn_of_dropped_notes(dropped: Sequence[Dropped]) -> None:
    """Issue one warning, at the line outside this package that called the render."""
    if not dropped:
        return
    drop = dropped[0]
    notes = "1 note" if len(dropped) == 1 else f"{len(dropped)} notes"
    text = f"{notes} cannot be played; the first, at {drop.time:.2f} s: {drop.reason}"
    _warn(DroppedNotesWarning(text))


def _warn(warning: Warning) -> None:
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "tonewood":
        level, frame = level + 1, frame.f_back
    warnings.warn(warning, stacklevel=level)


@one_blas_thread
def render(
    score: ScoreLike,
    instrument: InstrumentLike,
    fs: float | None = None,
    *,
    options: RenderOptions | None = None,
    progress: Callable[[float], None] | None = None,
    **settings: Any,
) -> Audio:
    """Render a whole score in memory.

    Parameters
    ----------
    score, instrument, fs, options : as for `Renderer`, single options as keywords too.
    progress : called with the score time reached (s) after every block.

    Returns
    -------
    The sound, with the notes that could not be played; with `energy` it carries the account of energy, too.
    """
    score, instrument = as_score(score), as_instrument(instrument)
    renderer = Renderer(score, instrument, options=RenderOptions.of(options, fs, settings))
    blocks = []
    for block in renderer.blocks(_BLOCK):
        blocks.append(block)
        if progress is not None:
            progress(renderer.time)
    samples = np.concatenate(blocks) if blocks else np.zeros((0, len(renderer.channels)))
    for text in silence(float(np.max(np.abs(samples), initial=0.0)), ended=True):
        _warn(UserWarning(text))
    tags = Tags.of(score, [instrument])
    return Audio(samples, renderer.fs, renderer.channels, renderer.energy, renderer.dropped, tags)
