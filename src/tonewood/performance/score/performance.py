"""MIDI messages in time order, on sixteen channels, to notes with an end, and controls."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from tonewood.performance.score.note import Control
from tonewood.performance.score.smf import Findings

_PERCUSSION = 9
# Bank select, data entry and parameter numbers steer other messages; 120 and up are mode messages.
_NOT_CONTROLS = {0, 32, 6, 38, 96, 97, 98, 99, 100, 101}
_IGNORED_CONTROLLERS = {0: "bank select", 32: "bank select", 96: "data increment", 97: "data decrement"}
#: upper four bits of the status byte
_IGNORED = {0xA0: "polyphonic pressure", 0xC0: "program change", 0xF0: "system exclusive"}
_NO_PARAMETER = (127, 127)
_BEND_RANGE = (0, 0)


@dataclass
class _Channel:
    """State of a MIDI channel between messages; notes are indices into the performance's list."""

    held: dict[int, deque[int]] = field(default_factory=dict)
    pedalled: dict[int, int] = field(default_factory=dict)
    pedal: bool = False
    parameter: tuple[int, int] = _NO_PARAMETER
    bend_range: float = 2.0
    bend: int = 0


class ChannelReader:
    """Plays timed messages on sixteen channels and keeps the notes and controls they make.

    Attributes
    ----------
    notes : (time in s, channel, key, velocity) in time order.
    ends, releases : s, one per note: when it ends, and when its key is released.
    controls : ``bend`` in cents, ``ccN`` from 0 to 1; only changes.
    ignored : (time in s, kind) of messages without effect.
    """

    def __init__(self, findings: Findings):
        self.notes: list[tuple[float, int, int, int]] = []
        self.ends: list[float] = []
        self.releases: list[float] = []
        self.controls: list[Control] = []
        self.ignored: list[tuple[float, str]] = []
        self._findings = findings
        self._latest: dict[tuple[int, str], float] = {}
        self._channels = [_Channel() for _ in range(16)]

    def play(self, messages: Iterable[tuple[float, int, int, int]]) -> None:
        """Take messages (time in s, status, data 1, data 2) in time order."""
        for time, status, a, b in messages:
            number = status & 0x0F
            channel = self._channels[number]
            match status & 0xF0:
                case 0x90 if b:
                    self._note_on(time, number, channel, a, b)
                case 0x80 | 0x90:
                    self._note_off(time, number, channel, a)
                case 0xB0 if a < 120:
                    self._controller(time, number, channel, a, b)
                case 0xB0:
                    self._mode_message(time, number, channel, a)
                case 0xE0:
                    channel.bend = (b << 7 | a) - 8192
                    self._bend(time, number, channel)
                case 0xD0:
                    self._control(time, number, "channel_pressure", a / 127)
                case kind:
                    self.ignored.append((time, _IGNORED[kind]))

    def finish(self, time: float) -> None:
        """End notes that still sound at the end of a pattern; controllers and bends keep their values."""
        for number, channel in enumerate(self._channels):
            for key, notes in channel.held.items():
                for _ in notes:
                    self._findings.add("note never ended, ended with the track", where(number, key, time))
            if channel.pedal:
                self._control(time, number, "cc64", 0.0)
            if channel.pedalled:
                self._findings.add("pedal never released, released with the track", f"channel {number + 1}")
            self._silence(time, channel)
            channel.pedal = False

    def _note_on(self, time: float, number: int, channel: _Channel, key: int, velocity: int) -> None:
        if key in channel.pedalled:
            self.ends[channel.pedalled.pop(key)] = time
        held = channel.held.setdefault(key, deque())
        if held:
            self._findings.add("key struck again before its note-off", where(number, key, time))
        if number == _PERCUSSION:
            self._findings.add("channel 10, percussion by General MIDI, is read as pitches")
        held.append(len(self.notes))
        self.notes.append((time, number, key, velocity))
        self.ends.append(time)
        self.releases.append(time)

    def _note_off(self, time: float, number: int, channel: _Channel, key: int) -> None:
        held = channel.held.get(key)
        if not held:
            self._findings.add("note-off without a note, ignored", where(number, key, time))
            return
        self._release(time, channel, key, held.popleft())

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
        for key, notes in channel.held.items():
            for note in notes:
                self._release(time, channel, key, note)
        channel.held.clear()

    def _silence(self, time: float, channel: _Channel) -> None:
        """End every note, held by key or pedal; the pedal keeps its position."""
        self._all_notes_off(time, channel)
        self._end_pedalled(time, channel)

    def _controller(self, time: float, number: int, channel: _Channel, a: int, b: int) -> None:
        if a == 64 and b >= 64:
            channel.pedal = True
        elif a == 64:
            self._lift_pedal(time, channel)
        elif a in (98, 99):  # a non-registered parameter: data entry is ignored until a registered one is chosen
            channel.parameter = _NO_PARAMETER
        elif a in (100, 101):
            low, high = channel.parameter
            channel.parameter = (b, high) if a == 100 else (low, b)
        elif a in (6, 38):
            self._data_entry(time, number, channel, a, b)
        elif a in _IGNORED_CONTROLLERS:
            self.ignored.append((time, _IGNORED_CONTROLLERS[a]))
        if a not in _NOT_CONTROLS:
            self._control(time, number, f"cc{a}", b / 127)

    def _data_entry(self, time: float, number: int, channel: _Channel, a: int, b: int) -> None:
        if channel.parameter == _BEND_RANGE:
            channel.bend_range = float(b) if a == 6 else int(channel.bend_range) + b / 100
            self._bend(time, number, channel)
        elif channel.parameter in ((1, 0), (2, 0)):
            self._findings.add("channel tuning (registered parameters 1 and 2) is not read", f"channel {number + 1}")
        else:
            self.ignored.append((time, "data entry of a parameter that is not read"))

    def _mode_message(self, time: float, number: int, channel: _Channel, a: int) -> None:
        if a == 120:
            self._silence(time, channel)
        elif a == 121:  # RP-015 resets neither the volume nor the range of the bend
            self._lift_pedal(time, channel)
            channel.parameter = _NO_PARAMETER
            channel.bend = 0
            self._bend(time, number, channel)
            for kind, value in (("cc1", 0.0), ("cc11", 1.0), ("cc64", 0.0)):
                if (number, kind) in self._latest:
                    self._control(time, number, kind, value)
        elif a == 122:
            self.ignored.append((time, "local control"))
        else:
            self._all_notes_off(time, channel)

    def _bend(self, time: float, number: int, channel: _Channel) -> None:
        self._control(time, number, "bend", channel.bend / 8192 * channel.bend_range * 100)

    def _control(self, time: float, number: int, kind: str, value: float) -> None:
        if self._latest.get((number, kind), 0.0 if kind == "bend" else None) != value:
            self._latest[number, kind] = value
            self.controls.append(Control(time, kind, value, number))


def where(channel: int, key: int, time: float) -> str:
    """Name a note for a person, who counts channels from 1."""
    return f"channel {channel + 1}, note {key} at {time:.3f} s"
