"""Turn MIDI messages in time order, on sixteen channels, into notes with an end, and controls."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TypeVar

from tonewood.errors import ScoreError
from tonewood.performance.score.channels import STEERING, TUNING, MidiChannels
from tonewood.performance.score.note import Control
from tonewood.performance.score.smf import Findings

_T = TypeVar("_T")
#: changes of controllers and bends; and further channels that messages of a master channel reach in all
MAX_CONTROLS = 600_000
_PERCUSSION = 9
#: finding: how a score says that notes are left out
DRUM = "note of channel 10, percussion by General MIDI, left out (--tracks 10 plucks them)"
#: upper four bits of the status byte
_IGNORED = {0xA0: "polyphonic pressure", 0xC0: "program change", 0xF0: "system exclusive"}


@dataclass
class _Channel:
    """State of a MIDI channel between messages; notes are indices into the performance's list."""

    pressed: dict[int, deque[int]] = field(default_factory=dict)
    pedalled: dict[int, int] = field(default_factory=dict)
    pedal: bool = False
    program: int | None = None


class ChannelReader:
    """Plays timed messages on sixteen channels and keeps the notes and controls they make.

    findings : takes oddities.
    file : for errors.
    percussion : whether notes of channel 10 are read.
    notes : (time in s, channel, key, velocity) in time order.
    programs : of General MIDI, from 1, one per note; None before the first of its channel.
    n_drums : notes of channel 10 that were left out.
    ends, releases : s, one per note: when it ends, and when its key is released.
    controls : ``bend`` in cents, ``ccN`` from 0 to 1; only changes.
    ignored : (time in s, kind) of messages without effect.
    """

    def __init__(self, findings: Findings, file: str | os.PathLike[str], *, percussion: bool):
        self.programs: list[int | None] = []
        self.n_drums = 0
        self._percussion = percussion
        self.notes: list[tuple[float, int, int, int]] = []
        self.ends: list[float] = []
        self.releases: list[float] = []
        self.controls: list[Control] = []
        self.ignored: list[tuple[float, str]] = []
        self._findings, self._file = findings, file
        self._n_reached = 0
        self._latest: dict[tuple[int, str], float] = {}
        self._channels = [_Channel() for _ in range(16)]
        self._midi = MidiChannels()

    @property
    def zones(self) -> dict[int, list[int]]:
        """Master channel -> member channels, of zones of MPE at the end."""
        return self._midi.zones

    def play(self, messages: Iterable[tuple[float, int, int, int]]) -> None:
        """Take messages (time in s, status, data 1, data 2) in time order.

        Raises ScoreError : more than `MAX_CONTROLS` changes, or channels reached by masters.
        """
        for time, status, a, b in messages:
            number = status & 0x0F
            channel = self._channels[number]
            match status & 0xF0:
                case 0x90 if b:
                    self._note_on(time, number, channel, a, b)
                case 0x80 | 0x90:
                    self._note_off(time, number, channel, a)
                case 0xB0 if a in STEERING:
                    self._steer(time, number, a, b)
                case 0xB0:
                    for at in self._counted(self._midi.reached(number)):
                        self._controller(time, at, a, b)
                    self._bend(time)
                case 0xE0:
                    self._midi.wheel(number, a, b)
                    self._bend(time)
                case 0xC0:
                    for at in self._counted(self._midi.reached(number)):
                        self._channels[at].program = a + 1
                    self.ignored.append((time, _IGNORED[0xC0]))  # by an instrument that is given
                case 0xD0:
                    for at in self._counted(self._midi.reached(number)):
                        self._control(time, at, "channel_pressure", a / 127)
                case kind:
                    self.ignored.append((time, _IGNORED[kind]))

    def finish(self, time: float) -> None:
        """End notes that still sound at the end of a pattern; controllers and bends keep their values."""
        for number, channel in enumerate(self._channels):
            for key, notes in channel.pressed.items():
                for _ in notes:
                    self._findings.add("note never ended, ended with the track", where(number, key, time))
            if channel.pedal:
                self._control(time, number, "cc64", 0.0)
            if channel.pedalled:
                self._findings.add("pedal never released, released with the track", f"channel {number + 1}")
            self._silence(time, channel)
            channel.pedal = False

    def _is_drum(self, number: int) -> bool:
        return number == _PERCUSSION and not self._percussion and not self._midi.is_member(number)

    def _note_on(self, time: float, number: int, channel: _Channel, key: int, velocity: int) -> None:
        if self._is_drum(number):
            self.n_drums += 1
            self._findings.add(DRUM, where(number, key, time))
            return
        if key in channel.pedalled:
            self.ends[channel.pedalled.pop(key)] = time
        indices = channel.pressed.setdefault(key, deque())
        if indices:
            self._findings.add("key struck again before its note-off", where(number, key, time))
        indices.append(len(self.notes))
        self.notes.append((time, number, key, velocity))
        self.ends.append(time)
        self.releases.append(time)
        self.programs.append(channel.program)

    def _note_off(self, time: float, number: int, channel: _Channel, key: int) -> None:
        indices = channel.pressed.get(key)
        if not indices and self._is_drum(number):
            return
        if not indices:
            self._findings.add("note-off without a note, ignored", where(number, key, time))
            return
        self._release(time, channel, key, indices.popleft())

    def _release(self, time: float, channel: _Channel, key: int, note: int) -> None:
        """Release a key: its note ends, or is left to the pedal, which holds one note per key."""
        self.ends[note] = self.releases[note] = time
        if channel.pedal:
            if key in channel.pedalled:
                self.ends[channel.pedalled[key]] = time
            channel.pedalled[key] = note

    def _lift_pedal(self, time: float, channel: _Channel) -> None:
        self._end_pedalled(time, channel)
        channel.pedal = False

    def _end_pedalled(self, time: float, channel: _Channel) -> None:
        for note in channel.pedalled.values():
            self.ends[note] = time
        channel.pedalled.clear()

    def _all_notes_off(self, time: float, channel: _Channel) -> None:
        for key, notes in channel.pressed.items():
            for note in notes:
                self._release(time, channel, key, note)
        channel.pressed.clear()

    def _silence(self, time: float, channel: _Channel) -> None:
        """End every note, held by key or pedal; the pedal keeps its position."""
        self._all_notes_off(time, channel)
        self._end_pedalled(time, channel)

    def _steer(self, time: float, number: int, a: int, b: int) -> None:
        kind = self._midi.steer(number, a, b)
        if kind == TUNING:
            self._findings.add("channel tuning (registered parameters 1 and 2) is not read", f"channel {number + 1}")
        elif kind:
            self.ignored.append((time, kind))
        self._bend(time)

    def _controller(self, time: float, number: int, a: int, b: int) -> None:
        channel = self._channels[number]
        if a >= 120:
            self._mode_message(time, number, channel, a)
            return
        if a == 64 and b >= 64:
            channel.pedal = True
        elif a == 64:
            self._lift_pedal(time, channel)
        self._control(time, number, f"cc{a}", b / 127)

    def _mode_message(self, time: float, number: int, channel: _Channel, a: int) -> None:
        if a == 120:
            self._silence(time, channel)
        elif a == 121:
            self._lift_pedal(time, channel)
            self._midi.reset(number)
            for kind, value in (("cc1", 0.0), ("cc11", 1.0), ("cc64", 0.0)):
                if (number, kind) in self._latest:
                    self._control(time, number, kind, value)
        elif a == 122:
            self.ignored.append((time, "local control"))
        else:
            self._all_notes_off(time, channel)

    def _bend(self, time: float) -> None:
        for number, cents in self._counted(self._midi.bends()):
            self._control(time, number, "bend", cents)

    def _counted(self, reached: list[_T]) -> list[_T]:
        """Count the channels that a message reaches: a master reaches sixteen, even where it changes nothing."""
        self._n_reached += max(len(reached) - 1, 0)
        if self._n_reached > MAX_CONTROLS:
            raise self._too_many()
        return reached

    def _too_many(self) -> ScoreError:
        return ScoreError(f"more than {MAX_CONTROLS} changes of controllers and bends", file=self._file)

    def _control(self, time: float, number: int, kind: str, value: float) -> None:
        if self._latest.get((number, kind), 0.0 if kind == "bend" else None) != value:
            self._latest[number, kind] = value
            self.controls.append(Control(time, kind, value, number))
            if len(self.controls) > MAX_CONTROLS:
                raise self._too_many()


def where(channel: int, key: int, time: float) -> str:
    """Name a note for a person, who counts channels from 1."""
    return f"channel {channel + 1}, note {key} at {time:.3f} s"
