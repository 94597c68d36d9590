"""``tonewood play --midi-in`` and ``--keyboard``: an instrument played live."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tonewood.cli.common import print_json, warn, warn_of_kinds
from tonewood.errors import OutputError, TonewoodError
from tonewood.performance.score.smf import MAX_MESSAGES
from tonewood.support.units import counted

if TYPE_CHECKING:
    from tonewood.instrument.bundle.loading import Instrument
    from tonewood.sound.live.instrument import Live
    from tonewood.sound.live.ports import EventSource
    from tonewood.sound.live.session import LiveSession
    from tonewood.sound.live.stream import Playback
    from tonewood.sound.live.take import Take
    from tonewood.sound.render.options import RenderOptions

#: velocity of the chord of all open strings whose peak is brought near full scale
_LOUD = 110
#: s
_KEPT_EVERY = 1.0


def play_live(
    instrument: Instrument,
    options: RenderOptions,
    *,
    port: str | None,
    keyboard: bool,
    record: Path | None,
    block_size: int,
    ahead: int,
    ramp: float,
    spacing: int,
    duration: float | None,
    device: Any,
    calibrated: bool,
    channels: list[int] | None,
    as_json: bool,
    stream: Any = None,
) -> None:
    """Play until Ctrl-C, Esc on the computer's keys, or `duration` s; then print the notes played and dropped."""
    from tonewood.sound.live.instrument import Live
    from tonewood.sound.live.keyboard import HELP, ComputerKeyboard
    from tonewood.sound.live.ports import MidiInput
    from tonewood.sound.live.session import LiveSession
    from tonewood.sound.live.take import Take
    from tonewood.sound.render.level import meaning

    take = Take(options.fs, channels) if record is not None else None
    if record is not None:
        _check_record(record)
    sources: list[EventSource] = []
    try:
        if port is not None:
            sources.append(MidiInput("" if port == "first" else port))
        if not calibrated:
            options = options.at(gain_db=round(_gain(instrument, options), 1))
        live = Live(instrument, options=options, ramp=ramp, spacing=spacing)
        keys = None
        if keyboard:
            keys = ComputerKeyboard(min(s.open_note for s in live.model.strings.values()))
            sources.append(keys)
        session = LiveSession(live, sources, block_size=block_size, ahead=ahead, take=take, channels=channels)
        if not as_json:
            print(f"{live.instrument.spec.name} played by {' and '.join(s.name for s in sources)}; Ctrl-C ends")
            print(f"  {meaning(live.model.outputs, live.options.gain_db)}")
            if keys is not None:
                print(f"  {HELP}")
        meter, kept = _meter(session, duration, lambda: keys is not None and keys.ended), Kept(take, record, live)

        def wait() -> bool:
            kept.now_and_then()
            return meter()

        try:
            played = session.run(device, stream, wait)
        except BaseException:
            if take is not None and take.messages:
                kept.save()
            raise
        kept.save()
    finally:
        for source in sources:
            source.close()
    _tell(session, played, record, as_json=as_json)


