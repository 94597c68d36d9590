"""Takes: the messages of live playing as a MIDI file that plays back to the same samples.

One tick of the file is one frame of the sound, so that every message keeps the frame before which it came. The track's
name holds the other values that the samples depend on: ``tonewood take; fs=48000; ramp=0.005; spacing=2;
instrument=...``.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.performance.score.midi import read_messages
from tonewood.performance.score.note import Dropped
from tonewood.sound.files.audio import decibels
from tonewood.sound.files.inputs import InstrumentLike
from tonewood.sound.live.instrument import Live
from tonewood.sound.live.receiver import MidiReceiver, channel_message
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import Summary, silence
from tonewood.support.arrays import Floats
from tonewood.support.units import number_in
from tonewood.support.whole_files import write_whole

_HEADING = "tonewood take"
#: ticks before an event, most
_LONGEST = 0x0FFFFFFF
#: microseconds per quarter note of which one is taken; a quarter note has at most 32767 ticks
_TEMPOS = (1_000_000, 500_000, 250_000, 200_000, 125_000, 100_000, 50_000, 40_000)


class Take:
    """Messages with the frames before which they came.

    fs : frames per second.
    channels : as the `MidiReceiver` has them that plays it.
    messages : (frame, bytes), in order.
    Raises TonewoodError : a MIDI file has no tempo of which a tick is one frame.
    """

    def __init__(self, fs: int, channels: Collection[int] | None = None):
        self.fs, self.channels = fs, channels
        self.messages: list[tuple[int, bytes]] = []
        tempos = [t for t in _TEMPOS if (fs * t) % 1_000_000 == 0 and fs * t // 1_000_000 <= 32767]
        if not tempos:
            raise TonewoodError(f"a take at {fs} Hz has no tempo of whole frames; e.g. 44100 or 48000 has", key="--fs")
        self._tempo = tempos[0]
        #: messages as they stand in the file, their number, and the frame of the last
        self._encoded, self._n_encoded, self._frame = bytearray(), 0, 0

    def add(self, frame: int, message: Sequence[int]) -> None:
        """Add a channel message that came before a frame; others, and damaged ones, are left out.

        Each byte of the file depends on those before: one that is missing or added would change all later messages.
        """
        if (whole := channel_message(message)) is not None:
            self.messages.append((frame, whole))

    def save(self, path: str | os.PathLike[str], live: Live, frames: int) -> None:
        """Write a MIDI file, of a length in frames; whole or not at all, and again whenever there are more messages.

        Raises OutputError : it cannot be written.
        """
        name = live.instrument.spec.name
        chosen = "" if self.channels is None else f"channels={' '.join(map(str, sorted(self.channels)))}; "
        settings = f"fs={live.fs}; ramp={live.ramp!r}; spacing={live.player.spacing}"
        title = f"{_HEADING}; {settings}; {chosen}instrument={name}".encode()
        track = b"\x00\xff\x03" + _variable_length(len(title)) + title
        track += b"\x00\xff\x51\x03" + self._tempo.to_bytes(3, "big")
        n = len(self.messages)  # others may come meanwhile, in another thread
        for frame, data in self.messages[self._n_encoded : n]:
            self._encoded += _later(frame - self._frame) + data
            self._frame = frame
        self._n_encoded = n
        track += self._encoded + _later(max(frames - self._frame, 0)) + b"\xff\x2f\x00"
        ticks = self.fs * self._tempo // 1_000_000
        header = b"MThd\x00\x00\x00\x06\x00\x00\x00\x01" + ticks.to_bytes(2, "big")
        write_whole(path, header + b"MTrk" + len(track).to_bytes(4, "big") + track)


def _variable_length(value: int) -> bytes:
    out = [value & 0x7F]
    while value := value >> 7:
        out.append(value & 0x7F | 0x80)
    return bytes(reversed(out))


def _later(ticks: int) -> bytes:
    """Ticks before an event; more than a file has for one follow empty texts."""
    wait, rest = divmod(ticks, _LONGEST)
    return wait * (_variable_length(_LONGEST) + b"\xff\x01\x00") + _variable_length(rest)


def _settings(title: str) -> dict[str, str]:
    """Settings in the name of a take's track; none of another file."""
    heading, *parts = (part.strip() for part in title.split(";"))
    return dict(part.split("=", 1) for part in parts if "=" in part) if heading == _HEADING else {}


#: least and largest value of the settings of a take
_RANGES = {"fs": (8000.0, 768000.0), "ramp": (0.0, 1.0), "spacing": (0.0, 1e6)}


def _number(settings: dict[str, str], name: str, default: float, path: str | os.PathLike[str]) -> float:
    """Return the number of a setting; raises a `TonewoodError` where it is none, or out of its range."""
    text, (least, most) = settings.get(name, str(default)), _RANGES[name]
    if least <= (value := number_in(text)) <= most:
        return value
    reason = f"the take has the value {text[:40]!r}; a number from {least:g} to {most:g} is needed"
    raise TonewoodError(reason, file=path, key=name)


