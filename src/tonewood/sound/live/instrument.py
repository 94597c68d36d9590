"""An instrument played live: notes and controllers as they come, sound block by block."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.instrument.model.assembly import Model
from tonewood.performance.effects.base import EffectReport
from tonewood.performance.engine.engine import GRID, Engine
from tonewood.performance.player.player import Player
from tonewood.performance.player.timeline import Timeline
from tonewood.performance.player.voices import Voice
from tonewood.performance.score.note import Dropped, Note
from tonewood.sound.files.audio import decibels
from tonewood.sound.files.inputs import InstrumentLike, as_instrument
from tonewood.sound.live.prepared import PreparedBases
from tonewood.sound.render.accuracy import LEVELS
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.presets import with_preset
from tonewood.sound.render.renderer import assembled
from tonewood.sound.render.resampling import Resampler
from tonewood.sound.render.routing import Routing
from tonewood.support.arrays import Floats
from tonewood.support.blas import one_blas_thread
from tonewood.support.one_user import OneUser, alone

#: options of a render that need its end or its past
_NOT_LIVE = ("tail", "tail_level_db", "max_duration", "lead_in", "energy", "room")
#: frames between two times that lists of the past are emptied
_FORGET = 1 << 16
#: s, shortest and longest preparation of a pluck
RAMP = (1e-3, 0.1)
#: cents, largest bend
BEND_LIMIT = 12800.0


@dataclass(frozen=True, slots=True)
class LiveSummary:
    """Summary of live playing.

    Attributes
    ----------
    frames, fs : how long.
    notes : that were played.
    cut : that ended because another one needed their string.
    dropped : reason -> number of notes that could not be played.
    latest_dropped : the last of these, at most 100.
    ignored : kind of controller or message -> number without effect.
    peak_dbfs : largest sample re full scale.
    clipped : samples beyond full scale.
    process_s : seconds of computing.
    effects : when they ran and were left out.
    """

    frames: int
    fs: int
    notes: int
    cut: int
    dropped: Mapping[str, int]
    latest_dropped: Sequence[Dropped]
    ignored: Mapping[str, int]
    peak_dbfs: float
    clipped: int
    process_s: float
    effects: Sequence[EffectReport] = ()


class Live:
    """Plays an instrument from events as they come.

    >>> import tonewood as tw
    >>> live = tw.Live("monochord")
    >>> live.note_on("A2", velocity=90)
    >>> sound = live.process(128)  # (128, channels)

    Every event takes effect in the next block. The samples depend only on the events and on the frames between which
    they came, not on the sizes of the blocks: an event that comes after frame n acts from the first point of the
    control grid (64 steps of the engine) on that no frame up to n needs. A note then sounds after the preparation of
    its gesture, `ramp` for a pluck; `latency` adds this up.

    One thread at a time may call these methods, another gets an error; `AudioStream.send` passes calls on.

    Parameters
    ----------
    instrument : a loaded instrument, or its name or folder.
    fs : sampling rate, Hz.
    options, settings : as for `Renderer`, single ones as keywords; tail, lead-in, longest duration and the account of
        energy are for scores.
    ramp : s, longest preparation of a pluck; a shorter one is heard as a thump.
    spacing : control intervals between the beginnings of notes that come together, 0 for none: a chord is strummed.
        One interval is 64 steps, 1.3 ms at 48 kHz; the default lets six notes cost no more than their time.
    prepare : compile every stop before the first note, in about a second, so that no note has to wait for it.
    model : that `assembled` made of this instrument and these options; else it is made.

    Attributes
    ----------
    use : context of a thread that calls several methods with no other in between.

    Raises
    ------
    TonewoodError : something is out of range; one line.
    """

    @one_blas_thread
    def __init__(
        self,
        instrument: InstrumentLike,
        fs: float | None = None,
        *,
        options: RenderOptions | None = None,
        ramp: float = 5e-3,
        spacing: int = 2,
        prepare: bool = True,
        model: Model | None = None,
        **settings: Any,
    ):
        self.use = OneUser("instrument", "AudioStream.send calls a function before the next block")
        self.options = options = RenderOptions.of(options, fs, settings)
        wrong = [name for name in _NOT_LIVE if getattr(options, name) != type(options).model_fields[name].default]
        if wrong:
            raise TonewoodError("is for scores that are known before; it is not allowed live", key=wrong[0])
        if not RAMP[0] <= ramp <= RAMP[1]:
            raise TonewoodError(f"is {ramp!r} s; {RAMP[0]:g} to {RAMP[1]:g} s are allowed", key="ramp")
        if spacing not in range(65):
            raise TonewoodError(f"is {spacing!r}; 0 to 64 control intervals are allowed", key="spacing")
        self.fs, self.ramp = options.fs, ramp
        self.instrument = as_instrument(instrument)
        self.options = options = with_preset(options, self.instrument.spec).at(room=None)  # a preset's room is left out
        steps = LEVELS[options.accuracy].oversampling(self.instrument.spec)
        if options.oversampling is not None:
            steps = Fraction(options.oversampling)
        whole = assembled(self.instrument, options) if model is None else model
        self.model = replace(whole, strings={name: string.for_live() for name, string in whole.strings.items()})
        self.engine = Engine(self.model, Timeline((), ()))
        self.player = Player(
            self.model, ramp=ramp, spacing=spacing, channel_per_string=options.channel_per_string, capo=options.capo
        )
        self._bases = PreparedBases(self.model, self.engine.fingerboard, options.capo)
        self.player.spare = self._bases.compile_one
        self._routing = Routing(self.model, self.fs, options.gain_db)
        self._resampler = Resampler(steps, len(self.channels))
        # frames that come out of the resampler before frame 0
        self._early = -self._resampler.frame(0)
        self._pending = np.zeros((0, len(self.channels)))
        self._forget_at = _FORGET
        #: frames that were given out
        self.frames = 0
        self._peak, self._clipped, self._seconds = 0.0, 0, 0.0
        if prepare:
            self._bases.prepare()

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the output channels."""
        return self._routing.channels

    @property
    def time(self) -> float:
        """Length of the sound given out so far, s."""
        return self.frames / self.fs

    @property
    def latency(self) -> float:
        """Longest time from an event to its sound, s, without that of blocks and the device.

        One interval of the control grid, the look-ahead of the resampler, and the preparation of a pluck.
        """
        return self.ramp + GRID / self.model.fs - self._resampler.frame(0) / self.fs

    @alone
    def note_on(
        self,
        note: float | str | None = None,
        velocity: float = 90.0,
        *,
        channel: int = 0,
        force: float | None = None,
        string: str | None = None,
        stop: float | None = None,
        technique: str | None = None,
        from_bridge: float | None = None,
        angle_deg: float | None = None,
    ) -> Voice | None:
        """Begin a note in the next block.

        Parameters
        ----------
        note : MIDI number, fractions are cents / 100, or a name such as ``E2``; or give `string`, with `stop`.
        velocity : 1 to 127, mapped to a force by the instrument's curve; or give `force`, N.
        channel : 0 to 15.
        string, stop, technique, from_bridge, angle_deg : as for `Note`; the instrument decides on those left out.

        Returns
        -------
        The note, for `release`; None for a key that chooses a technique. Notes that cannot be played are counted in
        `summary`, with reasons.

        Raises
        ------
        ScoreError : a value is out of range, or there is no such technique.
        """
        struck = Note(
            self.time,
            1.0,
            note=note,
            velocity_midi=velocity if force is None else None,
            force=force,
            channel=channel,
            string=string,
            stop=stop,
            technique=technique,
            from_bridge=from_bridge,
            angle_deg=angle_deg,
        )
        return self.player.note_on(struck)

    @alone
    def note_off(self, note: float | str, channel: int = 0) -> bool:
        """Release the key of a pitch, that struck first if there are several; returns whether there was one.

        Parameters
        ----------
        note, channel : as for `note_on`.
        """
        _check_channel(channel)
        return self.player.note_off(Note(0.0, note=note).note or 0.0, channel)

    @alone
    def release(self, voice: Voice) -> None:
        """Release the key of a note: the `voice` that `note_on` returned.

        Raises
        ------
        TonewoodError : it is no voice of this instrument.
        """
        if not isinstance(voice, Voice) or (voice.key_down and not self.player.keys.holds(voice)):
            raise TonewoodError("release: a voice that note_on of this instrument returned is allowed")
        self.player.release(voice)

    @alone
    def control(self, number: int, value: float, channel: int = 0) -> None:
        """Move controller `number` to a value from 0 to 1: 64 the sustain pedal, 7 and 11 volume, others by bundle.

        Raises
        ------
        TonewoodError : another number than 0 to 127, or another value; also for a channel that is none.
        """
        if not (_whole(number, 128) and _within(value, 0.0, 1.0)):
            raise TonewoodError(f"controller {number!r} at {value!r}: 0 to 127, at values 0 to 1, are allowed")
        self._control(f"cc{number}", value, channel)

    @alone
    def pressure(self, value: float, channel: int = 0, note: float | None = None) -> None:
        """Press on the keys of a channel, or on one, 0 to 1.

        Pressure on a channel moves the parameter to which the bundle maps ``channel_pressure``, for the notes that
        follow; without that, and on a single key, it has no effect and is counted.

        Parameters
        ----------
        value : 0 to 1.
        channel : 0 to 15.
        note : MIDI number of a single key.

        Raises
        ------
        TonewoodError : a value is out of range.
        """
        if not _within(value, 0.0, 1.0):
            raise TonewoodError(f"pressure of {value!r}: 0 to 1 is allowed")
        self._control("channel_pressure" if note is None else "polyphonic_pressure", value, channel)

    def _control(self, kind: str, value: float, channel: int) -> None:
        _check_channel(channel)
        self.player.control(kind, value, channel)
        self._bases.moved(kind, value)

    @alone
    def bend(self, cents: float, channel: int | None = None) -> None:
        """Bend the strings of a channel, or all, to so many cents above their notes; followed at 40 cents per ms.

        Raises
        ------
        TonewoodError : more than 12800 cents up or down; a channel that is none.
        """
        if not _within(cents, -BEND_LIMIT, BEND_LIMIT):
            raise TonewoodError(f"a bend of {cents!r} cents: {-BEND_LIMIT:g} to {BEND_LIMIT:g} are allowed")
        if channel is not None:
            _check_channel(channel)
        self.player.bend(cents, channel)

    @alone
    def all_off(self, channel: int | None = None) -> None:
        """Release all keys and pedals, of a channel or of all.

        Raises
        ------
        TonewoodError : it is no channel of MIDI.
        """
        if channel is not None:
            _check_channel(channel)
        for at in range(16) if channel is None else (channel,):
            for kind in {"cc64", *self.player.hands.dampers.kinds}:
                self.player.control(kind, 0.0, at)
        self.player.all_off(channel, pedalled=True)

    @alone
    def release_keys(self, channel: int | None = None, *, pedalled: bool = False) -> None:
        """Release all keys of a channel, or of all; notes that the pedal holds sound on.

        Parameters
        ----------
        channel : 0 to 15; all where left out.
        pedalled : end the notes that the pedal holds, too; the pedal stays where it is.

        Raises
        ------
        TonewoodError : it is no channel of MIDI.
        """
        if channel is not None:
            _check_channel(channel)
        self.player.all_off(channel, pedalled=pedalled)

    @alone
    def process(self, frames: int) -> Floats:
        """Return the next frames, (frames, n_channels).

        Raises
        ------
        NumericalError : the state is no longer finite.
        TonewoodError : `frames` is no whole number, or below 1.
        """
        if not (isinstance(frames, int | np.integer) and frames >= 1):
            raise TonewoodError(f"is {frames}; a whole number, 1 or more, is allowed", key="frames")
        began = time.perf_counter()
        self._fill(frames)
        block, self._pending = self._pending[:frames], self._pending[frames:]
        self.frames += frames
        peak = float(max(block.max(), -block.min()))
        self._peak = max(self._peak, peak)
        if peak > 1.0:
            self._clipped += int(np.count_nonzero(np.abs(block) > 1.0))
        if self.frames >= self._forget_at:
            self.engine.usage.forget_times()
            self._forget_at = self.frames + _FORGET
        self._seconds += time.perf_counter() - began
        return block

    @one_blas_thread
    def _fill(self, frames: int) -> None:
        """Step as few points of the control grid as the frames need."""
        blocks, n = [self._pending], len(self._pending)
        while n < frames:
            sample = self.engine.state.sample
            actions = self.player.feed((), 0.0, sample)
            self.engine.schedule.add(actions.changes, actions.plays)
            points = int(-(-self._resampler.samples(frames - n + self._early) // GRID))
            sound = self.engine.advance(max(1, min(points, 1 if self._bases.waiting else self.player.idle_points)))
            sound = self._routing.finished(self._resampler(self._routing.scaled(sound), sample))
            if self._early:
                early = min(self._early, len(sound))
                sound, self._early = sound[early:], self._early - early
            blocks.append(sound)
            n += len(sound)
        if len(blocks) > 1:
            self._pending = np.concatenate(blocks)

    def summary(self) -> LiveSummary:
        """Return the summary so far."""
        counters = self.player.counters
        return LiveSummary(
            frames=self.frames,
            fs=self.fs,
            notes=counters.notes,
            cut=counters.cut,
            dropped=dict(counters.dropped),
            latest_dropped=tuple(counters.latest),
            ignored=dict(counters.ignored),
            peak_dbfs=decibels(self._peak),
            clipped=self._clipped,
            process_s=self._seconds,
            effects=[report for effect in self.engine.effects for report in effect.report(self.engine.usage)],
        )


def _within(value: Any, least: float, most: float) -> bool:
    """Whether a value is a number in a range."""
    return isinstance(value, (int, float, np.number)) and not isinstance(value, bool) and bool(least <= value <= most)


def _whole(value: Any, n: int) -> bool:
    """Whether a value is a whole number from 0 to n - 1."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool) and value in range(n)


def _check_channel(channel: int) -> None:
    """Raises TonewoodError : it is no channel of MIDI."""
    if not _whole(channel, 16):
        raise TonewoodError(f"channel {channel!r}: 0 to 15 are allowed")