class Kept:
    """Keeps a take on disk while it is recorded: a program that is killed loses the last second."""

    def __init__(self, take: Take | None, record: Path | None, live: Live):
        self._take, self._record, self._live = take, record, live
        self._at, self._n, self._said = time.monotonic(), 0, set[str]()

    def now_and_then(self) -> None:
        """Save messages of the last second; where they cannot be written, say so once: `save` tries again."""
        now, n = time.monotonic(), 0 if self._take is None else len(self._take.messages)
        if n > self._n and now - self._at >= _KEPT_EVERY:
            self._at, self._n = now, n
            try:
                self._write()
            except OutputError as fault:
                self._say(f"{fault}; it is tried again until the end")
            if n > MAX_MESSAGES:
                self._say(f"{self._record}: `render --live` reads {MAX_MESSAGES} messages at most; begin another take")

    def _say(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            warn([text])

    def save(self) -> None:
        """Save all; Ctrl-C meanwhile begins it again."""
        try:
            self._write()
        except KeyboardInterrupt:
            self._write()
            raise

    def _write(self) -> None:
        if self._take is not None and self._record is not None:
            self._take.save(self._record, self._live, self._live.frames)


def _check_record(record: Path) -> None:
    """Refuse a file that cannot be written when the session is over."""
    if not record.parent.is_dir():
        raise TonewoodError(f"there is no folder {record.parent}", key="--record")
    if record.is_dir() or not os.access(record if record.exists() else record.parent, os.W_OK):
        raise TonewoodError(f"{record} cannot be written", key="--record")


def _gain(instrument: Instrument, options: RenderOptions) -> float:
    """Gain (dB) that brings a chord of all open strings near full scale."""
    from tonewood.instrument.model.assembly import assemble
    from tonewood.performance.score.note import Note, Score
    from tonewood.sound.render.level import preview_gain

    strings = assemble(instrument, 48000.0).strings
    chord = [Note(0.01 * i, 1.0, string=name, stop=0, velocity_midi=_LOUD) for i, name in enumerate(strings)]
    return preview_gain(Score(chord), instrument, options)


def _meter(session: LiveSession, duration: float | None, ended: Callable[[], bool]) -> Callable[[], bool]:
    """Show the meter on a terminal; returns whether to go on."""
    began, shown = time.monotonic(), [False]

    def wait() -> bool:
        if not shown[0]:
            shown[0] = True
            parts = session.latency
            listed = ", ".join(f"{name} {1e3 * value:.1f}" for name, value in parts.items())
            print(f"  latency {1e3 * sum(parts.values()):.1f} ms: {listed}", file=sys.stderr)
        if sys.stderr.isatty():
            print(f"\r\x1b[K{session.status()[:110]}", end="", file=sys.stderr, flush=True)
        return not ended() and (duration is None or time.monotonic() - began < duration)

    return wait


def _tell(session: LiveSession, played: Playback, record: Path | None, *, as_json: bool) -> None:
    """Print the summary of a session."""
    live = session.live
    summary = live.summary()
    ignored = {**summary.ignored, **session.receiver.ignored}
    dropped = sum(summary.dropped.values())
    if as_json:
        report = {
            "duration_s": played.frames / live.fs,
            "fs": live.fs,
            "block": session.stream.block_size,
            "latency_s": session.latency,
            "underruns": played.underruns,
            "late_blocks": played.late,
            "load": played.load,
            "worst_block_s": played.worst_block_s,
            "clipped": summary.clipped,
            "peak_dbfs": summary.peak_dbfs,
            "gain_db": live.options.gain_db,
            "messages": session.receiver.messages,
            "notes": summary.notes,
            "notes_cut": summary.cut,
            "notes_dropped": dict(summary.dropped),
            "midi_ignored": ignored,
            "record": None if record is None else str(record),
            "effects": [asdict(effect) for effect in summary.effects],
        }
        print_json("play", report)
        return
    if sys.stderr.isatty():
        print(file=sys.stderr)
    if summary.clipped:
        warn([f"{counted(summary.clipped, 'sample')} clipped; lower --gain"])
    warn_of_kinds([f"{count} not played: {reason}" for reason, count in summary.dropped.items()])
    by_device = f" ({played.late} for want of a block, others by the device or system)" if played.underruns else ""
    print(
        f"played {played.frames / live.fs:.2f} s, {counted(summary.notes, 'note')}, {dropped} dropped, "
        f"{summary.cut} ended by another on their string; {counted(played.underruns, 'underrun')}{by_device}"
    )
    length = session.stream.block_size / live.fs
    print(
        f"  load {100 * played.load:.0f} %, worst block {1e3 * played.worst_block_s:.2f} ms of {1e3 * length:.2f} ms; "
        f"peak {summary.peak_dbfs:.1f} dBFS"
    )
    left_out = sorted({e.title for e in summary.effects if e.bound and e.seconds_active < summary.frames / live.fs})
    if left_out:
        print(f"  left out at times within the budget: {', '.join(left_out)}")
    if ignored:
        print(f"  without effect: {', '.join(f'{n} {kind}' for kind, n in ignored.items())}")
    if record is not None:
        print(f"  {record}: {len(session.take.messages) if session.take else 0} messages")