class Replay:
    """Plays a MIDI file as if it were coming in live: no note knows those that follow.

    A take gives the samples that were heard when it was recorded, to the last bit, with the same options, and
    its own ramp and spacing; so is its sampling rate where none is given.

    path : a take, or any MIDI file.
    instrument, fs, options : as for `Renderer`, single options as keywords too. After the last message the tail is as
        for a score.
    channels : as for `MidiReceiver`; those of the take where left out.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        instrument: InstrumentLike,
        fs: float | None = None,
        *,
        options: RenderOptions | None = None,
        channels: Collection[int] | None = None,
        **settings: Any,
    ):
        messages, end, texts = read_messages(path)
        recorded_settings = _settings(texts.get("title", ""))
        options = RenderOptions.of(options, fs, settings)
        recorded = _number(recorded_settings, "fs", options.fs, path)
        if "fs" not in options.model_fields_set and "fs" in recorded_settings:
            options = options.at(fs=int(recorded))
        wrong = [name for name in ("lead_in", "energy", "room") if getattr(options, name)]
        if wrong:
            raise TonewoodError("needs a score that is known before; a replay is played as it comes", key=wrong[0])
        defaults = RenderOptions()
        ended = {name: getattr(defaults, name) for name in ("tail", "tail_level_db", "max_duration")}
        self.live = Live(
            instrument,
            ramp=_number(recorded_settings, "ramp", 5e-3, path),
            spacing=int(_number(recorded_settings, "spacing", 2, path)),
            prepare=False,
            options=options.at(**ended),
        )
        played = [int(word) for word in recorded_settings.get("channels", "").split() if word.isdecimal()]
        self.receiver = MidiReceiver(self.live, channels or played or None)
        self.options, self.fs, self.path = options, options.fs, Path(path)
        self._messages = [(round(time * self.fs), (status, a, b)) for time, status, a, b in messages]
        self._end = round(end * self.fs)
        self.model, self.energy = self.live.model, None
        self._warnings = (
            [] if recorded == self.fs else [f"recorded at {recorded:.0f} Hz: its samples are those at that rate"]
        )
        self._over, self._loudest = "", 0.0

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the output channels."""
        return self.live.channels

    @property
    def time(self) -> float:
        """Time reached, s."""
        return self.live.time

    @property
    def expected_duration(self) -> float:
        """Upper bound of the length, s."""
        longest = self._end / self.fs + self.options.tail
        return longest if self.options.max_duration is None else min(longest, self.options.max_duration)

    @property
    def dropped(self) -> tuple[Dropped, ...]:
        """The last notes that could not be played, at most 100, and why."""
        return tuple(self.live.summary().latest_dropped)

    def blocks(self, block_size: int = 1024) -> Iterator[Floats]:
        """Yield blocks until the sound has decayed after the last message."""
        most, due = round(self.expected_duration * self.fs), 0
        recent: list[float] = []
        while self.live.frames < most:
            frame = self.live.frames
            while due < len(self._messages) and self._messages[due][0] <= frame:
                self.receiver.receive(self._messages[due][1])
                due += 1
            until = min(self._messages[due][0] if due < len(self._messages) else most, frame + block_size, most)
            block = self.live.process(until - frame)
            yield block
            peak = float(np.abs(block).max(initial=0.0))
            self._loudest = max(self._loudest, peak)
            if frame < self._end or due < len(self._messages):
                continue
            recent.append(peak)
            window = -(-round(0.2 * self.fs) // block_size) + 1
            del recent[:-window]
            if len(recent) == window and max(recent) <= self._loudest * 10 ** (self.options.tail_level_db / 20):
                self._over = "decayed"
                return
        capped = self.options.max_duration is not None and most == round(self.options.max_duration * self.fs)
        self._over = "maximum duration" if capped else "tail cap"

    def summary(self) -> Summary:
        """Return the summary of the frames so far."""
        totals = self.live.summary()
        cut = [f"{totals.cut} notes end early: their string is needed again"] if totals.cut else []
        return Summary(
            frames=totals.frames,
            fs=self.fs,
            duration_s=totals.frames / self.fs,
            render_s=totals.process_s,
            realtime_factor=totals.frames / self.fs / totals.process_s if totals.process_s > 0 else 0.0,
            n_modes=self.model.n_modes,
            notes=totals.notes,
            notes_dropped=totals.latest_dropped,
            peak_dbfs=totals.peak_dbfs if totals.frames else decibels(0.0),
            end=self._over or "not ended",
            warnings=[*self.model.warnings, *self._warnings, *cut, *silence(self._loudest, ended=bool(self._over))],
            effects=totals.effects,
            ignored={**totals.ignored, **self.receiver.ignored},
        )
