"""Small MIDI files put together event by event, at 1000 ticks per second, as odd as wanted."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

Event = tuple[float, tuple[int, ...]]


def on(time: float, note: int, velocity: int = 80, channel: int = 0) -> Event:
    return (time, (0x90 | channel, note, velocity))


def off(time: float, note: int, channel: int = 0) -> Event:
    return (time, (0x80 | channel, note, 64))


def control(time: float, number: int, value: int, channel: int = 0) -> Event:
    return (time, (0xB0 | channel, number, value))


def bend(time: float, value: int, channel: int = 0) -> Event:
    """`value` from -8192 to 8191."""
    raw = value + 8192
    return (time, (0xE0 | channel, raw & 0x7F, raw >> 7))


def bend_range(semitones: int, time: float = 0.0, channel: int = 0) -> list[Event]:
    return [control(time, number, value, channel) for number, value in ((101, 0), (100, 0), (6, semitones), (38, 0))]


def note(time: float, duration: float, number: int, velocity: int = 80, channel: int = 0) -> list[Event]:
    return [on(time, number, velocity, channel), off(time + duration, number, channel)]


def _length(value: int) -> bytes:
    out = [value & 0x7F]
    while value := value >> 7:
        out.append(value & 0x7F | 0x80)
    return bytes(reversed(out))


def midi_file(events: Iterable[Event]) -> bytes:
    """Format 0, 500 ticks per quarter at 120 quarters per minute; events of one time stay in their order."""
    body, now = b"", 0
    for time, message in sorted(events, key=lambda e: round(1000 * e[0])):
        tick = round(1000 * time)
        body += _length(tick - now) + bytes(message)
        now = tick
    body += b"\x00\xff\x2f\x00"
    head = b"MThd" + (6).to_bytes(4, "big") + (0).to_bytes(2, "big") + (1).to_bytes(2, "big") + (500).to_bytes(2, "big")
    return head + b"MTrk" + len(body).to_bytes(4, "big") + body


def write(path: Path, events: Iterable[Event]) -> Path:
    path.write_bytes(midi_file(events))
    return path
